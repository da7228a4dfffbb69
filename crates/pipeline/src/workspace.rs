//! The folder in which a run works and leaves its results: a COLMAP project with a few files of
//! ours beside it.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};

use tiepoint_io::database::{Database, read_stage_rows};
use tiepoint_io::disk;

use crate::file_names::{RIG, SPARSE, is_rig_name, model_path};
use crate::output_folder::{OutputFolder, model_names, output};
use crate::records::{Progress, Recipe, Records, json};
use crate::{Error, Report, Stage};

/// A workspace that this process holds; nobody else can while it does.
#[derive(Debug)]
pub struct Workspace {
    root: PathBuf,
    /// Locked for as long as it lives.
    _lock: File,
    pub(crate) folder: OutputFolder,
    pub(crate) records: Records,
}

const LOCK: &str = ".lock";
pub(crate) const STAGES: &str = "stages.json";
pub(crate) const REPORT: &str = "report.json";
pub(crate) const POINTS: &str = "points.ply";
pub(crate) const TIMESTAMPS: &str = "timestamps.csv";
pub(crate) const DATABASE: &str = "database.db";
/// What a workspace may hold: where a folder is to become one, none of these may be there.
const RESERVED: [&str; 9] =
    [STAGES, DATABASE, SPARSE, "frames", REPORT, RIG, POINTS, TIMESTAMPS, "report.html"];
/// Files of an earlier version, which kept no list of them.
const TAKEN_OVER: [&str; 4] = [REPORT, RIG, POINTS, TIMESTAMPS];

impl Workspace {
    /// Opens a workspace, or makes one where there is none.
    ///
    /// # Errors
    ///
    /// Where the folder holds files of somebody under the names of a workspace's, is in use, or
    /// cannot be written.
    pub fn create(root: &Path) -> Result<Self, Error> {
        disk::create_folders(root).map_err(output(root))?;
        let is_claimed = OutputFolder::is_ours(root);
        let record = Records::read(&root.join(STAGES));
        let database = root.join(DATABASE);
        if !is_claimed {
            // What says that this program made it: the record, or, where that is damaged, the
            // database.
            let is_ours = matches!(record, Ok(Some(_)))
                || database.is_file() && matches!(read_stage_rows(&database), Ok(Some(_)));
            let reserved = RESERVED.into_iter().map(str::to_owned).chain(rigs_in(root));
            let found =
                reserved.into_iter().find(|name| fs::symlink_metadata(root.join(name)).is_ok());
            if let Some(found) = found.filter(|_| !is_ours) {
                return Err(Error::ForeignWorkspace { path: root.to_owned(), found });
            }
        }
        let lock = lock(root)?;
        let mut folder = OutputFolder::open(root)?;
        folder.always_ours(&[STAGES]);
        if !is_claimed {
            let models = (0..).map(model_path);
            let models = models.take_while(|model| root.join(model).is_dir());
            let models = models.flat_map(|model| model_names(Some(&model)));
            let names = TAKEN_OVER.iter().map(|name| (*name).to_owned()).chain(models);
            folder.claim(&names.collect::<Vec<_>>())?;
        }
        let mut log = database.as_os_str().to_owned();
        log.push("-wal");
        if Path::new(&log).exists()
            && matches!(read_stage_rows(&database), Ok(Some(_)))
            && let Ok(database) = Database::open(&database)
        {
            // What a killed run committed belongs into the file.
            database.close()?;
        }
        // Again, since what a killed run left undone was done meanwhile.
        let written = Records::read(&root.join(STAGES)).ok().flatten();
        let records = match (current_records(root)?, &written) {
            (records, Some(written)) if written.is_without_rows() => {
                if database.is_file()
                    && let Ok(mut database) = Database::open(&database)
                {
                    database.write_stage_rows(&records.rows())?;
                    database.close()?;
                }
                records
            }
            (records, _) => records,
        };
        let mut this =
            Self { root: root.to_owned(), _lock: lock, folder, records: records.upgraded() };
        if written.is_none_or(|written| written.to_json() != this.records.to_json()) {
            this.mend()?;
        }
        Ok(this)
    }

    /// Opens a workspace that is there.
    ///
    /// # Errors
    ///
    /// Where there is none, and those of [`Workspace::create`].
    pub fn open(root: &Path) -> Result<Self, Error> {
        if !is_workspace(root) {
            return Err(Error::NoWorkspace { path: root.to_owned() });
        }
        Self::create(root)
    }

    /// Writes the record, and forgets what is no longer there from the report.
    fn mend(&mut self) -> Result<(), Error> {
        let is_old = match self.report() {
            Ok(mut report) => {
                let before = json(&report);
                report.keep_only(|stage| self.records.is_complete(stage));
                json(&report) != before
            }
            Err(_) => false,
        };
        if is_old {
            return self.note(|_| {});
        }
        self.folder.stage_bytes(STAGES, &self.records.to_json())?;
        self.folder.publish(&[STAGES.to_owned()], &[]).map(drop)
    }

