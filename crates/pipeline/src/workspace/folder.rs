//! The workspace: a folder with a COLMAP project and a few files of this program.

use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::path::{Component, Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use tiepoint_io::database::{Database, read_stage_rows};
use tiepoint_store::{Error as StoreError, OutputFolder, disk};

use crate::workspace::file_names::{DENSE, GEOREFERENCE, RIG, SPARSE, is_rig_name, model_path};
use crate::workspace::format::json;
use crate::workspace::records::{Progress, Recipe, Records};
use crate::workspace::report::Report;
use crate::{Error, Stage};

/// A workspace, locked by this process.
#[derive(Debug)]
pub struct Workspace {
    root: PathBuf,
    _lock: File,
    pub(crate) folder: OutputFolder,
    pub(crate) records: Records,
}

const LOCK: &str = ".lock";
/// Longest time that a shard waits for another one that completes what an interrupted run has
/// committed, and for its lock when it just has.
const MAX_WAIT: Duration = Duration::from_secs(30);
const MAX_WAIT_FOR_LOCK: Duration = Duration::from_secs(1);
/// Time between two looks.
const LOOK: Duration = Duration::from_millis(50);
/// Folders above a result of a workspace: `dense/stereo/depth_maps/NAME` is the deepest.
const MAX_RESULT_DEPTH: usize = 8;
pub(crate) const STAGES: &str = "stages.json";
/// Name of the report.
pub const REPORT: &str = "report.json";
pub(crate) const POINTS: &str = "points.ply";
pub(crate) const TIMESTAMPS: &str = "timestamps.csv";
pub(crate) const DATABASE: &str = "database.db";
/// Names of files in a workspace. A folder that has one of them cannot become a workspace.
const RESERVED: [&str; 14] = [
    STAGES,
    DATABASE,
    "database.db-wal",
    "database.db-shm",
    "database.db-journal",
    SPARSE,
    "frames",
    REPORT,
    RIG,
    GEOREFERENCE,
    POINTS,
    TIMESTAMPS,
    "report.html",
    DENSE,
];

impl Workspace {
    /// Opens or creates a workspace.
    ///
    /// # Errors
    ///
    /// The folder holds foreign files with the names of a workspace's files or files of another
    /// format, another run uses it, or it cannot be written.
    pub fn create(root: &Path) -> Result<Self, Error> {
        Self::check_folder(root)?;
        let lock = lock(root, false)?;
        let mut folder = OutputFolder::open(root)?;
        folder.always_replaceable(&[STAGES]);
        let database = root.join(DATABASE);
        let mut log = database.as_os_str().to_owned();
        log.push("-wal");
        if Path::new(&log).exists()
            && matches!(read_stage_rows(&database), Ok(Some(_)))
            && let Ok(database) = Database::open(&database)
        {
            // Moves the write-ahead log of an interrupted run into the database.
            database.close()?;
        }
        // Read now, because opening the folder may have completed an interrupted transaction.
        let written = Records::read(&root.join(STAGES)).ok().flatten();
        let records = current_records(root)?;
        let mut this = Self { root: root.to_owned(), _lock: lock, folder, records };
        if written.is_none_or(|written| written.to_json() != this.records.to_json()) {
            this.repair()?;
        }
        Ok(this)
    }

    /// Opens or creates a workspace for a shard. Shards may use it at the same time, and no other
    /// run. They change none of its files, except that the first one completes what an interrupted
    /// run has committed, and those that start with it wait.
    ///
    /// # Errors
    ///
    /// Those of [`Workspace::create`].
    pub fn create_shared(root: &Path) -> Result<Self, Error> {
        let is_unfinished = OutputFolder::is_unfinished(root);
        let until = Instant::now() + if is_unfinished { MAX_WAIT } else { MAX_WAIT_FOR_LOCK };
        loop {
            match Self::share(root) {
                Err(Error::Store(StoreError::InUse { .. })) if Instant::now() < until => {
                    thread::sleep(LOOK);
                }
                shared => return shared,
            }
        }
    }

    fn share(root: &Path) -> Result<Self, Error> {
        if OutputFolder::is_unfinished(root) {
            // Completes what an interrupted run has committed.
            drop(Self::create(root)?);
        }
        Self::check_folder(root)?;
        let lock = lock(root, true)?;
        let folder = OutputFolder::open_shared(root)?;
        Ok(Self { root: root.to_owned(), _lock: lock, folder, records: current_records(root)? })
    }

    /// [`Workspace::create_shared`] for an existing workspace.
    ///
    /// # Errors
    ///
    /// The folder is not a workspace, and those of [`Workspace::create_shared`].
    pub fn open_shared(root: &Path) -> Result<Self, Error> {
        if !is_workspace(root) {
            return Err(Error::NoWorkspace { path: root.to_owned() });
        }
        Self::create_shared(root)
    }

    /// Checks that a folder is a workspace, or can become one; creates it.
    fn check_folder(root: &Path) -> Result<(), Error> {
        disk::create_folders(root).map_err(Error::output(root))?;
        // The files that are written in place, and not replaced by a transaction.
        for name in [LOCK, DATABASE].map(|name| root.join(name)) {
            if fs::symlink_metadata(&name).is_ok_and(|found| found.is_symlink()) {
                return Err(StoreError::LinkInFolder { path: name }.into());
            }
        }
        // Nothing is written into a workspace of another format.
        if let Err(error @ Error::OtherFormat { .. }) = current_records(root) {
            return Err(error);
        }
        let database = root.join(DATABASE);
        if !OutputFolder::is_ours(root) {
            // The record shows that this program made the folder, or, if it is damaged, the
            // database.
            let is_ours = matches!(Records::read(&root.join(STAGES)), Ok(Some(_)))
                || database.is_file() && matches!(read_stage_rows(&database), Ok(Some(_)));
            let reserved = RESERVED.into_iter().map(str::to_owned).chain(rigs_in(root));
            let found =
                reserved.into_iter().find(|name| fs::symlink_metadata(root.join(name)).is_ok());
            if let Some(found) = found.filter(|_| !is_ours) {
                return Err(Error::ForeignWorkspace { path: root.to_owned(), found });
            }
        }
        Ok(())
    }

    /// Opens an existing workspace.
    ///
    /// # Errors
    ///
    /// The folder is not a workspace, and those of [`Workspace::create`].
    pub fn open(root: &Path) -> Result<Self, Error> {
        if !is_workspace(root) {
            return Err(Error::NoWorkspace { path: root.to_owned() });
        }
        Self::create(root)
    }

    /// Writes the record, and removes stages that are no longer complete from the report.
    fn repair(&mut self) -> Result<(), Error> {
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
        self.folder.publish(&[STAGES.to_owned()], &[])?;
        Ok(())
    }

    /// Creates a workspace at `root` with a copy of the features and matches of this one, unless
    /// `root` is a workspace already.
    ///
    /// # Errors
    ///
    /// `root` holds foreign files or cannot be written.
    pub fn fork(&self, root: &Path) -> Result<(), Error> {
        if is_workspace(root) && root.join(DATABASE).is_file() {
            return Ok(());
        }
        let mut fork = Self::create(root)?;
        if self.timestamps().is_file() {
            let to = fork.folder.stage(TIMESTAMPS)?;
            disk::copy_new(&self.timestamps(), &to).map_err(Error::output(&fork.timestamps()))?;
            fork.folder.publish(&[TIMESTAMPS.to_owned()], &[])?;
        }
        // The database includes its records.
        let to = fork.folder.stage(DATABASE)?;
        disk::copy_new(&self.database(), &to).map_err(Error::output(&fork.database()))?;
        disk::rename(&to, &fork.database()).map_err(Error::output(&fork.database()))?;
        disk::sync_folder(root).map_err(Error::output(root))?;
        fork.records = self.records.clone();
        fork.records.forget_from(Stage::Map);
        let report = self.report()?;
        fork.note(|all| *all = report)
    }

    /// Keeps files that a stage reads beside the photos: no result replaces them, then or later.
    pub(crate) fn protect_sources<'a>(&mut self, files: impl IntoIterator<Item = &'a Path>) {
        for file in files {
            self.folder.protect([file]);
            // A file that is not there makes its stage fail.
            self.records.sources.extend(file.canonicalize());
        }
    }

    /// Folder of the workspace.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Path of the COLMAP database.
    pub fn database(&self) -> PathBuf {
        self.root.join(DATABASE)
    }

    /// Folder of the models; the largest is in its sub-folder `0`.
    pub fn sparse(&self) -> PathBuf {
        self.root.join(SPARSE)
    }

    /// Path of the point cloud of the largest model.
    pub fn points(&self) -> PathBuf {
        self.root.join(POINTS)
    }

    /// Path of the capture times.
    pub fn timestamps(&self) -> PathBuf {
        self.root.join(TIMESTAMPS)
    }

    /// Reads the report on all complete stages.
    ///
    /// # Errors
    ///
    /// `report.json` cannot be read or is damaged.
    pub fn report(&self) -> Result<Report, Error> {
        Report::read(&self.report_path())
    }

    fn report_path(&self) -> PathBuf {
        self.root.join(REPORT)
    }

    /// Decides how to run a stage. A complete stage whose files somebody removed continues. Writes
    /// nothing.
    ///
    /// # Errors
    ///
    /// The stage was run with another recipe, and `redo` does not name it; or `report.json` is
    /// foreign.
    pub(crate) fn begin(
        &mut self,
        stage: Stage,
        recipe: &Recipe,
        redo: Option<Stage>,
    ) -> Result<Progress, Error> {
        let mut progress = self.records.begin(&self.root, stage, recipe, redo)?;
        if progress == Progress::Kept && self.has_lost_files(stage) {
            self.records.reopen(stage);
            progress = Progress::Continue;
        }
        if progress != Progress::Kept {
            // Foreign files are detected before any work is done.
            self.folder.ensure_writable([REPORT])?;
        }
        Ok(progress)
    }

    /// Writes the record and the report after `change`.
    ///
    /// # Errors
    ///
    /// A file is damaged, foreign, or cannot be written.
    pub(crate) fn note(&mut self, change: impl FnOnce(&mut Report)) -> Result<(), Error> {
        self.publish(Vec::new(), &[], change)
    }

    /// [`Workspace::note`] in one transaction with staged files and removed ones.
    ///
    /// # Errors
    ///
    /// A file is damaged, foreign, or cannot be written.
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
        self.folder.publish(&files, removed)?;
        Ok(())
    }

    /// Marks a stage as complete; the next [`Workspace::publish`] writes that.
    pub(crate) fn complete(&mut self, stage: Stage) {
        self.records.complete(stage);
    }

    /// The fingerprint of a complete stage.
    ///
    /// # Errors
    ///
    /// [`Error::Missing`] if the stage is not complete, or if files of its models are gone.
    pub(crate) fn fingerprint(&self, stage: Stage) -> Result<String, Error> {
        if self.has_lost_files(stage) {
            return Err(Error::Missing { path: self.root.clone(), stage });
        }
        self.records.fingerprint(&self.root, stage)
    }

    /// Whether files are gone that a stage wrote into the folder of its results: the largest model,
    /// or the dense workspace. Other models and `points.ply` are not worth a run.
    fn has_lost_files(&self, stage: Stage) -> bool {
        let results = match stage {
            // The database has their results and records.
            Stage::Features | Stage::Match => return false,
            Stage::Map => model_path(0),
            Stage::Dense => DENSE.to_owned(),
        };
        let mut names = self.folder.names().filter(|name| Path::new(name).starts_with(&results));
        names.any(|name| !self.folder.exists(name))
    }

    /// Path of the capture times that the feature stage wrote; `None` if it wrote none.
    ///
    /// # Errors
    ///
    /// The file was changed or removed since, which the records would not show.
    pub(crate) fn verified_timestamps(&self) -> Result<Option<PathBuf>, Error> {
        let path = self.timestamps();
        if !path.is_file() && self.folder.names().all(|name| name != TIMESTAMPS) {
            return Ok(None);
        }
        if self.folder.is_unmodified(TIMESTAMPS)? {
            Ok(Some(path))
        } else {
            Err(Error::ChangedTimes { path })
        }
    }
}

