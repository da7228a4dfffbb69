//! Records of the input and options of each stage, from which a later run decides whether to keep,
//! to resume or to reject the stage.
//!
//! The database holds the records of the two stages whose results it holds, written in the
//! transactions that change them; `stages.json` holds those of all stages. If they differ, the
//! database takes precedence.
//!
//! The input of the first stage is a fingerprint of the photos; that of a later stage is the
//! fingerprint of the stage before it. Options are kept as texts by key
//! ([`crate::stages::option_keys`]), so that error messages can name a difference. Records of
//! another format are refused.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tiepoint_input::cameras::FOUND;
use tiepoint_io::database::StageRow;
use tiepoint_store::{Error as StoreError, require_regular_file};

use crate::workspace::format;
use crate::workspace::option_names::{NONE, difference};
use crate::{Error, Stage};

/// Stages whose results are in the database.
const IN_DATABASE: [Stage; 2] = [Stage::Features, Stage::Match];
/// Longer option values are not quoted in error messages.
const MAX_QUOTED: usize = 48;
/// Error messages name at most this number of options that differ.
const MAX_NAMED: usize = 3;

/// Input and options of a stage, which determine its result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub(crate) struct Recipe {
    /// Fingerprint of the photos, or of the previous stage.
    pub(crate) input: String,
    /// Options by key, without those that are not given: so a new option does not change existing
    /// records.
    pub(crate) options: BTreeMap<String, String>,
}

impl Recipe {
    pub(crate) fn new(
        input: String,
        options: impl IntoIterator<Item = (impl Into<String>, String)>,
    ) -> Self {
        let given = options.into_iter().filter(|(_, value)| value != NONE);
        Self { input, options: given.map(|(key, value)| (key.into(), value)).collect() }
    }

    /// Fingerprint of the stage, which is the input of the next one.
    pub(crate) fn fingerprint(&self) -> String {
        let mut hash = blake3::Hasher::new();
        let words = self.options.iter().flat_map(|(name, value)| [name, value]);
        for word in std::iter::once(&self.input).chain(words) {
            hash.update(&(word.len() as u64).to_le_bytes()).update(word.as_bytes());
        }
        hash.finalize().to_hex().to_string()
    }

    /// Difference between this recorded recipe and the one that is asked for, as the end of the
    /// sentence "they were made …"; `None` if they are equal.
    pub(crate) fn difference(&self, asked: &Self, stage: Stage) -> Option<String> {
        // What was found follows from the photos and the other options.
        let keys: BTreeSet<&String> = self.options.keys().chain(asked.options.keys()).collect();
        let changed = keys
            .into_iter()
            .filter(|key| !key.starts_with(FOUND))
            .filter(|key| self.options.get(*key) != asked.options.get(*key));
        let changed: Vec<String> = changed.map(|key| self.changed_option(asked, key)).collect();
        if !changed.is_empty() {
            let named = changed[..changed.len().min(MAX_NAMED)].join(", ");
            // Options that come with the photos, as their times, differ with them.
            let input = match stage {
                Stage::Features if self.input != asked.input => "from other photos, and ",
                _ => "",
            };
            return Some(match changed.len().saturating_sub(MAX_NAMED) {
                0 => format!("{input}with {named}"),
                more => format!("{input}with {named}, and {more} more that differ"),
            });
        }
        (self.input != asked.input).then(|| match stage {
            Stage::Features => "from other photos, or photos have changed since".to_owned(),
            Stage::Match => "from other features than the current ones".to_owned(),
            Stage::Map => "from other matches than the current ones".to_owned(),
            Stage::Dense => "from other models or masks than the current ones".to_owned(),
        })
    }

    fn changed_option(&self, asked: &Self, key: &str) -> String {
        let value =
            |recipe: &Self| recipe.options.get(key).cloned().unwrap_or_else(|| NONE.to_owned());
        let (was, is) = (value(self), value(asked));
        if was.len().max(is.len()) <= MAX_QUOTED {
            difference(key, &was, &is)
        } else {
            format!("another `{key}`")
        }
    }
}

/// The state of a stage on disk.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
struct Record {
    is_complete: bool,
    #[serde(flatten)]
    recipe: Recipe,
}

