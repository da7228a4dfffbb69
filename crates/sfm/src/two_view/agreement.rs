//! Agreement of verified pairs with the poses of a model.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{Rigid3, epipolar};
use tiepoint_scene::{Camera, CorrespondenceGraph, ImagePair, Reconstruction};

/// Number of matches of verified pairs, and of those that agree with the poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Agreement {
    pub(crate) num_matches: usize,
    pub(crate) num_agreeing: usize,
}

impl Agreement {
    /// Whether most of the matches agree. Right poses of a walk (lund) have 0.84 and more.
    pub(crate) fn is_majority(self) -> bool {
        2 * self.num_agreeing > self.num_matches
    }

    pub(crate) fn add(&mut self, other: Self) {
        self.num_matches += other.num_matches;
        self.num_agreeing += other.num_agreeing;
    }
}

/// Compares the matches of a verified pair with the poses `cam_from_world` of its images: the
/// Sampson error of the rays is at most `max_error_px`, and they meet in front of both cameras,
/// unless they are parallel within that error.
pub(crate) fn agreement(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    pair: ImagePair,
    [a_from_world, b_from_world]: [&Rigid3; 2],
    max_error_px: f64,
) -> Agreement {
    let Some(two_view) = graph.pairs().get(&pair) else { return Agreement::default() };
    let b_from_a = *b_from_world * a_from_world.inverse();
    let essential = epipolar::essential_from_pose(&b_from_a);
    let (camera_a, camera_b) = (model.camera_of(pair.a), model.camera_of(pair.b));
    let focal_px =
        (camera_a.intrinsics.mean_focal_px() + camera_b.intrinsics.mean_focal_px()) / 2.0;
    let max_error_rad = max_error_px / focal_px;
    let ray = |camera: &Camera, image, keypoint: u32| {
        camera.intrinsics.unproject(&model.image(image).keypoints[keypoint as usize].pixel)
    };
    let agrees = |a: &Vector3<f64>, b: &Vector3<f64>| {
        let (line_b, line_a) = (essential * a, essential.tr_mul(b));
        let constraint = b.dot(&line_b);
        // The gradient with respect to directions on the sphere.
        let gradient = b.cross(&line_b).norm_squared() + a.cross(&line_a).norm_squared();
        let fits = constraint * constraint <= max_error_rad * max_error_rad * gradient;
        let (turned, t) = (b_from_a.rotation * a, b_from_a.translation);
        // λ turned + t = μ b.
        let normal = b.cross(&turned);
        let in_front = t.cross(b).dot(&normal) > 0.0 && t.cross(&turned).dot(&normal) > 0.0;
        fits && (in_front || normal.norm() <= max_error_rad)
    };
    let rays = two_view.matches.iter().filter_map(|m| {
        let a = ray(camera_a, pair.a, m.a)?.normalize();
        Some((a, ray(camera_b, pair.b, m.b)?.normalize()))
    });
    let num_agreeing = rays.filter(|(a, b)| agrees(a, b)).count();
    Agreement { num_matches: two_view.matches.len(), num_agreeing }
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rng};
    use tiepoint_scene::{Image, ImageId, Keypoint, Match, TwoView, TwoViewKind};

    use super::*;

    const POINTS: usize = 200;
    const MAX_ERROR_PX: f64 = 4.0;

    /// Matches of points at some distance, and of directions at infinity, without noise.
    #[test]
    fn matches_agree_with_the_right_pose_alone() {
        let mut rng = Rng::stream(3, &[]);
        let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, 500.0, 640, 480);
        let mut model = Reconstruction::default();
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        let pose =
            Rigid3::from_axis_angle(Vector3::new(0.02, 0.1, -0.03), Vector3::new(-1.0, 0.2, -0.3));
        let mut keypoints = [Vec::new(), Vec::new()];
        while keypoints[0].len() < POINTS {
            let mut span = || 2.0 * rng.uniform() - 1.0;
            let depth = if keypoints[0].len() % 4 == 0 { 1e9 } else { 6.0 + 3.0 * span() };
            let xyz = Vector3::new(0.4 * span(), 0.3 * span(), 1.0) * depth;
            let both = [intrinsics.project(&xyz), intrinsics.project(&(pose * xyz))];
            let [Some(a), Some(b)] = both else { continue };
            for (keypoints, pixel) in keypoints.iter_mut().zip([a, b]) {
                keypoints.push(Keypoint { pixel, scale_px: 1.0 });
            }
        }
        for (name, keypoints) in ["a", "b"].iter().zip(keypoints) {
            model.add_image(Image::new((*name).to_owned(), camera, keypoints));
        }
        let pair = ImagePair::new(ImageId(0), ImageId(1)).expect("two images");
        let matches = (0..POINTS as u32).map(|k| Match { a: k, b: k }).collect();
        let two_view = TwoView { kind: TwoViewKind::Calibrated, matches, ..TwoView::default() };
        let graph = CorrespondenceGraph::new(&[POINTS; 2], [(pair, two_view)]);
        let with = |b_from_a: Rigid3| {
            // Any frame of the world.
            let a = Rigid3::from_axis_angle(Vector3::new(0.3, -0.5, 1.0), Vector3::y());
            agreement(&graph, &model, pair, [&a, &(b_from_a * a)], MAX_ERROR_PX)
        };
        let right = with(pose);
        assert_eq!((right.num_matches, right.num_agreeing), (POINTS, POINTS));
        // The points are behind the cameras of the reverse motion; the directions stay.
        let reverse = with(Rigid3 { translation: -pose.translation, ..pose });
        assert_eq!(reverse.num_agreeing, POINTS / 4);
        let turned = Rigid3::from_axis_angle(Vector3::new(0.0, 0.0, 0.2), Vector3::zeros()) * pose;
        assert!(right.is_majority() && !with(turned).is_majority());
    }
}
