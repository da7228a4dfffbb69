//! Layout of a street along a route: houses in rows or apart, gardens between them, trees, lamps
//! and parked cars.

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};

use super::builder::{Block, Builder, on_ground};
use super::building::{Style, house};
use super::furniture::{CAR_LENGTH_M, car, hedge, in_range, lamp, street_sign, tree};
use super::ground::{KERB_M, PAVEMENT_M};
use super::options::StreetOptions;
use crate::route::{Route, RoutePosition};

/// Smallest distance of houses from the centre line, in metres.
const CLEARANCE_M: f64 = PAVEMENT_M + 0.1;
/// Candidate depths of a house, in metres.
const DEPTHS_M: [f64; 4] = [12.0, 10.0, 8.0, 6.0];
/// Candidate setbacks of a house behind the building line, in metres.
const SETBACKS_M: [f64; 3] = [0.0, 1.5, 3.5];
/// Range of the distance of the second row of taller houses from the centre line, in metres.
const SECOND_ROW_M: [f64; 2] = [38.0, 75.0];
/// Ranges of the distance of hedges and trees from the centre line of a highway, which ends before
/// the second row, and of the distance along it from one object to the next, in metres.
const ROADSIDE_M: [f64; 2] = [13.0, 33.0];
const ROADSIDE_STEP_M: [f64; 2] = [8.0, 26.0];
/// Signs of the sides of the street: positive is left.
const SIDES: [f64; 2] = [-1.0, 1.0];

/// A rectangular lot in the plane: its front left corner as seen from the street, the unit vector
/// to the right, width and depth in metres.
#[derive(Clone, Copy, Debug)]
struct Lot {
    corner: Vector2<f64>,
    right: Vector2<f64>,
    size: [f64; 2],
}

impl Lot {
    /// Unit vector towards the street.
    fn out(&self) -> Vector2<f64> {
        Vector2::new(self.right.y, -self.right.x)
    }

    fn at(&self, right: f64, back: f64) -> Vector2<f64> {
        self.corner + self.right * right - self.out() * back
    }

    fn corners(&self) -> [Vector2<f64>; 4] {
        let [width, depth] = self.size;
        [self.at(0.0, 0.0), self.at(width, 0.0), self.at(width, depth), self.at(0.0, depth)]
    }

    /// Whether two lots overlap: no axis of either separates them (separating axis theorem). Lots
    /// that touch do not overlap.
    fn overlaps(&self, other: &Lot) -> bool {
        let range = |lot: &Lot, axis: Vector2<f64>| {
            let along = lot.corners().map(|corner| corner.dot(&axis));
            (
                along.into_iter().fold(f64::INFINITY, f64::min),
                along.into_iter().fold(f64::NEG_INFINITY, f64::max),
            )
        };
        [self.right, self.out(), other.right, other.out()].into_iter().all(|axis| {
            let ((low, high), (other_low, other_high)) = (range(self, axis), range(other, axis));
            low < other_high - 0.05 && other_low < high - 0.05
        })
    }

    /// Whether the lot is beside the street everywhere.
    fn is_clear_of(&self, route: &Route) -> bool {
        let [width, depth] = self.size;
        let steps = |length: f64| (length / 2.0).ceil() as usize;
        (0..=steps(width)).all(|i| {
            (0..=steps(depth)).all(|j| {
                let place = self.at(
                    width * i as f64 / steps(width) as f64,
                    depth * j as f64 / steps(depth) as f64,
                );
                route.locate(place).left_m.abs() > CLEARANCE_M
            })
        })
    }

    fn block(&self) -> Block {
        let [width, depth] = self.size;
        Block {
            corner: on_ground(self.corner, 0.0),
            right: on_ground(self.right, 0.0),
            out: on_ground(self.out(), 0.0),
            size: [width, depth, 0.0],
        }
    }
}

/// A lot of `width_m` beside the route with its front parallel to the street; `left_m` is the
/// lateral offset of the front.
fn lot_beside(route: &Route, along_m: f64, left_m: f64, width_m: f64) -> Lot {
    let ends = [along_m, along_m + width_m]
        .map(|along_m| route.point_beside(RoutePosition { along_m, left_m }));
    // Seen from the street, the route runs to the right on its left side, and to the left on its
    // right side.
    let [corner, end] = if left_m > 0.0 { ends } else { [ends[1], ends[0]] };
    let across = end - corner;
    Lot { corner, right: across.normalize(), size: [across.norm(), 0.0] }
}

