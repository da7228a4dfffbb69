//! Steps in which poses move relative to other poses, and points relative to poses.
//!
//! A step is computed in the world's frame, and there poses and points are moved in straight lines.
//! Where a long chain of them bends or grows, what is far along the chain moves far, and on a
//! straight line neighbours part that should turn together: by second order in the motion of the
//! whole, while the measurements know only of that of one against the next. So a step is read as
//! one of each pose relative to its parent in a tree of poses, and of each point relative to a pose
//! that sees it, and these are composed from the roots of the tree: to first order the same step,
//! and exact where everything turns, moves or grows as one. (The parametrisation of relative bundle
//! adjustment — Sibley, Mei, Reid & Newman 2009 — for moving alone; the linear system remains that
//! of the world's frame, which is sparse.)

use std::any::TypeId;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;
use tiepoint_geometry::{Rigid3, so3};

use crate::error::Error;
use crate::problem::Problem;
use crate::retraction::{Moved, Retraction, Step, StepOf};
use crate::variable::{AnyKey, Key};

/// In place of the number of a pose.
const NO_POSE: u32 = u32::MAX;
/// Points that one task moves, at least.
const POINTS_PER_TASK: usize = 500;

/// The relative retraction: poses (`cam_from_world`) move relative to others that see the same
/// points, and points (in the world) relative to a pose that sees them, so that a long chain bends
/// where a step would tear it. Of a long drive far fewer steps are needed.
#[derive(Clone, Debug, Default)]
pub struct SpanningTree {
    /// Poses and their parents, parents before children.
    poses: Vec<(u32, u32)>,
    /// The pose relative to which each point moves, or [`NO_POSE`].
    pose_of_point: Vec<u32>,
}

impl SpanningTree {
    /// `sights` are which pose sees which point, as the factors have it. Poses that are to hold
    /// still should do so already. One of which only some directions are held moves along these by
    /// second order in the step.
    ///
    /// # Errors
    /// [`Error::UnknownVariable`] where the problem does not have a pose or a point.
    pub fn new(
        problem: &Problem,
        sights: &[(Key<Rigid3>, Key<Vector3<f64>>)],
    ) -> Result<Self, Error> {
        for &(pose, point) in sights {
            problem.locate(&pose.into())?;
            problem.locate(&point.into())?;
        }
        let slots: Vec<(u32, u32)> =
            sights.iter().map(|(pose, point)| (pose.slot, point.slot)).collect();
        let poses = problem.values.find(TypeId::of::<Rigid3>()).map(|store| &problem.metas[store]);
        let is_fixed = |slot: u32| poses.is_some_and(|poses| poses[slot as usize].free == 0);
        Ok(Self::over(&slots, is_fixed))
    }

    /// A pose's parent shares many points with it: such pairs are the maximum spanning tree (Prim
    /// 1957), whose roots are the poses that hold still. A point moves relative to the first pose
    /// that sees it. `sights` are (pose, point).
    fn over(sights: &[(u32, u32)], is_fixed: impl Fn(u32) -> bool) -> Self {
        let mut by_point: Vec<(u32, u32)> =
            sights.iter().map(|&(pose, point)| (point, pose)).collect();
        by_point.par_sort_unstable();
        by_point.dedup();
        let mut pose_of_point =
            vec![NO_POSE; by_point.last().map_or(0, |(point, _)| *point as usize + 1)];
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for seen in by_point.chunk_by(|a, b| a.0 == b.0) {
            let (point, first) = seen[0];
            pose_of_point[point as usize] = first;
            // Those next to each other suffice, of all pairs that share a point.
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

    /// Where a point moves by a tangent.
    fn moved(
        &self,
        poses: &StepOf<'_, Rigid3>,
        after: &[Rigid3],
        (point, place): (usize, &Vector3<f64>),
        tangent: &[f64],
    ) -> Option<Vector3<f64>> {
        let pose = self.pose_of(point)?;
        let shift = Vector3::from_column_slice(tangent);
        Some(carried(&poses.values()[pose], &Motion::of(poses, pose), &after[pose], place, &shift))
    }
}

impl Retraction for SpanningTree {
    fn retract(&self, step: &Step<'_>, moved: &mut Moved<'_>) {
        let (Some(poses), Some(points)) = (step.of::<Rigid3>(), step.of::<Vector3<f64>>()) else {
            return;
        };
        let Some((after, places)) = moved.two_mut::<Rigid3, Vector3<f64>>() else { return };
        let before = poses.values();
        for &(pose, parent) in &self.poses {
            let (pose, parent) = (pose as usize, parent as usize);
            if poses.tangent(pose).is_none() {
                continue;
            }
            let (own, of_parent) = (Motion::of(&poses, pose), Motion::of(&poses, parent));
            let place = before[pose].origin_in_a();
            let centre = carried(&before[parent], &of_parent, &after[parent], &place, &own.centre);
            let from_parent = before[pose].rotation * before[parent].rotation.inverse();
            let turn = so3::exp(&(own.turn - from_parent * of_parent.turn));
            // Each is a product with the one before: without this their norms would grow along the
            // chain.
            let rotation = UnitQuaternion::new_normalize(
                (turn * from_parent * after[parent].rotation).into_inner(),
            );
            after[pose] = Rigid3::new(rotation, -(rotation * centre));
        }
        let after = &*after;
        let move_point = |((index, to), from): ((usize, &mut Vector3<f64>), &Vector3<f64>)| {
            if let Some(tangent) = points.tangent(index) {
                *to = self.moved(&poses, after, (index, from), tangent).unwrap_or(*to);
            }
        };
        let places = places.par_iter_mut().enumerate().zip(points.values());
        places.with_min_len(POINTS_PER_TASK).for_each(move_point);
    }

    fn retract_one(&self, step: &Step<'_>, key: AnyKey, tangent: &[f64], moved: &mut Moved<'_>) {
        let (Some(poses), Some(points)) = (step.of::<Rigid3>(), step.of::<Vector3<f64>>()) else {
            return;
        };
        let Some(point) = key.typed::<Vector3<f64>>().map(Key::index) else { return };
        let Some((after, places)) = moved.two_mut::<Rigid3, Vector3<f64>>() else { return };
        if let Some(place) = self.moved(&poses, after, (point, &points.values()[point]), tangent) {
            places[point] = place;
        }
    }
}

/// Poses with the one through which they were reached, in this order.
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
        // What has no points in common with those before is a root itself.
        let Some(root) = others.find(|&pose| reached.insert(pose)) else { return tree };
        next.extend(edges(root));
    }
}

