//! Pose-graph optimisation over similarities (Strasdat, Montiel & Davison 2010).
//!
//! Edges of the covisibility graph keep their relative pose and scale, since drift along one edge
//! is small. Loop constraints have the relative pose and scale that the matches give. The optimum
//! takes a second. Bundle adjustment converges slowly here, because it sees the loop only through
//! reprojection errors of hundreds of pixels.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use tiepoint_ba::factors::{Between, Relative};
use tiepoint_ba::{EliminationOrder, Factor, Key, Options, Problem, Solver};
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::{Loss, RansacOptions, Rigid3, Sim3, estimate};
use tiepoint_scene::{ImageId, ImagePair, Match, PointId, Reconstruction, TwoView};

use super::pairs::CovisibilityGraph;
use crate::Error;

/// Inlier threshold of a loop constraint, in pixels; the same as for the creation of points.
const MAX_ERROR_PX: f64 = 12.0;
/// Minimum number of inliers, as for verified pairs.
const MIN_INLIERS: usize = 15;
/// Two loop constraints at one place are consistent if they differ by less than this: in radians,
/// in median point distances, and in the logarithm of the scale.
const MAX_DIFFERENCE: f64 = 0.1;
/// The stiffness of a long chain is a millionth of that of one edge. The damping must be far
/// smaller.
const INITIAL_DAMPING: f64 = 1e-12;
/// A relative accuracy of a thousandth suffices, since bundle adjustment follows.
const TOLERANCE: f64 = 1e-6;

/// A Sim(3) loop constraint between two images: `b_from_a` between their camera frames, including
/// the ratio of their scales.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LoopConstraint {
    pub(crate) pair: ImagePair,
    b_from_a: Sim3,
    num_inliers: usize,
}

impl LoopConstraint {
    /// Estimates the constraint from matches of which both keypoints observe points; `None` with
    /// too few inliers.
    ///
    /// At an open loop the two points of a match are two estimates of one scene point, a's and b's.
    /// The pose of image a relative to b's points follows from its keypoints (absolute pose). The
    /// scale is the median ratio of the distances of b's and of a's points from image a.
    pub(crate) fn new(
        model: &Reconstruction,
        pair: ImagePair,
        two_view: &TwoView,
        seed: u64,
    ) -> Option<Self> {
        let (a, b) = (model.image(pair.a), model.image(pair.b));
        let (a_from_world, b_from_world) = (a.cam_from_world()?, b.cam_from_world()?);
        let xyz = |point: Option<PointId>| Some(model.track(point?)?.xyz);
        let seen = |m: &Match| {
            let (point_a, point_b) = (xyz(a.point_of(m.a))?, xyz(b.point_of(m.b))?);
            Some((a.keypoints[m.a as usize].pixel, point_a, point_b))
        };
        let seen: Vec<(Vector2<f64>, Vector3<f64>, Vector3<f64>)> =
            two_view.matches.iter().filter_map(seen).collect();
        let (pixels, points_b): (Vec<_>, Vec<_>) =
            seen.iter().map(|(pixel, _, point_b)| (*pixel, *point_b)).unzip();
        let options = RansacOptions { max_error: MAX_ERROR_PX, seed, ..RansacOptions::default() };
        let found = estimate::absolute_pose(
            &pixels,
            &points_b,
            &model.camera_of(pair.a).intrinsics,
            &options,
        )?;
        let inliers = seen.iter().zip(&found.inliers).filter(|(_, is_inlier)| **is_inlier);
        let mut scales: Vec<f64> = inliers
            .map(|((_, point_a, point_b), _)| {
                (found.model * *point_b).norm() / (*a_from_world * *point_a).norm()
            })
            .filter(|scale| scale.is_finite() && *scale > 0.0)
            .collect();
        if scales.len() < MIN_INLIERS {
            return None;
        }
        let scale = median(&mut scales)?;
        let scaling = Sim3 { scale, ..Sim3::identity() };
        let b_from_a = similarity(&(*b_from_world * found.model.inverse())) * scaling;
        Some(Self { pair, b_from_a, num_inliers: scales.len() })
    }
}

