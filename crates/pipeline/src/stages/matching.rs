//! Stage 2: matches image pairs and verifies them by two-view geometry.
//!
//! Pairs are processed in tiles of the image × image matrix, so that at most the descriptors of two
//! blocks of images are in memory at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use rayon::prelude::*;
use tiepoint_input::parallel::for_each_in_order;
use tiepoint_io::database::Database;
use tiepoint_io::features::Features;
use tiepoint_sfm::geometry::Rng;
use tiepoint_sfm::matching::{self, PairSelection};
use tiepoint_sfm::scene::{Camera, Image, ImageId, ImagePair, Match, TwoView};
use tiepoint_sfm::{ImageObservations, VerifyOptions};

use crate::stages::foreign_database::{has_imported_pairs, require_sift, verify_imported_pairs};
use crate::stages::loaded_features::LoadedFeatures;
use crate::stages::option_keys;
use crate::stages::pair_choice::{self, IMAGES_READ_AT_ONCE, PairChoice};
use crate::stages::stationary::Removal;
use crate::stages::verification::verify;
use crate::workspace::option_names::PAIRS;
use crate::workspace::records::Recipe;
use crate::workspace::report::MatchReport;
use crate::workspace::stage_run::{StageRequest, StageResult};
use crate::{Error, Event, Stage, Watch, Workspace, emit};

/// Images per side of a tile. 8192 prepared features take 1.4 MiB, so that a tile takes a third of
/// a gigabyte.
const TILE: u32 = 128;
/// Pairs per transaction: an interruption loses at most these.
const PAIRS_PER_TRANSACTION: usize = 64;

/// One of this number of pairs is matched first, for the estimate of the time of all.
const PAIRS_PER_TIMED_PAIR: usize = 100;
/// Most pairs that are matched first. Their images are half a tile at most, and the standard error
/// of their mean time is an eighth of the spread of the times.
const MAX_TIMED_PAIRS: usize = 64;

