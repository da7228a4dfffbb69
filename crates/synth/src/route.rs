//! The centre line of the street: straight lines and circular arcs, joined without kinks.
//!
//! Lines and arcs have a closed form both ways, from an arc length to a point and from a point to
//! (arc length, lateral offset), so that the vehicle, the buildings and the paint on the road share
//! one exact centre line.

use tiepoint_geometry::{Rng, nalgebra::Vector2};

use crate::error::{Error, require};

/// Turns of a street corner have radii in this range, in metres: of the centre line, so that the
/// inner lane stays drivable.
const TURN_RADIUS_M: [f64; 2] = [10.0, 14.0];
/// Radius of a gentle bend within a block, in metres.
const BEND_RADIUS_M: f64 = 60.0;
/// A side longer than this, in metres, gets a gentle bend.
const BEND_MIN_SIDE_M: f64 = 120.0;
/// How far a bend displaces the middle of its side, in metres.
const BEND_OFFSET_M: [f64; 2] = [3.0, 8.0];
/// Blocks of an open street, in metres.
const BLOCK_M: [f64; 2] = [70.0, 140.0];

/// A line (curvature 0) or an arc (positive curvature turns left).
#[derive(Clone, Copy, Debug)]
struct Piece {
    start: Vector2<f64>,
    heading_rad: f64,
    curvature_per_m: f64,
    length_m: f64,
    /// Arc length of the route where it begins.
    offset_m: f64,
    /// Directions at its beginning, half-way and at its end.
    direction: Vector2<f64>,
    middle_direction: Vector2<f64>,
    end_direction: Vector2<f64>,
}

/// A place relative to the centre line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoutePosition {
    /// Arc length of the nearest point of the centre line, in metres.
    pub along_m: f64,
    /// Distance from it, in metres, positive to the left.
    pub left_m: f64,
}

/// The centre line of a street, seen from above (x east, y north).
#[derive(Clone, Debug)]
pub struct Route {
    pieces: Vec<Piece>,
    length_m: f64,
    is_closed: bool,
}

fn unit(heading_rad: f64) -> Vector2<f64> {
    Vector2::new(heading_rad.cos(), heading_rad.sin())
}

fn left_of(direction: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-direction.y, direction.x)
}

fn in_range(rng: &mut Rng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.uniform()
}

impl Piece {
    fn heading_at(&self, s: f64) -> f64 {
        self.heading_rad + self.curvature_per_m * s
    }

    fn point_at(&self, s: f64) -> Vector2<f64> {
        // The chord of an arc: length s·sinc(κs/2), direction half-way.
        let half = 0.5 * self.curvature_per_m * s;
        let sinc = if half.abs() < 1e-9 { 1.0 } else { half.sin() / half };
        self.start + unit(self.heading_rad + half) * (s * sinc)
    }

    /// Nearest point of the piece, the direction there, and the distance from it.
    fn foot(&self, point: Vector2<f64>) -> (RoutePosition, Vector2<f64>, f64) {
        let from_start = point - self.start;
        let mut tangent = self.direction;
        let s = if self.curvature_per_m == 0.0 {
            from_start.dot(&tangent)
        } else {
            // On a circle the direction there is at right angles to the radius; the angle from the
            // arc's middle does not wrap.
            let radius = 1.0 / self.curvature_per_m;
            let from_centre = (from_start - left_of(self.direction) * radius) * radius.signum();
            tangent = left_of(from_centre) / from_centre.norm();
            let from_middle =
                self.middle_direction.perp(&tangent).atan2(self.middle_direction.dot(&tangent));
            0.5 * self.length_m + from_middle * radius
        };
        let is_beyond = !(0.0..=self.length_m).contains(&s);
        let s = s.clamp(0.0, self.length_m);
        if is_beyond {
            tangent = if s == 0.0 { self.direction } else { self.end_direction };
        }
        let offset = point - self.point_at_towards(s, tangent);
        let distance = offset.norm();
        let left_m = if tangent.perp(&offset) < 0.0 { -distance } else { distance };
        (RoutePosition { along_m: self.offset_m + s, left_m }, tangent, distance)
    }

    /// `point_at(s)`, where the direction is known to be `tangent`.
    fn point_at_towards(&self, s: f64, tangent: Vector2<f64>) -> Vector2<f64> {
        if self.curvature_per_m == 0.0 {
            return self.start + self.direction * s;
        }
        // p' = t, t' = κ n: the point is the start plus the change of −n over κ.
        self.start + (left_of(self.direction) - left_of(tangent)) / self.curvature_per_m
    }
}

