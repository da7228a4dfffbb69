//! Stage 2: matches image pairs and verifies them by two-view geometry.
//!
//! Pairs are processed in tiles of the image × image matrix, so that at most the descriptors of two
//! blocks of images are in memory at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use rayon::prelude::*;
use tiepoint_io::database::Database;
use tiepoint_io::timestamps;
use tiepoint_sfm::geometry::Rng;
use tiepoint_sfm::matching::{
    self, GlobalDescriptor, PairSelection, Prepared, RetrievalIndex, Sequence, Vocabulary,
    VocabularyOptions, match_prepared,
};
use tiepoint_sfm::scene::{Camera, Image, ImageId, ImagePair, Keypoint, Match, TwoView};
use tiepoint_sfm::{VerifyOptions, View, verify_pair};

use crate::foreign_database::{has_imported_pairs, require_sift, verify_imported_pairs};
use crate::keypoints::keypoint;
use crate::ordered::for_each_in_order;
use crate::records::{Progress, Recipe};
use crate::{Error, Event, MatchReport, Stage, Watch, Workspace, emit, option_keys};

/// Images per side of a tile. 8192 prepared features take 1.4 MiB, so that a tile takes a third of
/// a gigabyte.
const TILE: u32 = 128;
/// Pairs per transaction: an interruption loses at most these.
const PAIRS_PER_TRANSACTION: usize = 64;

/// Size of the sample that the visual vocabulary is learnt from: number of images, and descriptors
/// per image. It gives about 400 descriptors per word.
const SAMPLE_IMAGES: usize = 256;
const SAMPLE_DESCRIPTORS: usize = 200;
/// Images that are read from the database at a time.
const IMAGES_READ_AT_ONCE: usize = 16;

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
            pairs: PairSelection::Exhaustive,
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
        Recipe::new(input, option_keys::of_matching(pairs, descriptors, verify, *seed))
    }
}

/// Features of an image in memory.
struct Loaded {
    keypoints: Vec<Keypoint>,
    descriptors: Prepared,
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
    const STAGE: Stage = Stage::Match;
    options.descriptors.validate()?;
    if has_imported_pairs(workspace, redo) {
        return verify_imported_pairs(workspace, &options.verify, options.seed, redo, watch);
    }
    let recipe = options.recipe(workspace.fingerprint(Stage::Features)?);
    let progress = workspace.begin(STAGE, &recipe, redo)?;
    if progress == Progress::Kept {
        return emit(watch, &Event::StageKept { stage: STAGE });
    }
    let start = Instant::now();
    let mut database = Database::open(&workspace.database())?;
    require_sift(workspace, &database)?;
    if progress == Progress::Begin {
        database.clear_matches_for(&workspace.records.rows())?;
        workspace.note(|_| {})?;
    }
    let (cameras, images) = (database.read_cameras()?, database.read_images()?);
    let all = select_pairs(workspace, &database, &images, options)?;
    let done: BTreeSet<ImagePair> = database.matched_pairs()?.into_iter().collect();
    let tiles = tiles(all.iter().copied().filter(|pair| !done.contains(pair)));
    let mut report = report_so_far(&database)?;
    emit(watch, &Event::StageBegan { stage: STAGE, total: all.len(), done: done.len() })?;

    let mut loaded: BTreeMap<ImageId, Loaded> = BTreeMap::new();
    for pairs in &tiles {
        load(&database, pairs, &mut loaded)?;
        let work = |pair: &ImagePair| match_pair(*pair, &loaded, &cameras, &images, options);
        let mut batch = Vec::new();
        let taken = for_each_in_order(pairs, work, |pair, (matches, two_view)| {
            let (image1, image2) = (&images[pair.a.index()].name, &images[pair.b.index()].name);
            let inliers = two_view.matches.len();
            let event = Event::PairDone { image1, image2, matches: matches.len(), inliers };
            count(&mut report, matches.len(), two_view.is_verified().then_some(inliers));
            batch.push((*pair, matches, two_view));
            if batch.len() >= PAIRS_PER_TRANSACTION {
                write(&mut database, &mut batch)?;
            }
            emit(watch, &event)
        });
        // Completed pairs are kept when the callback stops the run.
        write(&mut database, &mut batch)?;
        taken?;
    }
    let seconds = start.elapsed().as_secs_f64();
    report.seconds = seconds;
    // The report is written first, because the database marks the stage as complete.
    workspace.complete(STAGE);
    workspace.note(|all| all.stages.matches = Some(report))?;
    database.write_stage_rows(&workspace.records.rows())?;
    database.close()?;
    emit(watch, &Event::StageDone { stage: STAGE, seconds })
}

/// The pairs to match. The images of a folder are a sequence, whatever settings its camera had;
/// they are ordered by time if all times are known, else by name. Similar images are found by the
/// visual vocabulary.
fn select_pairs(
    workspace: &Workspace,
    database: &Database,
    images: &[Image],
    options: &MatchOptions,
) -> Result<Vec<ImagePair>, Error> {
    let times = workspace.timestamps_as_left()?;
    let times = times.map_or(Ok(BTreeMap::new()), |path| timestamps::read(&path))?;
    // Of each camera: the first camera in its folder, that of its first image.
    let mut firsts: BTreeMap<u32, u32> = BTreeMap::new();
    let mut first_in_folder: BTreeMap<&str, u32> = BTreeMap::new();
    for image in images {
        firsts
            .entry(image.camera.0)
            .or_insert_with(|| *first_in_folder.entry(image.folder()).or_insert(image.camera.0));
    }
    let mut folders: BTreeMap<u32, Vec<(f64, u32)>> = BTreeMap::new();
    let are_timed = images.iter().all(|image| times.contains_key(&image.name));
    for (id, image) in (0..).zip(images) {
        let time_s = times.get(&image.name).copied().unwrap_or_default();
        folders.entry(firsts[&image.camera.0]).or_default().push((time_s, id));
    }
    let sequences = folders.into_values().map(|mut images| {
        if !are_timed {
            return Ok(Sequence::new(images.into_iter().map(|(_, id)| id).collect()));
        }
        images.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (times_s, ids) = images.into_iter().unzip();
        Sequence::with_times(ids, times_s)
    });
    let sequences: Vec<Sequence> = sequences.collect::<Result<_, _>>()?;
    let mut pairs = options.pairs.pairs(&sequences);
    if options.pairs.similar() > 0 {
        let index = retrieval_index(database, images.len(), options.seed)?;
        let similar = index.pairs(options.pairs.similar() as usize, &pairs);
        pairs.extend(similar);
        pairs.sort_unstable();
    }
    Ok(pairs.into_iter().filter_map(|(a, b)| ImagePair::new(ImageId(a), ImageId(b))).collect())
}

