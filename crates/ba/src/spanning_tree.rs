//! Relative retraction: poses move relative to other poses, and points relative to poses.
//!
//! A step is computed in the world frame, where poses and points move along straight lines. If a
//! long chain of poses bends or changes its scale, its far end moves far, and neighbours that
//! should rotate together separate by second order in the total motion, although the measurements
//! only relate neighbours. The step is therefore read as one of each pose relative to its parent in
//! a spanning tree, and of each point relative to a pose that observes it. These relative motions
//! are composed from the roots. The result agrees with the straight step to first order, and is
//! exact if everything rotates, translates or scales as one. This is the parametrisation of
//! relative bundle adjustment (Sibley, Mei, Reid & Newman 2009), used for the retraction alone: the
//! linear system remains that of the world frame, which is sparse.

use std::any::TypeId;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;
use tiepoint_geometry::{Rigid3, so3};

use crate::error::Error;
use crate::problem::Problem;
use crate::retraction::{RetractedValues, Retraction, Step, TypedStep};
use crate::variable::{AnyKey, Key};

/// Index of a pose that does not exist.
const NO_POSE: u32 = u32::MAX;
/// Minimal number of points that one parallel job moves.
const POINTS_PER_JOB: usize = 500;

/// Relative retraction along a maximum spanning tree. Poses (`cam_from_world`) move relative to
/// others that observe the same points, and points (in the world) relative to a pose that observes
/// them. Long drives then need far fewer steps.
#[derive(Clone, Debug, Default)]
pub struct SpanningTree {
    /// Poses and their parents, parents before children.
    poses: Vec<(u32, u32)>,
    /// The pose relative to which each point moves, or [`NO_POSE`].
    pose_of_point: Vec<u32>,
}

impl SpanningTree {
    /// `observations` are the pairs (pose, point) of the reprojection factors. Fix poses before
    /// this call. A pose with only some directions fixed moves along these by second order in the
    /// step.
    ///
    /// # Errors
    /// [`Error::UnknownVariable`] if the problem does not have a pose or a point.
    pub fn new(
        problem: &Problem,
        observations: &[(Key<Rigid3>, Key<Vector3<f64>>)],
    ) -> Result<Self, Error> {
        for &(pose, point) in observations {
            problem.locate(&pose.into())?;
            problem.locate(&point.into())?;
        }
        let slots: Vec<(u32, u32)> =
            observations.iter().map(|(pose, point)| (pose.slot, point.slot)).collect();
        let poses = problem.values.find(TypeId::of::<Rigid3>()).map(|store| &problem.metas[store]);
        let is_fixed = |slot: u32| poses.is_some_and(|poses| poses[slot as usize].free == 0);
        Ok(Self::from_slots(&slots, is_fixed))
    }

    /// Builds the maximum spanning tree (Prim 1957) of poses, weighted by the number of points of
    /// which they are consecutive observers, with the fixed poses as roots. A point moves relative
    /// to the first pose that observes it. `observations` are (pose, point).
    fn from_slots(observations: &[(u32, u32)], is_fixed: impl Fn(u32) -> bool) -> Self {
        let mut by_point: Vec<(u32, u32)> =
            observations.iter().map(|&(pose, point)| (point, pose)).collect();
        by_point.par_sort_unstable();
        by_point.dedup();
        let mut pose_of_point =
            vec![NO_POSE; by_point.last().map_or(0, |(point, _)| *point as usize + 1)];
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for seen in by_point.chunk_by(|a, b| a.0 == b.0) {
            let (point, first) = seen[0];
            pose_of_point[point as usize] = first;
            // Consecutive observers of a point are enough to connect all of them.
            pairs.extend(seen.windows(2).map(|pair| (pair[0].1, pair[1].1)));
        }
        pairs.par_sort_unstable();
        let mut neighbours: BTreeMap<u32, Vec<(usize, u32)>> =
            by_point.iter().map(|&(_, pose)| (pose, Vec::new())).collect();
        for same in pairs.chunk_by(|a, b| a == b) {
            let (a, b) = same[0];
            neighbours.entry(a).or_default().push((same.len(), b));
            neighbours.entry(b).or_default().push((same.len(), a));
        }
        Self { poses: maximum_spanning_tree(&neighbours, is_fixed), pose_of_point }
    }

    fn pose_of(&self, point: usize) -> Option<usize> {
        self.pose_of_point.get(point).filter(|&&pose| pose != NO_POSE).map(|&pose| pose as usize)
    }

