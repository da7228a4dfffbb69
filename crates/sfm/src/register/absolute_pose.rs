//! Absolute pose of an image from its 2D-3D correspondences.
//!
//! With repeated texture, wrong correspondences may outnumber the correct ones and agree on a wrong
//! pose: windows of a facade look alike from positions that differ by their spacing. Missing
//! correspondences reveal such a pose (Zach, Irschara & Bischof 2008), because an image there would
//! observe nearly all points that its neighbours observe. The visible-point recall measures this.

use std::collections::BTreeSet;

use tiepoint_geometry::estimate::{RigCamera, RigObservation};
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{OptionError, RansacOptions, Report, Rigid3, estimate};
use tiepoint_scene::rig::KnownFrame;
use tiepoint_scene::{
    Camera, CorrespondenceGraph, Frame, ImageId, Observation, PointId, Reconstruction,
};

/// A second pose is considered if it has at least this fraction of the first pose's inliers. It is
/// selected if its recall is larger by the factor `MIN_ADVANTAGE`, or larger at all if only the
/// second pose is plausible. On the streets used for tuning, correct poses had at least 1.28 times
/// the recall of wrong ones.
const MIN_SECOND_INLIERS: f64 = 0.5;
const MIN_ADVANTAGE: f64 = 1.25;
/// Views of a point whose directions differ by less than 10° and whose distances differ by less
/// than a quarter match well (Mikolajczyk & Schmid 2005).
const MAX_VIEW_ANGLE_RAD: f64 = 0.175;
const MAX_DISTANCE_RATIO: f64 = 1.25;

/// Thresholds of registration.
#[derive(Clone, Copy, Debug)]
pub struct RegisterOptions {
    /// Maximum reprojection error of an inlier, in pixels.
    pub max_error_px: f64,
    /// Minimum number of inliers.
    pub min_num_inliers: usize,
    /// Minimum fraction of inliers.
    pub min_inlier_ratio: f64,
}

impl RegisterOptions {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// Names the first option that is out of range.
    pub fn validate(&self) -> Result<(), OptionError> {
        OptionError::check_positive("register.max_error_px", self.max_error_px)?;
        let least = self.min_num_inliers;
        OptionError::check("register.min_num_inliers", least as f64, least >= 1, "at least 1")?;
        OptionError::check_ratio("register.min_inlier_ratio", self.min_inlier_ratio)
    }
}

impl Default for RegisterOptions {
    fn default() -> Self {
        Self { max_error_px: 12.0, min_num_inliers: 30, min_inlier_ratio: 0.25 }
    }
}

/// Estimates and sets the pose of `image`, and adds its inliers to the tracks. Returns the number
/// of inliers; `None` without changes if there are too few.
pub fn register_image(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    image: ImageId,
    options: &RegisterOptions,
    seed: u64,
) -> Option<usize> {
    let placement =
        estimate_placement(graph, model, &RegistrationUnit::Image(image), options, seed, &|_| {
            true
        })?;
    placement.apply(model);
    Some(placement.inliers.len())
}

/// An image, or a frame of a known rig whose images are registered together.
pub(crate) enum RegistrationUnit<'a> {
    /// An image.
    Image(ImageId),
    /// The images of a frame of a rig of the model.
    Frame(&'a KnownFrame),
}

