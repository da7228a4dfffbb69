//! A detector and a matcher of a caller go through all stages: corners with patches of 64 floats,
//! on photos of a rendered drive.
#![allow(clippy::unwrap_used)]

use std::error::Error as StdError;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use tiepoint_pipeline::input::cameras::Calibration;
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::io::database::Database;
use tiepoint_pipeline::io::features::{
    DescriptorEntries, DescriptorFormat, DescriptorKind, Descriptors, Extractor, Features,
    GrayView, Keypoint,
};
use tiepoint_pipeline::models::{LocalizeOptions, localize};
use tiepoint_pipeline::sfm::matching::{
    self, Match, Matcher, NearestNeighbours, Pair, PairSelection, PreparedImages,
};
use tiepoint_pipeline::sfm::scene::{ImageId, Reconstruction};
use tiepoint_pipeline::stages::{
    FeatureOptions, MapOptions, MatchOptions, choose_pairs, match_images,
};
use tiepoint_pipeline::workspace::LocatedModel;
use tiepoint_pipeline::{Error, Event, Options, Stage, Workspace, reconstruct};
use tiepoint_synth::{Drive, DriveOptions, Mount, ViewDirection};

type Failure = Box<dyn StdError + Send + Sync>;

/// Shi-Tomasi corners (1994) with the brightness of a patch around them: 8 × 8 means of 3 × 3
/// pixels, without their mean and of norm 1.
#[derive(Clone, Copy, Debug)]
struct Corners {
    max_features: usize,
}

/// Half the size of a patch, with the pixels that its means take, in pixels.
const REACH: usize = 13;
const DIM: usize = 64;

impl Corners {
    const FORMAT: DescriptorFormat = DescriptorFormat { kind: DescriptorKind::Floats, dim: DIM };

    /// The smaller eigenvalue of the gradient matrix of 5 × 5 pixels around each pixel.
    fn strength(image: &GrayView<'_>) -> Vec<f32> {
        let (width, height) = (image.width, image.height);
        let at = |x: usize, y: usize| f32::from(image.data[y * image.stride + x]);
        let mut strength = vec![0.0; width * height];
        for y in REACH..height - REACH {
            for x in REACH..width - REACH {
                let [mut xx, mut xy, mut yy] = [0.0; 3];
                for (v, u) in (y - 2..=y + 2).flat_map(|v| (x - 2..=x + 2).map(move |u| (v, u))) {
                    let dx = at(u + 1, v) - at(u - 1, v);
                    let dy = at(u, v + 1) - at(u, v - 1);
                    xx += dx * dx;
                    xy += dx * dy;
                    yy += dy * dy;
                }
                let half: f32 = 0.5 * (xx - yy);
                strength[y * width + x] = 0.5 * (xx + yy) - half.hypot(xy);
            }
        }
        strength
    }

    /// The patch around a pixel; `None` if all of it is equally bright.
    fn patch(image: &GrayView<'_>, x: usize, y: usize) -> Option<[f32; DIM]> {
        let mean = |k: usize| {
            let (u, v) = (x + 3 * (k % 8) - 11, y + 3 * (k / 8) - 11);
            let rows = (v - 1..=v + 1).map(|v| &image.data[v * image.stride..][u - 1..=u + 1]);
            rows.flatten().map(|value| f32::from(*value)).sum::<f32>() / 9.0
        };
        let values: [f32; DIM] = std::array::from_fn(mean);
        let of_all = values.iter().sum::<f32>() / DIM as f32;
        let norm = values.iter().map(|value| (value - of_all).powi(2)).sum::<f32>().sqrt();
        (norm > 0.0).then(|| values.map(|value| (value - of_all) / norm))
    }
}

impl Extractor for Corners {
    fn name(&self) -> &str {
        "corners"
    }

    fn options(&self) -> Vec<(&'static str, String)> {
        vec![("max_features", self.max_features.to_string())]
    }

