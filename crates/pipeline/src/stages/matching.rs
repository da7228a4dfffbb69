//! Stage 2: matches image pairs and verifies them by two-view geometry.
//!
//! Pairs are processed in tiles of the image × image matrix, so that at most the descriptors of two
//! blocks of images are in memory at a time. The matcher gets the pairs of a tile in batches.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;
use tiepoint_input::parallel::for_each_in_order;
use tiepoint_io::database::{Database, TileReader, TileWriter};
use tiepoint_io::features::{DescriptorFormat, Features};
use tiepoint_sfm::convert::keypoint;
use tiepoint_sfm::geometry::Rng;
use tiepoint_sfm::matching::{
    AutoPairs, Matcher, NearestNeighbours, PairSelection, PreparedImages,
};
use tiepoint_sfm::scene::{Camera, Image, ImageId, ImagePair, Keypoint, Match, TwoView};
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions};

use crate::shard::Shard;
use crate::stages::foreign_database::{
    has_imported_pairs, require_descriptors, verify_imported_pairs,
};
use crate::stages::option_keys;
use crate::stages::pair_choice::{self, IMAGES_READ_AT_ONCE, PairChoice};
use crate::stages::stationary::Removal;
use crate::stages::verification::{self, verify};
use crate::workspace::option_names::PAIRS;
use crate::workspace::records::Recipe;
use crate::workspace::report::MatchReport;
use crate::workspace::shards::ShardReport;
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
    /// What matches descriptors.
    pub matcher: Arc<dyn Matcher>,
    /// Options of geometric verification.
    pub verify: VerifyOptions,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Default for MatchOptions {
    fn default() -> Self {
        Self {
            pairs: PairSelection::Auto,
            matcher: Arc::new(NearestNeighbours::default()),
            verify: VerifyOptions::default(),
            seed: 0,
        }
    }
}