impl RegistrationUnit<'_> {
    /// The images.
    fn images(&self) -> &[ImageId] {
        match self {
            Self::Image(image) => std::slice::from_ref(image),
            Self::Frame(frame) => &frame.images,
        }
    }

    /// The pose of an image: `cam_from_world`, from that of the image or that of the rig.
    fn cam_from_world(
        &self,
        model: &Reconstruction,
        image: ImageId,
        pose: &Rigid3,
    ) -> Option<Rigid3> {
        match self {
            Self::Image(_) => Some(*pose),
            Self::Frame(frame) => {
                let rig = model.rigs.get(frame.rig.index())?;
                Some(rig.cam_from_rig(model.image(image).camera)? * *pose)
            }
        }
    }

    /// Estimates the pose from keypoints and their points.
    fn estimate(
        &self,
        model: &Reconstruction,
        candidates: &[(Observation, PointId)],
        ransac: &RansacOptions,
    ) -> Option<Report<Rigid3>> {
        let pixel = |observation: &Observation| {
            model.image(observation.image).keypoints[observation.keypoint as usize].pixel
        };
        let xyz = |point: PointId| model.track(point).map(|track| track.xyz);
        match self {
            Self::Image(image) => {
                let pixels: Vec<Vector2<f64>> =
                    candidates.iter().map(|(observation, _)| pixel(observation)).collect();
                let points: Vec<Vector3<f64>> =
                    candidates.iter().filter_map(|(_, point)| xyz(*point)).collect();
                let camera = model.camera_of(*image);
                estimate::absolute_pose(&pixels, &points, &camera.intrinsics, ransac)
            }
            Self::Frame(frame) => {
                let rig = model.rigs.get(frame.rig.index())?;
                let of_image = |image: &ImageId| {
                    let camera = model.image(*image).camera;
                    Some(RigCamera {
                        intrinsics: model.camera(camera).intrinsics,
                        cam_from_rig: rig.cam_from_rig(camera)?,
                    })
                };
                let cameras: Option<Vec<RigCamera>> = frame.images.iter().map(of_image).collect();
                let observation = |(observation, point): &(Observation, PointId)| {
                    Some(RigObservation {
                        camera: frame.images.iter().position(|i| *i == observation.image)?,
                        pixel: pixel(observation),
                        point_in_world: xyz(*point)?,
                    })
                };
                let observations: Option<Vec<RigObservation>> =
                    candidates.iter().map(observation).collect();
                estimate::generalized_absolute_pose(&cameras?, &observations?, ransac)
            }
        }
    }
}

/// An estimated pose of an image, or of the images of a frame.
pub(crate) struct Placement {
    /// The images with their poses; the first stands for all in the selection.
    pub(super) poses: Vec<(ImageId, Rigid3)>,
    /// The frame that the model gets.
    frame: Option<Frame>,
    /// Inliers: keypoints and their points.
    pub(super) inliers: Vec<(Observation, PointId)>,
    /// Number of expected points that the inliers contain.
    num_found: usize,
    /// Visible-point recall: `num_found` relative to the number of expected points.
    pub(crate) recall: f64,
    /// Whether the caller's check accepts the pose.
    pub(crate) is_plausible: bool,
}

impl Placement {
    /// The image that stands for all in the selection.
    pub(crate) fn image(&self) -> ImageId {
        self.poses[0].0
    }

    pub(crate) fn apply(&self, model: &mut Reconstruction) {
        for &(image, cam_from_world) in &self.poses {
            model.register(image, cam_from_world);
        }
        model.frames.extend(self.frame.clone());
        for &(observation, point) in &self.inliers {
            model.add_observation(point, observation);
        }
    }
}