    /// Position of a point after a step by `tangent`.
    fn moved_point(
        &self,
        poses: &TypedStep<'_, Rigid3>,
        after: &[Rigid3],
        (point, position): (usize, &Vector3<f64>),
        tangent: &[f64],
    ) -> Option<Vector3<f64>> {
        let pose = self.pose_of(point)?;
        let shift = Vector3::from_column_slice(tangent);
        Some(move_with_pose(
            &poses.values()[pose],
            &Motion::of(poses, pose),
            &after[pose],
            position,
            &shift,
        ))
    }
}

impl Retraction for SpanningTree {
    fn retract(&self, step: &Step<'_>, moved: &mut RetractedValues<'_>) {
        let (Some(poses), Some(points)) = (step.of::<Rigid3>(), step.of::<Vector3<f64>>()) else {
            return;
        };
        let Some((after, positions)) = moved.two_mut::<Rigid3, Vector3<f64>>() else { return };
        let before = poses.values();
        for &(pose, parent) in &self.poses {
            let (pose, parent) = (pose as usize, parent as usize);
            if poses.tangent(pose).is_none() {
                continue;
            }
            let (own, of_parent) = (Motion::of(&poses, pose), Motion::of(&poses, parent));
            let position = before[pose].origin_in_a();
            let centre =
                move_with_pose(&before[parent], &of_parent, &after[parent], &position, &own.centre);
            let from_parent = before[pose].rotation * before[parent].rotation.inverse();
            let relative_rotation = so3::exp(&(own.rotation - from_parent * of_parent.rotation));
            // Products of rotations: without normalisation their norms would drift along the chain.
            let rotation = UnitQuaternion::new_normalize(
                (relative_rotation * from_parent * after[parent].rotation).into_inner(),
            );
            after[pose] = Rigid3::new(rotation, -(rotation * centre));
        }
        let after = &*after;
        let move_point = |((index, to), from): ((usize, &mut Vector3<f64>), &Vector3<f64>)| {
            if let Some(tangent) = points.tangent(index) {
                *to = self.moved_point(&poses, after, (index, from), tangent).unwrap_or(*to);
            }
        };
        let positions = positions.par_iter_mut().enumerate().zip(points.values());
        positions.with_min_len(POINTS_PER_JOB).for_each(move_point);
    }

    fn retract_one(
        &self,
        step: &Step<'_>,
        key: AnyKey,
        tangent: &[f64],
        moved: &mut RetractedValues<'_>,
    ) {
        let (Some(poses), Some(points)) = (step.of::<Rigid3>(), step.of::<Vector3<f64>>()) else {
            return;
        };
        let Some(point) = key.typed::<Vector3<f64>>().map(Key::index) else { return };
        let Some((after, positions)) = moved.two_mut::<Rigid3, Vector3<f64>>() else { return };
        if let Some(position) =
            self.moved_point(&poses, after, (point, &points.values()[point]), tangent)
        {
            positions[point] = position;
        }
    }
}

/// Pairs (pose, parent) of the tree, parents before children. `neighbours` are the weighted edges
/// of each pose.
fn maximum_spanning_tree(
    neighbours: &BTreeMap<u32, Vec<(usize, u32)>>,
    is_fixed: impl Fn(u32) -> bool,
) -> Vec<(u32, u32)> {
    let (fixed, others): (Vec<u32>, Vec<u32>) =
        neighbours.keys().partition(|&&pose| is_fixed(pose));
    let edges =
        |from: u32| neighbours[&from].iter().map(move |&(weight, pose)| (weight, pose, from));
    let mut next: BinaryHeap<_> = fixed.iter().flat_map(|&pose| edges(pose)).collect();
    let mut reached: BTreeSet<u32> = fixed.into_iter().collect();
    let mut others = others.into_iter();
    let mut tree = Vec::new();
    loop {
        while let Some((_, pose, from)) = next.pop() {
            if reached.insert(pose) {
                tree.push((pose, from));
                next.extend(edges(pose));
            }
        }
        // A pose without points in common with the tree so far is a root itself.
        let Some(root) = others.find(|&pose| reached.insert(pose)) else { return tree };
        next.extend(edges(root));
    }
}

/// Step of a pose: rotation tangent in its own frame, and translation of its centre in the world.
#[derive(Clone, Copy)]
struct Motion {
    rotation: Vector3<f64>,
    centre: Vector3<f64>,
}