/// How a step moves a pose: its turn in its own frame, and its centre in the world.
#[derive(Clone, Copy)]
struct Motion {
    turn: Vector3<f64>,
    centre: Vector3<f64>,
}

impl Motion {
    fn of(poses: &StepOf<'_, Rigid3>, index: usize) -> Self {
        let Some(tangent) = poses.tangent(index) else {
            return Self { turn: Vector3::zeros(), centre: Vector3::zeros() };
        };
        let (turn, tau) =
            (Vector3::from_column_slice(&tangent[..3]), Vector3::from_column_slice(&tangent[3..]));
        Self { turn, centre: -(poses.values()[index].rotation.inverse() * tau) }
    }
}

/// Where a pose that was `before` and is `after`, and that a step moves by `motion`, carries a
/// place that the step moves by `shift`: in the frame of the pose the place moves in a straight
/// line.
fn carried(
    before: &Rigid3,
    motion: &Motion,
    after: &Rigid3,
    place: &Vector3<f64>,
    shift: &Vector3<f64>,
) -> Vector3<f64> {
    let seen = *before * *place;
    let moved = seen + motion.turn.cross(&seen) + before.rotation * (shift - motion.centre);
    after.rotation.inverse() * (moved - after.translation)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use tiepoint_geometry::Manifold;

    use super::*;
    use crate::variable::{FIXED, Order, Values};

    const POSES: usize = 6;
    /// Rounding of places some tens of units from the origin, moved a few times.
    const TOLERANCE: f64 = 1e-12;
    /// Of two retractions that agree to first order, halving the step leaves this share of the
    /// difference, and a bit.
    const SECOND_ORDER: f64 = 0.26;
    /// So short a step that only the second order matters; and the difference that rounding leaves
    /// of it.
    const SHORT: f64 = 1e-3;
    const ROUNDING: f64 = 1e-12;

    fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-limit..limit, -limit..limit, -limit..limit].prop_map(Vector3::from)
    }

    /// Poses along a line and points beside it, each seen by two neighbours; the first pose holds
    /// still if `hold` says so.
    fn chain(offs: &[(Vector3<f64>, Vector3<f64>)], hold: bool) -> (Problem, SpanningTree) {
        let mut problem = Problem::new();
        let poses: Vec<_> = (0..POSES)
            .map(|i| {
                let centre = Vector3::new(5.0 * i as f64, 0.0, 0.0) + offs[i].0;
                let rotation = so3::exp(&offs[i].1);
                problem
                    .add_parameter(Rigid3::new(rotation, -(rotation * centre)), Order::At(i as u32))
            })
            .collect();
        if hold {
            problem.fix(poses[0]);
        }
        let points: Vec<_> = (0..POSES)
            .map(|i| problem.add_landmark(Vector3::new(5.0 * i as f64, 1.0, 8.0) + offs[i].1))
            .collect();
        let sights: Vec<_> = (0..POSES)
            .flat_map(|i| [i, i + 1].map(|k| (poses[k.min(POSES - 1)], points[i])))
            .collect();
        let tree = SpanningTree::new(&problem, &sights).unwrap();
        (problem, tree)
    }

    /// Where a step (six numbers a pose, then three a point) leads in straight lines, and carried.
    fn moved(
        (problem, tree): &(Problem, SpanningTree),
        step: &[f64],
        hold: bool,
    ) -> [(Vec<Rigid3>, Vec<Vector3<f64>>); 2] {
        let pose_at: Vec<u32> =
            (0..POSES as u32).map(|i| if hold && i == 0 { FIXED } else { 6 * i }).collect();
        let point_at: Vec<u32> = (0..POSES as u32).map(|i| 6 * POSES as u32 + 3 * i).collect();
        let step_at = [pose_at, point_at];
        let step = Step { values: &problem.values, numbers: step, at: &step_at };
        [None, Some(tree as &dyn Retraction)].map(|retraction| {
            let mut trial: Values = problem.values.clone();
            step.take(retraction, &mut trial);
            (trial.slice::<Rigid3>(0).to_vec(), trial.slice(1).to_vec())
        })
    }

    /// The step of a world that turns about its origin, grows and is shifted.
    fn as_one(
        problem: &Problem,
        turn: &Vector3<f64>,
        growth: f64,
        shift: &Vector3<f64>,
    ) -> Vec<f64> {
        let moves = |place: &Vector3<f64>| turn.cross(place) + place * growth + shift;
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

    fn offs() -> impl Strategy<Value = Vec<(Vector3<f64>, Vector3<f64>)>> {
        proptest::collection::vec((vector(1.0), vector(0.5)), POSES)
    }

    proptest! {
        /// However far: what the cameras see is as large as the world has become, and else as it
        /// was.
        #[test]
        fn what_moves_as_one_stays_together(
            offs in offs(),
            turn in vector(1.0),
            growth in -0.5..1.0f64,
            shift in vector(10.0),
        ) {
            let chain = chain(&offs, false);
            let problem = &chain.0;
            let step = as_one(problem, &turn, growth, &shift);
            let [_, (poses, points)] = moved(&chain, &step, false);
            let old_poses = problem.values.slice::<Rigid3>(0);
            let old_points = problem.values.slice::<Vector3<f64>>(1);
            for i in 0..POSES {
                for k in 0..POSES {
                    let (seen, was) =
                        (poses[i] * points[k], old_poses[i] * old_points[k] * (1.0 + growth));
                    prop_assert!(
                        (seen - was).norm() < TOLERANCE * was.norm().max(1.0),
                        "{seen} {was}"
                    );
                }
            }
        }

        #[test]
        fn to_first_order_it_is_the_same_step(
            offs in offs(), step in proptest::collection::vec(-SHORT..SHORT, 9 * POSES), hold: bool,
        ) {
            let chain = chain(&offs, hold);
            let apart = |step: &[f64]| {
                let [straight, carried] = moved(&chain, step, hold);
                let poses = straight.0.iter().zip(&carried.0).map(|(a, b)| a.minus(b).norm());
                let points = straight.1.iter().zip(&carried.1).map(|(a, b)| (a - b).norm());
                poses.chain(points).fold(0.0, f64::max)
            };
            let half: Vec<f64> = step.iter().map(|s| 0.5 * s).collect();
            let (whole, half) = (apart(&step), apart(&half));
            prop_assert!(half < SECOND_ORDER * whole + ROUNDING, "{whole} {half}");
        }
    }

    #[test]
    fn what_is_fixed_stays() {
        let chain = chain(&[(Vector3::zeros(), Vector3::zeros()); POSES], true);
        let problem = &chain.0;
        let step = as_one(problem, &Vector3::new(0.1, 0.2, 0.3), 0.1, &Vector3::new(1.0, 2.0, 3.0));
        let [_, (poses, _)] = moved(&chain, &step, true);
        assert_eq!(poses[0], problem.values.slice::<Rigid3>(0)[0]);
        assert_ne!(poses[1], problem.values.slice::<Rigid3>(0)[1]);
    }

    /// Poses 0 and 2 see most in common, 3 sees as much of 2 as of 0 and hangs on the later one, 7
    /// sees points that no other does; 1 holds still, and 4 with it.
    #[test]
    fn parents_share_most_points() {
        let mut point = 0;
        let mut sights = Vec::new();
        let mut see = |poses: [u32; 2], count: usize| {
            for _ in 0..count {
                sights.extend(poses.map(|pose| (pose, point)));
                point += 1;
            }
        };
        see([0, 2], 5);
        see([0, 3], 2);
        see([2, 3], 2);
        see([1, 4], 3);
        see([4, 0], 1);
        see([7, 7], 4);
        let tree = SpanningTree::over(&sights, |pose| pose == 1);
        assert_eq!(tree.poses, [(4, 1), (0, 4), (2, 0), (3, 2)]);
        assert_eq!(tree.pose_of(0), Some(0));
        assert_eq!(tree.pose_of(12), Some(0));
        assert_eq!(tree.pose_of(13), Some(7));
        assert_eq!(tree.pose_of(17), None);
    }
}
