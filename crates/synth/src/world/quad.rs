//! Geometric primitives: rectangles and ellipses in space, with openings.

use tiepoint_geometry::nalgebra::Vector3;

use super::noise::floor;

/// A ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Origin, in metres.
    pub origin: Vector3<f64>,
    /// Direction; distances along the ray are in units of its length.
    pub direction: Vector3<f64>,
}

impl Ray {
    /// The point at a distance.
    pub fn at(&self, distance: f64) -> Vector3<f64> {
        self.origin + self.direction * distance
    }
}

/// A rectangle, or the ellipse inscribed in it; visible from both sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quad {
    /// A corner, in metres.
    pub origin: Vector3<f64>,
    /// Unit vector along its first edge: to the right as seen from the front.
    pub u: Vector3<f64>,
    /// Unit vector along its second edge: upwards as seen from the front.
    pub v: Vector3<f64>,
    /// Lengths of the edges, in metres.
    pub size: [f64; 2],
    /// Whether the quad is the inscribed ellipse.
    pub is_ellipse: bool,
    /// Index of its surface in the world.
    pub surface: u32,
}

impl Quad {
    /// Unit normal of the front.
    pub fn normal(&self) -> Vector3<f64> {
        self.u.cross(&self.v)
    }

    /// Intersection with a ray beyond `min_distance`: distance and (u, v) in metres.
    pub(crate) fn intersect(&self, ray: &Ray, min_distance: f64) -> Option<(f64, [f64; 2])> {
        let (distance, uv) = self.intersect_plane(ray)?;
        (distance > min_distance && self.contains(uv)).then_some((distance, uv))
    }

    /// Intersection of a ray with the plane of the quad.
    pub(crate) fn intersect_plane(&self, ray: &Ray) -> Option<(f64, [f64; 2])> {
        let normal = self.normal();
        let distance = normal.dot(&(self.origin - ray.origin)) / normal.dot(&ray.direction);
        let local = ray.at(distance) - self.origin;
        distance.is_finite().then(|| (distance, [local.dot(&self.u), local.dot(&self.v)]))
    }

    fn contains(&self, [u, v]: [f64; 2]) -> bool {
        let (a, b) = (u / self.size[0], v / self.size[1]);
        if self.is_ellipse {
            (a - 0.5).powi(2) + (b - 0.5).powi(2) <= 0.25
        } else {
            (0.0..=1.0).contains(&a) && (0.0..=1.0).contains(&b)
        }
    }

    /// The corners.
    pub(crate) fn corners(&self) -> [Vector3<f64>; 4] {
        let (u, v) = (self.u * self.size[0], self.v * self.size[1]);
        [self.origin, self.origin + u, self.origin + v, self.origin + u + v]
    }
}

/// A grid of openings in a wall with equal depth: windows, and doors or shop windows on the ground
/// floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relief {
    /// Number of columns of openings.
    pub columns: i32,
    /// Number of floors above the ground floor.
    pub floors: i32,
    /// Width of a column and height of a floor, in metres.
    pub cell_m: [f64; 2],
    /// Height of the ground floor, in metres; 0 for none.
    pub ground_m: f64,
    /// Offset of the first column, in metres.
    pub margin_m: f64,
    /// An opening within its cell: left, bottom, right, top, in metres.
    pub opening_m: [f64; 4],
    /// An opening of the ground floor within its cell, in metres.
    pub ground_opening_m: [f64; 4],
    /// Depth of the openings, in metres.
    pub depth_m: f64,
}

/// The part of a surface that a ray hits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Part {
    /// The surface itself.
    Face,
    /// The bottom of an opening: its column and floor (0 is the ground floor), the position within
    /// it, and its size in metres.
    Pane { cell: [i32; 2], uv: [f64; 2], size: [f64; 2] },
    /// A side of an opening: 0 left, 1 right, 2 sill, 3 lintel.
    Jamb { side: u8 },
}