pub(super) fn build(route: &Route, options: &StreetOptions, seed: u64) -> Builder {
    let mut world = Builder::default();
    let mut lots: Vec<Lot> = Vec::new();
    for (index, side) in SIDES.into_iter().enumerate() {
        houses(
            &mut world,
            &mut lots,
            route,
            side,
            options,
            &mut Rng::stream(seed, &[1, index as u64]),
        );
    }
    for (index, side) in SIDES.into_iter().enumerate() {
        second_row(&mut world, &mut lots, route, side, &mut Rng::stream(seed, &[2, index as u64]));
        street_objects(
            &mut world,
            &lots,
            route,
            side,
            options,
            &mut Rng::stream(seed, &[3, index as u64]),
        );
    }
    world
}

/// A highway: sparse lamps, hedges and trees beside it, houses in the distance.
pub(super) fn build_highway(route: &Route, seed: u64) -> Builder {
    let (mut world, mut lots) = (Builder::default(), Vec::new());
    for (index, side) in SIDES.into_iter().enumerate() {
        second_row(&mut world, &mut lots, route, side, &mut Rng::stream(seed, &[2, index as u64]));
        let rng = &mut Rng::stream(seed, &[3, index as u64]);
        let mut along_m = in_range(rng, 0.0, ROADSIDE_STEP_M[1]);
        while along_m < route.length_m() {
            let heading = route.heading_rad(along_m);
            let mut place = |model: &Builder, left_m: f64, yaw_rad: f64| {
                let position = RoutePosition { along_m, left_m: side * left_m };
                world.place(model, yaw_rad, on_ground(route.point_beside(position), 0.0));
            };
            let far_m = in_range(rng, ROADSIDE_M[0], ROADSIDE_M[1]);
            match rng.below(4) {
                0 => {
                    let inwards = heading - side * std::f64::consts::FRAC_PI_2;
                    place(&lamp(rng), PAVEMENT_M, inwards);
                }
                1 => place(&hedge(in_range(rng, 4.0, 9.0), rng), far_m, heading),
                _ => place(&tree(rng), far_m, in_range(rng, 0.0, 6.0)),
            }
            along_m += in_range(rng, ROADSIDE_STEP_M[0], ROADSIDE_STEP_M[1]);
        }
    }
    world
}

fn houses(
    world: &mut Builder,
    lots: &mut Vec<Lot>,
    route: &Route,
    side: f64,
    options: &StreetOptions,
    rng: &mut Rng,
) {
    let mut along = 0.0;
    let (mut style, mut width, mut repeats) = (Style::sample(rng), 10.0, 0);
    let mut setback = 0.0;
    while along < route.length_m() {
        if repeats == 0 {
            style = Style::sample(rng);
            width = in_range(rng, 7.0, 16.0);
            setback = if rng.below(3) == 0 { in_range(rng, 0.5, 3.0) } else { 0.0 };
            let is_terrace = rng.uniform() < options.repeated_fraction;
            (repeats, width) =
                if is_terrace { (3 + rng.below(4), width.min(9.0)) } else { (1, width) };
        }
        // In a bend the middle of the front is nearer to the street than its ends: a house further
        // back may fit.
        let fits = SETBACKS_M
            .into_iter()
            .flat_map(|more| DEPTHS_M.map(|depth| (more, depth)))
            .find_map(|(more, depth)| {
                let mut lot =
                    lot_beside(route, along, side * (CLEARANCE_M + 0.1 + setback + more), width);
                lot.size[1] = depth;
                let is_free =
                    lot.is_clear_of(route) && !lots.iter().any(|other| lot.overlaps(other));
                is_free.then_some(lot)
            });
        match fits {
            Some(lot) => {
                house(world, &lot.block(), style);
                lots.push(lot);
                repeats -= 1;
                // In a bend the front is longer or shorter than the arc length along the centre
                // line.
                let gap = if repeats == 0 && rng.uniform() < options.gap_fraction {
                    in_range(rng, 2.5, 9.0)
                } else {
                    0.0
                };
                along += width + gap;
            }
            None => along += 1.5,
        }
    }
}

