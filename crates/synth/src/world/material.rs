//! Textures of surfaces: patterns of `noise`, combined for each material and averaged over the
//! footprint of the pixel.

use super::noise::{
    Footprint, Fractal, cells, floor, hash, interval, lines, signed, spots, unsigned,
};
use super::quad::{Part, Relief};

/// The material of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Material {
    /// Bricks of 24 × 7 cm.
    Brick,
    /// Plastered walls with stains.
    Plaster,
    /// Ashlar of 80 × 40 cm.
    Stone,
    /// Concrete panels of 1.5 × 3 m.
    Concrete,
    /// Horizontal boards.
    Boards,
    /// Roofs and other matt surfaces.
    Plain,
    /// Lettering: white on a colour, different for each seed.
    Sign,
    /// A cluster of leaves.
    Leaves,
    /// The bark of a trunk.
    Bark,
    /// The paint of a car.
    Paint,
    /// Tinted glass.
    Glass,
    /// A checkerboard with squares of 25 cm, for measurements.
    Checker,
}

/// The appearance of a quad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Material.
    pub material: Material,
    /// Albedo: red, green, blue in 0..1.
    pub color: [f32; 3],
    /// Surfaces with equal seeds look the same.
    pub seed: u32,
    /// Openings in the surface.
    pub relief: Option<Relief>,
}

pub(crate) fn mix(a: [f32; 3], b: [f32; 3], share: f32) -> [f32; 3] {
    std::array::from_fn(|c| a[c] + share * (b[c] - a[c]))
}

pub(crate) fn scale(color: [f32; 3], factor: f32) -> [f32; 3] {
    color.map(|c| c * factor)
}

/// The pattern of a wall of bricks, stones, panels or boards.
struct Courses {
    /// Length and height of an element, in metres.
    size: [f64; 2],
    /// Shift of each row relative to the one below, in lengths.
    shift: f64,
    /// Thickness of the joints, in metres.
    joint: f64,
    /// Variation of the brightness of the elements.
    tint: f32,
}

/// Albedo of narrow joints; wide joints are dark.
const MORTAR: [f32; 3] = [0.52, 0.5, 0.47];

impl Surface {
    /// A surface without openings.
    pub fn new(material: Material, color: [f32; 3], seed: u32) -> Self {
        Self { material, color, seed, relief: None }
    }

    /// Mean albedo over a footprint, and the reflectance (fraction of mirrored light).
    pub(crate) fn albedo(
        &self,
        part: &Part,
        uv: [f64; 2],
        footprint: &Footprint,
    ) -> ([f32; 3], f32) {
        match *part {
            Part::Face => {
                let mirror = match self.material {
                    Material::Glass => 0.25,
                    Material::Paint => 0.12,
                    _ => 0.0,
                };
                (self.face(uv, footprint), mirror)
            }
            Part::Jamb { side } => {
                let grain = Fractal { coarsest: 0.2, octaves: 4, persistence: 0.8 };
                let grain = grain.at(uv, footprint, self.seed ^ u32::from(side));
                (scale([0.55, 0.53, 0.5], 0.8 + 0.25 * grain), 0.0)
            }
            Part::Pane { cell, uv, size } => self.pane(cell, uv, size, footprint),
        }
    }

