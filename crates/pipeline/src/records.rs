//! What each stage was made from, so that a later run can tell whether to keep it, to go on with it, or to ask.
//!
//! The database holds this for its own two stages, written in the transactions that change them; `stages.json` holds it for
//! all. Where they differ, the database is right.
//!
//! The input of the first stage is a fingerprint of the photos; that of a later stage stands for everything before it. Options
//! are kept as words, so that a difference can be named.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tiepoint_io::database::StageRow;

use crate::{Error, Stage};

/// Raised when the meaning of the file changes.
const VERSION: u32 = 2;
/// Databases of this version know nothing of stages.
const VERSION_WITHOUT_ROWS: u32 = 1;
/// The stages whose products lie in the database.
const IN_DATABASE: [Stage; 2] = [Stage::Features, Stage::Match];
/// Longer values of options are not quoted in a message.
const MAX_QUOTED: usize = 48;

/// What a stage was, or is to be, made from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Recipe {
    /// Fingerprint of the photos, or of the stage before.
    pub(crate) input: String,
    /// Options by name.
    pub(crate) options: BTreeMap<String, String>,
}

impl Recipe {
    pub(crate) fn new(input: String, options: impl IntoIterator<Item = (&'static str, String)>) -> Self {
        Self { input, options: options.into_iter().map(|(name, value)| (name.to_owned(), value)).collect() }
    }

    /// A fingerprint of the stage: the input of the next.
    fn fingerprint(&self) -> String {
        let mut hash = blake3::Hasher::new();
        let words = self.options.iter().flat_map(|(name, value)| [name, value]);
        for word in std::iter::once(&self.input).chain(words) {
            hash.update(&(word.len() as u64).to_le_bytes()).update(word.as_bytes());
        }
        hash.finalize().to_hex().to_string()
    }

    /// In what this, which was, differs from what is asked for now; as the end of "were made …".
    fn difference(&self, asked: &Self, stage: Stage) -> Option<String> {
        let names = self.options.keys().chain(asked.options.keys());
        let changed = names.filter(|name| self.options.get(*name) != asked.options.get(*name)).min();
        if let Some(name) = changed {
            let value =
                |recipe: &Self| recipe.options.get(name).cloned().unwrap_or_else(|| "none".to_owned());
            let (was, is) = (value(self), value(asked));
            return Some(if was.len().max(is.len()) <= MAX_QUOTED {
                format!("with {name} {was} and not {is}")
            } else {
                format!("with another {name}")
            });
        }
        (self.input != asked.input).then(|| match stage {
            Stage::Features => "from other photos, or some have changed since".to_owned(),
            Stage::Match | Stage::Map => "from something that has been made anew since".to_owned(),
        })
    }
}

/// A stage as it stands on disk.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Record {
    /// Whether all of it is there.
    is_complete: bool,
    #[serde(flatten)]
    recipe: Recipe,
}

/// What is to be done about a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Progress {
    /// Everything.
    Begin,
    /// What is missing.
    Continue,
    /// Nothing.
    Kept,
}

/// The file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Records {
    version: u32,
    /// Where the photos are.
    pub(crate) inputs: Vec<PathBuf>,
    stages: BTreeMap<Stage, Record>,
}

impl Default for Records {
    fn default() -> Self {
        Self { version: VERSION, inputs: Vec::new(), stages: BTreeMap::new() }
    }
}

impl Records {
    /// Reads the file; `None` where there is none.
    pub(crate) fn read(path: &Path) -> Result<Option<Self>, Error> {
        let broken = |what: String| Error::BrokenRecord { path: path.to_owned(), what };
        let text = match std::fs::read(path) {
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(cause) => return Err(Error::Unreadable { path: path.to_owned(), cause }),
            Ok(text) => text,
        };
        let records: Self = serde_json::from_slice(&text).map_err(|error| broken(error.to_string()))?;
        if ![VERSION_WITHOUT_ROWS, VERSION].contains(&records.version) {
            return Err(broken(format!("it is of version {} and not {VERSION}", records.version)));
        }
        Ok(Some(records))
    }

    pub(crate) fn to_json(&self) -> Vec<u8> {
        json(self)
    }

    /// Whether the database may not know its stages yet.
    pub(crate) fn is_without_rows(&self) -> bool {
        self.version == VERSION_WITHOUT_ROWS
    }

    /// The file as this version writes it.
    pub(crate) fn upgraded(mut self) -> Self {
        self.version = VERSION;
        self
    }

    /// What the database is to hold.
    pub(crate) fn rows(&self) -> Vec<StageRow> {
        let row = |stage: &Stage| {
            let Record { is_complete, recipe } = self.stages.get(stage)?;
            let recipe = String::from_utf8(json(recipe)).ok()?;
            Some(StageRow { stage: stage.name().to_owned(), is_complete: *is_complete, recipe })
        };
        IN_DATABASE.iter().filter_map(row).collect()
    }

    /// Takes what the database holds; models of matches that are gone are forgotten.
    pub(crate) fn take_rows(&mut self, rows: &[StageRow]) {
        for stage in IN_DATABASE {
            let row = rows.iter().find(|row| row.stage == stage.name());
            let recipe = row.and_then(|row| serde_json::from_str(&row.recipe).ok());
            match row.zip(recipe) {
                Some((row, recipe)) => {
                    self.stages.insert(stage, Record { is_complete: row.is_complete, recipe });
                }
                None => drop(self.stages.remove(&stage)),
            }
        }
        let made_from = self.stages.get(&Stage::Map).map(|record| record.recipe.input.clone());
        let matches = self.stages.get(&Stage::Match).filter(|record| record.is_complete);
        if made_from.is_some() && made_from != matches.map(|record| record.recipe.fingerprint()) {
            self.forget_from(Stage::Map);
        }
    }

