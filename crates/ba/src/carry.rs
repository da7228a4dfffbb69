//! Steps that carry along what hangs together.
//!
//! A step is computed in the world's frame, and there poses and points are moved in straight lines. Where a long chain of them bends or
//! grows, what is far along the chain moves far, and on a straight line neighbours part that should turn together: by second order in the
//! motion of the whole, while the measurements know only of that of one against the next. So a step is read as one of each pose relative
//! to a pose that carries it, and of each point relative to a pose that sees it, and these are composed from the ends that hold still or lead:
//! to first order the same step, and exact where everything turns, moves or grows as one. (The parametrisation of relative bundle adjustment — Sibley,
//! Mei, Reid & Newman 2009 — for moving alone; the linear system remains that of the world's frame, which is sparse.)

use std::any::TypeId;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;
use tiepoint_geometry::{Rigid3, so3};

use crate::variable::{FIXED, PARALLEL_VALUES, Values};

/// In place of the number of a pose.
const NOBODY: u32 = u32::MAX;

/// Who carries whom. Poses are `cam_from_world`, points are in the world.
#[derive(Default)]
pub(crate) struct Carriers {
    /// Poses and who carries them, who stands before.
    poses: Vec<(u32, u32)>,
    /// Who carries each point.
    points: Vec<u32>,
}

impl Carriers {
    /// Every pose is carried by one with which it shares many points: those pairs are the heaviest tree (Prim 1957), begun at the poses that hold
    /// still. Every point is carried by the first pose that sees it. `sights` are (pose, point).
    pub(crate) fn new(sights: &[(u32, u32)], is_fixed: impl Fn(u32) -> bool) -> Self {
        let mut by_point: Vec<(u32, u32)> = sights.iter().map(|&(pose, point)| (point, pose)).collect();
        by_point.par_sort_unstable();
        by_point.dedup();
        let mut points = vec![NOBODY; by_point.last().map_or(0, |(point, _)| *point as usize + 1)];
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for seen in by_point.chunk_by(|a, b| a.0 == b.0) {
            let (point, first) = seen[0];
            points[point as usize] = first;
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
        Self { poses: heaviest_tree(&neighbours, is_fixed), points }
    }

    fn point(&self, slot: usize) -> Option<usize> {
        self.points.get(slot).filter(|&&carrier| carrier != NOBODY).map(|&carrier| carrier as usize)
    }
}

/// Poses with the one through which they were reached, in this order.
fn heaviest_tree(
    neighbours: &BTreeMap<u32, Vec<(usize, u32)>>,
    is_fixed: impl Fn(u32) -> bool,
) -> Vec<(u32, u32)> {
    let (fixed, others): (Vec<u32>, Vec<u32>) = neighbours.keys().partition(|&&pose| is_fixed(pose));
    let edges = |from: u32| neighbours[&from].iter().map(move |&(weight, pose)| (weight, pose, from));
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
        // What has no points in common with those before leads itself.
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

/// One step, from `values`.
pub(crate) struct Carry<'a> {
    pub(crate) carriers: &'a Carriers,
    pub(crate) values: &'a Values,
    pub(crate) step: &'a [f64],
    /// For each store, where in `step` its variables are.
    pub(crate) step_at: &'a [Vec<u32>],
}

impl Carry<'_> {
    /// Moves everything to `trial`: in straight lines, but for what is carried.
    pub(crate) fn all(&self, trial: &mut Values) {
        for ((trial, values), at) in trial.stores.iter_mut().zip(&self.values.stores).zip(self.step_at) {
            trial.plus_all(&**values, self.step, at);
        }
        let Some((poses, points)) = self.stores() else { return };
        let before = self.values.slice::<Rigid3>(poses as u16);
        let mut after = std::mem::take(trial.store_mut::<Rigid3>().1);
        for &(pose, carrier) in &self.carriers.poses {
            let (pose, carrier) = (pose as usize, carrier as usize);
            if self.step_at[poses][pose] == FIXED {
                continue;
            }
            let (own, of_carrier) = (self.motion(poses, pose), self.motion(poses, carrier));
            let centre = carried(
                &before[carrier],
                &of_carrier,
                &after[carrier],
                &before[pose].origin_in_a(),
                &own.centre,
            );
            let from_carrier = before[pose].rotation * before[carrier].rotation.inverse();
            let turn = so3::exp(&(own.turn - from_carrier * of_carrier.turn));
            // Each is a product with the one before: without this their norms would grow along the chain.
            let rotation =
                UnitQuaternion::new_normalize((turn * from_carrier * after[carrier].rotation).into_inner());
            after[pose] = Rigid3::new(rotation, -(rotation * centre));
        }
        let at = &self.step_at[points];
        let move_point = |(slot, point): (usize, &mut Vector3<f64>)| {
            if at[slot] != FIXED {
                let step = &self.step[at[slot] as usize..][..3];
                *point = self.moved(poses, points, &after, slot, step).unwrap_or(*point);
            }
        };
        let places = trial.store_mut::<Vector3<f64>>().1;
        places.par_iter_mut().enumerate().with_min_len(PARALLEL_VALUES / 8).for_each(move_point);
        *trial.store_mut::<Rigid3>().1 = after;
    }