/// Removes the constraints that are inconsistent with others of larger support.
///
/// On a facade with repeated windows, a wrong constraint is off by a multiple of the spacing of the
/// windows, and is therefore inconsistent with the correct constraints at that place. The support
/// of a constraint is the number of inliers of the constraints that agree with it.
pub(crate) fn consistent_set(
    model: &Reconstruction,
    loop_constraints: &[LoopConstraint],
    covisibility: &CovisibilityGraph,
) -> Vec<LoopConstraint> {
    let images: BTreeSet<ImageId> =
        loop_constraints.iter().flat_map(|m| [m.pair.a, m.pair.b]).collect();
    let (poses, depths) = (similarities(model, &images), depths(model, &images));
    let near: BTreeMap<ImageId, BTreeSet<ImageId>> =
        images.iter().map(|id| (*id, covisibility.within_path_length(*id))).collect();
    let is_near =
        |one: ImageId, other: ImageId| near.get(&one).is_some_and(|near| near.contains(&other));
    // Whether one constraint predicts the other one; `None` if they are at different places.
    let is_consistent = |one: &LoopConstraint, other: &LoopConstraint| {
        let ImagePair { a, b } = one.pair;
        // The drift between the parts of the model around a and around b, as a transform of the
        // world.
        let b_world_from_a_world =
            || Some(poses.get(&b)?.inverse() * one.b_from_a * *poses.get(&a)?);
        let other_b_world_from_a_world = if is_near(a, other.pair.a) && is_near(b, other.pair.b) {
            b_world_from_a_world()?
        } else if is_near(b, other.pair.a) && is_near(a, other.pair.b) {
            b_world_from_a_world()?.inverse()
        } else {
            return None;
        };
        let expected = *poses.get(&other.pair.b)?
            * other_b_world_from_a_world
            * poses.get(&other.pair.a)?.inverse();
        let factor = Between::new(other.b_from_a, &sigmas(*depths.get(&other.pair.b)?)).ok()?;
        let residual = factor.residual((&Sim3::identity(), &expected))?;
        Some(residual.norm() <= MAX_DIFFERENCE)
    };
    let support = |one: &LoopConstraint| {
        let consistent =
            loop_constraints.iter().filter(|other| is_consistent(one, other) == Some(true));
        consistent.map(|other| other.num_inliers).sum::<usize>()
    };
    let supports: Vec<usize> = loop_constraints.par_iter().map(support).collect();
    let is_contradicted = |one: &LoopConstraint, support: usize| {
        loop_constraints.iter().zip(&supports).any(|(other, other_support)| {
            *other_support > support && is_consistent(other, one) == Some(false)
        })
    };
    let kept = loop_constraints
        .par_iter()
        .zip(&supports)
        .filter(|(one, support)| !is_contradicted(one, **support));
    kept.map(|(one, _)| *one).collect()
}