    /// Begins a workspace at `root` with the features and matches of this one, unless there is one
    /// already.
    ///
    /// # Errors
    ///
    /// Where `root` holds files of somebody, or cannot be written.
    pub fn fork(&self, root: &Path) -> Result<(), Error> {
        if is_workspace(root) && root.join(DATABASE).is_file() {
            return Ok(());
        }
        let mut fork = Self::create(root)?;
        if self.timestamps().is_file() {
            let to = fork.folder.stage(TIMESTAMPS)?;
            disk::copy_new(&self.timestamps(), &to).map_err(output(&fork.timestamps()))?;
            fork.folder.publish(&[TIMESTAMPS.to_owned()], &[])?;
        }
        // The database has its record with it.
        let to = fork.folder.stage(DATABASE)?;
        disk::copy_new(&self.database(), &to).map_err(output(&fork.database()))?;
        disk::rename(&to, &fork.database()).map_err(output(&fork.database()))?;
        disk::sync_folder(root).map_err(output(root))?;
        fork.records = self.records.clone();
        fork.records.forget_from(Stage::Map);
        let report = self.report()?;
        fork.note(|all| *all = report)
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
        self.root.join(POINTS)
    }

    /// When each image was taken.
    pub fn timestamps(&self) -> PathBuf {
        self.root.join(TIMESTAMPS)
    }

    /// What came out.
    pub fn report(&self) -> Result<Report, Error> {
        Report::read(&self.report_path())
    }

    fn report_path(&self) -> PathBuf {
        self.root.join(REPORT)
    }

    /// What is to be done about a stage. Nothing is written yet.
    pub(crate) fn begin(
        &mut self,
        stage: Stage,
        recipe: &Recipe,
        redo: Option<Stage>,
    ) -> Result<Progress, Error> {
        let progress = self.records.begin(&self.root, stage, recipe, redo)?;
        if progress != Progress::Kept {
            // Refused before any work is done.
            self.folder.refuse_foreign([REPORT])?;
        }
        Ok(progress)
    }

    /// Writes the record and the report: what `change` makes of it.
    pub(crate) fn note(&mut self, change: impl FnOnce(&mut Report)) -> Result<(), Error> {
        self.publish(Vec::new(), &[], change)
    }

    /// The same, with files that were staged and others that go, all together.
    pub(crate) fn publish(
        &mut self,
        mut files: Vec<String>,
        removed: &[String],
        change: impl FnOnce(&mut Report),
    ) -> Result<(), Error> {
        let mut report = self.report()?;
        change(&mut report);
        report.keep_only(|stage| self.records.is_complete(stage));
        self.folder.stage_bytes(REPORT, &json(&report))?;
        self.folder.stage_bytes(STAGES, &self.records.to_json())?;
        files.extend([REPORT.to_owned(), STAGES.to_owned()]);
        self.folder.publish(&files, removed).map(drop)
    }

    /// Notes that all of a stage is there; it is on disk with the next [`Workspace::publish`].
    pub(crate) fn complete(&mut self, stage: Stage) {
        self.records.complete(stage);
    }

    /// The fingerprint of a stage that must be complete.
    pub(crate) fn fingerprint(&self, stage: Stage) -> Result<String, Error> {
        self.records.fingerprint(&self.root, stage)
    }

    /// The times of the images as the first stage left them; nobody else may have changed them,
    /// since the record would not tell.
    pub(crate) fn timestamps_as_left(&self) -> Result<Option<PathBuf>, Error> {
        let path = self.timestamps();
        if !path.is_file() && self.folder.names().all(|name| name != TIMESTAMPS) {
            return Ok(None);
        }
        if self.folder.is_as_left(TIMESTAMPS)? {
            Ok(Some(path))
        } else {
            Err(Error::ChangedTimes { path })
        }
    }
}

/// The names of files in a folder that are those of models' rigs.
pub(crate) fn rigs_in(root: &Path) -> impl Iterator<Item = String> {
    let entries = fs::read_dir(root).into_iter().flatten().flatten();
    entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| is_rig_name(name))
}

/// Whether this program works in a folder.
pub(crate) fn is_workspace(root: &Path) -> bool {
    root.join(STAGES).is_file() || OutputFolder::is_ours(root) && root.join(DATABASE).is_file()
}

