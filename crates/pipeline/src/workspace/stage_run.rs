//! The protocol of a stage: whether it runs, what it reports, and the order of its writes.
//!
//! A run may be killed between any two writes. Therefore the order is fixed here, and a stage only
//! returns what is to be written. The models of a stage and the report are replaced in one
//! transaction with the record that the stage is complete. A stage whose results are in the
//! database is complete for later runs when the last transaction of the database says so, which
//! comes behind the report: a complete stage always has its report.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use tiepoint_io::database::{Database, TileWriter};
use tiepoint_sfm::scene::{ImagePair, TwoView};

use super::folder::Workspace;
use super::records::{Progress, Recipe};
use super::report::{FeaturesReport, MatchReport, Report};
use super::shards::{ShardReport, ShardWork};
use crate::shard::Shard;
use crate::{Error, Event, Stage, Watch, emit};

/// A stage that is to be run.
pub(crate) struct StageRequest {
    pub(crate) stage: Stage,
    pub(crate) recipe: Recipe,
    /// The first stage that is run again although it is complete.
    pub(crate) redo: Option<Stage>,
    /// The input folders of the photos, if the stage sets them.
    pub(crate) inputs: Option<Vec<PathBuf>>,
}

/// A stage that runs.
pub(crate) struct StageRun<'a, 'w> {
    pub(crate) workspace: &'a mut Workspace,
    pub(crate) watch: Watch<'w>,
    stage: Stage,
    /// Whether nothing of an interrupted run is kept.
    pub(crate) begins: bool,
    /// Whether the caller asks to run this stage again.
    pub(crate) is_redone: bool,
}

impl StageRun<'_, '_> {
    /// Passes an event to the caller.
    ///
    /// # Errors
    ///
    /// [`Error::Cancelled`].
    pub(crate) fn emit(&mut self, event: &Event) -> Result<(), Error> {
        emit(self.watch, event)
    }

    /// Tells the caller that `done` of `total` steps are there.
    ///
    /// # Errors
    ///
    /// [`Error::Cancelled`].
    pub(crate) fn began(&mut self, total: usize, done: usize) -> Result<(), Error> {
        let stage = self.stage;
        self.emit(&Event::StageBegan { stage, total, done })
    }
}

/// Writes the section of a stage into the report, given its duration in seconds.
type WriteReport = Box<dyn FnOnce(&mut Report, f64)>;

/// What a stage made.
pub(crate) struct StageResult {
    /// Names of the staged files; the last one is the one that readers look for first.
    pub(crate) files: Vec<String>,
    /// Names of files that are removed with them.
    pub(crate) removed: Vec<String>,
    /// The database, if it has the results, and the two-view geometries that its last transaction
    /// replaces.
    pub(crate) database: Option<(Database, BTreeMap<ImagePair, TwoView>)>,
    /// Its section of the report.
    pub(crate) report: WriteReport,
}

impl StageResult {
    /// The result of the feature stage.
    pub(crate) fn features(database: Database, report: FeaturesReport) -> Self {
        Self::in_database(database, BTreeMap::new(), move |all, seconds| {
            all.stages.features = Some(FeaturesReport { seconds, ..report });
        })
    }

    /// The result of matching. `two_views`: the geometries that differ from those in the database.
    pub(crate) fn matches(
        database: Database,
        report: MatchReport,
        two_views: BTreeMap<ImagePair, TwoView>,
    ) -> Self {
        Self::in_database(database, two_views, move |all, seconds| {
            all.warnings = report.warnings();
            all.stages.matches = Some(MatchReport { seconds, ..report });
        })
    }

    fn in_database(
        database: Database,
        two_views: BTreeMap<ImagePair, TwoView>,
        report: impl FnOnce(&mut Report, f64) + 'static,
    ) -> Self {
        let (files, removed) = (Vec::new(), Vec::new());
        Self { files, removed, database: Some((database, two_views)), report: Box::new(report) }
    }
}

impl Workspace {
    /// Runs a stage, unless an earlier run completed it with the same recipe.
    ///
    /// # Errors
    ///
    /// The stage was run with another recipe, and `redo` does not name it; a file cannot be
    /// written; those of `work`; `watch` returns `Break`.
    pub(crate) fn run_stage(
        &mut self,
        request: StageRequest,
        watch: Watch,
        work: impl FnOnce(&mut StageRun) -> Result<StageResult, Error>,
    ) -> Result<(), Error> {
        let StageRequest { stage, recipe, redo, inputs } = request;
        let inputs = inputs.unwrap_or_else(|| self.records.inputs.clone());
        let inputs_before = std::mem::replace(&mut self.records.inputs, inputs);
        let progress = self.begin(stage, &recipe, redo)?;
        if progress == Progress::Kept {
            // A run that was killed may have left them.
            self.remove_tiles(stage, &recipe, &mut *watch)?;
            if self.records.inputs != inputs_before {
                // The photos have moved, and exports need their paths.
                self.note(|_| {})?;
            }
            return emit(watch, &Event::StageKept { stage });
        }
        let start = Instant::now();
        let begins = progress == Progress::Begin;
        let is_redone = redo == Some(stage);
        let result =
            work(&mut StageRun { workspace: self, watch: &mut *watch, stage, begins, is_redone })?;
        let StageResult { files, removed, database, report } = result;
        let seconds = start.elapsed().as_secs_f64();
        self.complete(stage);
        self.publish(files, &removed, |all| report(all, seconds))?;
        if let Some((mut database, two_views)) = database {
            let two_views = two_views.iter().map(|(pair, view)| (*pair, view));
            database.write_two_views_for(two_views, &self.records.rows())?;
            database.close()?;
        }
        self.remove_tiles(stage, &recipe, &mut *watch)?;
        emit(watch, &Event::StageDone { stage, seconds })
    }

    /// Removes the tiles of a complete stage, and says what stays.
    fn remove_tiles(&self, stage: Stage, recipe: &Recipe, watch: Watch) -> Result<(), Error> {
        match self.remove_tiles_of(stage, recipe)? {
            Some(what) => emit(watch, &Event::Noted { what: &what }),
            None => Ok(()),
        }
    }

    /// Runs a shard of a stage, unless an earlier run did. `work` fills its tile.
    ///
    /// # Errors
    ///
    /// Those of [`Workspace::begin_shard`] and of `work`; the tile cannot be written; `watch`
    /// returns `Break`.
    pub(crate) fn run_shard(
        &self,
        stage: Stage,
        (shard, recipe): (Shard, &Recipe),
        redo: Option<Stage>,
        watch: Watch,
        work: impl FnOnce(&mut TileWriter, Watch) -> Result<(), Error>,
    ) -> Result<ShardReport, Error> {
        let (mut tile, report) = match self.begin_shard(stage, shard, recipe, redo)? {
            ShardWork::Begin(tile, report) => (tile, report),
            ShardWork::Kept(report) => {
                emit(watch, &Event::StageKept { stage })?;
                return Ok(report);
            }
        };
        let start = Instant::now();
        work(&mut tile, &mut *watch)?;
        tile.finish()?;
        emit(watch, &Event::StageDone { stage, seconds: start.elapsed().as_secs_f64() })?;
        Ok(report)
    }
}