impl Relief {
    /// The opening at a position of the wall: its cell and its edges (left, bottom, right, top) in
    /// wall coordinates.
    fn opening(&self, [u, v]: [f64; 2]) -> Option<([i32; 2], [f64; 4])> {
        let column = floor((u - self.margin_m) / self.cell_m[0]);
        if !(0..self.columns).contains(&column) {
            return None;
        }
        let left = self.margin_m + f64::from(column) * self.cell_m[0];
        let (storey, bottom, opening) = if v < self.ground_m {
            (0, 0.0, &self.ground_opening_m)
        } else {
            let storey = floor((v - self.ground_m) / self.cell_m[1]);
            (storey + 1, self.ground_m + f64::from(storey) * self.cell_m[1], &self.opening_m)
        };
        let edges =
            [left + opening[0], bottom + opening[1], left + opening[2], bottom + opening[3]];
        let is_inside =
            storey <= self.floors && edges[0] < u && u < edges[2] && edges[1] < v && v < edges[3];
        is_inside.then_some(([column, storey], edges))
    }

    /// Traces a ray from its intersection `uv` with the wall into an opening, if there is one: the
    /// further depth along the wall normal in metres, and the part that it hits. `slope` is the
    /// change of u and v of the ray per metre of depth.
    pub(crate) fn follow(&self, uv: [f64; 2], slope: [f64; 2]) -> (f64, Part) {
        let Some((cell, edges)) = self.opening(uv) else { return (0.0, Part::Face) };
        let (mut depth, mut side) = (self.depth_m, None);
        for axis in 0..2 {
            let (edge, index) =
                if slope[axis] < 0.0 { (edges[axis], 0) } else { (edges[axis + 2], 1) };
            let reach = (edge - uv[axis]) / slope[axis];
            if reach < depth {
                (depth, side) = (reach, Some(2 * axis as u8 + index));
            }
        }
        let at = [uv[0] + depth * slope[0] - edges[0], uv[1] + depth * slope[1] - edges[1]];
        let part = match side {
            Some(side) => Part::Jamb { side },
            None => Part::Pane { cell, uv: at, size: [edges[2] - edges[0], edges[3] - edges[1]] },
        };
        (depth, part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RELIEF: Relief = Relief {
        columns: 3,
        floors: 2,
        cell_m: [2.5, 3.0],
        ground_m: 4.0,
        margin_m: 0.5,
        opening_m: [0.6, 0.9, 1.9, 2.4],
        ground_opening_m: [0.3, 0.0, 2.2, 2.8],
        depth_m: 0.25,
    };
    /// Steps of the slow march into an opening.
    const STEPS: usize = 20_000;

    proptest! {
        #[test]
        fn follow_equals_ray_marching(
            u in 0.0..9.0,
            v in 0.0..12.0,
            su in -2.0..2.0,
            sv in -2.0..2.0,
        ) {
            let (depth, part) = RELIEF.follow([u, v], [su, sv]);
            let first = RELIEF.opening([u, v]);
            prop_assert_eq!(first.is_none(), part == Part::Face);
            if let Some((cell, _)) = first {
                // March until the position leaves the opening, or reaches its bottom.
                let mut marched = RELIEF.depth_m;
                for k in 0..STEPS {
                    let d = RELIEF.depth_m * k as f64 / STEPS as f64;
                    if RELIEF.opening([u + su * d, v + sv * d]).map(|found| found.0) != Some(cell) {
                        marched = d;
                        break;
                    }
                }
                prop_assert!(
                    (marched - depth).abs() <= 2.0 * RELIEF.depth_m / STEPS as f64,
                    "{marched} {depth}"
                );
                let is_pane = matches!(part, Part::Pane { .. });
                prop_assert_eq!(is_pane, depth == RELIEF.depth_m);
            }
        }
    }

    #[test]
    fn rays_intersect_quads_and_ellipses() {
        let quad = Quad {
            origin: Vector3::new(-1.0, 5.0, 0.0),
            u: Vector3::x(),
            v: Vector3::z(),
            size: [2.0, 3.0],
            is_ellipse: false,
            surface: 0,
        };
        assert_eq!(quad.normal(), -Vector3::y());
        let ray =
            Ray { origin: Vector3::new(0.0, 0.0, 1.0), direction: Vector3::new(0.0, 2.0, 0.0) };
        assert_eq!(quad.intersect(&ray, 0.0), Some((2.5, [1.0, 1.0])));
        let ellipse = Quad { is_ellipse: true, ..quad };
        let corner = Ray { origin: Vector3::new(-0.9, 0.0, 0.1), ..ray };
        assert!(
            quad.intersect(&corner, 0.0).is_some() && ellipse.intersect(&corner, 0.0).is_none()
        );
    }
}