    /// Moves one variable to `trial` by another step than that of all.
    pub(crate) fn one(&self, trial: &mut Values, store: usize, slot: usize, step: &[f64]) {
        trial.stores[store].plus_one(&*self.values.stores[store], slot, step);
        let Some((poses, points)) = self.stores().filter(|(_, points)| *points == store) else { return };
        if let Some(point) = self.moved(poses, points, trial.slice(poses as u16), slot, step) {
            trial.store_mut::<Vector3<f64>>().1[slot] = point;
        }
    }

    /// Numbers of the stores of poses and points.
    fn stores(&self) -> Option<(usize, usize)> {
        if self.carriers.points.is_empty() {
            return None;
        }
        let find = |type_id| self.values.find(type_id);
        find(TypeId::of::<Rigid3>()).zip(find(TypeId::of::<Vector3<f64>>()))
    }

    fn motion(&self, poses: usize, slot: usize) -> Motion {
        let at = self.step_at[poses][slot];
        if at == FIXED {
            return Motion { turn: Vector3::zeros(), centre: Vector3::zeros() };
        }
        let step = &self.step[at as usize..][..6];
        let (turn, tau) = (Vector3::from_column_slice(&step[..3]), Vector3::from_column_slice(&step[3..]));
        let before = &self.values.slice::<Rigid3>(poses as u16)[slot];
        Motion { turn, centre: -(before.rotation.inverse() * tau) }
    }

    /// Where a point is carried that moves by `step`.
    fn moved(
        &self,
        poses: usize,
        points: usize,
        after: &[Rigid3],
        slot: usize,
        step: &[f64],
    ) -> Option<Vector3<f64>> {
        let carrier = self.carriers.point(slot)?;
        let before = &self.values.slice::<Rigid3>(poses as u16)[carrier];
        let point = &self.values.slice::<Vector3<f64>>(points as u16)[slot];
        let step = Vector3::from_column_slice(step);
        Some(carried(before, &self.motion(poses, carrier), &after[carrier], point, &step))
    }
}