impl Motion {
    fn of(poses: &TypedStep<'_, Rigid3>, index: usize) -> Self {
        let Some(tangent) = poses.tangent(index) else {
            return Self { rotation: Vector3::zeros(), centre: Vector3::zeros() };
        };
        let (rotation, tau) =
            (Vector3::from_column_slice(&tangent[..3]), Vector3::from_column_slice(&tangent[3..]));
        Self { rotation, centre: -(poses.values()[index].rotation.inverse() * tau) }
    }
}

/// The new position, in the world, of a point that moves with a camera.
///
/// The step of the linear system moves the point from `point_in_world` by `shift` (world frame) and
/// the camera from `before` to `after` (both cam_from_world), to first order by `motion`. The point
/// moves along a straight line in the camera frame, and `after` takes it back to the world.
fn move_with_pose(
    before: &Rigid3,
    motion: &Motion,
    after: &Rigid3,
    point_in_world: &Vector3<f64>,
    shift: &Vector3<f64>,
) -> Vector3<f64> {
    let in_cam = *before * *point_in_world;
    let moved_in_cam =
        in_cam + motion.rotation.cross(&in_cam) + before.rotation * (shift - motion.centre);
    after.rotation.inverse() * (moved_in_cam - after.translation)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use tiepoint_geometry::Manifold;

    use super::*;
    use crate::variable::{EliminationOrder, FIXED, Values};

    const POSES: usize = 6;
    /// Rounding of positions of some tens of units, moved a few times.
    const TOLERANCE: f64 = 1e-12;
    /// Two retractions that agree to first order differ by second order: half the step leaves a
    /// quarter of the difference, plus a margin.
    const SECOND_ORDER: f64 = 0.26;
    /// A step for which only the second order matters, and the rounding error of its difference.
    const SHORT: f64 = 1e-3;
    const ROUNDING: f64 = 1e-12;

    fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-limit..limit, -limit..limit, -limit..limit].prop_map(Vector3::from)
    }

    /// Poses along a line with points beside it, each observed by two neighbours. The first pose is
    /// fixed if `fix_first`.
    fn chain(
        perturbations: &[(Vector3<f64>, Vector3<f64>)],
        fix_first: bool,
    ) -> (Problem, SpanningTree) {
        let mut problem = Problem::new();
        let poses: Vec<_> = (0..POSES)
            .map(|i| {
                let centre = Vector3::new(5.0 * i as f64, 0.0, 0.0) + perturbations[i].0;
                let rotation = so3::exp(&perturbations[i].1);
                problem.add_parameter(
                    Rigid3::new(rotation, -(rotation * centre)),
                    EliminationOrder::At(i as u32),
                )
            })
            .collect();
        if fix_first {
            problem.fix(poses[0]);
        }
        let points: Vec<_> = (0..POSES)
            .map(|i| {
                problem.add_landmark(Vector3::new(5.0 * i as f64, 1.0, 8.0) + perturbations[i].1)
            })
            .collect();
        let observations: Vec<_> = (0..POSES)
            .flat_map(|i| [i, i + 1].map(|k| (poses[k.min(POSES - 1)], points[i])))
            .collect();
        let tree = SpanningTree::new(&problem, &observations).unwrap();
        (problem, tree)
    }

    /// Values after a step (six numbers per pose, then three per point), without and with the
    /// relative retraction.
    fn retracted(
        (problem, tree): &(Problem, SpanningTree),
        step: &[f64],
        fix_first: bool,
    ) -> [(Vec<Rigid3>, Vec<Vector3<f64>>); 2] {
        let pose_at: Vec<u32> =
            (0..POSES as u32).map(|i| if fix_first && i == 0 { FIXED } else { 6 * i }).collect();
        let point_at: Vec<u32> = (0..POSES as u32).map(|i| 6 * POSES as u32 + 3 * i).collect();
        let step_offsets = [pose_at, point_at];
        let step = Step { values: &problem.values, tangents: step, offsets: &step_offsets };
        [None, Some(tree as &dyn Retraction)].map(|retraction| {
            let mut trial: Values = problem.values.clone();
            step.take(retraction, &mut trial);
            (trial.slice::<Rigid3>(0).to_vec(), trial.slice(1).to_vec())
        })
    }

    /// The step of a world that rotates about its origin, scales and translates.
    fn similarity_step(
        problem: &Problem,
        turn: &Vector3<f64>,
        scaling: f64,
        shift: &Vector3<f64>,
    ) -> Vec<f64> {
        let moves = |position: &Vector3<f64>| turn.cross(position) + position * scaling + shift;
        let mut step = Vec::new();
        for pose in problem.values.slice::<Rigid3>(0) {
            let tau = -(pose.rotation * moves(&pose.origin_in_a()));
            step.extend((-(pose.rotation * turn)).iter().chain(tau.iter()).copied());
        }
        problem
            .values
            .slice::<Vector3<f64>>(1)
            .iter()
            .for_each(|point| step.extend(moves(point).iter()));
        step
    }

    fn perturbations() -> impl Strategy<Value = Vec<(Vector3<f64>, Vector3<f64>)>> {
        proptest::collection::vec((vector(1.0), vector(0.5)), POSES)
    }

    proptest! {
        /// Whatever the size of the step, the points in the camera frames scale with the world and
        /// do not change otherwise.
        #[test]
        fn a_similarity_of_the_world_is_retracted_exactly(
            perturbations in perturbations(),
            turn in vector(1.0),
            scaling in -0.5..1.0f64,
            shift in vector(10.0),
        ) {
            let chain = chain(&perturbations, false);
            let problem = &chain.0;
            let step = similarity_step(problem, &turn, scaling, &shift);
            let [_, (poses, points)] = retracted(&chain, &step, false);
            let old_poses = problem.values.slice::<Rigid3>(0);
            let old_points = problem.values.slice::<Vector3<f64>>(1);
            for i in 0..POSES {
                for k in 0..POSES {
                    let (seen, was) =
                        (poses[i] * points[k], old_poses[i] * old_points[k] * (1.0 + scaling));
                    prop_assert!(
                        (seen - was).norm() < TOLERANCE * was.norm().max(1.0),
                        "{seen} {was}"
                    );
                }
            }
        }

        #[test]
        fn it_agrees_with_the_straight_step_to_first_order(
            perturbations in perturbations(),
            step in proptest::collection::vec(-SHORT..SHORT, 9 * POSES),
            fix_first: bool,
        ) {
            let chain = chain(&perturbations, fix_first);
            let difference = |step: &[f64]| {
                let [straight, relative] = retracted(&chain, step, fix_first);
                let poses = straight.0.iter().zip(&relative.0).map(|(a, b)| a.minus(b).norm());
                let points = straight.1.iter().zip(&relative.1).map(|(a, b)| (a - b).norm());
                poses.chain(points).fold(0.0, f64::max)
            };
            let half: Vec<f64> = step.iter().map(|s| 0.5 * s).collect();
            let (whole, half) = (difference(&step), difference(&half));
            prop_assert!(half < SECOND_ORDER * whole + ROUNDING, "{whole} {half}");
        }
    }

    #[test]
    fn fixed_poses_do_not_move() {
        let chain = chain(&[(Vector3::zeros(), Vector3::zeros()); POSES], true);
        let problem = &chain.0;
        let step = similarity_step(
            problem,
            &Vector3::new(0.1, 0.2, 0.3),
            0.1,
            &Vector3::new(1.0, 2.0, 3.0),
        );
        let [_, (poses, _)] = retracted(&chain, &step, true);
        assert_eq!(poses[0], problem.values.slice::<Rigid3>(0)[0]);
        assert_ne!(poses[1], problem.values.slice::<Rigid3>(0)[1]);
    }

    /// Poses 0 and 2 share most points. Pose 3 shares as many with 2 as with 0, and the later one
    /// becomes its parent. Pose 7 shares no points. Pose 1 is fixed, and 4 is connected to it.
    #[test]
    fn parents_share_most_points() {
        let mut point = 0;
        let mut observations = Vec::new();
        let mut observe = |poses: [u32; 2], count: usize| {
            for _ in 0..count {
                observations.extend(poses.map(|pose| (pose, point)));
                point += 1;
            }
        };
        observe([0, 2], 5);
        observe([0, 3], 2);
        observe([2, 3], 2);
        observe([1, 4], 3);
        observe([4, 0], 1);
        observe([7, 7], 4);
        let tree = SpanningTree::from_slots(&observations, |pose| pose == 1);
        assert_eq!(tree.poses, [(4, 1), (0, 4), (2, 0), (3, 2)]);
        assert_eq!(tree.pose_of(0), Some(0));
        assert_eq!(tree.pose_of(12), Some(0));
        assert_eq!(tree.pose_of(13), Some(7));
        assert_eq!(tree.pose_of(17), None);
    }
}
