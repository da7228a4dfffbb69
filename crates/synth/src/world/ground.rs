//! The ground: the plane z = 0 with the texture of the street, a function of the position relative
//! to the centre line, which is exact (lines and arcs). A grid of cells lists the segments of the
//! route that can be nearest.

use tiepoint_geometry::nalgebra::Vector2;

use super::material::{mix, scale};
use super::noise::{
    Footprint, Fractal, cells, floor, hash, interval, lines, signed, smoothstep, spots, unsigned,
};
use crate::route::{Route, RoutePosition};

/// Distances of the edge of the lane, the kerb, and the outer edge of the pavement from the centre
/// line, in metres.
const LANE_M: f64 = 3.6;
pub(crate) const KERB_M: f64 = 5.8;
pub(crate) const PAVEMENT_M: f64 = 8.6;
/// Side of a cell of the grid, and the distance from the street beyond which there is only grass,
/// in metres.
const CELL_M: f64 = 8.0;
const REACH_M: f64 = 40.0;
/// Albedos.
const ASPHALT: [f32; 3] = [0.115, 0.115, 0.12];
const PARKING: [f32; 3] = [0.16, 0.155, 0.15];
const PAVING: [f32; 3] = [0.34, 0.33, 0.31];
const KERB: [f32; 3] = [0.42, 0.41, 0.40];
const PAINT: [f32; 3] = [0.72, 0.72, 0.70];
const GRASS: [f32; 3] = [0.10, 0.16, 0.055];
const SOIL: [f32; 3] = [0.24, 0.19, 0.13];
/// Mean distance of zebra crossings, in metres.
const CROSSING_M: f64 = 90.0;

/// The ground of a street.
#[derive(Clone, Debug)]
pub(crate) struct Ground {
    route: Route,
    seed: u32,
    corner: Vector2<f64>,
    columns: usize,
    /// For each cell, the segments of the route that may be nearest to a point in it; empty far
    /// from the street.
    cells: Vec<Vec<u16>>,
}

impl Ground {
    pub(crate) fn new(route: &Route, seed: u32) -> Self {
        let margin = Vector2::repeat(REACH_M + CELL_M);
        let (low, high) = route.bounds();
        let (low, high) = (low - margin, high + margin);
        let [columns, rows] =
            [0, 1].map(|axis| ((high[axis] - low[axis]) / CELL_M).ceil() as usize);
        let mut index = Vec::with_capacity(columns * rows);
        for k in 0..columns * rows {
            let centre =
                low + Vector2::new((k % columns) as f64 + 0.5, (k / columns) as f64 + 0.5) * CELL_M;
            let distances: Vec<f64> = route.segment_distances(centre).collect();
            let nearest = distances.iter().copied().fold(f64::INFINITY, f64::min);
            // A segment that is nearest somewhere in the cell is at most a diagonal further from
            // its centre than the nearest segment.
            let candidates =
                (0..distances.len()).filter(|&p| distances[p] <= nearest + CELL_M * 1.4143);
            let candidates = candidates.map(|p| p as u16).collect();
            index.push(if nearest < REACH_M { candidates } else { Vec::new() });
        }
        Self { route: route.clone(), seed, corner: low, columns, cells: index }
    }

    /// The position of a point relative to the street, and the tangent of the street there; `None`
    /// far from it.
    fn closest_point(&self, place: Vector2<f64>) -> Option<(RoutePosition, Vector2<f64>)> {
        let cell = (place - self.corner) / CELL_M;
        if cell.x < 0.0 || cell.y < 0.0 || cell.x as usize >= self.columns {
            return None;
        }
        let segments = self.cells.get(cell.y as usize * self.columns + cell.x as usize)?;
        (!segments.is_empty())
            .then(|| self.route.closest_point(place, segments.iter().map(|&p| usize::from(p))))
    }

    /// Mean albedo (red, green, blue, 0 to 1) over the footprint of a pixel around `place`, a point
    /// of the ground plane in metres.
    pub(crate) fn albedo(&self, place: Vector2<f64>, footprint: &Footprint) -> [f32; 3] {
        let at = [place.x, place.y];
        let Some((position, tangent)) = self.closest_point(place) else {
            return self.grass(at, footprint);
        };
        let (beside, width) = (position.left_m.abs(), footprint.reach());
        let grain = Fractal { coarsest: 0.25, octaves: 4, persistence: 1.0 }.at(
            at,
            footprint,
            self.seed ^ 3,
        );
        let spots =
            |size: f64, share: f32, salt: u32| spots(at, footprint, size, share, self.seed ^ salt);
        let mut color = ASPHALT;
        if beside - width < KERB_M {
            let wear = Fractal { coarsest: 3.0, octaves: 2, persistence: 0.7 }.at(
                at,
                footprint,
                self.seed ^ 4,
            );
            let marks =
                0.22 * (spots(1.1, 0.5, 6) + spots(0.37, 0.6, 7)) + 0.3 * spots(0.11, 0.3, 13);
            color = scale(color, (1.0 + 0.25 * wear + marks).max(0.2));
        }
        let has_pavement = beside + width > KERB_M;
        let stain = if has_pavement {
            0.25 * spots(0.8, 0.5, 9) + 0.2 * spots(0.13, 0.35, 10)
        } else {
            0.0
        };
        // The other patterns have straight edges along and across the street, in coordinates that
        // are locally a rotation of the plane.
        let color = footprint.mean(0.0, |offset, width, _| {
            let along = position.along_m + offset[0] * tangent.x + offset[1] * tangent.y;
            let left = position.left_m + offset[1] * tangent.x - offset[0] * tangent.y;
            self.paved(color, stain, [along, left], width)
        });
        let color = scale(color, (1.0 + 0.22 * grain).max(0.2));
        if beside + width < PAVEMENT_M {
            return color;
        }
        let beyond = ((beside - PAVEMENT_M) / width + 0.5).clamp(0.0, 1.0) as f32;
        mix(color, self.grass(at, footprint), beyond)
    }