/// Estimates the pose of an image or of a frame; `None` with too few inliers. A pose whose first
/// image `is_plausible` rejects is returned only if no other is found.
pub(crate) fn estimate_placement(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    view: &RegistrationUnit,
    options: &RegisterOptions,
    seed: u64,
    is_plausible: &dyn Fn(&Rigid3) -> bool,
) -> Option<Placement> {
    let images = view.images();
    let candidates: Vec<(Observation, PointId)> =
        images.iter().flat_map(|image| candidates(graph, model, *image)).collect();
    let visible_to_neighbours: Vec<Vec<PointId>> =
        images.iter().map(|image| visible_to_neighbours(graph, model, *image)).collect();
    let ransac =
        RansacOptions { max_error: options.max_error_px, seed, ..RansacOptions::default() };
    let estimate_from = |candidates: &[(Observation, PointId)], min_inliers: usize| {
        if candidates.len() < min_inliers {
            return None;
        }
        let report = view.estimate(model, candidates, &ransac)?;
        let poses: Option<Vec<(ImageId, Rigid3)>> = images
            .iter()
            .map(|image| Some((*image, view.cam_from_world(model, *image, &report.model)?)))
            .collect();
        let poses = poses?;
        let inliers = candidates.iter().zip(&report.inliers).filter(|(_, inlier)| **inlier);
        let inliers: Vec<(Observation, PointId)> = inliers.map(|(one, _)| *one).collect();
        let found_points: BTreeSet<(ImageId, PointId)> =
            inliers.iter().map(|(observation, point)| (observation.image, *point)).collect();
        let (mut num_expected, mut num_found) = (0, 0);
        for ((image, pose), visible) in poses.iter().zip(&visible_to_neighbours) {
            let camera = model.camera_of(*image);
            for point in visible.iter().filter(|point| is_expected(model, camera, pose, **point)) {
                num_expected += 1;
                num_found += usize::from(found_points.contains(&(*image, *point)));
            }
        }
        // With few expected points the recall is not informative.
        let is_informative = num_expected >= options.min_num_inliers.max(1);
        let is_plausible = poses.first().is_some_and(|(_, pose)| is_plausible(pose));
        let placement = Placement {
            poses,
            frame: match view {
                RegistrationUnit::Image(_) => None,
                RegistrationUnit::Frame(frame) => Some(Frame {
                    rig: frame.rig,
                    rig_from_world: report.model,
                    images: frame.images.clone(),
                }),
            },
            inliers,
            num_found,
            recall: if is_informative { num_found as f64 / num_expected as f64 } else { 1.0 },
            is_plausible,
        };
        (placement.inliers.len() >= min_inliers).then_some(placement)
    };
    let best = estimate_from(&candidates, options.min_num_inliers)?;
    if (best.inliers.len() as f64) < options.min_inlier_ratio * candidates.len() as f64 {
        return None;
    }
    // The outliers of the best pose may support another pose.
    let is_seen: BTreeSet<&(Observation, PointId)> = best.inliers.iter().collect();
    let others: Vec<(Observation, PointId)> =
        candidates.iter().filter(|candidate| !is_seen.contains(candidate)).copied().collect();
    // Against an implausible pose, the second pose only needs the usual fraction of inliers.
    let min_inliers = if best.is_plausible {
        MIN_SECOND_INLIERS * best.inliers.len() as f64
    } else {
        options.min_inlier_ratio * others.len() as f64
    };
    let second = estimate_from(&others, options.min_num_inliers.max(min_inliers.ceil() as usize))
        .filter(|second| {
            let advantage =
                if second.is_plausible && !best.is_plausible { 1.0 } else { MIN_ADVANTAGE };
            (second.is_plausible || !best.is_plausible)
                && second.num_found >= options.min_num_inliers
                && second.recall > advantage * best.recall
        });
    Some(second.unwrap_or(best))
}

/// Whether an image with this pose should observe a point: the point projects into the image, and
/// some image observes it from a similar direction and distance.
fn is_expected(
    model: &Reconstruction,
    camera: &Camera,
    cam_from_world: &Rigid3,
    point: PointId,
) -> bool {
    let Some(track) = model.track(point) else { return false };
    let is_inside = camera
        .intrinsics
        .project(&(*cam_from_world * track.xyz))
        .is_some_and(|pixel| camera.contains(&pixel));
    let ray = track.xyz - cam_from_world.origin_in_a();
    let is_similar_view = |observation: &Observation| {
        model.image(observation.image).cam_from_world().is_some_and(|pose| {
            let other_ray = track.xyz - pose.origin_in_a();
            let ratio = ray.norm() / other_ray.norm();
            ray.angle(&other_ray) < MAX_VIEW_ANGLE_RAD
                && ratio.max(1.0 / ratio) < MAX_DISTANCE_RATIO
        })
    };
    is_inside && track.observations.iter().any(is_similar_view)
}

/// The points that the neighbours of an image in the graph observe, in order of their ids.
fn visible_to_neighbours(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    image: ImageId,
) -> Vec<PointId> {
    let neighbours = graph.neighbours(image).iter();
    let mut points: Vec<PointId> =
        neighbours.flat_map(|&other| model.image(other).points()).flatten().copied().collect();
    points.sort_unstable();
    points.dedup();
    points
}