    fn format(&self) -> DescriptorFormat {
        Self::FORMAT
    }

    fn memory_bytes(&self, width: u32, height: u32) -> u64 {
        4 * u64::from(width) * u64::from(height)
    }

    fn extract(
        &self,
        image: &GrayView<'_>,
        mask: Option<&GrayView<'_>>,
    ) -> Result<Features, Failure> {
        let (width, height) = (image.width, image.height);
        if width.min(height) <= 2 * REACH {
            return Err(format!("{width} x {height} pixels are too few for a patch").into());
        }
        let strength = Self::strength(image);
        let is_largest = |x: usize, y: usize| {
            let own = (strength[y * width + x], y, x);
            let mut around = (y - 3..=y + 3).flat_map(|v| (x - 3..=x + 3).map(move |u| (v, u)));
            own.0 > 0.0 && around.all(|(v, u)| (strength[v * width + u], v, u) <= own)
        };
        let pixels = (REACH..height - REACH)
            .flat_map(|y| (REACH..width - REACH).map(move |x| (x, y)))
            .filter(|(x, y)| mask.is_none_or(|mask| mask.data[y * mask.stride + x] > 0));
        let mut corners: Vec<(usize, usize)> = pixels.filter(|(x, y)| is_largest(*x, *y)).collect();
        corners.sort_by(|a, b| {
            strength[b.1 * width + b.0].total_cmp(&strength[a.1 * width + a.0]).then(a.cmp(b))
        });
        corners.truncate(self.max_features);
        let (mut keypoints, mut entries) = (Vec::new(), Vec::new());
        for (x, y) in corners {
            let Some(patch) = Self::patch(image, x, y) else { continue };
            let (x, y) = (x as f32 + 0.5, y as f32 + 0.5);
            keypoints.push(Keypoint { x, y, scale: 1.0, orientation: 0.0 });
            entries.extend(patch);
        }
        let descriptors = Descriptors::new(Self::FORMAT, DescriptorEntries::Floats(entries))?;
        Ok(Features { keypoints, descriptors })
    }
}

/// The built-in matcher with all pairs of a tile in a batch, as a GPU would have it.
#[derive(Debug, Default)]
struct Batched {
    inner: NearestNeighbours,
    /// Numbers of batches and of pairs.
    calls: Arc<[AtomicUsize; 2]>,
}

struct BatchedImages {
    inner: Box<dyn PreparedImages>,
    calls: Arc<[AtomicUsize; 2]>,
}

impl Matcher for Batched {
    fn name(&self) -> &str {
        "batched"
    }

    fn options(&self) -> Vec<(&'static str, String)> {
        self.inner.options()
    }

    fn images(&self) -> Box<dyn PreparedImages> {
        Box::new(BatchedImages { inner: self.inner.images(), calls: self.calls.clone() })
    }
}

impl PreparedImages for BatchedImages {
    fn insert(&mut self, images: &[(u32, &Features)]) -> Result<(), Failure> {
        self.inner.insert(images)
    }

    fn retain(&mut self, is_needed: &dyn Fn(u32) -> bool) {
        self.inner.retain(is_needed);
    }

    fn match_pairs(&self, pairs: &[Pair]) -> Result<Vec<Vec<Match>>, Failure> {
        self.calls[0].fetch_add(1, Ordering::Relaxed);
        self.calls[1].fetch_add(pairs.len(), Ordering::Relaxed);
        self.inner.match_pairs(pairs)
    }
}

const OLD: usize = 8;
const ALL: usize = 9;
/// Positions of the cameras relative to the length of the drive. Corners are at whole pixels: with
/// uniform rounding errors of 0.29 px, at a focal length of 288 px and a distance of 10 m to the
/// houses, a camera is off by some centimetres of 7 m.
const MAX_ERROR: f64 = 0.02;