/// Where a pose that was `before` and is `after`, and that a step moves by `motion`, carries a place that the step moves by `shift`: in the
/// frame of the pose the place moves in a straight line.
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
    use crate::problem::Problem;
    use crate::variable::Order;

    const POSES: usize = 6;
    /// Rounding of places some tens of units from the origin, moved a few times.
    const TOLERANCE: f64 = 1e-12;
    /// Of two retractions that agree to first order, halving the step leaves this share of the difference, and a bit.
    const SECOND_ORDER: f64 = 0.26;
    /// So short a step that only the second order matters; and the difference that rounding leaves of it.
    const SHORT: f64 = 1e-3;
    const ROUNDING: f64 = 1e-12;

    fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-limit..limit, -limit..limit, -limit..limit].prop_map(Vector3::from)
    }

    /// Poses along a line and points beside it, each seen by two neighbours; the first pose holds still if `hold` says so.
    fn chain(offs: &[(Vector3<f64>, Vector3<f64>)], hold: bool) -> Problem {
        let mut problem = Problem::new();
        let poses: Vec<_> = (0..POSES)
            .map(|i| {
                let centre = Vector3::new(5.0 * i as f64, 0.0, 0.0) + offs[i].0;
                let rotation = so3::exp(&offs[i].1);
                problem.keep(Rigid3::new(rotation, -(rotation * centre)), Order::At(i as u32))
            })
            .collect();
        if hold {
            problem.fix(poses[0]);
        }
        let points: Vec<_> = (0..POSES)
            .map(|i| problem.eliminate(Vector3::new(5.0 * i as f64, 1.0, 8.0) + offs[i].1))
            .collect();
        let sights: Vec<_> =
            (0..POSES).flat_map(|i| [i, i + 1].map(|k| (poses[k.min(POSES - 1)], points[i]))).collect();
        problem.carry(&sights).unwrap();
        problem
    }

    /// Where a step (six numbers a pose, then three a point) leads in straight lines, and carried.
    fn moved(problem: &Problem, step: &[f64], hold: bool) -> [(Vec<Rigid3>, Vec<Vector3<f64>>); 2] {
        let pose_at: Vec<u32> =
            (0..POSES as u32).map(|i| if hold && i == 0 { FIXED } else { 6 * i }).collect();
        let point_at: Vec<u32> = (0..POSES as u32).map(|i| 6 * POSES as u32 + 3 * i).collect();
        let step_at = [pose_at, point_at];
        let values = &problem.values;
        let mut trial = values.clone();
        for ((trial, values), at) in trial.stores.iter_mut().zip(&values.stores).zip(&step_at) {
            trial.plus_all(&**values, step, at);
        }
        let both = |values: &Values| (values.slice::<Rigid3>(0).to_vec(), values.slice(1).to_vec());
        let straight = both(&trial);
        Carry { carriers: &problem.carriers, values, step, step_at: &step_at }.all(&mut trial);
        [straight, both(&trial)]
    }

    /// The step of a world that turns about its origin, grows and is shifted.
    fn as_one(problem: &Problem, turn: &Vector3<f64>, growth: f64, shift: &Vector3<f64>) -> Vec<f64> {
        let moves = |place: &Vector3<f64>| turn.cross(place) + place * growth + shift;
        let mut step = Vec::new();
        for pose in problem.values.slice::<Rigid3>(0) {
            let tau = -(pose.rotation * moves(&pose.origin_in_a()));
            step.extend((-(pose.rotation * turn)).iter().chain(tau.iter()).copied());
        }
        problem.values.slice::<Vector3<f64>>(1).iter().for_each(|point| step.extend(moves(point).iter()));
        step
    }

    fn offs() -> impl Strategy<Value = Vec<(Vector3<f64>, Vector3<f64>)>> {
        proptest::collection::vec((vector(1.0), vector(0.5)), POSES)
    }

    proptest! {
        /// However far: what the cameras see is as large as the world has become, and else as it was.
        #[test]
        fn what_moves_as_one_stays_together(
            offs in offs(), turn in vector(1.0), growth in -0.5..1.0f64, shift in vector(10.0),
        ) {
            let problem = chain(&offs, false);
            let step = as_one(&problem, &turn, growth, &shift);
            let [_, (poses, points)] = moved(&problem, &step, false);
            let old_poses = problem.values.slice::<Rigid3>(0);
            let old_points = problem.values.slice::<Vector3<f64>>(1);
            for i in 0..POSES {
                for k in 0..POSES {
                    let (seen, was) = (poses[i] * points[k], old_poses[i] * old_points[k] * (1.0 + growth));
                    prop_assert!((seen - was).norm() < TOLERANCE * was.norm().max(1.0), "{seen} {was}");
                }
            }
        }

        #[test]
        fn to_first_order_it_is_the_same_step(
            offs in offs(), step in proptest::collection::vec(-SHORT..SHORT, 9 * POSES), hold: bool,
        ) {
            let problem = chain(&offs, hold);
            let apart = |step: &[f64]| {
                let [straight, carried] = moved(&problem, step, hold);
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
        let problem = chain(&[(Vector3::zeros(), Vector3::zeros()); POSES], true);
        let step = as_one(&problem, &Vector3::new(0.1, 0.2, 0.3), 0.1, &Vector3::new(1.0, 2.0, 3.0));
        let [_, (poses, _)] = moved(&problem, &step, true);
        assert_eq!(poses[0], problem.values.slice::<Rigid3>(0)[0]);
        assert_ne!(poses[1], problem.values.slice::<Rigid3>(0)[1]);
    }

    /// Poses 0 and 2 see most in common, 3 sees as much of 2 as of 0 and hangs on the later one, 7 sees points that no other does; 1 holds still,
    /// and 4 with it.
    #[test]
    fn the_heaviest_pairs_carry() {
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
        let carriers = Carriers::new(&sights, |pose| pose == 1);
        assert_eq!(carriers.poses, [(4, 1), (0, 4), (2, 0), (3, 2)]);
        assert_eq!(carriers.point(0), Some(0));
        assert_eq!(carriers.point(12), Some(0));
        assert_eq!(carriers.point(13), Some(7));
        assert_eq!(carriers.point(17), None);
    }
}