/// Names of the files of rig extrinsics in a folder.
pub(crate) fn rigs_in(root: &Path) -> impl Iterator<Item = String> {
    let entries = fs::read_dir(root).into_iter().flatten().flatten();
    entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| is_rig_name(name))
}

/// Whether a folder is a workspace.
pub(crate) fn is_workspace(root: &Path) -> bool {
    let database = root.join(DATABASE);
    // COLMAP's commands put their output beside a database that a caller names, which has no
    // records. A damaged one may be that of a workspace.
    let has_records = || !matches!(read_stage_rows(&database), Ok(None));
    root.join(STAGES).is_file()
        || OutputFolder::is_ours(root) && database.is_file() && has_records()
}

/// Refuses an output folder that is a workspace, or lies where a workspace has its results: its
/// records would no longer be true.
///
/// # Errors
///
/// [`Error::ModelIntoWorkspace`] with the workspace.
pub fn refuse_workspace(to: &Path) -> Result<(), Error> {
    // The folder and some of those above it need not exist yet.
    let path = std::path::absolute(to).map_err(Error::output(to))?;
    let existing = path.ancestors().find_map(|path| path.canonicalize().ok());
    for root in existing.iter().flat_map(|path| path.ancestors()).take(MAX_RESULT_DEPTH) {
        if is_workspace(root) {
            let inner =
                path.ancestors().find(|path| path.canonicalize().is_ok_and(|it| it == root));
            let inner = inner.and_then(|inner| path.strip_prefix(inner).ok());
            let first = inner.and_then(|inner| inner.components().next());
            let is_result = |part: Component| {
                [SPARSE, DENSE, "frames"].map(OsStr::new).contains(&part.as_os_str())
            };
            if first.is_none_or(is_result) {
                return Err(Error::ModelIntoWorkspace { path: root.to_owned() });
            }
        }
    }
    Ok(())
}