impl Route {
    /// Through corners, each cut by an arc of its radius (metres). A closed route begins in the
    /// middle of the side from the last corner to the first; the first and last corner of an open
    /// one are its ends.
    pub fn from_corners(corners: &[(Vector2<f64>, f64)], is_closed: bool) -> Result<Self, Error> {
        let count = corners.len();
        let least = if is_closed { 3 } else { 2 };
        require(
            count >= least,
            "number of corners",
            count as f64,
            "at least 3 for a loop, 2 for a street",
        )?;
        let mut route = Self { pieces: Vec::new(), length_m: 0.0, is_closed };
        let at = |index: usize| corners[index % count].0;
        let turn = |index: usize| {
            let before = at(index) - at(index + count - 1);
            let after = at(index + 1) - at(index);
            before.perp(&after).atan2(before.dot(&after))
        };
        let is_end = |index: usize| !is_closed && (index == 0 || index + 1 == count);
        // Length of the side that a corner's arc takes away.
        let cut = |index: usize| {
            if is_end(index) { 0.0 } else { corners[index].1 * (0.5 * turn(index)).tan().abs() }
        };
        let sides = if is_closed { count } else { count - 1 };
        for corner in 0..sides {
            let next = (corner + 1) % count;
            let (distance_m, needed_m) = ((at(next) - at(corner)).norm(), cut(corner) + cut(next));
            if distance_m <= needed_m {
                return Err(Error::CornersTooClose { corner, distance_m, needed_m });
            }
        }
        let first = if is_closed { 0.5 * (at(count - 1) + at(0)) } else { at(0) };
        let mut position = first;
        for (corner, &(vertex, radius)) in corners.iter().enumerate().skip(usize::from(!is_closed))
        {
            let direction = (vertex - position).normalize();
            let heading_rad = direction.y.atan2(direction.x);
            route.push(position, heading_rad, 0.0, (vertex - position).norm() - cut(corner));
            position = vertex - direction * cut(corner);
            if !is_end(corner) && turn(corner) != 0.0 {
                let angle = turn(corner);
                route.push(position, heading_rad, angle.signum() / radius, radius * angle.abs());
                position = vertex + unit(heading_rad + angle) * cut(corner);
            }
        }
        if is_closed {
            let direction = first - position;
            route.push(position, direction.y.atan2(direction.x), 0.0, direction.norm());
        }
        Ok(route)
    }

    /// A loop of about `length_m` around a block: a quadrangle, gently bent where its sides are
    /// long; in either sense.
    pub fn street_loop(length_m: f64, rng: &mut Rng) -> Result<Self, Error> {
        require(length_m >= 160.0, "loop length_m", length_m, "at least 160 m")?;
        let aspect = in_range(rng, [0.75, 1.35]);
        let width = 0.5 * length_m * aspect / (1.0 + aspect);
        let height = 0.5 * length_m - width;
        let slack = 0.04 * width.min(height);
        let mut corners = Vec::new();
        for (x, y) in [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)] {
            let shift =
                Vector2::new(in_range(rng, [-slack, slack]), in_range(rng, [-slack, slack]));
            corners.push(Vector2::new(x * width, y * height) + shift);
        }
        if rng.below(2) == 1 {
            corners.reverse();
        }
        let radii: Vec<f64> = (0..4).map(|_| in_range(rng, TURN_RADIUS_M)).collect();
        let mut bent = Vec::new();
        for index in 0..4 {
            bent.push((corners[index], radii[index]));
            bent.extend(bend(corners[index], corners[(index + 1) % 4], rng));
        }
        Self::from_corners(&bent, true)
    }

    /// A street of about `length_m` that never comes back: blocks eastwards, northwards and
    /// southwards.
    pub fn open_street(length_m: f64, rng: &mut Rng) -> Result<Self, Error> {
        require(length_m >= 40.0, "street length_m", length_m, "at least 40 m")?;
        let mut corners = vec![(Vector2::zeros(), 0.0)];
        let (mut position, mut left, mut is_eastwards) = (Vector2::zeros(), length_m, true);
        while left > 0.0 {
            // No rest shorter than a block: its turn would not fit.
            let block = in_range(rng, BLOCK_M);
            let block = if left < block + BLOCK_M[0] { left } else { block };
            let tilt = in_range(rng, [-0.12, 0.12]);
            let side = if rng.below(2) == 0 { 1.0 } else { -1.0 };
            let heading =
                if is_eastwards { tilt } else { side * std::f64::consts::FRAC_PI_2 + tilt };
            let end = position + unit(heading) * block;
            corners.extend(bend(position, end, rng));
            corners.push((end, in_range(rng, TURN_RADIUS_M)));
            (position, left, is_eastwards) = (end, left - block, !is_eastwards);
        }
        Self::from_corners(&corners, false)
    }

    fn push(&mut self, start: Vector2<f64>, heading_rad: f64, curvature_per_m: f64, length_m: f64) {
        let middle_rad = heading_rad + 0.5 * curvature_per_m * length_m;
        let (direction, middle_direction) = (unit(heading_rad), unit(middle_rad));
        let offset_m = self.length_m;
        self.pieces.push(Piece {
            start,
            heading_rad,
            curvature_per_m,
            length_m,
            offset_m,
            direction,
            middle_direction,
            end_direction: unit(heading_rad + curvature_per_m * length_m),
        });
        self.length_m += length_m;
    }

    /// Length, in metres.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Whether its end is its beginning.
    pub fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// The piece at an arc length, and the arc length from its beginning. A loop goes round; an
    /// open street goes on straight beyond its ends.
    fn piece_at(&self, along_m: f64) -> (&Piece, f64) {
        let s = if self.is_closed { along_m.rem_euclid(self.length_m) } else { along_m };
        let index = self.pieces.partition_point(|piece| piece.offset_m <= s).max(1) - 1;
        (&self.pieces[index], s - self.pieces[index].offset_m)
    }

    /// The point of the centre line at an arc length.
    pub fn point(&self, along_m: f64) -> Vector2<f64> {
        let (piece, s) = self.piece_at(along_m);
        piece.point_at(s)
    }

    /// The point at an arc length and a lateral offset (positive to the left).
    pub fn point_beside(&self, position: RoutePosition) -> Vector2<f64> {
        self.point(position.along_m)
            + left_of(unit(self.heading_rad(position.along_m))) * position.left_m
    }

    /// The heading at an arc length, from east towards north.
    pub fn heading_rad(&self, along_m: f64) -> f64 {
        let (piece, s) = self.piece_at(along_m);
        piece.heading_at(s)
    }

    /// The curvature at an arc length, positive to the left.
    pub fn curvature_per_m(&self, along_m: f64) -> f64 {
        self.piece_at(along_m).0.curvature_per_m
    }

    /// Where a point lies relative to the centre line.
    pub fn locate(&self, point: Vector2<f64>) -> RoutePosition {
        self.foot(point, 0..self.pieces.len()).0
    }

    /// The same among some pieces only, with the direction of the centre line there.
    pub(crate) fn foot(
        &self,
        point: Vector2<f64>,
        pieces: impl IntoIterator<Item = usize>,
    ) -> (RoutePosition, Vector2<f64>) {
        let mut best =
            (RoutePosition { along_m: 0.0, left_m: f64::INFINITY }, Vector2::x(), f64::INFINITY);
        for index in pieces {
            let found = self.pieces[index].foot(point);
            if found.2 < best.2 {
                best = found;
            }
        }
        (best.0, best.1)
    }

    /// Distance from a point to each piece.
    pub(crate) fn piece_distances(&self, point: Vector2<f64>) -> impl Iterator<Item = f64> {
        self.pieces.iter().map(move |piece| piece.foot(point).2)
    }
}