/// Options of matching.
#[derive(Clone, Debug)]
pub struct MatchOptions {
    /// Image pairs to match.
    pub pairs: PairSelection,
    /// Options of descriptor matching.
    pub descriptors: matching::Options,
    /// Options of geometric verification.
    pub verify: VerifyOptions,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Default for MatchOptions {
    fn default() -> Self {
        Self {
            pairs: PairSelection::Auto,
            descriptors: matching::Options::default(),
            verify: VerifyOptions::default(),
            seed: 0,
        }
    }
}

impl MatchOptions {
    /// The recipe of the stage; `input`: fingerprint of the feature stage.
    fn recipe(&self, input: String) -> Recipe {
        let Self { pairs, descriptors, verify, seed } = self;
        Recipe::new(input, option_keys::matching_options(pairs, descriptors, verify, *seed))
    }
}

/// The selection of this run: that of the record if `auto` agrees with it, as
/// [`pair_choice::resolved`] says. The database is only needed if there is no such record.
fn resolved(
    pairs: PairSelection,
    workspace: &Workspace,
    redo: Option<Stage>,
) -> Result<PairSelection, Error> {
    let recorded = workspace.records.option(Stage::Match, PAIRS);
    let recorded = recorded.filter(|_| redo != Some(Stage::Match));
    let by_record = pair_choice::resolved(pairs, usize::MAX, recorded);
    if by_record != PairSelection::Auto || recorded == Some(&*by_record.to_string()) {
        return Ok(by_record);
    }
    let database = Database::open(&workspace.database())?;
    let images = database.num_images();
    database.close()?;
    Ok(pair_choice::resolved(pairs, images, None))
}

/// Matches and verifies the pairs of a workspace that has features, or resumes that.
///
/// # Errors
///
/// The options are invalid; the workspace has no features; the stage was run with other options,
/// and `redo` does not ask for it; the database cannot be read or written; `watch` returns `Break`.
pub fn match_images(
    workspace: &mut Workspace,
    options: &MatchOptions,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<(), Error> {
    options.descriptors.validate()?;
    options.verify.validate()?;
    if has_imported_pairs(workspace, redo) {
        return verify_imported_pairs(workspace, &options.verify, options.seed, redo, watch);
    }
    let input = workspace.fingerprint(Stage::Features)?;
    let options =
        &MatchOptions { pairs: resolved(options.pairs, workspace, redo)?, ..options.clone() };
    let recipe = options.recipe(input);
    let request = StageRequest { stage: Stage::Match, recipe, redo, inputs: None };
    workspace.run_stage(request, watch, |run| {
        let workspace = &mut *run.workspace;
        let mut database = Database::open(&workspace.database())?;
        require_sift(workspace, &database)?;
        if run.begins {
            database.clear_matches_for(&workspace.records.rows())?;
            workspace.note(|_| {})?;
        }
        let images = database.read_images()?;
        let MatchOptions { pairs, seed, .. } = *options;
        let choice =
            pair_choice::choose_pairs_of_images(workspace, &database, &images, pairs, seed)?;
        let report = match_pairs(&mut database, choice, options, run.watch)?;
        let removal = Removal::find(&database, &options.verify, options.seed)?;
        let report = removal.added_to(report, &database)?;
        Ok(StageResult::matches(database, report, removal.into_views()))
    })
}

/// Matches and verifies the pairs of a choice that have no matches in the database yet. Completed
/// pairs are kept when `watch` stops the run. Matches on overlays are not removed.
///
/// # Errors
///
/// The database cannot be read or written, or `watch` returns `Break`.
pub fn match_pairs(
    database: &mut Database,
    choice: PairChoice,
    options: &MatchOptions,
    watch: Watch,
) -> Result<MatchReport, Error> {
    let (cameras, images) = (database.read_cameras()?, database.read_images()?);
    let PairChoice { selection, pairs: all } = choice;
    let done: BTreeSet<ImagePair> = database.matched_pairs()?.into_iter().collect();
    let pending: Vec<ImagePair> = all.iter().copied().filter(|pair| !done.contains(pair)).collect();
    let tiles = tiles(pending.iter().copied());
    let mut report = report_so_far(database)?;
    let match_pair = |pair: ImagePair, loaded: &BTreeMap<ImageId, LoadedFeatures>| {
        match_pair(pair, loaded, &cameras, &images, options)
    };
    let first = first_pairs(database, &pending, options.seed, match_pair)?;
    let expected_s = first.expected_s(&tiles);
    emit(watch, &Event::PairsChosen { selection: &selection, pairs: pending.len(), expected_s })?;
    let (total, done) = (all.len(), all.len() - pending.len());
    emit(watch, &Event::StageBegan { stage: Stage::Match, total, done })?;

    let mut loaded: BTreeMap<ImageId, LoadedFeatures> = BTreeMap::new();
    for pairs in &tiles {
        load(database, pairs, &mut loaded)?;
        let work = |pair: &ImagePair| match first.found.get(pair) {
            Some(found) => found.clone(),
            None => match_pair(*pair, &loaded),
        };
        let mut batch = Vec::new();
        let taken = for_each_in_order(pairs, work, |pair, (matches, two_view)| {
            let (image1, image2) = (&images[pair.a.index()].name, &images[pair.b.index()].name);
            let inliers = two_view.matches.len();
            let event = Event::PairDone { image1, image2, matches: matches.len(), inliers };
            count(&mut report, matches.len(), two_view.is_verified().then_some(inliers));
            batch.push((*pair, matches, two_view));
            if batch.len() >= PAIRS_PER_TRANSACTION {
                write(database, &mut batch)?;
            }
            emit(watch, &event)
        });
        // Completed pairs are kept when the callback stops the run.
        write(database, &mut batch)?;
        taken?;
    }
    report.selection = selection;
    report.expected_seconds = expected_s;
    Ok(report)
}

/// The result of a pair: its matches and its two-view geometry.
type Found = (Vec<Match>, TwoView);

/// The pairs that are matched before all others, to estimate the time.
struct FirstPairs {
    found: BTreeMap<ImagePair, Found>,
    /// Mean time of a thread for a pair.
    pair_s: f64,
    /// Mean time to load an image, on all threads.
    load_s: f64,
}

/// Matches a random sample of the pairs. The results are the same as if the pairs were matched in
/// their turn.
fn first_pairs(
    database: &Database,
    pending: &[ImagePair],
    seed: u64,
    match_pair: impl Fn(ImagePair, &BTreeMap<ImageId, LoadedFeatures>) -> Found + Sync,
) -> Result<FirstPairs, Error> {
    let mut random = Rng::stream(seed, &[]);
    let count = pending.len().div_ceil(PAIRS_PER_TIMED_PAIR).min(MAX_TIMED_PAIRS);
    let sample: BTreeSet<ImagePair> =
        (0..count).map(|_| pending[random.below(pending.len())]).collect();
    let sample: Vec<ImagePair> = sample.into_iter().collect();
    let mut loaded = BTreeMap::new();
    let start = Instant::now();
    load(database, &sample, &mut loaded)?;
    let load_s = start.elapsed().as_secs_f64() / loaded.len().max(1) as f64;
    let timed = |&pair: &ImagePair| {
        let start = Instant::now();
        let found = match_pair(pair, &loaded);
        ((pair, found), start.elapsed().as_secs_f64())
    };
    let timed: Vec<((ImagePair, Found), f64)> = sample.par_iter().map(timed).collect();
    let pair_s = timed.iter().map(|(_, seconds)| seconds).sum::<f64>() / timed.len().max(1) as f64;
    Ok(FirstPairs { found: timed.into_iter().map(|(found, _)| found).collect(), pair_s, load_s })
}

impl FirstPairs {
    /// The expected time of tiles of pairs, in seconds.
    fn expected_s(&self, tiles: &[Vec<ImagePair>]) -> f64 {
        let mut loads = 0;
        let mut loaded = BTreeSet::new();
        for pairs in tiles {
            let needed: BTreeSet<ImageId> =
                pairs.iter().flat_map(|pair| [pair.a, pair.b]).collect();
            loads += needed.difference(&loaded).count();
            loaded = needed;
        }
        let pairs = tiles.iter().map(Vec::len).sum::<usize>();
        let threads = rayon::current_num_threads();
        self.pair_s * pairs as f64 / threads as f64 + self.load_s * loads as f64
    }
}

/// Groups pairs by tile.
fn tiles(pairs: impl Iterator<Item = ImagePair>) -> Vec<Vec<ImagePair>> {
    let mut tiles: BTreeMap<(u32, u32), Vec<ImagePair>> = BTreeMap::new();
    for pair in pairs {
        tiles.entry((pair.a.0 / TILE, pair.b.0 / TILE)).or_default().push(pair);
    }
    tiles.into_values().collect()
}

/// Loads the features of the images of these pairs, and drops all others.
fn load(
    database: &Database,
    pairs: &[ImagePair],
    loaded: &mut BTreeMap<ImageId, LoadedFeatures>,
) -> Result<(), Error> {
    let needed: BTreeSet<ImageId> = pairs.iter().flat_map(|pair| [pair.a, pair.b]).collect();
    loaded.retain(|image, _| needed.contains(image));
    let missing: Vec<ImageId> =
        needed.into_iter().filter(|image| !loaded.contains_key(image)).collect();
    let prepare = |(image, features): (ImageId, Features)| (image, LoadedFeatures::new(&features));
    // In batches, so that few images are in memory twice.
    for batch in missing.chunks(IMAGES_READ_AT_ONCE) {
        let read = batch.iter().map(|&image| Ok((image, database.read_features(image)?)));
        let features = read.collect::<Result<Vec<_>, Error>>()?;
        loaded.extend(features.into_par_iter().map(prepare).collect::<Vec<_>>());
    }
    Ok(())
}

/// Matches the descriptors of a pair and estimates its two-view geometry. The random seed depends
/// only on `options.seed` and the pair.
fn match_pair(
    pair: ImagePair,
    loaded: &BTreeMap<ImageId, LoadedFeatures>,
    cameras: &[Camera],
    images: &[Image],
    options: &MatchOptions,
) -> (Vec<Match>, TwoView) {
    let (a, b) = (&loaded[&pair.a], &loaded[&pair.b]);
    let matches = a.matches(b, &options.descriptors);
    let view = |image: ImageId| ImageObservations {
        keypoints: &loaded[&image].keypoints,
        camera: &cameras[images[image.index()].camera.index()],
    };
    let two_view = verify(pair, view, &matches, &options.verify, options.seed);
    (matches, two_view)
}

/// Writes the pairs of a batch in one transaction, and empties it.
fn write(
    database: &mut Database,
    batch: &mut Vec<(ImagePair, Vec<Match>, TwoView)>,
) -> Result<(), Error> {
    database
        .write_pairs(batch.iter().map(|(pair, matches, view)| (*pair, matches.as_slice(), view)))?;
    batch.clear();
    Ok(())
}

/// The report on the pairs in the database. Only counts are read, because the matches of a long
/// video may not fit into memory.
fn report_so_far(database: &Database) -> Result<MatchReport, Error> {
    let mut report = MatchReport::default();
    let inliers: BTreeMap<ImagePair, Option<usize>> =
        database.inlier_counts()?.into_iter().collect();
    for (pair, matches) in database.match_counts()? {
        count(&mut report, matches, inliers.get(&pair).copied().flatten());
    }
    Ok(report)
}

/// Adds a pair to the report. `inliers`: number of inliers if the pair is verified.
fn count(report: &mut MatchReport, matches: usize, inliers: Option<usize>) {
    report.pairs += 1;
    report.matches += matches;
    if let Some(inliers) = inliers {
        report.verified_pairs += 1;
        report.inlier_matches += inliers;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_have_every_pair_once_and_few_images() {
        let pair = |a, b| ImagePair::new(ImageId(a), ImageId(b)).unwrap();
        let pairs: Vec<ImagePair> =
            (0..300).flat_map(|a| (a + 1..300).step_by(7).map(move |b| pair(a, b))).collect();
        let tiles = tiles(pairs.iter().copied());
        let mut back = tiles.concat();
        back.sort();
        assert_eq!(back, pairs);
        for tile in &tiles {
            let images: BTreeSet<ImageId> = tile.iter().flat_map(|pair| [pair.a, pair.b]).collect();
            assert!(images.len() <= 2 * TILE as usize);
        }
    }
}