    /// Forgets what a database held that is no longer there. The models stay what they were.
    pub(crate) fn forget_database(&mut self) {
        IN_DATABASE.iter().for_each(|stage| drop(self.stages.remove(stage)));
    }

    /// Whether all of a stage is there.
    pub(crate) fn is_complete(&self, stage: Stage) -> bool {
        self.stages.get(&stage).is_some_and(|record| record.is_complete)
    }

    /// Compares what was with what is asked for, and notes that the stage is to be made where it is. Later stages are forgotten
    /// with it.
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

    /// Forgets a stage and the later ones.
    pub(crate) fn forget_from(&mut self, stage: Stage) {
        self.stages.retain(|other, _| *other < stage);
    }

    /// Notes that all of a stage is there.
    pub(crate) fn complete(&mut self, stage: Stage) {
        if let Some(record) = self.stages.get_mut(&stage) {
            record.is_complete = true;
        }
    }

    /// An option of a stage that is there.
    pub(crate) fn option(&self, stage: Stage, name: &str) -> Option<&str> {
        self.stages.get(&stage)?.recipe.options.get(name).map(String::as_str)
    }

    /// The fingerprint of a complete stage.
    pub(crate) fn fingerprint(&self, workspace: &Path, stage: Stage) -> Result<String, Error> {
        match self.stages.get(&stage) {
            Some(record) if record.is_complete => Ok(record.recipe.fingerprint()),
            _ => Err(Error::Missing { path: workspace.to_owned(), stage }),
        }
    }
}

/// A text of ours.
pub(crate) fn json(value: &impl Serialize) -> Vec<u8> {
    let mut text =
        serde_json::to_vec_pretty(value).expect("our own types are JSON: string keys, finite numbers");
    text.push(b'\n');
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(input: &str, pairs: &str) -> Recipe {
        Recipe::new(input.to_owned(), [("pairs", pairs.to_owned()), ("seed", "0".to_owned())])
    }

    #[test]
    fn a_stage_is_begun_continued_and_kept() {
        let (dir, mut records) = (Path::new("ws"), Records::default());
        let asked = recipe("a", "exhaustive");
        assert_eq!(records.begin(dir, Stage::Match, &asked, None).unwrap(), Progress::Begin);
        assert!(matches!(records.fingerprint(dir, Stage::Match), Err(Error::Missing { .. })));
        assert_eq!(records.begin(dir, Stage::Match, &asked, None).unwrap(), Progress::Continue);
        records.complete(Stage::Match);
        assert_eq!(records.begin(dir, Stage::Match, &asked, None).unwrap(), Progress::Kept);
        assert_eq!(records.begin(dir, Stage::Match, &asked, Some(Stage::Match)).unwrap(), Progress::Begin);
    }

    #[test]
    fn a_difference_is_named_and_redone_on_request() {
        let (dir, mut records) = (Path::new("ws"), Records::default());
        records.begin(dir, Stage::Match, &recipe("a", "exhaustive"), None).unwrap();
        records.begin(dir, Stage::Map, &recipe("b", "-"), None).unwrap();
        let error = records.begin(dir, Stage::Match, &recipe("a", "sequential:5"), None).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the matches in ws were made with pairs exhaustive and not sequential:5: give --redo match to make them anew, or \
             choose another workspace"
        );
        let error = records.begin(dir, Stage::Match, &recipe("c", "exhaustive"), None).unwrap_err();
        assert!(error.to_string().contains("made anew since"), "{error}");
        let redone = records.begin(dir, Stage::Match, &recipe("a", "sequential:5"), Some(Stage::Match));
        assert_eq!(redone.unwrap(), Progress::Begin);
        // What was made from it is forgotten.
        assert_eq!(records.begin(dir, Stage::Map, &recipe("b", "-"), None).unwrap(), Progress::Begin);
    }

    #[test]
    fn neighbouring_words_do_not_run_together() {
        let one = Recipe::new("ab".to_owned(), [("c", String::new())]);
        let other = Recipe::new("a".to_owned(), [("bc", String::new())]);
        assert_ne!(one.fingerprint(), other.fingerprint());
    }

    #[test]
    fn the_file_comes_back_and_a_broken_one_is_named() {
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
        assert_eq!(back.option(Stage::Features, "pairs"), Some("b"));
        std::fs::write(&path, "{").unwrap();
        assert!(Records::read(&path).unwrap_err().to_string().contains("stages.json"));
    }

    #[test]
    fn the_database_is_right() {
        let (dir, mut records) = (Path::new("ws"), Records::default());
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
        records.take_rows(&rows);
        assert_eq!(records.to_json(), same.to_json());
        // Its matches are not complete, so the models are none of them.
        rows[1].is_complete = false;
        records.take_rows(&rows);
        assert!(!records.is_complete(Stage::Match) && !records.is_complete(Stage::Map));
        let mut records = same.clone();
        records.take_rows(&rows[..1]);
        assert!(records.is_complete(Stage::Features) && !records.is_complete(Stage::Map));
        let mut records = same;
        records.forget_database();
        assert!(records.is_complete(Stage::Map), "models need no database");
    }
}
