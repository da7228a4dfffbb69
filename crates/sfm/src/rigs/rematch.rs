//! Matches again what a split had kept apart.
//!
//! Images that were brought back to where their mounting has them have no matches with their
//! partners: nothing but the mounting holds them there, and they spring back when it is taken away.
//! Now that their poses are known, they are matched with their partners and all that those match,
//! along epipolar lines; what was found must then pass the verification of any other pair, which
//! knows nothing of the poses.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::{Matrix3, Vector3};
use tiepoint_geometry::{Rng, epipolar};
use tiepoint_matching::features::{Descriptor, Features, Keypoint};
use tiepoint_matching::{EpipolarGuide, Options, match_guided};
use tiepoint_scene::{
    Camera, CorrespondenceGraph, ImageId, ImagePair, Match, Reconstruction, TwoView,
};

use super::extrinsics::Closed;
use crate::two_view::{VerifyOptions, View, verify_pair};

/// Where the descriptors of an image's keypoints come from, one for each in order; none where there
/// are none.
pub type Descriptors<'a> = dyn FnMut(ImageId) -> Vec<Descriptor> + 'a;

/// Partners lie this near to epipolar lines, in pixels: the poses come from the mounting and not
/// from these images.
const MAX_GUIDE_ERROR_PX: f64 = 8.0;

/// The verified pairs that come to the graph's.
pub(super) fn rematch(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    closed: &BTreeSet<Closed>,
    descriptors: &mut Descriptors,
    seed: u64,
) -> Vec<(ImagePair, TwoView)> {
    let pairs_of = |closed: &Closed| {
        let of_partner = graph.neighbours(closed.left);
        let others: BTreeSet<ImageId> =
            std::iter::once(&closed.left).chain(of_partner).copied().collect();
        let has_pose = |image: &ImageId| model.image(*image).cam_from_world().is_some();
        let pairs = others.into_iter().filter(has_pose);
        let pairs = pairs.filter_map(|other| ImagePair::new(closed.right, other));
        pairs.filter(|pair| !graph.pairs().contains_key(pair)).collect::<Vec<_>>()
    };
    let mut found: BTreeMap<ImagePair, TwoView> = BTreeMap::new();
    // Of the neighbours of one image after the other, which are mostly those of the one before.
    let mut features: BTreeMap<ImageId, Features> = BTreeMap::new();
    for closed in closed {
        let pairs: Vec<ImagePair> =
            pairs_of(closed).into_iter().filter(|pair| !found.contains_key(pair)).collect();
        let needed: BTreeSet<ImageId> = pairs.iter().flat_map(|pair| [pair.a, pair.b]).collect();
        features.retain(|image, _| needed.contains(image));
        for image in needed {
            features
                .entry(image)
                .or_insert_with(|| through_a_pinhole(model, image, descriptors(image)));
        }
        let two_view = |pair: &ImagePair| {
            let matches = guided(model, pair, &features[&pair.a], &features[&pair.b])?;
            let camera = |image| Camera { has_focal_prior: true, ..*model.camera_of(image) };
            let (camera_a, camera_b) = (camera(pair.a), camera(pair.b));
            let a = View { keypoints: &model.image(pair.a).keypoints, camera: &camera_a };
            let b = View { keypoints: &model.image(pair.b).keypoints, camera: &camera_b };
            let seed = Rng::stream(seed, &[u64::from(pair.a.0), u64::from(pair.b.0)]).next_u64();
            Some((*pair, verify_pair(a, b, &matches, &VerifyOptions::default(), seed)))
        };
        found.extend(pairs.par_iter().filter_map(two_view).collect::<Vec<_>>());
    }
    found.into_iter().filter(|(_, two_view)| two_view.is_verified()).collect()
}

/// Keypoints as a lens without distortion would see them, from the principal point: there epipolar
/// lines are straight. What lies at the side of the camera or behind it has no place, and
/// descriptors that are not one for each keypoint count as none.
fn through_a_pinhole(
    model: &Reconstruction,
    image: ImageId,
    descriptors: Vec<Descriptor>,
) -> Features {
    let (intrinsics, keypoints) =
        (&model.camera_of(image).intrinsics, &model.image(image).keypoints);
    if descriptors.len() != keypoints.len() {
        return Features::default();
    }
    let focal_px = intrinsics.mean_focal_px();
    let keypoint = |keypoint: &tiepoint_scene::Keypoint| {
        let ray = intrinsics.unproject(&keypoint.pixel).filter(|ray| ray.z > 0.0);
        let [x, y] = ray.map_or([f32::NAN; 2], |ray| {
            [(focal_px * ray.x / ray.z) as f32, (focal_px * ray.y / ray.z) as f32]
        });
        Keypoint { x, y, scale: keypoint.scale_px, orientation: 0.0 }
    };
    Features { keypoints: keypoints.iter().map(keypoint).collect(), descriptors }
}