/// What the stages of a workspace were made from, by its record and its database; nothing is
/// written.
pub(crate) fn current_records(root: &Path) -> Result<Records, Error> {
    let database = root.join(DATABASE);
    let found = Records::read(&root.join(STAGES));
    if !database.is_file() {
        let mut records = found?.unwrap_or_default();
        records.forget_database();
        return Ok(records);
    }
    let rows = read_stage_rows(&database);
    let mut records = match (found, &rows) {
        (Ok(found), _) => found.unwrap_or_default(),
        // The database tells it all the same.
        (Err(Error::BrokenRecord { .. }), Ok(Some(_))) => Records::default(),
        (Err(error), _) => return Err(error),
    };
    match rows {
        Ok(Some(rows)) => records.take_rows(&rows),
        Ok(None) if !records.is_without_rows() => records.forget_database(),
        // A database that cannot be read is named by who needs it.
        Ok(None) | Err(_) => {}
    }
    Ok(records)
}

fn lock(root: &Path) -> Result<File, Error> {
    let path = root.join(LOCK);
    if fs::metadata(&path).is_ok_and(|found| !found.is_file()) {
        return Err(Error::NotOurs { path });
    }
    // Whatever it holds stays.
    let lock = OpenOptions::new().create(true).truncate(false).write(true).open(&path);
    let lock = lock.map_err(output(&path))?;
    match lock.try_lock() {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(Error::InUse { path: root.to_owned() }),
        Err(TryLockError::Error(cause)) => Err(Error::Output { path, cause }),
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
        from.folder.stage_bytes(TIMESTAMPS, b"image,seconds\n").unwrap();
        let recipe = |input: &str| Recipe::new(input.to_owned(), []);
        let mut input = "photos".to_owned();
        for stage in Stage::ALL {
            from.begin(stage, &recipe(&input), None).unwrap();
            from.complete(stage);
            input = from.fingerprint(stage).unwrap();
        }
        from.publish(vec![TIMESTAMPS.to_owned()], &[], |_| {}).unwrap();
        let rows = from.records.rows();
        let made =
            Database::create_with(&from.database(), |database| database.write_stage_rows(&rows));
        made.unwrap().close().unwrap();
        let root = dir.path().join("b");
        from.fork(&root).unwrap();
        let mut fork = Workspace::open(&root).unwrap();
        assert_eq!(fork.timestamps_as_left().unwrap(), Some(root.join(TIMESTAMPS)));
        let matching = recipe(&fork.fingerprint(Stage::Features).unwrap());
        assert_eq!(fork.begin(Stage::Match, &matching, None).unwrap(), Progress::Kept);
        let mapping = recipe(&fork.fingerprint(Stage::Match).unwrap());
        assert_eq!(fork.begin(Stage::Map, &mapping, None).unwrap(), Progress::Begin);
        drop(fork);
        let before = fs::read(root.join(DATABASE)).unwrap();
        from.fork(&root).unwrap();
        assert_eq!(fs::read(root.join(DATABASE)).unwrap(), before, "what is there stays");
    }

    #[test]
    fn a_damaged_record_is_mended_from_the_database() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("ws");
        let mut made = Workspace::create(&root).unwrap();
        made.begin(Stage::Features, &Recipe::new("photos".to_owned(), []), None).unwrap();
        made.complete(Stage::Features);
        let rows = made.records.rows();
        let database =
            Database::create_with(&made.database(), |database| database.write_stage_rows(&rows));
        database.unwrap().close().unwrap();
        made.note(|_| {}).unwrap();
        let good = fs::read(root.join(STAGES)).unwrap();
        drop(made);
        for damage in [Some("{"), None] {
            match damage {
                Some(text) => fs::write(root.join(STAGES), text).unwrap(),
                None => fs::remove_file(root.join(STAGES)).unwrap(),
            }
            assert!(Workspace::open(&root).unwrap().records.is_complete(Stage::Features));
            assert_eq!(fs::read(root.join(STAGES)).unwrap(), good);
        }
        // Without the list of its files, as a copy without hidden files is.
        fs::remove_file(root.join(tiepoint_io::MANIFEST)).unwrap();
        fs::write(root.join(STAGES), "{").unwrap();
        assert!(Workspace::open(&root).unwrap().records.is_complete(Stage::Features));
        fs::remove_file(root.join(DATABASE)).unwrap();
        fs::write(root.join(STAGES), "{").unwrap();
        let error = Workspace::open(&root).unwrap_err().to_string();
        assert!(
            error.contains("stages.json") && error.contains("choose another workspace"),
            "{error}"
        );
    }

    #[test]
    fn what_others_made_is_left_alone() {
        for name in RESERVED {
            let dir = tempfile::tempdir().unwrap();
            fs::write(dir.path().join(name), "theirs").unwrap();
            let error = Workspace::create(dir.path()).unwrap_err();
            let is_named =
                matches!(&error, Error::ForeignWorkspace { found, .. } if *found == name);
            assert!(is_named || name == STAGES, "{error}");
            assert_eq!(fs::read(dir.path().join(name)).unwrap(), b"theirs");
            assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        }
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