/// Returns keypoints with the points of their correspondences. A keypoint may have several points.
pub(crate) fn candidates(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    image: ImageId,
) -> Vec<(Observation, PointId)> {
    let mut candidates = Vec::new();
    for keypoint in 0..model.image(image).keypoints.len() as u32 {
        let observation = Observation { image, keypoint };
        let points: BTreeSet<PointId> = graph
            .correspondences(observation)
            .iter()
            .filter_map(|t| model.image(t.image).point_of(t.keypoint))
            .filter(|point| model.track(*point).is_some())
            .collect();
        candidates.extend(points.into_iter().map(|point| (observation, point)));
    }
    candidates
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::{Vector2, Vector3};
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
    use tiepoint_scene::{
        Camera, CorrespondenceGraph, Image, ImageId, ImagePair, Keypoint, Match, Observation,
        Reconstruction, Track, TwoView, TwoViewKind,
    };

    use super::{RegisterOptions, register_image};

    /// Number of points and of matched points at the true place, and at the place that looks alike.
    const TRUE_PLACE: (usize, usize) = (150, 60);
    const SIMILAR_PLACE: (usize, usize) = (600, 80);
    /// Distance between the two places, and tolerance of the pose without noise, in metres.
    const DISTANCE_M: f64 = 100.0;
    const TOLERANCE_M: f64 = 1e-3;

    /// Two similar walls, each observed by one image, and a third image with keypoints of both.
    #[test]
    fn a_pose_with_low_recall_loses_against_one_with_fewer_inliers() {
        let intrinsics =
            Intrinsics::new(CameraModelKind::SimplePinhole, &[400.0, 320.0, 240.0]).unwrap();
        let mut model = Reconstruction::default();
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        let centres =
            [Vector3::zeros(), Vector3::new(DISTANCE_M, 0.0, 0.0), Vector3::new(0.3, 0.0, 0.1)];
        let poses = centres.map(|centre| Rigid3 { translation: -centre, ..Rigid3::identity() });
        let mut rng = Rng::stream(5, &[]);
        let mut keypoints: [Vec<Keypoint>; 3] = Default::default();
        let mut walls: Vec<(Vector3<f64>, usize)> = Vec::new();
        let mut matches: [Vec<Match>; 2] = Default::default();
        let see = |pose: &Rigid3, point: &Vector3<f64>| -> Option<Vector2<f64>> {
            let pixel = intrinsics.project(&(*pose * *point))?;
            (pixel.x > 0.0 && pixel.x < 640.0 && pixel.y > 0.0 && pixel.y < 480.0).then_some(pixel)
        };
        for (place, (num_points, num_matched)) in
            [TRUE_PLACE, SIMILAR_PLACE].into_iter().enumerate()
        {
            while keypoints[place].len() < num_points {
                let [x, y, z] = [0; 3].map(|_| rng.uniform());
                let offset = Vector3::new(6.0 * x - 3.0, 4.0 * y - 2.0, 5.0 + 4.0 * z);
                let (point, as_if) = (centres[place] + offset, offset);
                let (Some(pixel), Some(pixel_of_third)) =
                    (see(&poses[place], &point), see(&poses[2], &as_if))
                else {
                    continue;
                };
                walls.push((point, place));
                if keypoints[place].len() < num_matched {
                    let (a, b) = (keypoints[place].len() as u32, keypoints[2].len() as u32);
                    matches[place].push(Match { a, b });
                    keypoints[2].push(Keypoint { pixel: pixel_of_third, scale_px: 1.0 });
                }
                keypoints[place].push(Keypoint { pixel, scale_px: 1.0 });
            }
        }
        let counts: Vec<usize> = keypoints.iter().map(Vec::len).collect();
        let images: Vec<ImageId> = keypoints
            .into_iter()
            .enumerate()
            .map(|(index, keypoints)| {
                model.add_image(Image::new(index.to_string(), camera, keypoints))
            })
            .collect();
        for place in 0..2 {
            model.register(images[place], poses[place]);
        }
        let mut num_seen = [0; 2];
        for (xyz, place) in walls {
            let observation = Observation { image: images[place], keypoint: num_seen[place] };
            num_seen[place] += 1;
            model.add_track(Track::new(xyz, vec![observation]));
        }
        let two_views = matches.into_iter().enumerate().filter_map(|(place, matches)| {
            Some((
                ImagePair::new(images[place], images[2])?,
                TwoView { kind: TwoViewKind::Calibrated, matches, ..TwoView::default() },
            ))
        });
        let graph = CorrespondenceGraph::new(&counts, two_views);
        let num_inliers =
            register_image(&graph, &mut model, images[2], &RegisterOptions::default(), 1).unwrap();
        assert_eq!(num_inliers, TRUE_PLACE.1);
        let found = model.image(images[2]).cam_from_world().unwrap().origin_in_a();
        assert!((found - centres[2]).norm() < TOLERANCE_M, "{found}");
    }
}
