//! Absolute pose of an image from its 2D-3D correspondences.
//!
//! With repeated texture, wrong correspondences may outnumber the correct ones and agree on a wrong
//! pose: windows of a facade look alike from positions that differ by their spacing. Missing
//! correspondences reveal such a pose (Zach, Irschara & Bischof 2008), because an image there would
//! observe nearly all points that its neighbours observe. The visible-point recall measures this.

use std::collections::BTreeSet;

use tiepoint_geometry::estimate::{RigCamera, RigObservation};
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{RansacOptions, Report, Rigid3, estimate};
use tiepoint_scene::rig::KnownFrame;
use tiepoint_scene::{CorrespondenceGraph, Frame, ImageId, Observation, PointId, Reconstruction};

use super::continuity::ExpectedMotion;
use super::evidence::Evidence;
use super::options::RegisterOptions;
use super::recall::{Recall, visible_to_neighbours};

/// A second pose is considered if it has at least this fraction of the first pose's inliers. It is
/// selected if its recall is larger by the factor `MIN_ADVANTAGE`, or larger at all if only the
/// second pose is plausible. On the streets used for tuning, correct poses had at least 1.28 times
/// the recall of wrong ones.
const MIN_SECOND_INLIERS: f64 = 0.5;
const MIN_ADVANTAGE: f64 = 1.25;
/// A keypoint is near to where the motion places its point within so many times the error of an
/// inlier: 24 px, as of a point 20 m away of a camera half a metre off at a focal length of 1,000
/// px. Chosen on four rendered streets, on which half and double of 48 px were tried: with 96 px
/// one of them ended 2.7 m off, with 48 px three images of it were left out, with 24 px none.
const MAX_EXPECTED_ERROR: f64 = 2.0;
/// A pose from keypoints near to where the motion leads is right if at least this fraction of them
/// agrees. By chance a quarter is within the error of an inlier. Of images that the motion placed
/// rightly on the open street of docs/benchmarks/experiments.md, seed 1, most had 0.94 and more: it
/// was chosen there. Half changes nothing on three other streets. Their visible-point recall does
/// not tell: it counts matches, of which the copy has more.
const MIN_AGREEING: f64 = 0.7;

/// Estimates and sets the pose of `image`, and adds its inliers to the tracks. Returns the number
/// of inliers; `None` without changes if there are too few.
pub fn register_image(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    image: ImageId,
    options: &RegisterOptions,
    seed: u64,
) -> Option<usize> {
    let unit = RegistrationUnit::Image(image);
    let placement = estimate_placement(graph, model, &unit, options, Evidence::Usual, seed, None)?;
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
    /// Visible-point recall: `num_found` relative to the number of expected points; `None` with too
    /// few of them.
    pub(crate) recall: Option<f64>,
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

/// Estimates the pose of an image or of a frame; `None` with too few inliers. A pose that
/// contradicts the motion of the first image is returned only if no other is found.
pub(crate) fn estimate_placement(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    view: &RegistrationUnit,
    options: &RegisterOptions,
    evidence: Evidence,
    seed: u64,
    motion: Option<ExpectedMotion>,
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
        let mut recall = Recall::default();
        for ((image, pose), visible) in poses.iter().zip(&visible_to_neighbours) {
            recall
                .add(model, *image, pose, visible, |point| found_points.contains(&(*image, point)));
        }
        let is_plausible = poses.first().is_some_and(|(_, pose)| {
            motion.as_ref().is_none_or(|motion| !motion.contradicts(pose))
        });
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
            num_found: recall.num_found,
            recall: recall.share(options),
            is_plausible,
        };
        (placement.inliers.len() >= min_inliers).then_some(placement)
    };
    let best = estimate_from(&candidates, evidence.min_num_inliers(options))?;
    let of_best = [&candidates[..], &best.inliers];
    if !evidence.suffices(graph, model, &best.poses, of_best, options) {
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
                && second.recall.unwrap_or(1.0) > advantage * best.recall.unwrap_or(1.0)
        });
    let found = second.unwrap_or(best);
    if found.is_plausible {
        return Some(found);
    }
    let third = || {
        let near = near_to_motion(model, &candidates, &found, motion.as_ref()?, options)?;
        let agreeing = MIN_AGREEING * near.len() as f64;
        estimate_from(&near, options.min_num_inliers)
            .filter(|third| third.is_plausible && third.inliers.len() as f64 >= agreeing)
    };
    Some(third().unwrap_or(found))
}

