//! The centre line of the street: line segments and circular arcs with continuous direction.
//!
//! Lines and arcs have closed forms from an arc length to a point, and from a point to arc length
//! and lateral offset. The vehicle, the buildings and the road markings therefore share one exact
//! centre line.

use tiepoint_geometry::{Rng, nalgebra::Vector2};

use crate::error::{Error, require};

/// Range of the radii of street corners, in metres, at the centre line: the inner lane stays
/// drivable.
const TURN_RADIUS_M: [f64; 2] = [10.0, 14.0];
/// Radius of a gentle bend within a block, in metres.
const BEND_RADIUS_M: f64 = 60.0;
/// Sides longer than this, in metres, get a gentle bend.
const BEND_MIN_SIDE_M: f64 = 120.0;
/// Range of the lateral displacement of the middle of a side by a bend, in metres.
const BEND_OFFSET_M: [f64; 2] = [3.0, 8.0];
/// Range of the lengths of the blocks of an open street, in metres.
const BLOCK_M: [f64; 2] = [70.0, 140.0];
/// Strips of a flight over a street, in metres: their distance, the radius of their turns, and how
/// far they reach beyond the centre line.
const STRIP_M: f64 = 20.0;
const STRIP_TURN_M: f64 = 8.0;
const STRIP_MARGIN_M: f64 = 15.0;

/// A segment of the route: a line (curvature 0) or an arc (positive curvature turns left).
#[derive(Clone, Copy, Debug)]
struct Segment {
    start: Vector2<f64>,
    heading_rad: f64,
    curvature_per_m: f64,
    length_m: f64,
    /// Arc length of the route at its beginning, in metres.
    offset_m: f64,
    /// Unit tangents at its beginning, middle and end.
    direction: Vector2<f64>,
    middle_direction: Vector2<f64>,
    end_direction: Vector2<f64>,
}

/// A position relative to the centre line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoutePosition {
    /// Arc length of the nearest point of the centre line, in metres.
    pub along_m: f64,
    /// Lateral offset from the centre line, in metres, positive to the left.
    pub left_m: f64,
}

/// The centre line of a street in the plane (x east, y north), in metres.
#[derive(Clone, Debug)]
pub struct Route {
    segments: Vec<Segment>,
    length_m: f64,
    is_closed: bool,
}

fn unit_vector(heading_rad: f64) -> Vector2<f64> {
    Vector2::new(heading_rad.cos(), heading_rad.sin())
}

fn left_of(direction: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-direction.y, direction.x)
}

fn uniform_in(rng: &mut Rng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.uniform()
}

impl Segment {
    fn heading_at(&self, s: f64) -> f64 {
        self.heading_rad + self.curvature_per_m * s
    }

    fn point_at(&self, s: f64) -> Vector2<f64> {
        // The chord of an arc of curvature κ has length s·sinc(κs/2) and the direction at its
        // middle.
        let half = 0.5 * self.curvature_per_m * s;
        let sinc = if half.abs() < 1e-9 { 1.0 } else { half.sin() / half };
        self.start + unit_vector(self.heading_rad + half) * (s * sinc)
    }

    /// Nearest point of the segment, the tangent there, and the distance to it.
    fn closest_point(&self, point: Vector2<f64>) -> (RoutePosition, Vector2<f64>, f64) {
        let from_start = point - self.start;
        let mut tangent = self.direction;
        let s = if self.curvature_per_m == 0.0 {
            from_start.dot(&tangent)
        } else {
            // The tangent of a circle is perpendicular to the radius; the angle from the middle of
            // the arc does not wrap.
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

    /// `point_at(s)` for a known tangent at s.
    fn point_at_towards(&self, s: f64, tangent: Vector2<f64>) -> Vector2<f64> {
        if self.curvature_per_m == 0.0 {
            return self.start + self.direction * s;
        }
        // p' = t, t' = κ n: the point is the start plus the change of −n divided by κ.
        self.start + (left_of(self.direction) - left_of(tangent)) / self.curvature_per_m
    }
}

impl Route {
    /// A route through corners (metres), each replaced by an arc of its radius (metres). A closed
    /// route begins in the middle of the side from the last corner to the first; the first and the
    /// last corner of an open route are its ends.
    ///
    /// # Errors
    ///
    /// [`Error::OutOfRange`] for too few corners, [`Error::CornersTooClose`] if the arcs of two
    /// corners overlap.
    pub fn from_corners(corners: &[(Vector2<f64>, f64)], is_closed: bool) -> Result<Self, Error> {
        let count = corners.len();
        let least = if is_closed { 3 } else { 2 };
        require(
            count >= least,
            "number of corners",
            count as f64,
            "at least 3 for a loop, 2 for a street",
        )?;
        let mut route = Self { segments: Vec::new(), length_m: 0.0, is_closed };
        let at = |index: usize| corners[index % count].0;
        let turn = |index: usize| {
            let before = at(index) - at(index + count - 1);
            let after = at(index + 1) - at(index);
            before.perp(&after).atan2(before.dot(&after))
        };
        let is_end = |index: usize| !is_closed && (index == 0 || index + 1 == count);
        // Length of a side that the arc of a corner replaces.
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
                position = vertex + unit_vector(heading_rad + angle) * cut(corner);
            }
        }
        if is_closed {
            let direction = first - position;
            route.push(position, direction.y.atan2(direction.x), 0.0, direction.norm());
        }
        Ok(route)
    }

