//! Houses: boxes with windows and doors in their walls, and parts attached to the front.

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::Vector3;

use super::builder::{Block, Builder, Cladding};
use super::furniture::{in_range, seed};
use super::material::{Material, Surface, scale};
use super::quad::Relief;

const WALLS: [(Material, [f32; 3]); 9] = [
    (Material::Brick, [0.36, 0.14, 0.09]),
    (Material::Brick, [0.40, 0.27, 0.16]),
    (Material::Brick, [0.27, 0.16, 0.13]),
    (Material::Plaster, [0.55, 0.47, 0.33]),
    (Material::Plaster, [0.52, 0.50, 0.46]),
    (Material::Plaster, [0.48, 0.33, 0.25]),
    (Material::Stone, [0.44, 0.40, 0.33]),
    (Material::Concrete, [0.40, 0.40, 0.39]),
    (Material::Boards, [0.30, 0.36, 0.38]),
];

/// The appearance of a house: equal styles give identical houses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Style {
    pub(crate) seed: u64,
    pub(crate) floors: i32,
}

impl Style {
    pub(crate) fn sample(rng: &mut Rng) -> Self {
        Self { seed: rng.next_u64(), floors: 1 + rng.below(4) as i32 }
    }
}

/// Builds a house on a lot, which gives place, width and depth; the height follows from the style.
pub(crate) fn house(world: &mut Builder, lot: &Block, style: Style) {
    let mut rng = Rng::stream(style.seed, &[]);
    let (material, color) = WALLS[rng.below(WALLS.len())];
    let color = scale(color, in_range(&mut rng, 0.8, 1.25) as f32);
    let ground_m = in_range(&mut rng, 3.2, 4.2);
    let floor_m = in_range(&mut rng, 2.7, 3.3);
    let width_m = in_range(&mut rng, 1.9, 3.4);
    let opening_width = in_range(&mut rng, 0.45, 0.65) * width_m;
    let sill = in_range(&mut rng, 0.7, 1.0);
    let opening_height = in_range(&mut rng, 1.2, floor_m - sill - 0.25);
    let is_shop = rng.below(2) == 0;
    let depth_m = in_range(&mut rng, 0.12, 0.3);
    let relief = |length: f64, has_ground: bool| {
        let columns = ((length - 0.6) / width_m).floor().max(0.0);
        let left = 0.5 * (width_m - opening_width);
        let ground = match (has_ground, is_shop) {
            (false, _) => [1.0, 1.0, 0.0, 0.0],
            (true, true) => [0.15, 0.0, width_m - 0.15, ground_m - 0.8],
            (true, false) => [left, 0.0, left + opening_width, ground_m - 1.0],
        };
        Relief {
            columns: columns as i32,
            floors: style.floors,
            cell_m: [width_m, floor_m],
            ground_m,
            margin_m: 0.5 * (length - columns * width_m),
            opening_m: [left, sill, left + opening_width, sill + opening_height],
            ground_opening_m: ground,
            depth_m,
        }
    };
    let height = ground_m + f64::from(style.floors) * floor_m + 0.4;
    let [width, depth, _] = lot.size;
    let block = Block { size: [width, depth, height], ..*lot };
    let wall_seed = seed(&mut rng);
    let wall = Surface::new(material, color, wall_seed);
    let (front_relief, side_relief) = (relief(width, true), relief(depth, false));
    let front = world.surface(Surface { relief: Some(front_relief), ..wall });
    let sides = world.surface(Surface { relief: Some(side_relief), seed: wall_seed ^ 1, ..wall });
    let roof = world.surface(Surface::new(Material::Plain, [0.17, 0.15, 0.14], seed(&mut rng)));
    world.block(&block, Cladding { front, sides, top: roof });

    let trim_color = [[0.6, 0.59, 0.56], [0.33, 0.32, 0.3], [0.2, 0.13, 0.1]][rng.below(3)];
    let trim = world.surface(Surface::new(Material::Plain, trim_color, seed(&mut rng)));
    let fixed = |world: &mut Builder, right: f64, up: f64, size: [f64; 3], surface: u32| {
        let part = block.attached(right, up, size[1], size);
        world.block(&part, Cladding::all(surface));
        world.underside(&part, surface);
    };
    // A cornice around the roof, and a ledge above the ground floor.
    let cornice = in_range(&mut rng, 0.15, 0.45);
    let eaves = block.attached(-0.05, height, cornice, [width + 0.1, depth + cornice, 0.28]);
    world.block(&eaves, Cladding::all(trim));
    world.underside(&eaves, trim);
    if rng.below(2) == 0 {
        fixed(world, 0.0, ground_m - 0.1, [width, 0.12, 0.22], trim);
    }
    if rng.below(3) > 0 {
        fixed(world, 0.12, 0.0, [0.11, 0.11, height], trim);
    }
    if rng.below(3) > 0 {
        let chimney = block.attached(
            0.2 * width,
            height + 0.28,
            -0.3 * depth,
            [0.9, 0.7, in_range(&mut rng, 0.8, 1.8)],
        );
        world.block(&chimney, Cladding::all(sides));
    }
    let has_sills = rng.below(3) > 0;
    let balcony_every = 2 + rng.below(5) as i32;
    let has_balconies = rng.below(3) == 0 && style.floors >= 2;
    for column in 0..front_relief.columns {
        for floor in 0..style.floors {
            let left =
                front_relief.margin_m + f64::from(column) * width_m + front_relief.opening_m[0];
            let bottom = ground_m + f64::from(floor) * floor_m;
            if has_balconies && (column + 2 * floor) % balcony_every == 0 {
                fixed(world, left - 0.3, bottom + 0.05, [opening_width + 0.6, 0.9, 0.14], trim);
                fixed(world, left - 0.3, bottom + 0.45, [opening_width + 0.6, 0.05, 0.55], trim);
            } else if has_sills {
                fixed(
                    world,
                    left - 0.1,
                    bottom + sill - 0.09,
                    [opening_width + 0.2, 0.14, 0.09],
                    trim,
                );
            }
        }
    }
    if is_shop {
        let sign_color = [
            [0.05, 0.12, 0.3],
            [0.4, 0.05, 0.05],
            [0.06, 0.2, 0.1],
            [0.1, 0.1, 0.1],
            [0.5, 0.35, 0.05],
        ];
        let sign =
            world.surface(Surface::new(Material::Sign, sign_color[rng.below(5)], seed(&mut rng)));
        let length = in_range(&mut rng, 0.4, 0.9) * width;
        let left = in_range(&mut rng, 0.0, width - length);
        let board = block.attached(left, ground_m - 0.75, 0.12, [length, 0.12, 0.62]);
        world.block(&board, Cladding { front: sign, sides: trim, top: trim });
        world.underside(&board, trim);
        if rng.below(2) == 0 {
            // A projecting sign, perpendicular to the front.
            let arm = block.attached(left + 0.5 * length, ground_m + 0.2, 0.95, [0.1, 0.8, 0.7]);
            world.block(&arm, Cladding { front: trim, sides: sign, top: trim });
        }
    }
    // A painted or pasted advertisement on the side wall.
    if rng.below(3) == 0 && depth > 5.0 {
        let color = [[0.45, 0.12, 0.1], [0.1, 0.2, 0.4], [0.5, 0.42, 0.12]][rng.below(3)];
        let bill = world.surface(Surface::new(Material::Sign, color, seed(&mut rng) | 1));
        let origin = block.point(width, in_range(&mut rng, 0.8, 2.0), -1.0) + block.right * 0.03;
        world.quad(origin, -block.out, Vector3::z(), [3.0, 2.0], bill);
    }
}
