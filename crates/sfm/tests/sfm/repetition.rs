//! A street with a repeating facade. A camera that drives along it observes the same windows again
//! and again, and most matches between frames some steps apart are between different periods.
//! Without the checks of registration, the trajectory folds at every period.

use std::collections::BTreeMap;

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_scene::{
    Camera, CorrespondenceGraph, Image, ImagePair, Keypoint, Match, Reconstruction,
};
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions, verify_pair};
use tiepoint_sfm::{Mapper, MapperOptions};

use crate::common::sample;

const FRAMES: usize = 60;
/// Seeds of the facade.
const SEEDS: [u64; 3] = [0, 1, 2];
/// In metres: distance between frames, distance to the facade, and period of the facade.
const STEP: f64 = 0.6;
const DISTANCE: f64 = 5.0;
const PERIOD: f64 = 4.2;
/// Maximum distance of matched frames. The facade repeats every seven.
const WINDOW: usize = 8;
/// Repeated features of each period, and unique ones.
const REPEATED: usize = 200;
const UNIQUE: usize = 10;
/// In the first periods all features are unique.
const VARIED: usize = 5;
/// Standard deviation of the keypoints, in pixels.
const NOISE_PX: f64 = 0.3;
/// Tolerance of the distance between frames. A shift by a period would multiply it by six.
const TOLERANCE: f64 = 0.2;

/// Appearance of a keypoint: equal in each period, unless it is unique.
type Appearance = (usize, Option<usize>);

struct Street {
    scene: Reconstruction,
    graph: CorrespondenceGraph,
}

/// A feature matches if its appearance occurs once in the other image, possibly in another period.
fn street(seed: u64) -> Street {
    let mut rng = Rng::stream(seed, &[]);
    let intrinsics =
        Intrinsics::new(CameraModelKind::SimplePinhole, &[400.0, 200.0, 150.0]).expect("sound");
    let mut scene = Reconstruction::default();
    let camera =
        scene.add_camera(Camera { intrinsics, width: 400, height: 300, has_focal_prior: true });
    let mut draw = |length: f64| {
        let [x, y, z] = [0; 3].map(|_| rng.uniform());
        Vector3::new(length * x, 3.0 * y - 1.5, DISTANCE + z - 0.5)
    };
    let periods = (FRAMES as f64 * STEP / PERIOD) as usize + 4;
    let repeated: Vec<Vector3<f64>> = (0..REPEATED).map(|_| draw(PERIOD)).collect();
    let mut facade: Vec<(Vector3<f64>, Appearance)> = Vec::new();
    for period in 0..periods {
        let begin = Vector3::new((period as f64 - 2.0) * PERIOD, 0.0, 0.0);
        let of = (period < VARIED).then_some(period);
        facade
            .extend(repeated.iter().enumerate().map(|(feature, xyz)| (begin + xyz, (feature, of))));
        facade.extend(
            (0..UNIQUE).map(|feature| (begin + draw(PERIOD), (REPEATED + feature, Some(period)))),
        );
    }
    let mut seen: Vec<BTreeMap<Appearance, Vec<u32>>> = Vec::new();
    for frame in 0..FRAMES {
        let centre = Vector3::new(STEP * frame as f64, 0.0, 0.0);
        let mut keypoints = Vec::new();
        let mut appearances: BTreeMap<Appearance, Vec<u32>> = BTreeMap::new();
        for (xyz, appearance) in &facade {
            let Some(pixel) = intrinsics.project(&(xyz - centre)) else { continue };
            if pixel.x > 0.0 && pixel.x < 400.0 && pixel.y > 0.0 && pixel.y < 300.0 {
                let noise = Vector2::new(rng.normal(), rng.normal()) * NOISE_PX;
                appearances.entry(*appearance).or_default().push(keypoints.len() as u32);
                keypoints.push(Keypoint { pixel: pixel + noise, scale_px: 1.0 });
            }
        }
        seen.push(appearances);
        let image = scene.add_image(Image::new(format!("{frame:03}.jpg"), camera, keypoints));
        scene.set_time(image, Some(frame as f64 * 0.1));
    }
    let ids: Vec<_> = scene.images().map(|(id, _)| id).collect();
    let counts: Vec<usize> = scene.images().map(|(_, image)| image.keypoints.len()).collect();
    let pairs = (0..FRAMES).flat_map(|a| (a + 1..FRAMES.min(a + 1 + WINDOW)).map(move |b| (a, b)));
    let two_views = pairs.filter_map(|(a, b)| {
        let only = |keypoints: &Vec<u32>| (keypoints.len() == 1).then(|| keypoints[0]);
        let of = |(appearance, keypoints): (&Appearance, &Vec<u32>)| {
            Some(Match { a: only(keypoints)?, b: only(seen[b].get(appearance)?)? })
        };
        let matches: Vec<Match> = seen[a].iter().filter_map(of).collect();
        let view = |frame: usize| ImageObservations::new(&scene, ids[frame]);
        let two_view = verify_pair(view(a), view(b), &matches, &VerifyOptions::default(), seed);
        (!two_view.matches.is_empty()).then_some((ImagePair::new(ids[a], ids[b])?, two_view))
    });
    let graph = CorrespondenceGraph::new(&counts, two_views);
    Street { scene, graph }
}

/// Distance from each frame to the next relative to the median. Missing frames count as jumps.
fn steps(street: &Street, seed: u64) -> Vec<f64> {
    let options =
        MapperOptions { refine: RefineIntrinsics::NONE, seed, ..MapperOptions::default() };
    let models = Mapper::new(&street.graph, &street.scene).run(&options);
    let model = models.expect("a street").remove(0).reconstruction;
    let centres: Vec<Option<Vector3<f64>>> =
        model.images().map(|(_, image)| image.cam_from_world().map(Rigid3::origin_in_a)).collect();
    let step = |pair: &[Option<Vector3<f64>>]| Some((pair[1]? - pair[0]?).norm());
    let steps: Vec<f64> =
        centres.windows(2).map(|pair| step(pair).unwrap_or(f64::INFINITY)).collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2];
    steps.into_iter().map(|step| step / median).collect()
}

#[test]
fn repeated_windows_displace_no_image_of_a_drive() {
    for &seed in sample(&SEEDS) {
        let steps = steps(&street(seed), seed);
        let jumps: Vec<_> =
            steps.iter().enumerate().filter(|(_, step)| (*step - 1.0).abs() > TOLERANCE).collect();
        assert!(jumps.is_empty(), "seed {seed}: {jumps:?}");
    }
}