/// The records of a workspace, from `stages.json` and the database. Writes nothing.
///
/// # Errors
///
/// `stages.json` is damaged or missing, and there is no readable database to restore it from; or a
/// record has another format.
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
        (Ok(Some(found)), _) => found,
        (Ok(None), Ok(_)) => Records::default(),
        // The database has the records, too.
        (Err(Error::BrokenRecord { .. }), Ok(Some(_))) => Records::default(),
        (Ok(None), Err(_)) => return Ok(rows.map(|_| Records::default())?),
        (Err(error), _) => return Err(error),
    };
    match rows {
        Ok(Some(rows)) => records.take_rows(&database, &rows)?,
        Ok(None) => records.forget_database(),
        // The stage that needs a damaged database reports it.
        Err(_) => {}
    }
    Ok(records)
}

fn lock(root: &Path, is_shared: bool) -> Result<File, Error> {
    let path = root.join(LOCK);
    if fs::metadata(&path).is_ok_and(|found| !found.is_file()) {
        return Err(StoreError::ForeignFile { path }.into());
    }
    // Not truncated: an existing file keeps its content.
    let lock = OpenOptions::new().create(true).truncate(false).read(true).write(true).open(&path);
    let lock = lock.map_err(Error::output(&path))?;
    match if is_shared { lock.try_lock_shared() } else { lock.try_lock() } {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(StoreError::InUse { path: root.to_owned() }.into()),
        Err(TryLockError::Error(cause)) => Err(StoreError::Output { path, cause }.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NO_OPTIONS: [(&str, String); 0] = [];

    #[test]
    fn workspace_is_locked() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("deep/ws");
        assert!(matches!(Workspace::open(&root), Err(Error::NoWorkspace { .. })));
        let held = Workspace::create(&root).unwrap();
        assert!(matches!(Workspace::create(&root), Err(Error::Store(StoreError::InUse { .. }))));
        drop(held);
        Workspace::create(&root).unwrap();
    }

    #[test]
    fn shards_wait_for_one_that_completes_what_a_killed_run_committed() {
        let dir = tempfile::tempdir().unwrap();
        drop(Workspace::create(dir.path()).unwrap());
        fs::create_dir(dir.path().join(".tiepoint-commit")).unwrap();
        let held = lock(dir.path(), false).unwrap();
        thread::scope(|scope| {
            let shards: Vec<_> =
                (0..4).map(|_| scope.spawn(|| Workspace::create_shared(dir.path()))).collect();
            thread::sleep(4 * LOOK);
            assert!(shards.iter().all(|shard| !shard.is_finished()));
            drop(held);
            shards.into_iter().for_each(|shard| drop(shard.join().unwrap().unwrap()));
        });
        assert!(!OutputFolder::is_unfinished(dir.path()));
    }

    #[test]
    fn fork_has_features_and_matches_and_no_models() {
        let dir = tempfile::tempdir().unwrap();
        let mut from = Workspace::create(&dir.path().join("a")).unwrap();
        from.folder.stage_bytes(TIMESTAMPS, b"image,seconds\n").unwrap();
        let recipe = |input: &str| Recipe::new(input.to_owned(), NO_OPTIONS);
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
        assert_eq!(fork.verified_timestamps().unwrap(), Some(root.join(TIMESTAMPS)));
        let matching = recipe(&fork.fingerprint(Stage::Features).unwrap());
        assert_eq!(fork.begin(Stage::Match, &matching, None).unwrap(), Progress::Kept);
        let mapping = recipe(&fork.fingerprint(Stage::Match).unwrap());
        assert_eq!(fork.begin(Stage::Map, &mapping, None).unwrap(), Progress::Begin);
        drop(fork);
        let before = fs::read(root.join(DATABASE)).unwrap();
        from.fork(&root).unwrap();
        assert_eq!(fs::read(root.join(DATABASE)).unwrap(), before, "an existing workspace is kept");
    }

    #[test]
    fn complete_stage_whose_files_are_gone_continues() {
        let dir = tempfile::tempdir().unwrap();
        let mut workspace = Workspace::create(dir.path()).unwrap();
        let recipe = |input: &str| Recipe::new(input.to_owned(), NO_OPTIONS);
        for (stage, file) in
            [(Stage::Map, "sparse/0/points3D.bin"), (Stage::Dense, "dense/fused.ply")]
        {
            workspace.begin(stage, &recipe("input"), None).unwrap();
            workspace.complete(stage);
            let names = [file, POINTS].map(str::to_owned);
            names.iter().for_each(|name| workspace.folder.stage_bytes(name, b"made").unwrap());
            workspace.publish(names.into(), &[], |_| {}).unwrap();
            fs::remove_file(dir.path().join(POINTS)).unwrap();
            assert_eq!(workspace.begin(stage, &recipe("input"), None).unwrap(), Progress::Kept);
            workspace.fingerprint(stage).unwrap();
            fs::remove_dir_all(dir.path().join(file.split('/').next().unwrap())).unwrap();
            assert!(matches!(workspace.fingerprint(stage), Err(Error::Missing { .. })));
            assert_eq!(workspace.begin(stage, &recipe("input"), None).unwrap(), Progress::Continue);
            assert!(!workspace.records.is_complete(stage));
        }
    }

    #[test]
    fn damaged_record_is_restored_from_the_database() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("ws");
        let mut made = Workspace::create(&root).unwrap();
        made.begin(Stage::Features, &Recipe::new("photos".to_owned(), NO_OPTIONS), None).unwrap();
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
        // Without the manifest, like a copy without hidden files.
        fs::remove_file(root.join(tiepoint_store::MANIFEST)).unwrap();
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
    fn folder_with_foreign_files_does_not_become_a_workspace() {
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
    fn error_names_a_file_in_place_of_a_folder() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("file");
        fs::write(&file, "").unwrap();
        let error = Workspace::create(&file.join("ws")).unwrap_err().to_string();
        assert!(error.starts_with("cannot write") && error.contains("file"), "{error}");
    }
}