fn guided(
    model: &Reconstruction,
    pair: &ImagePair,
    a: &Features,
    b: &Features,
) -> Option<Vec<Match>> {
    let pose = |image| model.image(image).cam_from_world();
    let b_from_a = *pose(pair.b)? * pose(pair.a)?.inverse();
    let calibration = |image| {
        let focal_px = model.camera_of(image).intrinsics.mean_focal_px();
        Matrix3::from_diagonal(&Vector3::new(focal_px, focal_px, 1.0))
    };
    let essential = epipolar::essential_from_pose(&b_from_a);
    let fundamental = epipolar::fundamental_from_essential(
        &essential,
        &calibration(pair.a),
        &calibration(pair.b),
    )?;
    let guide = EpipolarGuide {
        fundamental: std::array::from_fn(|row| {
            std::array::from_fn(|column| fundamental[(row, column)])
        }),
        max_error_px: MAX_GUIDE_ERROR_PX,
    };
    let matches = match_guided(a, b, &guide, &Options::default());
    Some(matches.into_iter().map(|m| Match { a: m.a, b: m.b }).collect())
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::Vector2;
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_scene::{Image, Keypoint as ScenePoint, TwoViewKind};

    use super::*;

    const POINTS: usize = 400;
    /// Points that look like another one, as windows of a facade do: the ratio test refuses them
    /// unless a line tells them apart.
    const TWINS: usize = 200;
    /// Of a fisheye, so that lines are straight through a pinhole alone.
    const FOCAL_PX: f64 = 200.0;
    /// A twin may lie on the line, too.
    const MIN_SHARE: f64 = 0.8;

    /// Three images of the same points: a left one and its neighbour, which match, and a right one,
    /// which matches neither.
    fn scene() -> (Reconstruction, CorrespondenceGraph) {
        let mut rng = Rng::stream(1, &[]);
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::OpencvFisheye, FOCAL_PX, 640, 480);
        let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: false };
        let cameras = [model.add_camera(camera), model.add_camera(camera)];
        let points: Vec<Vector3<f64>> = (0..POINTS)
            .map(|_| {
                let mut span = || 2.0 * rng.uniform() - 1.0;
                Vector3::new(6.0 * span(), 4.0 * span(), 7.0 + 2.0 * span())
            })
            .collect();
        let pose = |x: f64, z: f64| {
            Rigid3::from_axis_angle(
                Vector3::new(0.0, 0.05 * x, 0.01),
                Vector3::new(-x, 0.1 * x, -z),
            )
        };
        let poses = [(0, pose(0.0, 0.0)), (0, pose(0.1, 0.8)), (1, pose(0.5, 0.0))];
        for (index, (camera, pose)) in poses.into_iter().enumerate() {
            let seen = points.iter().map(|xyz| intrinsics.project(&(pose * *xyz)).unwrap());
            let keypoint = |pixel: Vector2<f64>| ScenePoint { pixel, scale_px: 2.0 };
            let keypoints = seen.map(keypoint).collect();
            let image =
                model.add_image(Image::new(format!("{index}.png"), cameras[camera], keypoints));
            model.register(image, pose);
        }
        let matches = (0..POINTS as u32).map(|k| Match { a: k, b: k }).collect();
        let two_view = TwoView { kind: TwoViewKind::Calibrated, matches, ..TwoView::default() };
        let pair = ImagePair::new(ImageId(0), ImageId(1)).unwrap();
        (model, CorrespondenceGraph::new(&[POINTS; 3], [(pair, two_view)]))
    }

    fn descriptor(k: usize) -> Descriptor {
        let mut rng = Rng::stream(2, &[(k % (POINTS - TWINS)) as u64]);
        std::array::from_fn(|_| rng.below(90) as u8)
    }

    #[test]
    fn an_image_that_was_brought_back_is_matched_with_its_partner_and_what_that_matches() {
        let (model, graph) = scene();
        let closed = BTreeSet::from([Closed { right: ImageId(2), left: ImageId(0) }]);
        let mut asked = Vec::new();
        let mut descriptors = |image| {
            asked.push(image);
            (0..POINTS).map(descriptor).collect()
        };
        let found = rematch(&graph, &model, &closed, &mut descriptors, 0);
        assert_eq!(asked, [ImageId(0), ImageId(1), ImageId(2)], "each is read once");
        let pairs: Vec<(u32, u32)> = found.iter().map(|(pair, _)| (pair.a.0, pair.b.0)).collect();
        assert_eq!(pairs, [(0, 2), (1, 2)]);
        for (_, two_view) in &found {
            let right = two_view.matches.iter().filter(|m| m.a == m.b).count();
            assert_eq!(right, two_view.matches.len(), "no twin is taken for the other");
            assert!(right as f64 >= MIN_SHARE * POINTS as f64, "{right}");
        }
        let extended = graph.extended(found);
        assert_eq!(extended.pairs().len(), 3);
    }

    #[test]
    fn without_descriptors_there_are_no_further_pairs() {
        let (model, graph) = scene();
        let closed = BTreeSet::from([Closed { right: ImageId(2), left: ImageId(0) }]);
        assert_eq!(rematch(&graph, &model, &closed, &mut |_| Vec::new(), 0), []);
    }
}
