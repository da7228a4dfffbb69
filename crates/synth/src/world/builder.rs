//! Construction of objects from quads: boxes, ellipses, and copies of objects.

use tiepoint_geometry::nalgebra::{Rotation3, Vector2, Vector3};

use super::material::Surface;
use super::quad::Quad;

/// A growing list of quads and their surfaces.
#[derive(Clone, Debug, Default)]
pub(crate) struct Builder {
    pub(crate) quads: Vec<Quad>,
    pub(crate) surfaces: Vec<Surface>,
}

/// An upright box: its front left bottom corner as seen from its front, the unit vectors to the
/// right and out of the front, and width, depth, height in metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Block {
    pub(crate) corner: Vector3<f64>,
    pub(crate) right: Vector3<f64>,
    pub(crate) out: Vector3<f64>,
    pub(crate) size: [f64; 3],
}

/// Surface indices of the front, the other sides and the top of a box.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cladding {
    pub(crate) front: u32,
    pub(crate) sides: u32,
    pub(crate) top: u32,
}

impl Cladding {
    pub(crate) fn all(surface: u32) -> Self {
        Self { front: surface, sides: surface, top: surface }
    }
}

pub(crate) fn on_ground(place: Vector2<f64>, height: f64) -> Vector3<f64> {
    place.push(height)
}

impl Block {
    /// The point at offsets to the right, upwards and outwards from the corner, in metres.
    pub(crate) fn point(&self, right: f64, up: f64, out: f64) -> Vector3<f64> {
        self.corner + self.right * right + Vector3::z() * up + self.out * out
    }

    /// A box with the same orientation, on or near the front: offsets of its corner as in
    /// [`Block::point`], and its size.
    pub(crate) fn attached(&self, right: f64, up: f64, out: f64, size: [f64; 3]) -> Self {
        Self { corner: self.point(right, up, out), size, ..*self }
    }
}

impl Builder {
    pub(crate) fn surface(&mut self, surface: Surface) -> u32 {
        self.surfaces.push(surface);
        self.surfaces.len() as u32 - 1
    }

    pub(crate) fn quad(
        &mut self,
        origin: Vector3<f64>,
        u: Vector3<f64>,
        v: Vector3<f64>,
        size: [f64; 2],
        surface: u32,
    ) {
        self.quads.push(Quad { origin, u, v, size, is_ellipse: false, surface });
    }

    /// Adds an ellipse, given by its centre.
    pub(crate) fn disc(
        &mut self,
        centre: Vector3<f64>,
        u: Vector3<f64>,
        v: Vector3<f64>,
        size: [f64; 2],
        surface: u32,
    ) {
        let origin = centre - u * (0.5 * size[0]) - v * (0.5 * size[1]);
        self.quads.push(Quad { origin, u, v, size, is_ellipse: true, surface });
    }

    /// Adds all faces of a box except its bottom.
    pub(crate) fn block(&mut self, block: &Block, cladding: Cladding) {
        let ([width, depth, height], up) = (block.size, Vector3::z());
        let (right, out) = (block.right, block.out);
        self.quad(block.corner, right, up, [width, height], cladding.front);
        self.quad(block.point(width, 0.0, -depth), -right, up, [width, height], cladding.sides);
        self.quad(block.point(0.0, 0.0, -depth), out, up, [depth, height], cladding.sides);
        self.quad(block.point(width, 0.0, 0.0), -out, up, [depth, height], cladding.sides);
        self.quad(block.point(0.0, height, 0.0), right, -out, [width, depth], cladding.top);
    }

    /// Adds the bottom of a box, for parts that hang on a wall.
    pub(crate) fn underside(&mut self, block: &Block, surface: u32) {
        let [width, depth, _] = block.size;
        self.quad(block.point(0.0, 0.0, -depth), block.right, block.out, [width, depth], surface);
    }

    /// Adds a copy of another object, rotated by `yaw_rad` about the vertical and translated.
    pub(crate) fn place(&mut self, other: &Builder, yaw_rad: f64, to: Vector3<f64>) {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        let first = self.surfaces.len() as u32;
        self.surfaces.extend_from_slice(&other.surfaces);
        self.quads.extend(other.quads.iter().map(|quad| Quad {
            origin: turn * quad.origin + to,
            u: turn * quad.u,
            v: turn * quad.v,
            surface: quad.surface + first,
            ..*quad
        }));
    }
}