/// Moves all images and points so that the loop constraints and the relative poses of covisible
/// images (`covisibility`) are satisfied in the least-squares sense.
pub(crate) fn distribute_drift(
    model: &mut Reconstruction,
    covisibility: &CovisibilityGraph,
    loop_constraints: &[LoopConstraint],
) -> Result<(), Error> {
    let images: BTreeSet<ImageId> = model.registered().map(|(id, ..)| id).collect();
    let (before, depths) = (similarities(model, &images), depths(model, &images));
    let current_relative =
        |pair: ImagePair| Some((pair, before.get(&pair.b)?.relative_to(before.get(&pair.a)?)));
    let loop_edges = loop_constraints
        .iter()
        .map(|loop_constraint| (loop_constraint.pair, loop_constraint.b_from_a));
    let mut problem = Problem::new();
    let mut keys: BTreeMap<ImageId, Key<Sim3>> = BTreeMap::new();
    let mut key = |problem: &mut Problem, id: ImageId| {
        let pose = before.get(&id)?;
        Some(
            *keys
                .entry(id)
                .or_insert_with(|| problem.add_parameter(*pose, EliminationOrder::At(id.0))),
        )
    };
    for (pair, b_from_a) in covisibility.pairs().filter_map(current_relative).chain(loop_edges) {
        let keys = (key(&mut problem, pair.a), key(&mut problem, pair.b));
        let ((Some(a), Some(b)), Some(&depth)) = (keys, depths.get(&pair.b)) else { continue };
        problem.add((a, b), Between::new(b_from_a, &sigmas(depth))?, Loss::Trivial)?;
    }
    let Some(first) = keys.values().next() else { return Ok(()) };
    problem.fix(*first);
    let options = Options {
        initial_damping: INITIAL_DAMPING,
        function_tolerance: TOLERANCE,
        ..Options::default()
    };
    Solver::new(&problem, &options)?.solve(&mut problem)?;
    let corrections: BTreeMap<ImageId, Sim3> = keys
        .iter()
        .filter_map(|(id, key)| Some((*id, problem.get(*key).inverse() * *before.get(id)?)))
        .collect();
    let moved: Vec<(ImageId, Rigid3)> = model
        .registered()
        .filter_map(|(id, _, pose)| Some((id, corrections.get(&id)?.transform_pose(pose))))
        .collect();
    moved.into_iter().for_each(|(id, pose)| model.register(id, pose));
    let points: Vec<PointId> = model.tracks().map(|(point, _)| point).collect();
    for point in points {
        let Some(track) = model.track_mut(point) else { continue };
        // Images with a common point move nearly equally. The first of them moves the point.
        if let Some(correction) = track.observations.iter().find_map(|o| corrections.get(&o.image))
        {
            track.xyz = *correction * track.xyz;
        }
    }
    Ok(())
}

/// Median distance of the points that each image observes.
fn depths(model: &Reconstruction, images: &BTreeSet<ImageId>) -> BTreeMap<ImageId, f64> {
    let depth = |id: &ImageId| {
        let (image, pose) = (model.image(*id), model.image(*id).cam_from_world()?);
        let tracks = image.points().iter().flatten().filter_map(|point| model.track(*point));
        let mut distances: Vec<f64> = tracks.map(|track| (*pose * track.xyz).norm()).collect();
        Some((*id, median(&mut distances)?))
    };
    images.iter().filter_map(depth).collect()
}

/// Weights: a radian, a median point distance and a scale factor of e cost the same.
fn sigmas(depth: f64) -> [f64; 7] {
    [1.0, 1.0, 1.0, depth, depth, depth, 1.0]
}

fn similarities(model: &Reconstruction, images: &BTreeSet<ImageId>) -> BTreeMap<ImageId, Sim3> {
    let pose = |id: &ImageId| Some((*id, similarity(model.image(*id).cam_from_world()?)));
    images.iter().filter_map(pose).collect()
}