/// The candidates near to where the motion places their points, with the rotation of a pose that
/// contradicts the motion: copies of a place along a facade share it. They may support the right
/// pose, although more candidates support another one. `None` for frames.
fn near_to_motion(
    model: &Reconstruction,
    candidates: &[(Observation, PointId)],
    found: &Placement,
    motion: &ExpectedMotion,
    options: &RegisterOptions,
) -> Option<Vec<(Observation, PointId)>> {
    let &[(image, Rigid3 { rotation, .. })] = &found.poses[..] else { return None };
    let expected = Rigid3 { rotation, translation: -(rotation * motion.centre()?) };
    let camera = model.camera_of(image);
    let is_near = |(observation, point): &&(Observation, PointId)| {
        let keypoint = &model.image(image).keypoints[observation.keypoint as usize];
        let xyz = model.track(*point).map(|track| expected * track.xyz);
        let pixel = xyz.and_then(|xyz| camera.intrinsics.project(&xyz));
        let max_error_px = MAX_EXPECTED_ERROR * options.max_error_px;
        pixel.is_some_and(|pixel| (pixel - keypoint.pixel).norm() <= max_error_px)
    };
    Some(candidates.iter().filter(is_near).copied().collect())
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

    use super::super::continuity::Timelines;
    use super::{Evidence, RegisterOptions, RegistrationUnit, estimate_placement, register_image};

    /// Numbers of points and of matched points of a place.
    type Place = (usize, usize);

    /// Distance between two places that look alike, and tolerance of the pose without noise, in
    /// metres.
    const DISTANCE_M: f64 = 100.0;
    const TOLERANCE_M: f64 = 1e-3;
    /// Centre of the image to register, and its distance from the one before in time.
    const CENTRE: Vector3<f64> = Vector3::new(0.3, 0.0, 0.1);
    const STEP_M: f64 = 0.3;

    struct Scene {
        graph: CorrespondenceGraph,
        model: Reconstruction,
        image: ImageId,
    }

    /// Two similar walls, each observed by one image, and an image with keypoints of both. It
    /// stands before the first wall. So many more of its keypoints match a point of a wall by
    /// chance.
    fn two_walls(places: [Place; 2], num_wrong: usize) -> Scene {
        let intrinsics =
            Intrinsics::new(CameraModelKind::SimplePinhole, &[400.0, 320.0, 240.0]).unwrap();
        let mut model = Reconstruction::default();
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        let centres = [Vector3::zeros(), Vector3::new(DISTANCE_M, 0.0, 0.0), CENTRE];
        let poses = centres.map(at);
        let mut rng = Rng::stream(5, &[]);
        let mut keypoints: [Vec<Keypoint>; 3] = Default::default();
        let mut walls: Vec<(Vector3<f64>, usize)> = Vec::new();
        let mut matches: [Vec<Match>; 2] = Default::default();
        let see = |pose: &Rigid3, point: &Vector3<f64>| -> Option<Vector2<f64>> {
            let pixel = intrinsics.project(&(*pose * *point))?;
            (pixel.x > 0.0 && pixel.x < 640.0 && pixel.y > 0.0 && pixel.y < 480.0).then_some(pixel)
        };
        for (place, (num_points, num_matched)) in places.into_iter().enumerate() {
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
        for k in 0..num_wrong {
            let place = k % 2;
            let num_unmatched = places[place].0 - places[place].1;
            let a = (places[place].1 + k / 2 % num_unmatched) as u32;
            matches[place].push(Match { a, b: keypoints[2].len() as u32 });
            let pixel = Vector2::new(640.0 * rng.uniform(), 480.0 * rng.uniform());
            keypoints[2].push(Keypoint { pixel, scale_px: 1.0 });
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
        Scene { graph, model, image: images[2] }
    }

    fn at(centre: Vector3<f64>) -> Rigid3 {
        Rigid3 { translation: -centre, ..Rigid3::identity() }
    }

    #[test]
    fn a_pose_with_low_recall_loses_against_one_with_fewer_inliers() {
        const PLACES: [Place; 2] = [(150, 60), (600, 80)];
        let Scene { graph, mut model, image } = two_walls(PLACES, 0);
        let num_inliers =
            register_image(&graph, &mut model, image, &RegisterOptions::default(), 1).unwrap();
        assert_eq!(num_inliers, PLACES[0].1);
        let found = model.image(image).cam_from_world().unwrap().origin_in_a();
        assert!((found - CENTRE).norm() < TOLERANCE_M, "{found}");
    }

    /// The wrong pose has most of the inliers, and the right one less than a quarter of the others.
    /// The recall of the right one is higher or, as where matches prefer the copy, lower.
    #[test]
    fn a_pose_near_to_where_the_motion_leads_wins_against_one_that_is_out_of_reach() {
        a_pose_near_to_where_the_motion_leads_wins([(60, 40), (600, 200)]);
        a_pose_near_to_where_the_motion_leads_wins([(600, 40), (300, 200)]);
    }

    fn a_pose_near_to_where_the_motion_leads_wins(places: [Place; 2]) {
        const NUM_WRONG: usize = 200;
        const NUM_BEFORE: usize = 12;
        let Scene { graph, mut model, image } = two_walls(places, NUM_WRONG);
        let camera = model.image(image).camera;
        for before in 0..=NUM_BEFORE {
            let id = match before {
                0 => image,
                _ => model.add_image(Image::new(format!("before {before}"), camera, Vec::new())),
            };
            model.set_time(id, Some(-0.1 * before as f64));
            if before > 0 {
                model.register(id, at(CENTRE - Vector3::new(STEP_M * before as f64, 0.0, 0.0)));
            }
        }
        let timelines = Timelines::new(&graph, &model);
        let estimate = |motion| {
            let (unit, options) = (RegistrationUnit::Image(image), RegisterOptions::default());
            let found =
                estimate_placement(&graph, &model, &unit, &options, Evidence::Usual, 1, motion);
            found.unwrap().poses[0].1.origin_in_a()
        };
        assert!((estimate(None) - CENTRE).norm() > 1.0);
        let motion = timelines.expected_motion(&model, image);
        assert!(motion.is_some());
        let found = estimate(motion);
        assert!((found - CENTRE).norm() < TOLERANCE_M, "{found}");
    }
}