impl MatchOptions {
    /// The recipe of the stage; `input`: fingerprint of the feature stage.
    fn recipe(&self, input: String) -> Recipe {
        let Self { pairs, matcher, verify, seed } = self;
        let texts = option_keys::matching_options(pairs.to_string(), verify, *seed);
        let texts = texts.into_iter().map(|(key, value)| (key.to_owned(), value));
        Recipe::new(input, texts.chain(option_keys::matcher_options(&**matcher)))
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
    // Other shards may have it open.
    pair_choice::resolved_in(&Database::open_read_only(&workspace.database())?, pairs)
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
    options.verify.validate()?;
    if has_imported_pairs(workspace, redo) {
        return verify_imported_pairs(workspace, &options.verify, options.seed, redo, watch);
    }
    let input = workspace.fingerprint(Stage::Features)?;
    let is_auto = options.pairs == PairSelection::Auto;
    let options =
        &MatchOptions { pairs: resolved(options.pairs, workspace, redo)?, ..options.clone() };
    let recipe = options.recipe(input);
    let request = StageRequest { stage: Stage::Match, recipe: recipe.clone(), redo, inputs: None };
    workspace.run_stage(request, watch, |run| {
        let workspace = &mut *run.workspace;
        // What is wrong with them is said before anything is replaced.
        let tiles = workspace.check_tiles(Stage::Match, &recipe)?;
        let mut database = Database::open(&workspace.database())?;
        require_descriptors(workspace, &database)?;
        if run.begins {
            database.clear_matches_for(&workspace.records.rows())?;
            workspace.note(|_| {})?;
        }
        workspace.for_each_tile(&tiles, |tile| take_pairs(&mut database, tile))?;
        let images = database.read_images()?;
        note_on_auto(is_auto, &images, &database, run.watch)?;
        let MatchOptions { pairs, seed, .. } = *options;
        let choice =
            pair_choice::choose_pairs_of_images(workspace, &database, &images, pairs, seed)?;
        let report = match_pairs(&mut database, choice, options, run.watch)?;
        let removal = Removal::find(&database, &options.verify, options.seed)?;
        let report = removal.added_to(report, &database)?;
        Ok(StageResult::matches(database, report, removal.into_views()))
    })
}

/// Says that `auto` matches all pairs of many images.
fn note_on_auto(
    is_auto: bool,
    images: &[Image],
    database: &Database,
    watch: Watch,
) -> Result<(), Error> {
    let format = database.descriptor_format()?;
    if is_auto && images.len() > AutoPairs::MAX_EXHAUSTIVE && format != DescriptorFormat::SIFT {
        let what = format!(
            "similar images are found by SIFT descriptors, and those of these images are {format}: \
            all pairs are matched"
        );
        emit(watch, &Event::Noted { what: &what })?;
    }
    Ok(())
}

/// Matches and verifies a shard of the pairs of a workspace that has features into its tile, from
/// which [`match_images`] with the same options takes them. Each shard chooses the pairs of all.
///
/// # Errors
///
/// Those of [`match_images`]; the pairs came with the database of another program; an existing tile
/// is damaged or of other features or options.
pub fn match_shard(
    workspace: &Workspace,
    options: &MatchOptions,
    shard: Shard,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<ShardReport, Error> {
    options.verify.validate()?;
    if has_imported_pairs(workspace, redo) {
        return Err(Error::ImportedPairs { path: workspace.root().to_owned() });
    }
    let input = workspace.fingerprint(Stage::Features)?;
    let options =
        &MatchOptions { pairs: resolved(options.pairs, workspace, redo)?, ..options.clone() };
    let recipe = options.recipe(input);
    workspace.run_shard(Stage::Match, (shard, &recipe), redo, watch, |tile, watch| {
        let database = Database::open_read_only(&workspace.database())?;
        require_descriptors(workspace, &database)?;
        let (cameras, images) = (database.read_cameras()?, database.read_images()?);
        let MatchOptions { pairs, seed, .. } = *options;
        let PairChoice { pairs, .. } =
            pair_choice::choose_pairs_of_images(workspace, &database, &images, pairs, seed)?;
        // By tiles of images, so that a shard has few of them.
        let all = tiles(pairs.into_iter()).concat();
        let own = &all[shard.range(all.len())];
        let total = own.len();
        emit(watch, &Event::StageBegan { stage: Stage::Match, total, done: 0 })?;
        let matching = Matching { cameras: &cameras, images: &images, options };
        let mut report = MatchReport::default();
        let into = &mut Into::Tile { database: &database, tile };
        let own = tiles(own.iter().copied());
        matching.for_all(&own, &BTreeMap::new(), into, &mut report, watch)
    })
}

/// Writes the pairs of a tile into a database.
fn take_pairs(database: &mut Database, mut tile: TileReader) -> Result<(), Error> {
    loop {
        let mut batch = Vec::new();
        while batch.len() < PAIRS_PER_TRANSACTION
            && let Some(found) = tile.next_pair()?
        {
            batch.push(found);
        }
        if batch.is_empty() {
            return Ok(());
        }
        write(database, &mut batch)?;
    }
}

/// Where results of pairs are written, and the database that has the features.
enum Into<'a> {
    Database(&'a mut Database),
    Tile { database: &'a Database, tile: &'a mut TileWriter },
}

impl Into<'_> {
    fn database(&self) -> &Database {
        match self {
            Self::Database(database) => database,
            Self::Tile { database, .. } => database,
        }
    }

    /// Writes the pairs of a batch, and empties it.
    fn write(&mut self, batch: &mut Vec<(ImagePair, Vec<Match>, TwoView)>) -> Result<(), Error> {
        match self {
            Self::Database(database) => write(database, batch),
            Self::Tile { tile, .. } => batch
                .drain(..)
                .try_for_each(|(pair, matches, view)| Ok(tile.write_pair(pair, &matches, &view)?)),
        }
    }
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
    let matching = Matching { cameras: &cameras, images: &images, options };
    let first = matching.first_pairs(database, &pending)?;
    let expected_s = first.expected_s(&tiles, options.matcher.pairs_per_batch());
    emit(watch, &Event::PairsChosen { selection: &selection, pairs: pending.len(), expected_s })?;
    let (total, done) = (all.len(), all.len() - pending.len());
    emit(watch, &Event::StageBegan { stage: Stage::Match, total, done })?;

    let into = &mut Into::Database(database);
    matching.for_all(&tiles, &first.found, into, &mut report, watch)?;
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

/// What the pairs of a run have in common.
struct Matching<'a> {
    cameras: &'a [Camera],
    images: &'a [Image],
    options: &'a MatchOptions,
}

impl Matching<'_> {
    /// The batches that the matcher takes.
    fn batches<'p>(&self, pairs: &'p [ImagePair]) -> Vec<&'p [ImagePair]> {
        pairs.chunks(self.options.matcher.pairs_per_batch().max(1)).collect()
    }

    /// Matches and verifies the pairs of tiles, without those in `first`. Completed pairs are
    /// written when the callback stops the run.
    fn for_all(
        &self,
        tiles: &[Vec<ImagePair>],
        first: &BTreeMap<ImagePair, Found>,
        into: &mut Into,
        report: &mut MatchReport,
        watch: Watch,
    ) -> Result<(), Error> {
        let images = self.images;
        let mut loaded = LoadedImages::new(&*self.options.matcher);
        for pairs in tiles {
            loaded.load(into.database(), pairs)?;
            let batches = self.batches(pairs);
            let work = |pairs: &&[ImagePair]| self.results(pairs, first, &loaded);
            let mut pending = Vec::new();
            let take = |pairs: &&[ImagePair], found: Result<Vec<Found>, Error>| {
                for (pair, (matches, two_view)) in pairs.iter().zip(found?) {
                    let [image1, image2] =
                        [pair.a, pair.b].map(|image| &*images[image.index()].name);
                    let inliers = two_view.matches.len();
                    let event = Event::PairDone { image1, image2, matches: matches.len(), inliers };
                    count(report, matches.len(), two_view.is_verified().then_some(inliers));
                    pending.push((*pair, matches, two_view));
                    if pending.len() >= PAIRS_PER_TRANSACTION {
                        into.write(&mut pending)?;
                    }
                    emit(watch, &event)?;
                }
                Ok(())
            };
            let taken: Result<(), Error> = for_each_in_order(&batches, work, take);
            into.write(&mut pending)?;
            taken?;
        }
        Ok(())
    }

    /// Matches a random sample of the pairs. The results are the same as if the pairs were matched
    /// in their turn.
    fn first_pairs(&self, database: &Database, pending: &[ImagePair]) -> Result<FirstPairs, Error> {
        let mut random = Rng::stream(self.options.seed, &[]);
        let count = pending.len().div_ceil(PAIRS_PER_TIMED_PAIR).min(MAX_TIMED_PAIRS);
        let sample: BTreeSet<ImagePair> =
            (0..count).map(|_| pending[random.below(pending.len())]).collect();
        let sample: Vec<ImagePair> = sample.into_iter().collect();
        let mut loaded = LoadedImages::new(&*self.options.matcher);
        let start = Instant::now();
        loaded.load(database, &sample)?;
        let load_s = start.elapsed().as_secs_f64() / loaded.keypoints.len().max(1) as f64;
        let timed = |pairs: &&[ImagePair]| {
            let start = Instant::now();
            let found = self.match_batch(pairs, &loaded)?;
            Ok((pairs.iter().copied().zip(found).collect(), start.elapsed().as_secs_f64()))
        };
        let timed: Vec<(Vec<(ImagePair, Found)>, f64)> =
            self.batches(&sample).par_iter().map(timed).collect::<Result<_, Error>>()?;
        let pair_s =
            timed.iter().map(|(_, seconds)| seconds).sum::<f64>() / sample.len().max(1) as f64;
        let found = timed.into_iter().flat_map(|(found, _)| found).collect();
        Ok(FirstPairs { found, pair_s, load_s })
    }

    /// The results of a batch, of which `known` are there.
    fn results(
        &self,
        pairs: &[ImagePair],
        known: &BTreeMap<ImagePair, Found>,
        loaded: &LoadedImages,
    ) -> Result<Vec<Found>, Error> {
        let new: Vec<ImagePair> =
            pairs.iter().copied().filter(|pair| !known.contains_key(pair)).collect();
        let mut found = self.match_batch(&new, loaded)?.into_iter();
        Ok(pairs
            .iter()
            .filter_map(|pair| known.get(pair).cloned().or_else(|| found.next()))
            .collect())
    }

    /// Matches the descriptors of pairs and estimates their two-view geometries. The random seed
    /// depends only on `options.seed` and the pair.
    fn match_batch(&self, pairs: &[ImagePair], loaded: &LoadedImages) -> Result<Vec<Found>, Error> {
        let count = |image: ImageId| loaded.keypoints[&image].len();
        let matched = verification::match_pairs(&*loaded.images, pairs, count)?;
        let view = |image: ImageId| ImageObservations {
            keypoints: &loaded.keypoints[&image],
            camera: &self.cameras[self.images[image.index()].camera.index()],
        };
        let MatchOptions { verify: options, seed, .. } = self.options;
        let found = |(pair, matches): (&ImagePair, Vec<Match>)| {
            let two_view = verify(*pair, view, &matches, options, *seed);
            (matches, two_view)
        };
        Ok(pairs.par_iter().zip(matched).map(found).collect())
    }
}