fn similarity(pose: &Rigid3) -> Sim3 {
    Sim3 { scale: 1.0, rotation: pose.rotation, translation: pose.translation }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion};
    use tiepoint_geometry::solvers::umeyama;
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rng, so3};
    use tiepoint_scene::{
        Camera, CorrespondenceGraph, Image, Keypoint, Observation, Track, TwoViewKind,
    };

    use super::*;
    use crate::loop_closure::classify_pairs;

    /// Cameras on a circle that look outwards; number of points between neighbouring cameras.
    const IMAGES: usize = 60;
    const RADIUS: f64 = 10.0;
    const POINTS: usize = 40;
    /// Drift between neighbouring images: rotation in radians, and logarithm of the scale.
    const ROTATION_DRIFT: f64 = 0.002;
    const SCALE_DRIFT: f64 = 0.003;
    /// Maximum remaining fraction of the error: the drift is not uniform, and it is not distributed
    /// uniformly.
    const MAX_REMAINING: f64 = 0.15;

    fn true_pose(i: usize) -> Rigid3 {
        let (sin, cos) = (TAU * i as f64 / IMAGES as f64).sin_cos();
        let (right, ahead) = (Vector3::new(-sin, cos, 0.0), Vector3::new(cos, sin, 0.0));
        let axes = Matrix3::from_columns(&[right, ahead.cross(&right), ahead]).transpose();
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Rigid3::new(rotation, -(rotation * (ahead * RADIUS)))
    }

    /// `model_from_true` at an image.
    fn drift(i: usize) -> Sim3 {
        let i = i as f64;
        let rotation = so3::exp(&(Vector3::new(0.5, 0.2, 1.0) * ROTATION_DRIFT * i));
        Sim3 { scale: (SCALE_DRIFT * i).exp(), rotation, translation: Vector3::zeros() }
    }

    /// A circle with one point for each match between neighbours, except between the last and the
    /// first image, which have two points for each match.
    fn open_circle() -> (Reconstruction, CorrespondenceGraph, Vec<ImageId>) {
        let mut rng = Rng::stream(7, &[]);
        let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 400.0, 640, 480);
        let mut keypoints = vec![Vec::new(); IMAGES];
        let mut links = Vec::new();
        for one in 0..IMAGES {
            let other = (one + 1) % IMAGES;
            while links.len() < POINTS * (one + 1) {
                let at = Vector3::new(
                    4.0 * rng.uniform() - 2.0,
                    3.0 * rng.uniform() - 1.5,
                    4.0 + 3.0 * rng.uniform(),
                );
                let xyz = true_pose(one).inverse() * at;
                let pixels = [one, other].map(|i| intrinsics.project(&(true_pose(i) * xyz)));
                if let [Some(in_one), Some(in_other)] = pixels {
                    links.push((
                        one,
                        keypoints[one].len() as u32,
                        other,
                        keypoints[other].len() as u32,
                        xyz,
                    ));
                    keypoints[one].push(Keypoint { pixel: in_one, scale_px: 1.0 });
                    keypoints[other].push(Keypoint { pixel: in_other, scale_px: 1.0 });
                }
            }
        }
        let counts: Vec<usize> = keypoints.iter().map(Vec::len).collect();
        let mut model = Reconstruction::default();
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        let images: Vec<ImageId> = (0..)
            .zip(keypoints)
            .map(|(i, keypoints)| model.add_image(Image::new(i.to_string(), camera, keypoints)))
            .collect();
        for (i, &image) in images.iter().enumerate() {
            model.register(image, drift(i).transform_pose(&true_pose(i)));
        }
        let mut matches: BTreeMap<ImagePair, Vec<Match>> = BTreeMap::new();
        for (one, a, other, b, xyz) in links {
            let seen = [(one, a), (other, b)]
                .map(|(i, keypoint)| Observation { image: images[i], keypoint });
            if other == 0 {
                model.add_track(Track::new(drift(one) * xyz, vec![seen[0]]));
                model.add_track(Track::new(drift(other) * xyz, vec![seen[1]]));
            } else {
                model.add_track(Track::new(drift(one) * xyz, seen.to_vec()));
            }
            let pair = ImagePair::new(images[one], images[other]).unwrap();
            let m = if pair.a == images[one] { Match { a, b } } else { Match { a: b, b: a } };
            matches.entry(pair).or_default().push(m);
        }
        let two_views = matches.into_iter().map(|(pair, matches)| {
            (pair, TwoView { kind: TwoViewKind::Calibrated, matches, ..TwoView::default() })
        });
        let graph = CorrespondenceGraph::new(&counts, two_views);
        (model, graph, images)
    }

    fn loop_constraint_of(
        model: &Reconstruction,
        graph: &CorrespondenceGraph,
        images: &[ImageId],
    ) -> LoopConstraint {
        let pair = ImagePair::new(images[0], images[IMAGES - 1]).unwrap();
        LoopConstraint::new(model, pair, &graph.pairs()[&pair], 1).unwrap()
    }

    /// Residual of the loop constraint.
    fn loop_residual(model: &Reconstruction, loop_constraint: &LoopConstraint) -> f64 {
        let [a, b] = [loop_constraint.pair.a, loop_constraint.pair.b]
            .map(|id| *model.image(id).cam_from_world().unwrap());
        let depth =
            depths(model, &BTreeSet::from([loop_constraint.pair.b]))[&loop_constraint.pair.b];
        let factor = Between::new(loop_constraint.b_from_a, &sigmas(depth)).unwrap();
        factor.residual((&similarity(&a), &similarity(&b))).unwrap().norm()
    }

    /// Root mean square error of the camera centres after similarity alignment.
    fn error(model: &Reconstruction) -> f64 {
        let found: Vec<Vector3<f64>> =
            model.registered().map(|(.., pose)| pose.origin_in_a()).collect();
        let truth: Vec<Vector3<f64>> = (0..IMAGES).map(|i| true_pose(i).origin_in_a()).collect();
        let true_from_found = umeyama(&found, &truth, true).unwrap();
        let squared =
            found.iter().zip(&truth).map(|(f, t)| (true_from_found * *f - t).norm_squared());
        (squared.sum::<f64>() / IMAGES as f64).sqrt()
    }

    #[test]
    fn drift_is_distributed_over_a_circle() {
        let (mut model, graph, images) = open_circle();
        let loop_constraint = loop_constraint_of(&model, &graph, &images);
        let (before, residual_before) = (error(&model), loop_residual(&model, &loop_constraint));
        let error_px = model.mean_reprojection_error_px();
        let covisibility = classify_pairs(&graph, &model).covisibility;
        distribute_drift(&mut model, &covisibility, &[loop_constraint]).unwrap();
        assert!(error(&model) < MAX_REMAINING * before, "{} of {before}", error(&model));
        // The residual of the loop decreases to that of one edge, and the points move along.
        let left = loop_residual(&model, &loop_constraint_of(&model, &graph, &images));
        assert!(left < 2.0 / IMAGES as f64 * residual_before, "{left} of {residual_before}");
        assert!(
            model.mean_reprojection_error_px() < error_px,
            "{} px",
            model.mean_reprojection_error_px()
        );
    }

    #[test]
    fn of_inconsistent_constraints_those_with_more_inliers_are_kept() {
        let (model, graph, images) = open_circle();
        let covisibility = classify_pairs(&graph, &model).covisibility;
        let right = loop_constraint_of(&model, &graph, &images);
        let mut wrong = right;
        wrong.b_from_a.translation.x += 2.0;
        let kept = |num_wrong: usize| {
            let loop_constraints = [right, LoopConstraint { num_inliers: num_wrong, ..wrong }];
            let kept = consistent_set(&model, &loop_constraints, &covisibility);
            kept.iter().map(|loop_constraint| loop_constraint.b_from_a).collect::<Vec<_>>()
        };
        assert_eq!(kept(right.num_inliers - 1), [right.b_from_a]);
        assert_eq!(kept(right.num_inliers + 1), [wrong.b_from_a]);
    }

    #[test]
    fn wrong_matches_give_no_constraint() {
        let (model, graph, images) = open_circle();
        let pair = ImagePair::new(images[0], images[IMAGES - 1]).unwrap();
        let mut two_view = graph.pairs()[&pair].clone();
        let others: Vec<u32> = two_view.matches.iter().rev().map(|m| m.b).collect();
        two_view.matches.iter_mut().zip(others).for_each(|(m, b)| m.b = b);
        assert!(LoopConstraint::new(&model, pair, &two_view, 1).is_none());
    }
}