/// Adds taller houses behind the first row where there is room, on one side of the route: `side` is
/// 1 for left and −1 for right.
fn second_row(world: &mut Builder, lots: &mut Vec<Lot>, route: &Route, side: f64, rng: &mut Rng) {
    let mut along = 0.0;
    while along < route.length_m() {
        let width = in_range(rng, 14.0, 30.0);
        let mut lot =
            lot_beside(route, along, side * in_range(rng, SECOND_ROW_M[0], SECOND_ROW_M[1]), width);
        lot.size = [width, in_range(rng, 10.0, 20.0)];
        if lot.is_clear_of(route) && !lots.iter().any(|other| lot.overlaps(other)) {
            let style = Style { floors: 3 + rng.below(6) as i32, ..Style::sample(rng) };
            house(world, &lot.block(), style);
            lots.push(lot);
        }
        along += width + in_range(rng, 5.0, 30.0);
    }
}

/// Places objects on the pavement and the parking strip, and gardens in the gaps between houses.
fn street_objects(
    world: &mut Builder,
    lots: &[Lot],
    route: &Route,
    side: f64,
    options: &StreetOptions,
    rng: &mut Rng,
) {
    let place = |along_m: f64, left_m: f64| {
        let position = RoutePosition { along_m, left_m: side * left_m };
        (on_ground(route.point_beside(position), 0.0), route.heading_rad(along_m))
    };
    let is_straight = |along: f64| {
        [-4.0, 0.0, 4.0].iter().all(|step| route.curvature_per_m(along + step).abs() < 0.05)
    };
    // Cars park in the bays that the ground texture shows, every 6.2 m.
    let mut bay = 0.0;
    while bay + 6.2 < route.length_m() {
        let middle = bay + 3.1 + in_range(rng, -0.4, 0.4);
        let is_taken = rng.uniform() < options.parked_fraction;
        let left = 0.5 * (3.6 + KERB_M) + in_range(rng, -0.1, 0.1);
        // Cars on the left side have the opposite heading.
        let turn = if side > 0.0 { std::f64::consts::PI } else { 0.0 } + in_range(rng, -0.03, 0.03);
        let model = car(rng);
        let beyond_end = bay < CAR_LENGTH_M && !route.is_closed();
        if is_taken && is_straight(middle) && !beyond_end {
            let (at, heading) = place(middle, left);
            world.place(&model, heading + turn, at);
        }
        bay += 6.2;
    }
    let mut along = in_range(rng, 2.0, 8.0);
    while along < route.length_m() {
        let (at, heading) = place(along, KERB_M + in_range(rng, 0.5, 0.9));
        let inwards = heading - side * std::f64::consts::FRAC_PI_2;
        match rng.below(5) {
            0 => world.place(&lamp(rng), inwards, at),
            1 => world.place(
                &street_sign(rng),
                heading + if side > 0.0 { std::f64::consts::PI } else { 0.0 },
                at,
            ),
            _ if rng.uniform() < options.tree_fraction => {
                world.place(&tree(rng), in_range(rng, 0.0, 6.0), at)
            }
            _ => {}
        }
        along += in_range(rng, 5.0, 11.0);
    }
    // Gardens: hedges along the pavement between houses, and trees behind them.
    let is_free = |point: Vector3<f64>, radius: f64| {
        // The front of a lot faces −y if its right is +x.
        let corner = point.xy() - Vector2::repeat(radius);
        let probe = Lot { corner, right: Vector2::x(), size: [2.0 * radius, 2.0 * radius] };
        route.locate(point.xy()).left_m.abs() > PAVEMENT_M
            && !lots.iter().any(|lot| lot.overlaps(&probe))
    };
    let mut along = 0.0;
    while along < route.length_m() {
        let length = in_range(rng, 2.0, 4.0);
        let (at, heading) = place(along, PAVEMENT_M + 0.8);
        let (end, _) = place(along + length, PAVEMENT_M + 0.8);
        let (model, deep) = (hedge(length, rng), tree(rng));
        if is_straight(along) && is_free(at, 0.5) && is_free(end, 0.5) {
            world.place(&model, heading, at);
        }
        let (back, _) = place(along, in_range(rng, PAVEMENT_M + 4.0, PAVEMENT_M + 16.0));
        if rng.below(3) == 0 && is_free(back, 2.0) {
            world.place(&deep, in_range(rng, 0.0, 6.0), back);
        }
        along += length;
    }
}
