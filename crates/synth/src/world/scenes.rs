//! Worlds for collections of photos: an object on a table, a room, two identical houses.

use std::f64::consts::{FRAC_PI_2, TAU};

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::{Rotation3, Vector2, Vector3};

use super::builder::{Block, Builder, Cladding, on_ground};
use super::building::{Style, house};
use super::furniture::{car, hedge, in_range, seed, tree};
use super::material::{Material, Surface};

/// Places of the two houses, in metres.
pub(crate) const TWINS_M: [[f64; 2]; 2] = [[40.0, 28.0], [180.0, 28.0]];
/// Width and depth of these houses, in metres.
const TWIN_M: [f64; 2] = [10.0, 8.0];
/// Width, depth and height of the room, in metres.
pub(crate) const ROOM_M: [f64; 3] = [7.0, 5.0, 2.8];
/// Materials of walls and boxes.
const CLADDINGS: [Material; 5] =
    [Material::Stone, Material::Brick, Material::Boards, Material::Concrete, Material::Plaster];

fn colored(world: &mut Builder, material: Material, rng: &mut Rng) -> u32 {
    let grey = in_range(rng, 0.15, 0.5);
    let color = std::array::from_fn(|_| (grey * in_range(rng, 0.7, 1.3)) as f32);
    world.surface(Surface::new(material, color, seed(rng)))
}

/// Gives each quad from `first` on a texture of its own: the sides of real things differ.
fn tell_apart(world: &mut Builder, first: usize) {
    for k in first..world.quads.len() {
        let surface = world.surfaces[world.quads[k].surface as usize];
        let seed = surface.seed ^ ((k as u32) << 8);
        world.quads[k].surface = world.surface(Surface { seed, ..surface });
    }
}

/// A box of `size` (width, depth, height in metres) with the middle of its bottom at `place`,
/// turned by `yaw_rad`.
fn add_box(world: &mut Builder, place: Vector3<f64>, yaw_rad: f64, size: [f64; 3], rng: &mut Rng) {
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    let (right, out) = (turn * Vector3::x(), turn * -Vector3::y());
    let corner = place - right * (0.5 * size[0]) + out * (0.5 * size[1]);
    let kind = CLADDINGS[rng.below(CLADDINGS.len())];
    let (front, sides) = (colored(world, Material::Sign, rng), colored(world, kind, rng));
    let first = world.quads.len();
    world.block(&Block { corner, right, out, size }, Cladding { front, sides, top: sides });
    tell_apart(world, first);
}

/// A horizontal square around the vertical axis.
fn plate(world: &mut Builder, half_m: f64, height: f64, surface: u32) {
    let corner = Vector3::new(-half_m, -half_m, height);
    world.quad(corner, Vector3::x(), Vector3::y(), [2.0 * half_m; 2], surface);
}

/// A heap of boxes, two metres high, with single ones around it, on a table above a floor. The
/// table top is at the height 0.
pub(super) fn table(rng: &mut Rng) -> Builder {
    let mut world = Builder::default();
    let (top, floor) =
        (colored(&mut world, Material::Boards, rng), colored(&mut world, Material::Concrete, rng));
    plate(&mut world, 3.5, 0.0, top);
    plate(&mut world, 30.0, -3.0, floor);
    let mut height = 0.0;
    for width in [2.4, 1.6, 0.9] {
        let shift = Vector2::from_fn(|_, _| in_range(rng, -0.2, 0.2));
        let size = [width, 0.8 * width, in_range(rng, 0.5, 0.8)];
        add_box(&mut world, on_ground(shift, height), in_range(rng, 0.0, TAU), size, rng);
        height += size[2];
    }
    let around = |yaw: f64, radius: f64| Vector3::new(radius * yaw.cos(), radius * yaw.sin(), 0.0);
    for turn in [0.0, 0.2, 0.35, 0.6, 0.8] {
        let size = [0.3, 0.3, 0.4].map(|least| in_range(rng, least, 2.0 * least));
        let place = around(turn * TAU, in_range(rng, 1.9, 2.6));
        add_box(&mut world, place, in_range(rng, 0.0, TAU), size, rng);
    }
    world
}