/// Images in memory.
struct LoadedImages {
    /// Their descriptors, as the matcher needs them.
    images: Box<dyn PreparedImages>,
    keypoints: BTreeMap<ImageId, Vec<Keypoint>>,
}

impl LoadedImages {
    fn new(matcher: &dyn Matcher) -> Self {
        Self { images: matcher.images(), keypoints: BTreeMap::new() }
    }

    /// Loads the features of the images of these pairs, and drops all others.
    fn load(&mut self, database: &Database, pairs: &[ImagePair]) -> Result<(), Error> {
        let needed: BTreeSet<ImageId> = pairs.iter().flat_map(|pair| [pair.a, pair.b]).collect();
        self.images.retain(&|image| needed.contains(&ImageId(image)));
        self.keypoints.retain(|image, _| needed.contains(image));
        let missing: Vec<ImageId> =
            needed.into_iter().filter(|image| !self.keypoints.contains_key(image)).collect();
        // In batches, so that few images are in memory twice.
        for batch in missing.chunks(IMAGES_READ_AT_ONCE) {
            let read = batch.iter().map(|&image| Ok((image, database.read_features(image)?)));
            let features = read.collect::<Result<Vec<_>, Error>>()?;
            let numbered: Vec<(u32, &Features)> =
                features.iter().map(|(image, features)| (image.0, features)).collect();
            self.images.insert(&numbered).map_err(Error::Method)?;
            self.keypoints.extend(features.into_iter().map(|(image, features)| {
                (image, features.keypoints.iter().map(keypoint).collect())
            }));
        }
        Ok(())
    }
}

impl FirstPairs {
    /// The expected time of tiles of pairs, in seconds, with as many pairs in a batch.
    fn expected_s(&self, tiles: &[Vec<ImagePair>], pairs_per_batch: usize) -> f64 {
        let mut loads = 0;
        let mut loaded = BTreeSet::new();
        for pairs in tiles {
            let needed: BTreeSet<ImageId> =
                pairs.iter().flat_map(|pair| [pair.a, pair.b]).collect();
            loads += needed.difference(&loaded).count();
            loaded = needed;
        }
        let pairs = tiles.iter().map(Vec::len).sum::<usize>();
        // Batches are matched by a thread each, or one after the other if they are larger.
        let threads = (rayon::current_num_threads() / pairs_per_batch.max(1)).max(1);
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