/// A camera that looks to the right.
fn drive() -> &'static Drive {
    static DRIVE: OnceLock<Drive> = OnceLock::new();
    DRIVE.get_or_init(|| {
        let [left, _] = Mount::stereo(ViewDirection::Right, 0.5);
        let options =
            DriveOptions { mounts: vec![left], width: 480, height: 360, ..DriveOptions::default() };
        let mut drive = Drive::new(&options).unwrap();
        drive.keep_first(ALL);
        drive
    })
}

/// A folder with `old` (photos and their workspace `ws`) and `new`, made once; and the calls of the
/// matcher, batches and pairs.
fn folder() -> (&'static Path, [usize; 2]) {
    static FOLDER: OnceLock<(tempfile::TempDir, [usize; 2])> = OnceLock::new();
    let (dir, calls) = FOLDER.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let (drive, renderer) = (drive(), drive().renderer(0));
        for (index, exposure) in drive.cameras()[0].exposures.iter().enumerate() {
            let folder = dir.path().join(if index < OLD { "old" } else { "new" });
            drive.write_image(&folder, 0, exposure, &renderer).unwrap();
        }
        let matcher = Arc::new(Batched::default());
        let matching = MatchOptions { matcher: matcher.clone(), ..MatchOptions::default() };
        let options = Options { matching, ..options() };
        reconstruct(&[dir.path().join("old")], &dir.path().join("ws"), &options, &mut go_on)
            .unwrap();
        let calls = [0, 1].map(|k: usize| matcher.calls[k].load(Ordering::Relaxed));
        (dir, calls)
    });
    (dir.path(), *calls)
}

fn extractor() -> Arc<dyn Extractor> {
    Arc::new(Corners { max_features: 1500 })
}

fn calibration() -> Calibration {
    let camera = &drive().cameras()[0];
    Calibration::Known(camera.lens.nearest_intrinsics(camera.width, camera.height))
}

fn options() -> Options {
    let (extractor, calibration) = (extractor(), calibration());
    let features = FeatureOptions { extractor, calibration, ..FeatureOptions::default() };
    Options { features, ..Options::default() }
}

fn go_on(_: &Event) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// The largest distance of the cameras of a model from their true places, over the length of the
/// drive: distances from the first camera are compared.
fn error(model: &Reconstruction) -> f64 {
    let truth = drive().truth();
    let true_place = |name: &str| {
        let (_, _, pose) = truth.registered().find(|(_, image, _)| image.name == name).unwrap();
        pose.origin_in_a()
    };
    let places: Vec<_> = model
        .registered()
        .map(|(_, image, pose)| (pose.origin_in_a(), true_place(&image.name)))
        .collect();
    let from_first = |k: usize| (places[k].0 - places[0].0, places[k].1 - places[0].1);
    let (found, length) = from_first(OLD - 1);
    let scale = length.norm() / found.norm();
    let errors = (0..places.len()).map(from_first);
    let errors = errors.map(|(found, truth)| (scale * found.norm() - truth.norm()).abs());
    errors.fold(0.0, f64::max) / length.norm()
}

fn model(workspace: &Path) -> Reconstruction {
    read_model(&workspace.join("sparse/0")).unwrap()
}

/// Held by a test that opens the workspace, which only one may do at a time.
static IN_USE: Mutex<()> = Mutex::new(());

/// Runs all stages again, and returns those that were kept.
fn run(folder: &Path, options: &Options) -> Result<Vec<Stage>, Error> {
    let _in_use = IN_USE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut kept = Vec::new();
    let mut watch = |event: &Event| {
        if let Event::StageKept { stage } = event {
            kept.push(*stage);
        }
        ControlFlow::Continue(())
    };
    reconstruct(&[folder.join("old")], &folder.join("ws"), options, &mut watch)?;
    Ok(kept)
}