/// The middle of a long side, moved sideways.
fn bend(from: Vector2<f64>, to: Vector2<f64>, rng: &mut Rng) -> Option<(Vector2<f64>, f64)> {
    let side = if rng.below(2) == 0 { 1.0 } else { -1.0 };
    let offset = side * in_range(rng, BEND_OFFSET_M);
    let along = to - from;
    (along.norm() > BEND_MIN_SIDE_M)
        .then(|| (0.5 * (from + to) + left_of(along.normalize()) * offset, BEND_RADIUS_M))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tiepoint_geometry::Rng;

    /// Lengths of metres in double precision, over a few hundred operations.
    const CLOSE_M: f64 = 1e-9;

    proptest! {
        #[test]
        fn the_line_has_no_kink_and_locates_its_own_points(
            seed in 0u64..1000,
            is_loop: bool,
            fraction in 0.0..1.0,
            left_m in -7.0..7.0,
        ) {
            let mut rng = Rng::stream(seed, &[1]);
            let route = if is_loop {
                Route::street_loop(400.0, &mut rng)
            } else {
                Route::open_street(400.0, &mut rng)
            };
            let route = route.unwrap();
            for pair in route.pieces.windows(2) {
                prop_assert!((pair[0].point_at(pair[0].length_m) - pair[1].start).norm() < CLOSE_M);
                let kink = pair[0].heading_at(pair[0].length_m) - pair[1].heading_rad;
                prop_assert!((unit(kink) - unit(0.0)).norm() < CLOSE_M);
            }
            if is_loop {
                prop_assert!((route.point(route.length_m()) - route.point(0.0)).norm() < CLOSE_M);
            }
            let position = RoutePosition { along_m: fraction * route.length_m(), left_m };
            let found = route.locate(route.point_beside(position));
            prop_assert!((found.left_m - left_m).abs() < 1e-6, "{found:?} {position:?}");
            let gap = (found.along_m - position.along_m).abs();
            prop_assert!(gap.min(route.length_m() - gap) < 1e-6, "{found:?} {position:?}");
        }
    }

    #[test]
    fn turns_that_do_not_fit_are_refused() {
        let corners = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
            .map(|(x, y)| (Vector2::new(x, y), 6.0));
        assert!(matches!(Route::from_corners(&corners, true), Err(Error::CornersTooClose { .. })));
    }
}
