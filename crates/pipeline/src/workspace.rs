//! The folder in which a run works and leaves its results: a COLMAP project with a few files of ours beside it.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

use crate::records::{Progress, Recipe, Records, write_json};
use crate::{Error, Report, Stage};

/// A workspace that this process holds; nobody else can while it does.
#[derive(Debug)]
pub struct Workspace {
    root: PathBuf,
    /// Locked for as long as it lives.
    _lock: File,
    pub(crate) records: Records,
}

const LOCK: &str = ".lock";
pub(crate) const STAGES: &str = "stages.json";
pub(crate) const REPORT: &str = "report.json";
pub(crate) const RIG: &str = "rig.json";
const DATABASE: &str = "database.db";
const SPARSE: &str = "sparse";

impl Workspace {
    /// Opens a workspace, or makes one where there is none.
    pub fn create(root: &Path) -> Result<Self, Error> {
        let output = |path: &Path| {
            let path = path.to_owned();
            move |cause| Error::Output { path, cause }
        };
        fs::create_dir_all(root).map_err(output(root))?;
        if !root.join(STAGES).exists() {
            for found in [DATABASE, SPARSE] {
                if root.join(found).exists() {
                    return Err(Error::ForeignWorkspace { path: root.to_owned(), found });
                }
            }
        }
        let path = root.join(LOCK);
        let lock = File::create(&path).map_err(output(&path))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(Error::InUse { path: root.to_owned() }),
            Err(TryLockError::Error(cause)) => return Err(Error::Output { path, cause }),
        }
        let records = Records::read(&root.join(STAGES))?;
        Ok(Self { root: root.to_owned(), _lock: lock, records })
    }

    /// Opens a workspace that is there.
    pub fn open(root: &Path) -> Result<Self, Error> {
        if !root.join(STAGES).is_file() {
            return Err(Error::NoWorkspace { path: root.to_owned() });
        }
        Self::create(root)
    }

    /// Begins a workspace at `root` with the features and matches of this one, unless there is one already.
    pub fn fork(&self, root: &Path) -> Result<(), Error> {
        if root.join(STAGES).is_file() {
            return Ok(());
        }
        let output = |path: &Path| {
            let path = path.to_owned();
            move |cause| Error::Output { path, cause }
        };
        fs::create_dir_all(root).map_err(output(root))?;
        for from in [self.timestamps(), self.database()] {
            let to = root.join(from.file_name().expect("both are files"));
            let part = to.with_extension("part");
            fs::copy(&from, &part).and_then(|_| fs::rename(&part, &to)).map_err(output(&to))?;
        }
        let mut report = self.report()?;
        report.forget_from(Stage::Map);
        write_json(&root.join(REPORT), &report)?;
        // Last: without it, the rest is not taken for a workspace.
        let mut records = self.records.clone();
        records.forget_from(Stage::Map);
        records.write(&root.join(STAGES))
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// COLMAP's database.
    pub fn database(&self) -> PathBuf {
        self.root.join(DATABASE)
    }

    /// The folder of the models, the largest in `0`.
    pub fn sparse(&self) -> PathBuf {
        self.root.join(SPARSE)
    }

    /// The cloud of the largest model.
    pub fn points(&self) -> PathBuf {
        self.root.join("points.ply")
    }

    /// The calibration of the cameras that ride together, and their clocks; there only where they were held to mountings.
    pub fn rig(&self) -> PathBuf {
        self.root.join(RIG)
    }

    /// When each image was taken.
    pub fn timestamps(&self) -> PathBuf {
        self.root.join("timestamps.csv")
    }

    /// What came out.
    pub fn report(&self) -> Result<Report, Error> {
        Report::read(&self.report_path())
    }

    fn report_path(&self) -> PathBuf {
        self.root.join(REPORT)
    }

    /// Changes the report on disk.
    pub(crate) fn update_report(&self, change: impl FnOnce(&mut Report)) -> Result<(), Error> {
        let mut report = self.report()?;
        change(&mut report);
        write_json(&self.report_path(), &report)
    }

    /// What is to be done about a stage; what is decided is on disk.
    pub(crate) fn begin(
        &mut self,
        stage: Stage,
        recipe: &Recipe,
        redo: Option<Stage>,
    ) -> Result<Progress, Error> {
        let progress = self.records.begin(&self.root, stage, recipe, redo)?;
        if progress == Progress::Begin {
            self.records.write(&self.root.join(STAGES))?;
            self.update_report(|report| report.forget_from(stage))?;
        }
        Ok(progress)
    }

    /// Notes on disk that all of a stage is there.
    pub(crate) fn complete(&mut self, stage: Stage) -> Result<(), Error> {
        self.records.complete(stage);
        self.records.write(&self.root.join(STAGES))
    }

    /// The fingerprint of a stage that must be complete.
    pub(crate) fn fingerprint(&self, stage: Stage) -> Result<String, Error> {
        self.records.fingerprint(&self.root, stage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_workspace_is_held_by_one() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("deep/ws");
        assert!(matches!(Workspace::open(&root), Err(Error::NoWorkspace { .. })));
        let held = Workspace::create(&root).unwrap();
        assert!(matches!(Workspace::create(&root), Err(Error::InUse { .. })));
        drop(held);
        Workspace::create(&root).unwrap();
    }

    #[test]
    fn a_fork_has_features_and_matches_and_no_models() {
        let dir = tempfile::tempdir().unwrap();
        let mut from = Workspace::create(&dir.path().join("a")).unwrap();
        fs::write(from.database(), "features").unwrap();
        fs::write(from.timestamps(), "image,seconds").unwrap();
        let recipe = |words: &str| Recipe::new(words.to_owned(), []);
        for (stage, words) in [(Stage::Features, "f"), (Stage::Match, "m"), (Stage::Map, "p")] {
            from.begin(stage, &recipe(words), None).unwrap();
            from.complete(stage).unwrap();
        }
        let root = dir.path().join("b");
        from.fork(&root).unwrap();
        let mut fork = Workspace::open(&root).unwrap();
        assert_eq!(fs::read(fork.database()).unwrap(), b"features");
        assert_eq!(fork.begin(Stage::Match, &recipe("m"), None).unwrap(), Progress::Kept);
        assert_eq!(fork.begin(Stage::Map, &recipe("other"), None).unwrap(), Progress::Begin);
        fs::write(fork.database(), "changed").unwrap();
        from.fork(&root).unwrap();
        assert_eq!(fs::read(fork.database()).unwrap(), b"changed", "what is there stays");
    }

    #[test]
    fn what_others_made_is_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join(DATABASE), "theirs").unwrap();
        assert!(matches!(Workspace::create(dir.path()), Err(Error::ForeignWorkspace { .. })));
        assert_eq!(fs::read(dir.path().join(DATABASE)).unwrap(), b"theirs");
    }

    #[test]
    fn a_file_in_the_way_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("file");
        fs::write(&file, "").unwrap();
        let error = Workspace::create(&file.join("ws")).unwrap_err().to_string();
        assert!(error.starts_with("cannot write") && error.contains("file"), "{error}");
    }
}