    /// A loop of about `length_m` around a block: a quadrangle with random orientation and with
    /// bends in long sides.
    ///
    /// # Errors
    ///
    /// [`Error::OutOfRange`] if the loop is shorter than 160 m.
    pub fn street_loop(length_m: f64, rng: &mut Rng) -> Result<Self, Error> {
        require(length_m >= 160.0, "loop length_m", length_m, "at least 160 m")?;
        let aspect = uniform_in(rng, [0.75, 1.35]);
        let width = 0.5 * length_m * aspect / (1.0 + aspect);
        let height = 0.5 * length_m - width;
        let max_shift = 0.04 * width.min(height);
        let mut corners = Vec::new();
        for (x, y) in [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)] {
            let shift = Vector2::new(
                uniform_in(rng, [-max_shift, max_shift]),
                uniform_in(rng, [-max_shift, max_shift]),
            );
            corners.push(Vector2::new(x * width, y * height) + shift);
        }
        if rng.below(2) == 1 {
            corners.reverse();
        }
        let radii: Vec<f64> = (0..4).map(|_| uniform_in(rng, TURN_RADIUS_M)).collect();
        let mut bent = Vec::new();
        for index in 0..4 {
            bent.push((corners[index], radii[index]));
            bent.extend(bend(corners[index], corners[(index + 1) % 4], rng));
        }
        Self::from_corners(&bent, true)
    }

    /// A street of about `length_m` without a loop: blocks to the east, north and south.
    ///
    /// # Errors
    ///
    /// [`Error::OutOfRange`] if the street is shorter than 40 m.
    pub fn open_street(length_m: f64, rng: &mut Rng) -> Result<Self, Error> {
        require(length_m >= 40.0, "street length_m", length_m, "at least 40 m")?;
        let mut corners = vec![(Vector2::zeros(), 0.0)];
        let (mut position, mut left, mut is_eastwards) = (Vector2::zeros(), length_m, true);
        while left > 0.0 {
            // The last block is not shorter than the others: its turn would not fit.
            let block = uniform_in(rng, BLOCK_M);
            let block = if left < block + BLOCK_M[0] { left } else { block };
            let tilt = uniform_in(rng, [-0.12, 0.12]);
            let side = if rng.below(2) == 0 { 1.0 } else { -1.0 };
            let heading =
                if is_eastwards { tilt } else { side * std::f64::consts::FRAC_PI_2 + tilt };
            let end = position + unit_vector(heading) * block;
            corners.extend(bend(position, end, rng));
            corners.push((end, uniform_in(rng, TURN_RADIUS_M)));
            (position, left, is_eastwards) = (end, left - block, !is_eastwards);
        }
        Self::from_corners(&corners, false)
    }

    /// A straight highway of `length_m` to the east.
    ///
    /// # Errors
    ///
    /// [`Error::OutOfRange`] if the highway is shorter than 40 m.
    pub fn highway(length_m: f64) -> Result<Self, Error> {
        require(length_m >= 40.0, "highway length_m", length_m, "at least 40 m")?;
        Self::from_corners(&[(Vector2::zeros(), 0.0), (Vector2::new(length_m, 0.0), 0.0)], false)
    }

    /// Parallel strips to and fro above another route, as in a survey by air.
    ///
    /// # Errors
    ///
    /// None that is known: the error of [`Route::from_corners`].
    pub(crate) fn strips_over(street: &Self) -> Result<Self, Error> {
        let (low, high) = street.bounds();
        let (first, last) = (low.x - STRIP_MARGIN_M, high.x + STRIP_MARGIN_M);
        let strips = ((high.y - low.y) / STRIP_M).ceil() as usize + 2;
        let margin = 0.5 * ((strips - 1) as f64 * STRIP_M - (high.y - low.y));
        let corners: Vec<_> = (0..strips)
            .flat_map(|strip| {
                let y = low.y - margin + strip as f64 * STRIP_M;
                let [from, to] = if strip % 2 == 0 { [first, last] } else { [last, first] };
                [from, to].map(|x| (Vector2::new(x, y), STRIP_TURN_M))
            })
            .collect();
        Self::from_corners(&corners, false)
    }

    /// Corners of a rectangle around the centre line, to within 2 m.
    pub(crate) fn bounds(&self) -> (Vector2<f64>, Vector2<f64>) {
        let points = (0..=self.length_m as usize / 4).map(|k| self.point(4.0 * k as f64));
        let none = Vector2::repeat(f64::INFINITY);
        points.fold((none, -none), |(low, high), point| (low.inf(&point), high.sup(&point)))
    }

    /// Appends a segment; its arc length begins at the current length of the route.
    fn push(&mut self, start: Vector2<f64>, heading_rad: f64, curvature_per_m: f64, length_m: f64) {
        let middle_rad = heading_rad + 0.5 * curvature_per_m * length_m;
        let (direction, middle_direction) = (unit_vector(heading_rad), unit_vector(middle_rad));
        let offset_m = self.length_m;
        self.segments.push(Segment {
            start,
            heading_rad,
            curvature_per_m,
            length_m,
            offset_m,
            direction,
            middle_direction,
            end_direction: unit_vector(heading_rad + curvature_per_m * length_m),
        });
        self.length_m += length_m;
    }

    /// Length in metres.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Whether the route is a loop.
    pub fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// The segment at an arc length, and the arc length from its beginning. A loop wraps around; an
    /// open street continues straight beyond its ends.
    fn segment_at(&self, along_m: f64) -> (&Segment, f64) {
        let s = if self.is_closed { along_m.rem_euclid(self.length_m) } else { along_m };
        let index = self.segments.partition_point(|segment| segment.offset_m <= s).max(1) - 1;
        (&self.segments[index], s - self.segments[index].offset_m)
    }

    /// The point of the centre line at an arc length, in metres.
    pub fn point(&self, along_m: f64) -> Vector2<f64> {
        let (segment, s) = self.segment_at(along_m);
        segment.point_at(s)
    }

    /// The point at an arc length and a lateral offset, in metres.
    pub fn point_beside(&self, position: RoutePosition) -> Vector2<f64> {
        self.point(position.along_m)
            + left_of(unit_vector(self.heading_rad(position.along_m))) * position.left_m
    }

    /// The heading at an arc length: the angle from east towards north, in radians.
    pub fn heading_rad(&self, along_m: f64) -> f64 {
        let (segment, s) = self.segment_at(along_m);
        segment.heading_at(s)
    }

    /// The curvature at an arc length, in 1/m, positive to the left.
    pub fn curvature_per_m(&self, along_m: f64) -> f64 {
        self.segment_at(along_m).0.curvature_per_m
    }

    /// The position of a point relative to the centre line.
    pub fn locate(&self, point: Vector2<f64>) -> RoutePosition {
        self.closest_point(point, 0..self.segments.len()).0
    }

    /// The position of a point relative to some segments, and the tangent at the nearest point.
    pub(crate) fn closest_point(
        &self,
        point: Vector2<f64>,
        segments: impl IntoIterator<Item = usize>,
    ) -> (RoutePosition, Vector2<f64>) {
        let mut best =
            (RoutePosition { along_m: 0.0, left_m: f64::INFINITY }, Vector2::x(), f64::INFINITY);
        for index in segments {
            let found = self.segments[index].closest_point(point);
            if found.2 < best.2 {
                best = found;
            }
        }
        (best.0, best.1)
    }

    /// Distance from a point to each segment, in metres.
    pub(crate) fn segment_distances(&self, point: Vector2<f64>) -> impl Iterator<Item = f64> {
        self.segments.iter().map(move |segment| segment.closest_point(point).2)
    }
}