    /// Albedo of the surface outside of openings. Patterns with edges are averaged over the parts
    /// of a long footprint; noise is averaged by its own footprint.
    fn face(&self, at: [f64; 2], footprint: &Footprint) -> [f32; 3] {
        let ([u, v], seed) = (at, self.seed);
        let fine = |coarsest: f64, octaves: u32, persistence: f32, salt: u32| {
            Fractal { coarsest, octaves, persistence }.at(at, footprint, seed ^ salt)
        };
        let spots =
            |size: f64, share: f32, salt: u32| spots(at, footprint, size, share, seed ^ salt);
        match self.material {
            Material::Brick => {
                let wall = self.courses(
                    at,
                    footprint,
                    &Courses { size: [0.25, 0.075], shift: 0.5, joint: 0.012, tint: 0.3 },
                );
                let marks = spots(0.9, 0.35, 20) + spots(0.21, 0.2, 21);
                scale(wall, (1.0 + 0.22 * fine(1.2, 5, 0.85, 22) + 0.25 * marks).max(0.1))
            }
            Material::Plaster => {
                let marks =
                    spots(1.3, 0.5, 23) + 0.8 * spots(0.41, 0.45, 24) + 0.8 * spots(0.11, 0.3, 25);
                // Streaks of water from the top of the wall.
                let runs = Fractal { coarsest: 0.35, octaves: 2, persistence: 0.7 };
                let runs = runs.at([u, 0.12 * v], footprint, seed ^ 26);
                scale(
                    self.color,
                    (1.0 + 0.2 * fine(1.6, 5, 0.85, 27) + 0.2 * marks + 0.12 * runs).max(0.1),
                )
            }
            Material::Stone => {
                let wall = self.courses(
                    at,
                    footprint,
                    &Courses { size: [0.8, 0.4], shift: 0.37, joint: 0.018, tint: 0.2 },
                );
                let pits = spots(0.17, 0.5, 28) + spots(0.07, 0.4, 29);
                scale(wall, (1.0 + 0.28 * fine(0.8, 5, 0.85, 30) + 0.22 * pits).max(0.1))
            }
            Material::Concrete => {
                let wall = self.courses(
                    at,
                    footprint,
                    &Courses { size: [1.5, 3.0], shift: 0.0, joint: 0.03, tint: 0.1 },
                );
                let holes = spots(0.23, 0.25, 31) + spots(0.6, 0.4, 32);
                scale(wall, (1.0 + 0.22 * fine(2.0, 6, 0.8, 33) + 0.2 * holes).max(0.1))
            }
            Material::Boards => {
                let wall = self.courses(
                    at,
                    footprint,
                    &Courses { size: [2.7, 0.16], shift: 0.41, joint: 0.012, tint: 0.15 },
                );
                let grain = Fractal { coarsest: 0.5, octaves: 5, persistence: 0.85 };
                let grain = grain.at([0.2 * u, v], footprint, seed ^ 34);
                scale(wall, (1.0 + 0.2 * grain + 0.25 * spots(0.3, 0.3, 35)).max(0.1))
            }
            Material::Sign => {
                let [ink] = footprint
                    .mean(0.0, |offset, _, axes| [self.ink([u + offset[0], v + offset[1]], axes)]);
                let wear = 1.0 + 0.12 * fine(0.4, 4, 0.8, 42);
                scale(mix(self.color, [0.85, 0.85, 0.8], ink), wear)
            }
            Material::Leaves => {
                let [leaf] = footprint.mean(0.02, |offset, width, _| {
                    let place = [u + offset[0], v + offset[1]].map(|x| x / 0.06);
                    [cells(place, [width / 0.06; 2], 0.0, |x, y| signed(hash(x, y, seed ^ 36)))]
                });
                scale(self.color, (1.0 + 0.35 * leaf + 0.35 * fine(0.3, 5, 0.9, 37)).max(0.12))
            }
            Material::Bark => {
                let grain = Fractal { coarsest: 0.12, octaves: 4, persistence: 0.9 };
                scale(self.color, (1.0 + 0.45 * grain.at([u, 0.25 * v], footprint, seed)).max(0.1))
            }
            Material::Plain => scale(
                self.color,
                (1.0 + 0.2 * fine(0.9, 5, 0.8, 39) + 0.15 * spots(0.7, 0.4, 38)).max(0.1),
            ),
            Material::Paint => scale(self.color, 1.0 + 0.04 * fine(0.6, 3, 0.8, 40)),
            Material::Glass => scale(self.color, 1.0 + 0.3 * fine(0.5, 2, 0.8, 41)),
            Material::Checker => {
                let [white] = footprint.mean(0.0, |offset, _, axes| {
                    let place = [u + offset[0], v + offset[1]].map(|x| x / 0.25);
                    [cells(place, axes.map(|a| a / 0.25), 0.5, |x, y| ((x ^ y) & 1) as f32)]
                });
                scale(self.color, 0.1 + 0.8 * white)
            }
        }
    }

