//! Objects along the street: cars, trees, hedges, lamps, signs.

use std::f64::consts::TAU;

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::Vector3;

use super::builder::{Block, Builder, Cladding};
use super::material::{Material, Surface, scale};

const CAR_COLORS: [[f32; 3]; 7] = [
    [0.55, 0.56, 0.58],
    [0.06, 0.06, 0.07],
    [0.75, 0.75, 0.74],
    [0.35, 0.03, 0.03],
    [0.04, 0.08, 0.25],
    [0.22, 0.24, 0.25],
    [0.05, 0.16, 0.09],
];
/// Length and width of a car, in metres.
pub(crate) const CAR_LENGTH_M: f64 = 4.3;
const CAR_WIDTH_M: f64 = 1.76;

pub(crate) fn in_range(rng: &mut Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.uniform()
}

pub(crate) fn seed(rng: &mut Rng) -> u32 {
    (rng.next_u64() >> 32) as u32
}

/// A car with the heading +x, centred at the origin.
pub(crate) fn car(rng: &mut Rng) -> Builder {
    let mut car = Builder::default();
    let color = CAR_COLORS[rng.below(CAR_COLORS.len())];
    let paint = car.surface(Surface::new(Material::Paint, color, seed(rng)));
    let glass = car.surface(Surface::new(Material::Glass, [0.03, 0.035, 0.04], seed(rng)));
    let rubber = car.surface(Surface::new(Material::Plain, [0.03, 0.03, 0.03], seed(rng)));
    let metal = car.surface(Surface::new(Material::Plain, [0.4, 0.4, 0.42], seed(rng)));
    let light = car.surface(Surface::new(Material::Plain, [0.8, 0.78, 0.7], seed(rng)));
    let red = car.surface(Surface::new(Material::Plain, [0.5, 0.03, 0.03], seed(rng)));
    let plate = car.surface(Surface::new(Material::Sign, [0.05, 0.05, 0.08], seed(rng) & !1));
    let (half, side) = (0.5 * CAR_LENGTH_M, 0.5 * CAR_WIDTH_M);
    let body_height = in_range(rng, 0.82, 0.95);
    let roof_height = in_range(rng, 1.4, 1.65);
    // Boxes as seen from behind: right is −y, outwards −x.
    let slab = |back: f64, front: f64, low: f64, high: f64, side: f64| Block {
        corner: Vector3::new(back, side, low),
        right: -Vector3::y(),
        out: -Vector3::x(),
        size: [2.0 * side, front - back, high - low],
    };
    car.block(&slab(-half, half, 0.25, 0.45, side - 0.02), Cladding::all(rubber));
    car.block(&slab(-half, half, 0.45, body_height, side), Cladding::all(paint));
    let middle = body_height + 0.78 * (roof_height - body_height);
    let cabin = Cladding { front: glass, sides: glass, top: paint };
    car.block(&slab(-half + 0.25, 0.85, body_height, middle, side - 0.08), cabin);
    car.block(&slab(-half + 0.5, 0.45, middle, roof_height, side - 0.16), Cladding::all(paint));
    for face in [-1.0, 1.0] {
        let (right, out) = (-Vector3::y() * -face, Vector3::x() * face);
        let at =
            |across: f64, height: f64| out * (half + 0.01) + right * across + Vector3::z() * height;
        let lamp = if face > 0.0 { light } else { red };
        for across in [-0.75, 0.4] {
            car.quad(at(across, body_height - 0.25), right, Vector3::z(), [0.35, 0.16], lamp);
        }
        car.quad(at(-0.26, 0.5), right, Vector3::z(), [0.52, 0.12], plate);
        for along in [-1.3, 1.35] {
            // The face of a wheel, seen from its side of the car.
            let outwards = Vector3::y() * face;
            let forward = Vector3::x() * -face;
            let centre = Vector3::new(along, 0.0, 0.32) + outwards * (side + 0.01);
            car.disc(centre, forward, Vector3::z(), [0.64, 0.64], rubber);
            car.disc(centre + outwards * 0.01, forward, Vector3::z(), [0.38, 0.38], metal);
        }
        // Pillars between the windows.
        for along in [-1.0, -0.1] {
            let outwards = Vector3::y() * face;
            let origin = Vector3::new(along, 0.0, body_height) + outwards * (side - 0.075);
            car.quad(
                origin,
                Vector3::x() * -face,
                Vector3::z(),
                [0.08, middle - body_height],
                paint,
            );
        }
    }
    car
}

/// A tree at the origin.
pub(crate) fn tree(rng: &mut Rng) -> Builder {
    let mut tree = Builder::default();
    let (trunk, radius) = (in_range(rng, 2.2, 3.2), in_range(rng, 1.3, 2.2));
    let bark = tree.surface(Surface::new(Material::Bark, [0.16, 0.12, 0.09], seed(rng)));
    // Two boxes, rotated by 45°, approximate a round trunk.
    for turn in [0.0, TAU / 8.0] {
        let right = Vector3::new(turn.cos(), turn.sin(), 0.0);
        let out = Vector3::new(turn.sin(), -turn.cos(), 0.0);
        let width = 0.24;
        let corner = (out - right) * (0.5 * width);
        let block = Block { corner, right, out, size: [width, width, trunk + 0.5 * radius] };
        tree.block(&block, Cladding::all(bark));
    }
    let centre = Vector3::new(0.0, 0.0, trunk + radius);
    let count = (55.0 * radius * radius) as usize;
    foliage(&mut tree, rng, count, |rng| {
        let direction = Vector3::from_fn(|_, _| rng.normal()).normalize();
        let shell = radius * (0.55 + 0.45 * rng.uniform());
        centre + direction.component_mul(&Vector3::new(1.0, 1.0, 0.85)) * shell
    });
    tree
}