/// How to run a stage, given the state on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Progress {
    /// From the start.
    Begin,
    /// Resume an incomplete stage.
    Continue,
    /// Not at all: the stage is complete.
    Kept,
}

/// The content of `stages.json`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub(crate) struct Records {
    /// Input folders of the photos.
    pub(crate) inputs: Vec<PathBuf>,
    /// What stages read beside the photos: videos, calibrations, times. Those of earlier runs stay
    /// in the list, as no result may replace them.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub(crate) sources: BTreeSet<PathBuf>,
    stages: BTreeMap<Stage, Record>,
}

impl Records {
    /// Reads the file; `None` if it does not exist.
    ///
    /// # Errors
    ///
    /// The file cannot be read, is damaged or has another format.
    pub(crate) fn read(path: &Path) -> Result<Option<Self>, Error> {
        let broken = |what: String| Error::BrokenRecord { path: path.to_owned(), what };
        require_regular_file(path)?;
        let text = match std::fs::read(path) {
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(cause) => {
                return Err(StoreError::Unreadable { path: path.to_owned(), cause }.into());
            }
            Ok(text) => text,
        };
        format::from_json(path, &text, broken).map(Some)
    }

    pub(crate) fn to_json(&self) -> Vec<u8> {
        format::to_json(self)
    }

    /// The records for the database.
    pub(crate) fn rows(&self) -> Vec<StageRow> {
        let row = |stage: &Stage| {
            let Record { is_complete, recipe } = self.stages.get(stage)?;
            let recipe = String::from_utf8(format::to_json(recipe)).ok()?;
            Some(StageRow { stage: stage.name().to_owned(), is_complete: *is_complete, recipe })
        };
        IN_DATABASE.iter().filter_map(row).collect()
    }