    /// Albedo of a wall of elements with individual brightness and joints between them.
    fn courses(&self, [u, v]: [f64; 2], footprint: &Footprint, courses: &Courses) -> [f32; 3] {
        let ([length, height], joint) = (courses.size, courses.joint);
        footprint.mean(0.0, |offset, _, axes| {
            let (u, v) = (u + offset[0], v + offset[1]);
            let shifted = u / length + courses.shift * f64::from(floor(v / height));
            let tint =
                cells([shifted, v / height], [axes[0] / length, axes[1] / height], 0.0, |x, y| {
                    signed(hash(x, y, self.seed))
                });
            let gaps = lines(v, axes[1], height, joint).max(lines(
                shifted * length,
                axes[0],
                length,
                joint,
            ));
            let wall = scale(self.color, 1.0 + courses.tint * tint);
            mix(wall, scale(MORTAR, if joint > 0.015 { 0.4 } else { 1.0 }), 0.75 * gaps)
        })
    }

    /// Fraction of the footprint under letters: rows of random letters of 5 × 7 dots, in one of two
    /// sizes.
    fn ink(&self, [u, v]: [f64; 2], axes: [f64; 2]) -> f32 {
        let seed = self.seed;
        let dot = if seed & 1 == 0 { 0.055 } else { 0.08 };
        cells([u / dot, v / dot], axes.map(|a| a / dot), 0.2, |x, y| {
            let (letter_x, letter_y) = (x.rem_euclid(7), y.rem_euclid(10));
            let is_gap = letter_x >= 5 || letter_y >= 7;
            let bits = hash(x.div_euclid(7), y.div_euclid(10), seed) ^ 0x1284_2100;
            // Neighbouring dots share a bit, so that strokes result.
            let bit = bits >> ((letter_x / 2 + 3 * (letter_y / 2) + letter_x % 2) as u32 % 32);
            if is_gap || bit & 1 == 0 { 0.0 } else { 1.0 }
        })
    }

    /// Albedo and reflectance of the bottom of an opening: a window, or a shop window or a door on
    /// the ground floor.
    fn pane(
        &self,
        cell: [i32; 2],
        uv: [f64; 2],
        size: [f64; 2],
        footprint: &Footprint,
    ) -> ([f32; 3], f32) {
        let bits = hash(cell[0], cell[1], self.seed ^ 50);
        let is_door = cell[1] == 0 && bits.is_multiple_of(5);
        let frame_color = if bits & 64 == 0 { [0.7, 0.7, 0.68] } else { [0.16, 0.1, 0.07] };
        let curtain_height = size[1] * f64::from(unsigned(bits.wrapping_mul(31)));
        let noise = |coarsest: f64, at: [f64; 2]| {
            Fractal { coarsest, octaves: 5, persistence: 0.85 }.at(at, footprint, bits)
        };
        let clutter = if is_door { noise(0.3, [uv[0], 0.2 * uv[1]]) } else { noise(0.7, uv) };
        let color = footprint.mean(0.0, |offset, _, axes| {
            let at = [uv[0] + offset[0], uv[1] + offset[1]];
            let inside = |margin: f64| {
                interval(at[0], axes[0], margin, size[0] - margin)
                    * interval(at[1], axes[1], margin, size[1] - margin)
            };
            if is_door {
                let panels =
                    lines(at[0] - 0.1, axes[0], 0.5, 0.06).max(lines(at[1], axes[1], 0.7, 0.06));
                let wood = scale(frame_color, (0.7 + 0.25 * clutter) * (1.0 - 0.5 * panels));
                return mix([0.3, 0.3, 0.3], wood, inside(0.05));
            }
            let dark = scale([0.075, 0.08, 0.09], (1.0 + 0.6 * clutter).max(0.2));
            let folds = lines(at[0], axes[0], 0.14, 0.06);
            let curtain = scale([0.42, 0.4, 0.36], 1.0 - 0.25 * folds);
            let drawn = interval(at[1], axes[1], size[1] - curtain_height, size[1]);
            let behind = if bits & 1 == 0 { mix(dark, curtain, drawn) } else { dark };
            let bar = interval(at[0], axes[0], 0.5 * size[0] - 0.03, 0.5 * size[0] + 0.03)
                .max(interval(at[1], axes[1], 0.66 * size[1], 0.66 * size[1] + 0.05));
            mix(frame_color, behind, inside(0.06) * (1.0 - bar))
        });
        (color, if is_door { 0.0 } else { 0.16 })
    }
}