    fn grass(&self, at: [f64; 2], footprint: &Footprint) -> [f32; 3] {
        let patches = Fractal { coarsest: 6.0, octaves: 3, persistence: 0.7 }.at(
            at,
            footprint,
            self.seed ^ 1,
        );
        let blades = Fractal { coarsest: 0.30, octaves: 4, persistence: 1.0 }.at(
            at,
            footprint,
            self.seed ^ 2,
        );
        let soil = smoothstep(patches * 0.8 + 0.15);
        scale(mix(GRASS, SOIL, 0.7 * soil), (1.0 + 0.35 * blades).max(0.15))
    }

    /// Albedo of the carriageway and the pavement at (metres along the street, metres to its left).
    fn paved(
        &self,
        asphalt: [f32; 3],
        stain: f32,
        [along, left]: [f64; 2],
        width: f64,
    ) -> [f32; 3] {
        let (beside, seed) = (left.abs(), self.seed);
        // Fraction of the footprint beyond a distance from the centre line.
        let beyond = |edge: f64| ((beside - edge) / width + 0.5).clamp(0.0, 1.0) as f32;
        let mut color = asphalt;
        if beside - width < KERB_M {
            // Patches of newer or older asphalt.
            let patch =
                cells([along / 3.1, left / 1.3], [width / 3.1, width / 1.3], 0.0, |x, y| {
                    let bits = hash(x, y, seed ^ 5);
                    if bits & 7 == 0 { unsigned(bits) - 0.5 } else { 0.0 }
                });
            let parking = mix(asphalt, PARKING, 0.6);
            color = mix(scale(color, 1.0 + 0.7 * patch), parking, beyond(LANE_M));
            color = mix(color, PAINT, 0.8 * self.paint(along, left, width));
        }
        if beside + width > KERB_M {
            let side = if left < 0.0 { 1u32 } else { 2 };
            let slab = cells([along / 0.6, left / 0.6], [width / 0.6, width / 0.6], 0.0, |x, y| {
                0.22 * signed(hash(x, y, seed ^ 8 ^ side))
            });
            let joint = lines(along, width, 0.6, 0.014).max(lines(left, width, 0.6, 0.014));
            let paving = scale(PAVING, (1.0 + slab + stain) * (1.0 - 0.45 * joint));
            let edge = lines(along, width, 1.0, 0.012);
            color = mix(color, scale(KERB, 1.0 - 0.5 * edge), beyond(KERB_M));
            color = mix(color, paving, beyond(KERB_M + 0.18));
        }
        color
    }

    /// Fraction of the footprint under road markings: the centre line, edge lines, parking bays,
    /// zebra crossings.
    fn paint(&self, along: f64, left: f64, width: f64) -> f32 {
        let beside = left.abs();
        let middle = lines(along, width, 6.0, 3.0) * interval(beside, width, -0.06, 0.06);
        let edge = interval(beside, width, LANE_M - 0.12, LANE_M);
        let bays = lines(along, width, 6.2, 0.1) * interval(beside, width, LANE_M, KERB_M);
        let block = floor(along / CROSSING_M);
        let place = 0.2 + 0.6 * f64::from(unsigned(hash(block, 0, self.seed)));
        let crossing = CROSSING_M * (f64::from(block) + place);
        let zebra = interval(along, width, crossing, crossing + 3.0)
            * lines(left, width, 1.0, 0.5)
            * interval(beside, width, -1.0, LANE_M - 0.2);
        (middle + edge + bays + zebra).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_geometry::Rng;

    #[test]
    fn grid_agrees_with_a_search_of_the_whole_route() {
        let mut rng = Rng::stream(5, &[]);
        for seed in 0..4 {
            let route = Route::street_loop(300.0, &mut Rng::stream(seed, &[])).unwrap();
            let ground = Ground::new(&route, 1);
            let mut far = 0;
            for _ in 0..2000 {
                let place = Vector2::from_fn(|_, _| 260.0 * (rng.uniform() - 0.5));
                let slow = route.locate(place);
                match ground.closest_point(place) {
                    Some((found, tangent)) => {
                        assert_eq!(found, slow);
                        let heading = route.heading_rad(found.along_m);
                        assert!(
                            (tangent - Vector2::new(heading.cos(), heading.sin())).norm() < 1e-9
                        );
                    }
                    None => {
                        far += 1;
                        assert!(slow.left_m.abs() > REACH_M - CELL_M);
                    }
                }
            }
            assert!(far < 2000);
        }
    }
}