/// A room with pictures on its walls and cupboards along them, the floor at the height 0.
pub(super) fn room(rng: &mut Rng) -> Builder {
    let mut world = Builder::default();
    let [width, depth, height] = ROOM_M;
    let up = Vector3::z();
    for storey in [Material::Boards, Material::Plaster].into_iter().zip([0.0, height]) {
        let surface = colored(&mut world, storey.0, rng);
        let corner = Vector3::new(-0.5 * width, -0.5 * depth, storey.1);
        world.quad(corner, Vector3::x(), Vector3::y(), [width, depth], surface);
    }
    for side in 0..4 {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), f64::from(side) * FRAC_PI_2);
        // Seen from inside: the wall is in front, `right` runs to the right along it.
        let [length, distance] = if side % 2 == 0 { [width, depth] } else { [depth, width] };
        let (right, inwards) = (turn * Vector3::x(), turn * -Vector3::y());
        let at = |along: f64, up_m: f64, off: f64| {
            right * along - inwards * (0.5 * distance - off) + up * up_m
        };
        let kind = CLADDINGS[rng.below(CLADDINGS.len())];
        let wall = colored(&mut world, kind, rng);
        world.quad(at(-0.5 * length, 0.0, 0.0), right, up, [length, height], wall);
        let mut along = -0.5 * length + in_range(rng, 0.2, 0.5);
        while along + 1.3 < 0.5 * length {
            let size = [in_range(rng, 0.6, 1.2), in_range(rng, 0.5, 0.9)];
            let picture = colored(&mut world, Material::Sign, rng);
            world.quad(at(along, in_range(rng, 1.4, 1.7), 0.02), right, up, size, picture);
            let cupboard = [size[0], in_range(rng, 0.25, 0.5), in_range(rng, 0.4, 1.2)];
            if rng.below(3) > 0 {
                let place = at(along + 0.5 * size[0], 0.0, 0.5 * cupboard[1]);
                add_box(&mut world, place, f64::from(side) * FRAC_PI_2, cupboard, rng);
            }
            along += size[0] + in_range(rng, 0.3, 0.8);
        }
    }
    world
}

/// Two identical houses, each among other trees, hedges and cars, with a row of other houses
/// between them that hides each from the surroundings of the other.
pub(super) fn twins(rng: &mut Rng) -> Builder {
    let mut world = Builder::default();
    let style = Style { floors: 1, ..Style::sample(rng) };
    let lot = |x: f64, y: f64, [width, depth]: [f64; 2]| Block {
        corner: Vector3::new(x - 0.5 * width, y - 0.5 * depth, 0.0),
        right: Vector3::x(),
        out: -Vector3::y(),
        size: [width, depth, 0.0],
    };
    let mut twin = Builder::default();
    house(&mut twin, &lot(0.0, 0.0, TWIN_M), style);
    tell_apart(&mut twin, 0);
    for [x, y] in TWINS_M {
        world.place(&twin, 0.0, Vector3::new(x, y, 0.0));
        for part in 0..14 {
            let yaw = (f64::from(part) + in_range(rng, 0.1, 0.9)) / 14.0 * TAU;
            let at =
                |radius: f64| Vector3::new(x + radius * yaw.cos(), y + radius * yaw.sin(), 0.0);
            let (near, far) = (at(in_range(rng, 9.0, 11.0)), at(in_range(rng, 24.0, 32.0)));
            let turn = in_range(rng, 0.0, TAU);
            match rng.below(3) {
                0 => world.place(&car(rng), turn, near),
                1 => world.place(&hedge(in_range(rng, 1.0, 3.0), rng), turn, near),
                _ => {}
            }
            // The road (y = 0) stays free.
            if far.y > 9.0 {
                world.place(&tree(rng), turn, far);
            }
        }
        for step in [-24.0, -8.0, 8.0, 24.0] {
            let size = [in_range(rng, 9.0, 14.0), 10.0];
            for y in [y + 42.0, -18.0] {
                house(&mut world, &lot(x + step, y, size), Style::sample(rng));
            }
        }
    }
    for y in [19.0, 35.0, 51.0, 67.0] {
        house(&mut world, &lot(110.0, y, [20.0, 14.0]), Style { floors: 3, ..Style::sample(rng) });
    }
    world
}