/// Global descriptors of all images, from a visual vocabulary that is learnt from a sample of them.
fn retrieval_index(database: &Database, images: usize, seed: u64) -> Result<RetrievalIndex, Error> {
    let mut sample = Vec::new();
    for image in (0..images).step_by(images.div_ceil(SAMPLE_IMAGES).max(1)) {
        let features = database.read_features(ImageId::from_index(image))?;
        sample.extend(Vocabulary::sample(&features.descriptors, SAMPLE_DESCRIPTORS).copied());
    }
    let vocabulary = Vocabulary::learn(&sample, &VocabularyOptions { seed, ..Default::default() });
    let mut index = RetrievalIndex::default();
    let ids: Vec<ImageId> = (0..images).map(ImageId::from_index).collect();
    for batch in ids.chunks(IMAGES_READ_AT_ONCE) {
        let features = batch.iter().map(|&image| database.read_features(image));
        let features = features.collect::<Result<Vec<_>, _>>()?;
        let described: Vec<GlobalDescriptor> = features
            .par_iter()
            .map(|features| vocabulary.describe(&features.descriptors))
            .collect();
        described.iter().for_each(|image| index.push(image));
    }
    Ok(index)
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
    loaded: &mut BTreeMap<ImageId, Loaded>,
) -> Result<(), Error> {
    let needed: BTreeSet<ImageId> = pairs.iter().flat_map(|pair| [pair.a, pair.b]).collect();
    loaded.retain(|image, _| needed.contains(image));
    let missing: Vec<ImageId> =
        needed.into_iter().filter(|image| !loaded.contains_key(image)).collect();
    let prepare = |(image, features): (ImageId, tiepoint_io::features::Features)| {
        let keypoints = features.keypoints.iter().map(keypoint).collect();
        (image, Loaded { keypoints, descriptors: Prepared::new(&features.descriptors) })
    };
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
    loaded: &BTreeMap<ImageId, Loaded>,
    cameras: &[Camera],
    images: &[Image],
    options: &MatchOptions,
) -> (Vec<Match>, TwoView) {
    let (a, b) = (&loaded[&pair.a], &loaded[&pair.b]);
    let matches = match_prepared(&a.descriptors, &b.descriptors, &options.descriptors);
    let matches: Vec<Match> = matches.iter().map(|m| Match { a: m.a, b: m.b }).collect();
    let view = |image: ImageId| View {
        keypoints: &loaded[&image].keypoints,
        camera: &cameras[images[image.index()].camera.index()],
    };
    let seed = Rng::stream(options.seed, &[u64::from(pair.a.0), u64::from(pair.b.0)]).next_u64();
    let two_view = verify_pair(view(pair.a), view(pair.b), &matches, &options.verify, seed);
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
    use tiepoint_io::features::{Descriptor, Features, Keypoint as Feature};
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics};
    use tiepoint_sfm::scene::CameraId;

    use super::*;

    #[test]
    fn similar_images_are_paired() {
        /// More than are read at a time; two images per place.
        const PLACES: usize = 50;
        const FEATURES: usize = 40;
        let folder = tempfile::tempdir().unwrap();
        let mut database = Database::create(&folder.path().join("database.db")).unwrap();
        let intrinsics = Intrinsics::new(CameraModelKind::Pinhole, &[9.0, 9.0, 5.0, 5.0]).unwrap();
        let camera = Camera { intrinsics, width: 10, height: 10, has_focal_prior: false };
        database.write_cameras(&[camera]).unwrap();
        let image = |k: usize| Image::new(format!("{k}.jpg"), CameraId(0), Vec::new());
        database.write_images(&(0..2 * PLACES).map(image).collect::<Vec<_>>()).unwrap();
        let seen = |image: usize| {
            let mut place = Rng::stream(7, &[(image % PLACES) as u64]);
            let mut noise = Rng::stream(8, &[image as u64]);
            let mut descriptor = || -> Descriptor {
                std::array::from_fn(|_| (place.below(80) + noise.below(8)) as u8)
            };
            Features {
                keypoints: vec![Feature { x: 1.0, y: 2.0, scale: 1.0, orientation: 0.0 }; FEATURES],
                descriptors: (0..FEATURES).map(|_| descriptor()).collect(),
            }
        };
        for k in 0..2 * PLACES {
            database.write_features([(ImageId::from_index(k), &seen(k))]).unwrap();
        }
        let pairs = retrieval_index(&database, 2 * PLACES, 0).unwrap().pairs(1, &[]);
        let expected: Vec<(u32, u32)> =
            (0..PLACES as u32).map(|k| (k, k + PLACES as u32)).collect();
        assert_eq!(pairs, expected);
    }

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