/// A corner that bends a long side: its middle, displaced laterally; `None` for short sides.
fn bend(from: Vector2<f64>, to: Vector2<f64>, rng: &mut Rng) -> Option<(Vector2<f64>, f64)> {
    let side = if rng.below(2) == 0 { 1.0 } else { -1.0 };
    let offset = side * uniform_in(rng, BEND_OFFSET_M);
    let along = to - from;
    (along.norm() > BEND_MIN_SIDE_M)
        .then(|| (0.5 * (from + to) + left_of(along.normalize()) * offset, BEND_RADIUS_M))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tiepoint_geometry::Rng;

    /// Rounding of lengths of metres over a few hundred operations in double precision.
    const CLOSE_M: f64 = 1e-9;

    proptest! {
        #[test]
        fn tangents_are_continuous_and_locate_inverts_point_beside(
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
            for pair in route.segments.windows(2) {
                prop_assert!((pair[0].point_at(pair[0].length_m) - pair[1].start).norm() < CLOSE_M);
                let turn_rad = pair[0].heading_at(pair[0].length_m) - pair[1].heading_rad;
                prop_assert!((unit_vector(turn_rad) - unit_vector(0.0)).norm() < CLOSE_M);
            }
            if is_loop {
                prop_assert!((route.point(route.length_m()) - route.point(0.0)).norm() < CLOSE_M);
            }
            let position = RoutePosition { along_m: fraction * route.length_m(), left_m };
            let found = route.locate(route.point_beside(position));
            prop_assert!((found.left_m - left_m).abs() < 1e-6, "{found:?} {position:?}");
            let difference = (found.along_m - position.along_m).abs();
            let along_error_m = difference.min(route.length_m() - difference);
            prop_assert!(along_error_m < 1e-6, "{found:?} {position:?}");
        }
    }

    #[test]
    fn overlapping_turns_are_refused() {
        let corners = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
            .map(|(x, y)| (Vector2::new(x, y), 6.0));
        assert!(matches!(Route::from_corners(&corners, true), Err(Error::CornersTooClose { .. })));
    }
}