#[test]
fn photos_become_a_model_and_a_second_run_keeps_it() {
    let (folder, calls) = folder();
    let found = model(&folder.join("ws"));
    assert_eq!(found.num_registered(), OLD);
    assert!(error(&found) < MAX_ERROR, "{}", error(&found));
    // All pairs of the tile at once, after the pair whose time is measured.
    assert_eq!(calls, [2, OLD * (OLD - 1) / 2]);

    let batched = MatchOptions { matcher: Arc::new(Batched::default()), ..Default::default() };
    let same = Options { matching: batched, ..options() };
    assert_eq!(run(folder, &same).unwrap(), [Stage::Features, Stage::Match, Stage::Map]);
    let message = |options: &Options| run(folder, options).unwrap_err().to_string();
    let sift = FeatureOptions { calibration: calibration(), ..Default::default() };
    let text = message(&Options { features: sift, ..same.clone() });
    assert!(text.contains("with `features.detector` corners and not sift"), "{text}");
    let extractor = Arc::new(Corners { max_features: 99 });
    let fewer = FeatureOptions { extractor, calibration: calibration(), ..Default::default() };
    let text = message(&Options { features: fewer, ..same });
    assert!(text.contains("with `features.detector.max_features` 1500 and not 99"), "{text}");
    let text = message(&options());
    assert!(text.contains("with `match.matcher` batched and not nearest_neighbours"), "{text}");
}

#[test]
fn a_photo_is_localized_and_other_features_are_refused() {
    let (folder, _) = folder();
    let dir = tempfile::tempdir().unwrap();
    let output = dir.path().join("new");
    let find = |options: &LocalizeOptions| {
        let model = LocatedModel::open(&folder.join("ws")).unwrap();
        localize(&model, &[folder.join("new")], &output, options, &mut go_on)
    };
    let (extractor, calibration) = (extractor(), calibration());
    let same = LocalizeOptions { extractor, calibration, ..LocalizeOptions::default() };
    let report = find(&same).unwrap();
    assert_eq!((report.localized, report.photos.len()), (1, 1));
    let found = read_model(&output).unwrap();
    assert_eq!(found.num_registered(), ALL);
    assert!(error(&found) < MAX_ERROR, "{}", error(&found));
    let text = find(&LocalizeOptions::default()).unwrap_err().to_string();
    assert!(text.contains("has features of 64 floats, and the photos would get those of SIFT"));
}

/// Without SIFT descriptors there are no similar images.
#[test]
fn retrieval_is_refused() {
    let (folder, _) = folder();
    let dir = tempfile::tempdir().unwrap();
    let workspace = dir.path().join("ws");
    let in_use = IN_USE.lock().unwrap_or_else(PoisonError::into_inner);
    Workspace::open(&folder.join("ws")).unwrap().fork(&workspace).unwrap();
    drop(in_use);
    let mut fork = Workspace::open(&workspace).unwrap();
    for pairs in ["similar:3", "sequential:2+loops:1"] {
        let pairs: PairSelection = pairs.parse().unwrap();
        let text = choose_pairs(&fork, pairs, 0).unwrap_err().to_string();
        assert!(text.contains("similar images are found by SIFT descriptors"), "{text}");
        assert!(text.contains("those of its images are 64 floats"), "{text}");
        let options = MatchOptions { pairs, ..MatchOptions::default() };
        match_images(&mut fork, &options, Some(Stage::Match), &mut go_on).unwrap_err();
    }
}

/// A matcher that finds a keypoint that no image has, or another number of lists than pairs.
#[derive(Debug)]
struct Wrong {
    num_lists: usize,
}

impl Matcher for Wrong {
    fn name(&self) -> &str {
        "wrong"
    }

    fn options(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    fn images(&self) -> Box<dyn PreparedImages> {
        Box::new(Self { num_lists: self.num_lists })
    }
}

impl PreparedImages for Wrong {
    fn insert(&mut self, _: &[(u32, &Features)]) -> Result<(), Failure> {
        Ok(())
    }

    fn retain(&mut self, _: &dyn Fn(u32) -> bool) {}