/// A hedge from the origin along +x.
pub(crate) fn hedge(length_m: f64, rng: &mut Rng) -> Builder {
    let mut hedge = Builder::default();
    let height = in_range(rng, 0.7, 1.5);
    let leaves = hedge.surface(Surface::new(Material::Leaves, [0.06, 0.11, 0.035], seed(rng)));
    let core = Block {
        corner: Vector3::new(0.0, -0.3, 0.0),
        right: Vector3::x(),
        out: -Vector3::y(),
        size: [length_m, 0.6, height],
    };
    hedge.block(&core, Cladding::all(leaves));
    foliage(&mut hedge, rng, (20.0 * length_m) as usize, |rng| {
        let (along, up) = (length_m * rng.uniform(), height * rng.uniform());
        let across = if rng.below(2) == 0 { -0.33 } else { 0.33 };
        match rng.below(3) {
            0 => Vector3::new(along, 0.66 * (rng.uniform() - 0.5), height),
            _ => Vector3::new(along, across, up),
        }
    });
    hedge
}

/// Adds clusters of leaves with random orientations.
fn foliage(
    plant: &mut Builder,
    rng: &mut Rng,
    count: usize,
    place: impl Fn(&mut Rng) -> Vector3<f64>,
) {
    let hue = [
        in_range(rng, 0.05, 0.12) as f32,
        in_range(rng, 0.11, 0.19) as f32,
        in_range(rng, 0.02, 0.05) as f32,
    ];
    for _ in 0..count {
        let color = scale(hue, in_range(rng, 0.5, 1.7) as f32);
        let leaves = plant.surface(Surface::new(Material::Leaves, color, seed(rng)));
        let u = Vector3::from_fn(|_, _| rng.normal()).normalize();
        let v = u.cross(&Vector3::from_fn(|_, _| rng.normal())).normalize();
        let size = [in_range(rng, 0.25, 0.6), in_range(rng, 0.2, 0.5)];
        let centre = place(rng);
        plant.disc(centre, u, v, size, leaves);
    }
}

/// A lamp post at the origin with its arm along +x.
pub(crate) fn lamp(rng: &mut Rng) -> Builder {
    let mut lamp = Builder::default();
    let steel = lamp.surface(Surface::new(Material::Plain, [0.24, 0.26, 0.25], seed(rng)));
    let bill = lamp.surface(Surface::new(Material::Sign, [0.5, 0.2, 0.1], seed(rng)));
    let post = |corner: Vector3<f64>, size: [f64; 3]| Block {
        corner,
        right: Vector3::y(),
        out: Vector3::x(),
        size,
    };
    lamp.block(&post(Vector3::new(0.06, -0.06, 0.0), [0.12, 0.12, 5.2]), Cladding::all(steel));
    let arm = post(Vector3::new(1.3, -0.12, 5.2), [0.24, 1.4, 0.1]);
    lamp.block(&arm, Cladding::all(steel));
    lamp.underside(&arm, steel);
    let has_bill = rng.below(2) == 0;
    if has_bill {
        lamp.quad(Vector3::new(0.07, -0.25, 1.2), Vector3::y(), Vector3::z(), [0.5, 0.7], bill);
    }
    lamp
}

/// A traffic sign, a bin or a bollard at the origin, facing −x.
pub(crate) fn street_sign(rng: &mut Rng) -> Builder {
    let mut sign = Builder::default();
    let steel = sign.surface(Surface::new(Material::Plain, [0.35, 0.36, 0.36], seed(rng)));
    let post = |side: f64, height: f64| Block {
        corner: Vector3::new(-0.5 * side, 0.5 * side, 0.0),
        right: -Vector3::y(),
        out: -Vector3::x(),
        size: [side, side, height],
    };
    match rng.below(3) {
        0 => {
            sign.block(&post(0.07, 2.6), Cladding::all(steel));
            let color = [[0.5, 0.03, 0.03], [0.03, 0.1, 0.45], [0.6, 0.5, 0.05]][rng.below(3)];
            let face = sign.surface(Surface::new(Material::Sign, color, seed(rng)));
            let centre = Vector3::new(-0.05, 0.0, 2.3);
            sign.disc(centre, -Vector3::y(), Vector3::z(), [0.65, 0.65], face);
        }
        1 => {
            let color = [[0.05, 0.2, 0.08], [0.35, 0.1, 0.05], [0.1, 0.1, 0.35]][rng.below(3)];
            let bin = sign.surface(Surface::new(Material::Boards, color, seed(rng)));
            sign.block(&post(0.5, in_range(rng, 0.8, 1.2)), Cladding::all(bin));
        }
        _ => sign.block(&post(0.16, 0.9), Cladding::all(steel)),
    }
    sign
}