    /// Replaces the records of stages in the database by those in the database at `path`. The
    /// record of the models is removed if they were computed from other matches.
    ///
    /// # Errors
    ///
    /// A record has another format.
    pub(crate) fn take_rows(&mut self, path: &Path, rows: &[StageRow]) -> Result<(), Error> {
        let broken = |what| Error::BrokenRecord { path: path.to_owned(), what };
        let mut stages = BTreeMap::new();
        for stage in IN_DATABASE {
            let Some(row) = rows.iter().find(|row| row.stage == stage.name()) else { continue };
            match format::from_json(path, row.recipe.as_bytes(), broken) {
                Ok(recipe) => {
                    stages.insert(stage, Record { is_complete: row.is_complete, recipe });
                }
                // The stage has no record.
                Err(Error::BrokenRecord { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        self.forget_database();
        self.stages.append(&mut stages);
        let made_from = self.stages.get(&Stage::Map).map(|record| record.recipe.input.clone());
        let matches = self.stages.get(&Stage::Match).filter(|record| record.is_complete);
        if made_from.is_some() && made_from != matches.map(|record| record.recipe.fingerprint()) {
            self.forget_from(Stage::Map);
        }
        Ok(())
    }

    /// Removes the records of stages in a database that no longer exists. That of the models stays.
    pub(crate) fn forget_database(&mut self) {
        IN_DATABASE.iter().for_each(|stage| drop(self.stages.remove(stage)));
    }

    /// Whether a stage was begun.
    pub(crate) fn is_begun(&self, stage: Stage) -> bool {
        self.stages.contains_key(&stage)
    }

    /// Whether a stage is complete.
    pub(crate) fn is_complete(&self, stage: Stage) -> bool {
        self.stages.get(&stage).is_some_and(|record| record.is_complete)
    }

    /// Decides how to run a stage with a recipe. A stage that runs from the start gets a new
    /// record, and the records of later stages are removed.
    ///
    /// # Errors
    ///
    /// The stage was run with another recipe, and `redo` does not name it.
    pub(crate) fn begin(
        &mut self,
        workspace: &Path,
        stage: Stage,
        recipe: &Recipe,
        redo: Option<Stage>,
    ) -> Result<Progress, Error> {
        if redo != Some(stage)
            && let Some(record) = self.stages.get(&stage)
        {
            return match record.recipe.difference(recipe, stage) {
                Some(how) => Err(Error::Changed { path: workspace.to_owned(), stage, how }),
                None if record.is_complete => Ok(Progress::Kept),
                None => Ok(Progress::Continue),
            };
        }
        self.forget_from(stage);
        self.stages.insert(stage, Record { is_complete: false, recipe: recipe.clone() });
        Ok(Progress::Begin)
    }

    /// Whether a stage is complete with a recipe.
    ///
    /// # Errors
    ///
    /// The stage was run with another recipe.
    pub(crate) fn is_kept(
        &self,
        workspace: &Path,
        stage: Stage,
        recipe: &Recipe,
    ) -> Result<bool, Error> {
        Ok(self.clone().begin(workspace, stage, recipe, None)? == Progress::Kept)
    }

    /// Removes the records of a stage and of the later ones.
    pub(crate) fn forget_from(&mut self, stage: Stage) {
        self.stages.retain(|other, _| *other < stage);
    }

    /// Marks a stage as complete.
    pub(crate) fn complete(&mut self, stage: Stage) {
        if let Some(record) = self.stages.get_mut(&stage) {
            record.is_complete = true;
        }
    }

    /// Marks a stage as incomplete, and removes the records of later ones: another version of the
    /// program may give other results.
    pub(crate) fn reopen(&mut self, stage: Stage) {
        if let Some(record) = self.stages.remove(&stage) {
            self.forget_from(stage);
            self.stages.insert(stage, Record { is_complete: false, ..record });
        }
    }

    /// The value of an option in the record of a stage; `None` if it was not given.
    pub(crate) fn option(&self, stage: Stage, key: &str) -> Option<&str> {
        self.stages.get(&stage)?.recipe.options.get(key).map(String::as_str)
    }

    /// The fingerprint of a complete stage.
    ///
    /// # Errors
    ///
    /// [`Error::Missing`] if the stage is not complete.
    pub(crate) fn fingerprint(&self, workspace: &Path, stage: Stage) -> Result<String, Error> {
        match self.stages.get(&stage) {
            Some(record) if record.is_complete => Ok(record.recipe.fingerprint()),
            _ => Err(Error::Missing { path: workspace.to_owned(), stage }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(input: &str, pairs: &str) -> Recipe {
        Recipe::new(
            input.to_owned(),
            [("match.pairs", pairs.to_owned()), ("match.seed", "0".to_owned())],
        )
    }

    #[test]
    fn stage_is_begun_resumed_and_kept() {
        let (dir, mut records) = (Path::new("ws"), Records::default());
        let asked = recipe("a", "exhaustive");
        assert_eq!(records.begin(dir, Stage::Match, &asked, None).unwrap(), Progress::Begin);
        assert!(matches!(records.fingerprint(dir, Stage::Match), Err(Error::Missing { .. })));
        assert_eq!(records.begin(dir, Stage::Match, &asked, None).unwrap(), Progress::Continue);
        records.complete(Stage::Match);
        assert_eq!(records.begin(dir, Stage::Match, &asked, None).unwrap(), Progress::Kept);
        assert_eq!(
            records.begin(dir, Stage::Match, &asked, Some(Stage::Match)).unwrap(),
            Progress::Begin
        );
    }

    #[test]
    fn difference_is_named_and_stage_is_redone_on_request() {
        let (dir, mut records) = (Path::new("ws"), Records::default());
        records.begin(dir, Stage::Match, &recipe("a", "exhaustive"), None).unwrap();
        records.begin(dir, Stage::Map, &recipe("b", "-"), None).unwrap();
        let error =
            records.begin(dir, Stage::Match, &recipe("a", "sequential:5"), None).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the matches in ws were made with `match.pairs` exhaustive and not sequential:5: give \
            `stage.redo` match to make them again, or choose another workspace"
        );
        let error = records.begin(dir, Stage::Match, &recipe("c", "exhaustive"), None).unwrap_err();
        assert!(error.to_string().contains("from other features"), "{error}");
        let mut photos = Records::default();
        photos.begin(dir, Stage::Features, &recipe("a", "0"), None).unwrap();
        let error = photos.begin(dir, Stage::Features, &recipe("b", "1"), None).unwrap_err();
        assert!(error.to_string().contains("from other photos, and with `match.pairs`"), "{error}");
        let redone =
            records.begin(dir, Stage::Match, &recipe("a", "sequential:5"), Some(Stage::Match));
        assert_eq!(redone.unwrap(), Progress::Begin);
        // The record of the later stage is removed.
        assert_eq!(
            records.begin(dir, Stage::Map, &recipe("b", "-"), None).unwrap(),
            Progress::Begin
        );
    }

    #[test]
    fn fingerprint_depends_on_boundaries_between_words() {
        let one = Recipe::new("ab".to_owned(), [("c", String::new())]);
        let other = Recipe::new("a".to_owned(), [("bc", String::new())]);
        assert_ne!(one.fingerprint(), other.fingerprint());
    }

    #[test]
    fn file_round_trips_and_a_damaged_one_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("stages.json");
        assert!(Records::read(&path).unwrap().is_none());
        let mut records = Records::default();
        records.begin(dir.path(), Stage::Features, &recipe("a", "b"), None).unwrap();
        records.complete(Stage::Features);
        std::fs::write(&path, records.to_json()).unwrap();
        let mut back = Records::read(&path).unwrap().unwrap();
        let kept = back.begin(dir.path(), Stage::Features, &recipe("a", "b"), None).unwrap();
        assert_eq!(kept, Progress::Kept);
        assert_eq!(back.option(Stage::Features, "match.pairs"), Some("b"));
        std::fs::write(&path, "{").unwrap();
        assert!(Records::read(&path).unwrap_err().to_string().contains("stages.json"));
    }

    #[test]
    fn records_of_the_database_take_precedence() {
        let (dir, mut records) = (Path::new("ws"), Records::default());
        let database = Path::new("ws/database.db");
        let mut add = |stage, recipe: &Recipe| {
            records.begin(dir, stage, recipe, None).unwrap();
            records.complete(stage);
        };
        let matching = recipe("f", "exhaustive");
        add(Stage::Features, &recipe("photos", "-"));
        add(Stage::Match, &matching);
        add(Stage::Map, &recipe(&matching.fingerprint(), "-"));
        let same = records.clone();
        let mut rows = records.rows();
        records.take_rows(database, &rows).unwrap();
        assert_eq!(records.to_json(), same.to_json());
        // Models of incomplete matches are not valid.
        rows[1].is_complete = false;
        records.take_rows(database, &rows).unwrap();
        assert!(!records.is_complete(Stage::Match) && !records.is_complete(Stage::Map));
        let mut records = same.clone();
        records.take_rows(database, &rows[..1]).unwrap();
        assert!(records.is_complete(Stage::Features) && !records.is_complete(Stage::Map));
        let mut records = same;
        records.forget_database();
        assert!(records.is_complete(Stage::Map), "models need no database");
    }

    #[test]
    fn differing_options_are_named_up_to_a_number() {
        let recipe = |options: &[(&'static str, &str)]| {
            Recipe::new(
                "a".to_owned(),
                options.iter().map(|(key, value)| (*key, (*value).to_owned())),
            )
        };
        let hash = "0123456789abcdef".repeat(4);
        for (was, is, expected) in [
            (
                vec![("mapper.readout", "none")],
                vec![("mapper.readout", "0.016s")],
                "`mapper.readout` none and not 0.016s",
            ),
            (
                vec![("mapper.rig", "off"), ("mapper.seed", "0")],
                vec![("mapper.rig", "auto"), ("mapper.seed", "1")],
                "`mapper.rig` off and not auto, `mapper.seed` 0 and not 1",
            ),
            // An option that another version does not have.
            (vec![], vec![("mapper.loss", "trivial")], "`mapper.loss` none and not trivial"),
            (
                vec![("features.timestamps", &hash)],
                vec![("features.timestamps", "none")],
                "another `features.timestamps`",
            ),
            (
                vec![("a", "1"), ("b", "1"), ("c", "1"), ("d", "1"), ("e", "1")],
                vec![],
                "`a` 1 and not none, `b` 1 and not none, `c` 1 and not none, and 2 more that \
                differ",
            ),
        ] {
            let how = recipe(&was).difference(&recipe(&is), Stage::Map).unwrap();
            assert_eq!(how, format!("with {expected}"));
        }
    }
}