    fn match_pairs(&self, _: &[Pair]) -> Result<Vec<Vec<Match>>, Failure> {
        let none = Match { a: 0, b: 100_000, distance: 0.0 };
        Ok(vec![vec![none]; self.num_lists])
    }
}

/// An extractor with two keypoints for a descriptor.
#[derive(Debug)]
struct Uneven;

impl Extractor for Uneven {
    fn name(&self) -> &str {
        "uneven"
    }

    fn options(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    fn format(&self) -> DescriptorFormat {
        DescriptorFormat::SIFT
    }

    fn memory_bytes(&self, _: u32, _: u32) -> u64 {
        0
    }

    fn extract(&self, _: &GrayView<'_>, _: Option<&GrayView<'_>>) -> Result<Features, Failure> {
        let keypoint = Keypoint { x: 1.0, y: 1.0, scale: 1.0, orientation: 0.0 };
        Ok(Features { keypoints: vec![keypoint; 2], descriptors: vec![[0; 128]].into() })
    }
}

#[test]
fn results_that_do_not_fit_together_are_refused() {
    let (folder, _) = folder();
    let dir = tempfile::tempdir().unwrap();
    let message = |options: &Options, workspace: &str| {
        let workspace = dir.path().join(workspace);
        reconstruct(&[folder.join("old")], &workspace, options, &mut go_on).unwrap_err().to_string()
    };
    for (num_lists, expected) in [
        (0, "the matcher gives 0 lists of matches for 1 pairs"),
        (1, "the matcher matches keypoints 0 and 100000 of images with"),
    ] {
        let matching =
            MatchOptions { matcher: Arc::new(Wrong { num_lists }), ..Default::default() };
        let text = message(&Options { matching, ..options() }, &format!("ws{num_lists}"));
        assert!(text.contains(expected), "{text}");
    }
    let features = FeatureOptions { extractor: Arc::new(Uneven), ..FeatureOptions::default() };
    let text = message(&Options { features, ..Options::default() }, "ws");
    assert!(text.contains("the extractor uneven gives 2 keypoints and 1 descriptors"), "{text}");
}

/// A database with keypoints and descriptors of another kind and no pairs, as another program may
/// leave it, is matched here.
#[test]
fn features_of_another_program_are_matched() {
    let (folder, _) = folder();
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("features.db");
    let from = Database::open_read_only(&folder.join("ws/database.db")).unwrap();
    let mut database = Database::create(&file).unwrap();
    database.write_cameras(&from.read_cameras().unwrap()).unwrap();
    database.write_images(&from.read_images().unwrap()).unwrap();
    for index in 0..OLD {
        let image = ImageId::from_index(index);
        let mut features = from.read_features(image).unwrap();
        // The bytes of the numbers' places in an interval: a kind that COLMAP calls undefined.
        let DescriptorEntries::Floats(entries) = features.descriptors.entries() else {
            unreachable!("corners have floats")
        };
        let bytes = entries.iter().map(|value| (127.5 * (value + 1.0)) as u8).collect();
        let format = DescriptorFormat { kind: DescriptorKind::Bytes, dim: DIM };
        features.descriptors = Descriptors::new(format, DescriptorEntries::Bytes(bytes)).unwrap();
        database.write_features([(image, &features)]).unwrap();
    }
    database.close().unwrap();
    // The angles between vectors of positive numbers are small.
    let no_angle = matching::Options { max_angle_rad: None, ..matching::Options::default() };
    let matcher = Arc::new(NearestNeighbours::new(no_angle).unwrap());
    let options = Options {
        database: Some(file),
        matching: MatchOptions { matcher, ..MatchOptions::default() },
        mapping: MapOptions::default(),
        ..Options::default()
    };
    let workspace: PathBuf = dir.path().join("ws");
    reconstruct(&[], &workspace, &options, &mut go_on).unwrap();
    let found = model(&workspace);
    assert_eq!(found.num_registered(), OLD);
    assert!(error(&found) < MAX_ERROR, "{}", error(&found));
}
