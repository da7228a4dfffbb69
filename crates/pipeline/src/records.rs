//! Records of the input and options of each stage, from which a later run decides whether to keep,
//! to resume or to reject the stage.
//!
//! The database holds the records of the two stages whose results it holds, written in the
//! transactions that change them; `stages.json` holds those of all stages. If they differ, the
//! database takes precedence.
//!
//! The input of the first stage is a fingerprint of the photos; that of a later stage is the
//! fingerprint of the stage before it. Options are kept as texts by key ([`crate::option_keys`]),
//! so that error messages can name a difference. Records of earlier versions are converted when
//! they are read.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tiepoint_io::database::StageRow;
use tiepoint_io::require_regular_file;

use crate::camera_facts::FOUND;
use crate::option_keys::{NONE, difference, shown};
use crate::{Error, Stage, legacy_options};

/// Current version of the file format.
const VERSION: u32 = 3;
/// Last version with options as texts of Rust structs, without keys.
const VERSION_WITHOUT_KEYS: u32 = 2;
/// Version whose databases have no records.
const VERSION_WITHOUT_ROWS: u32 = 1;
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
        options: impl IntoIterator<Item = (&'static str, String)>,
    ) -> Self {
        let given = options.into_iter().filter(|(_, value)| value != NONE);
        Self { input, options: given.map(|(key, value)| (key.to_owned(), value)).collect() }
    }

    /// Fingerprint of the stage, which is the input of the next one.
    fn fingerprint(&self) -> String {
        let mut hash = blake3::Hasher::new();
        let words = self.options.iter().flat_map(|(name, value)| [name, value]);
        for word in std::iter::once(&self.input).chain(words) {
            hash.update(&(word.len() as u64).to_le_bytes()).update(word.as_bytes());
        }
        hash.finalize().to_hex().to_string()
    }

    /// Difference between this recorded recipe and the one that is asked for, as the end of the
    /// sentence "they were made …"; `None` if they are equal.
    fn difference(&self, asked: &Self, stage: Stage) -> Option<String> {
        // What was found follows from the photos and the other options.
        let keys: BTreeSet<&String> = self.options.keys().chain(asked.options.keys()).collect();
        let changed = keys
            .into_iter()
            .filter(|key| !key.starts_with(FOUND))
            .filter(|key| self.options.get(*key) != asked.options.get(*key));
        let changed: Vec<String> = changed.map(|key| self.changed_option(asked, key)).collect();
        if !changed.is_empty() {
            let named = changed[..changed.len().min(MAX_NAMED)].join(", ");
            return Some(match changed.len().saturating_sub(MAX_NAMED) {
                0 => format!("with {named}"),
                more => format!("with {named}, and {more} more that differ"),
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
            format!("another {}", shown(key))
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

/// Converts the options of an earlier version to keys, and updates the input of each stage to the
/// new fingerprint of the previous one.
fn convert_to_keys(stages: &mut BTreeMap<Stage, Record>) {
    let mut made: Option<(String, String)> = None;
    for (stage, record) in stages {
        let recipe = &mut record.recipe;
        let before = recipe.fingerprint();
        recipe.options = legacy_options::by_key(*stage, &recipe.options);
        if let Some((before, now)) = made
            && recipe.input == before
        {
            recipe.input = now;
        }
        made = Some((before, recipe.fingerprint()));
    }
}

/// A recipe as text in the database.
#[derive(Serialize, Deserialize)]
#[serde(expecting = "an object")]
struct RecipeRow {
    #[serde(default = "version_without_keys")]
    version: u32,
    #[serde(flatten)]
    recipe: Recipe,
}

fn version_without_keys() -> u32 {
    VERSION_WITHOUT_KEYS
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
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub(crate) struct Records {
    version: u32,
    /// Input folders of the photos.
    pub(crate) inputs: Vec<PathBuf>,
    stages: BTreeMap<Stage, Record>,
}

impl Default for Records {
    fn default() -> Self {
        Self { version: VERSION, inputs: Vec::new(), stages: BTreeMap::new() }
    }
}

impl Records {
    /// Reads the file; `None` if it does not exist.
    ///
    /// # Errors
    ///
    /// The file cannot be read or is damaged.
    pub(crate) fn read(path: &Path) -> Result<Option<Self>, Error> {
        let broken = |what: String| Error::BrokenRecord { path: path.to_owned(), what };
        require_regular_file(path)?;
        let text = match std::fs::read(path) {
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(cause) => return Err(Error::Unreadable { path: path.to_owned(), cause }),
            Ok(text) => text,
        };
        let mut records: Self =
            serde_json::from_slice(&text).map_err(|error| broken(error.to_string()))?;
        if !(VERSION_WITHOUT_ROWS..=VERSION).contains(&records.version) {
            return Err(broken(format!("it is of version {} and not {VERSION}", records.version)));
        }
        if records.version <= VERSION_WITHOUT_KEYS {
            convert_to_keys(&mut records.stages);
        }
        Ok(Some(records))
    }

    pub(crate) fn to_json(&self) -> Vec<u8> {
        json(self)
    }

    /// Whether the database of this version has no records.
    pub(crate) fn is_without_rows(&self) -> bool {
        self.version == VERSION_WITHOUT_ROWS
    }

    /// The same records in the current version.
    pub(crate) fn upgraded(mut self) -> Self {
        self.version = VERSION;
        self
    }

    /// The records for the database.
    pub(crate) fn rows(&self) -> Vec<StageRow> {
        let row = |stage: &Stage| {
            let Record { is_complete, recipe } = self.stages.get(stage)?;
            let recipe = RecipeRow { version: VERSION, recipe: recipe.clone() };
            let recipe = String::from_utf8(json(&recipe)).ok()?;
            Some(StageRow { stage: stage.name().to_owned(), is_complete: *is_complete, recipe })
        };
        IN_DATABASE.iter().filter_map(row).collect()
    }

    /// Replaces the records of stages in the database by those in the database. The record of the
    /// models is removed if they were computed from other matches.
    pub(crate) fn take_rows(&mut self, rows: &[StageRow]) {
        let mut stages = BTreeMap::new();
        let mut has_keys = true;
        for stage in IN_DATABASE {
            let row = rows.iter().find(|row| row.stage == stage.name());
            let recipe = row.and_then(|row| serde_json::from_str::<RecipeRow>(&row.recipe).ok());
            if let Some((row, RecipeRow { version, recipe })) = row.zip(recipe) {
                has_keys &= version > VERSION_WITHOUT_KEYS;
                stages.insert(stage, Record { is_complete: row.is_complete, recipe });
            }
        }
        if !has_keys {
            convert_to_keys(&mut stages);
        }
        self.forget_database();
        self.stages.append(&mut stages);
        let made_from = self.stages.get(&Stage::Map).map(|record| record.recipe.input.clone());
        let matches = self.stages.get(&Stage::Match).filter(|record| record.is_complete);
        if made_from.is_some() && made_from != matches.map(|record| record.recipe.fingerprint()) {
            self.forget_from(Stage::Map);
        }
    }

    /// Removes the records of stages in a database that no longer exists. That of the models stays.
    pub(crate) fn forget_database(&mut self) {
        IN_DATABASE.iter().for_each(|stage| drop(self.stages.remove(stage)));
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

/// Pretty JSON with a final line break.
pub(crate) fn json(value: &impl Serialize) -> Vec<u8> {
    let mut text = serde_json::to_vec_pretty(value)
        .expect("our own types are JSON: string keys, finite numbers");
    text.push(b'\n');
    text
}

#[cfg(test)]
mod tests {
    use tiepoint_io::features as sift;
    use tiepoint_sfm::matching::{self, Ends, PairSelection};
    use tiepoint_sfm::{MapperOptions, RigTerm, VerifyOptions};

    use super::*;
    use crate::cameras::Calibration;
    use crate::option_keys::{of_features, of_mapping, of_matching};

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
            "the matches in ws were made with --pairs exhaustive and not sequential:5: give \
            --redo match to make them again, or choose another workspace"
        );
        let error = records.begin(dir, Stage::Match, &recipe("c", "exhaustive"), None).unwrap_err();
        assert!(error.to_string().contains("from other features"), "{error}");
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
        // Models of incomplete matches are not valid.
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
                "--rolling-shutter none and not 0.016s",
            ),
            (
                vec![("mapper.rig", "off"), ("mapper.seed", "0")],
                vec![("mapper.rig", "auto"), ("mapper.seed", "1")],
                "--rig off and not auto, --seed 0 and not 1",
            ),
            // An option that another version does not have.
            (vec![], vec![("mapper.loss", "trivial")], "mapper.loss none and not trivial"),
            (
                vec![("features.timestamps", &hash)],
                vec![("features.timestamps", "none")],
                "another --timestamps",
            ),
            (
                vec![("a", "1"), ("b", "1"), ("c", "1"), ("d", "1"), ("e", "1")],
                vec![],
                "a 1 and not none, b 1 and not none, c 1 and not none, and 2 more that differ",
            ),
        ] {
            let how = recipe(&was).difference(&recipe(&is), Stage::Map).unwrap();
            assert_eq!(how, format!("with {expected}"));
        }
    }

    /// `stages.json` of an earlier version for four photos, and its recipes.
    fn legacy_file(version: u32, pairs: &str) -> (String, [String; 3]) {
        let detector = "Options { first_octave: -1, octaves: 4, levels: 3, peak_threshold: \
        0.0066666664, \
             edge_threshold: 10.0, max_features: 8192, limit: WholeLevels, max_orientations: 2, \
             orientation: Dominant, \
             normalization: RootL1, domain_sizes: None }";
        let matching = "Options { max_ratio: Some(0.8), max_angle_rad: Some(0.7), mutual: true, \
        method: BruteForce, \
             preempt: None }";
        let verification = "VerifyOptions { max_error_px: 4.0, min_num_inliers: 15, \
        min_essential_share: 0.95, \
             max_homography_share: 0.8 }";
        let mapper = "MapperOptions { refine: RefineIntrinsics { focal: true, principal_point: \
        true, distortion: true }, \
             tracks: TrackOptions { max_create_error_px: 12.0, max_merge_error_px: 4.0, \
             min_angle_rad: 0.026179938779914945, two_view: false, max_transitivity: 5 }, \
             filter: FilterOptions { max_error_px: 4.0, min_angle_rad: 0.026179938779914945 }, \
             register: RegisterOptions { max_error_px: 12.0, min_num_inliers: 30, \
             min_inlier_share: 0.25 }, \
             min_initial_inliers: 30, min_model_size: 3, loss: SoftL1(4.0), local_images: 6, \
             global_growth: 1.1, \
             rig: Auto, readout: None, seed: 0 }";
        let features = format!(
            r#"{{ "input": "PHOTOS", "options":
                {{ "camera-model": "SIMPLE_RADIAL", "detector": "{detector}" }} }}"#
        );
        let fingerprint =
            |recipe: &str| serde_json::from_str::<Recipe>(recipe).expect("as it was").fingerprint();
        let matches = format!(
            r#"{{ "input": "{}", "options":
                {{ "matching": "{matching}", "pairs": "{pairs}", "seed": "0",
                   "verification": "{verification}" }} }}"#,
            fingerprint(&features)
        );
        let models = format!(
            r#"{{ "input": "{}", "options": {{ "mapper": "{mapper}" }} }}"#,
            fingerprint(&matches)
        );
        let complete = |recipe: &str| recipe.replacen('{', r#"{ "is_complete": true,"#, 1);
        let file = format!(
            r#"{{ "version": {version}, "inputs": ["photos"],
                "stages": {{ "features": {}, "match": {}, "map": {} }} }}"#,
            complete(&features),
            complete(&matches),
            complete(&models)
        );
        (file, [features, matches, models])
    }

    /// The recipe of a run with the default options of the command line.
    fn asked(records: &Records, stage: Stage, pairs: PairSelection) -> Recipe {
        let dir = Path::new("ws");
        let mapper = MapperOptions { rig: RigTerm::Auto, ..MapperOptions::default() };
        let (calibration, detector) = (Calibration::default(), sift::Options::default());
        let (descriptors, verify) = (matching::Options::default(), VerifyOptions::default());
        match stage {
            Stage::Features => {
                Recipe::new("PHOTOS".to_owned(), of_features(&calibration, &detector, None))
            }
            Stage::Match => {
                let input = records.fingerprint(dir, Stage::Features).unwrap();
                Recipe::new(input, of_matching(&pairs, &descriptors, &verify, 0))
            }
            Stage::Map => {
                let input = records.fingerprint(dir, Stage::Match).unwrap();
                Recipe::new(input, of_mapping(&mapper, None))
            }
            Stage::Dense => unreachable!("records without keys know of no dense stage"),
        }
    }

    #[test]
    fn records_without_keys_are_converted() {
        let (dir, folder) = (Path::new("ws"), tempfile::tempdir().unwrap());
        let path = folder.path().join("stages.json");
        let exhaustive = PairSelection::Exhaustive;
        for version in [1, 2] {
            let (file, recipes) = legacy_file(version, "exhaustive");
            std::fs::write(&path, file).unwrap();
            let read = Records::read(&path).unwrap().unwrap();
            let rows: Vec<StageRow> = IN_DATABASE
                .iter()
                .zip(recipes)
                .map(|(stage, recipe)| StageRow {
                    stage: stage.name().to_owned(),
                    is_complete: true,
                    recipe,
                })
                .collect();
            let mut with_rows = read.clone();
            with_rows.take_rows(&rows);
            assert_eq!(with_rows.to_json(), read.to_json(), "the database says the same");
            // A converted `stages.json` beside a database that was not converted.
            std::fs::write(&path, read.clone().upgraded().to_json()).unwrap();
            let mut upgraded = Records::read(&path).unwrap().unwrap();
            upgraded.take_rows(&rows);
            let rows = upgraded.rows();
            upgraded.take_rows(&rows);
            for mut records in [read, with_rows, upgraded] {
                for stage in [Stage::Features, Stage::Match, Stage::Map] {
                    let recipe = asked(&records, stage, exhaustive);
                    assert_eq!(
                        records.begin(dir, stage, &recipe, None).unwrap(),
                        Progress::Kept,
                        "{stage}"
                    );
                }
                let sequential = PairSelection::Sequential { reach: 5, ends: Ends::Open, loops: 0 };
                let recipe = asked(&records, Stage::Match, sequential);
                let error =
                    records.begin(dir, Stage::Match, &recipe, None).unwrap_err().to_string();
                assert!(
                    error.contains("with --pairs exhaustive and not sequential:5: give --redo"),
                    "{error}"
                );
                let recipe = asked(&records, Stage::Features, exhaustive);
                let recipe = Recipe { input: "OTHERS".to_owned(), ..recipe };
                let error =
                    records.begin(dir, Stage::Features, &recipe, None).unwrap_err().to_string();
                assert!(error.contains("in ws were made from other photos"), "{error}");
            }
        }
        // Models of other matches than those of the database are not valid.
        let (file, _) = legacy_file(2, "exhaustive");
        let (_, [features, matches, _]) = legacy_file(2, "sequential:5");
        std::fs::write(&path, file).unwrap();
        let mut records = Records::read(&path).unwrap().unwrap();
        let row = |stage: Stage, recipe| StageRow {
            stage: stage.name().to_owned(),
            is_complete: true,
            recipe,
        };
        records.take_rows(&[row(Stage::Features, features), row(Stage::Match, matches)]);
        assert!(records.is_complete(Stage::Match) && !records.is_complete(Stage::Map));
    }
}
