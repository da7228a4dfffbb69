use tiepoint_geometry::Rng;

use super::portable::Portable;
use super::{Isa, Ncc, OUTSIDE, PatchTable, RADIUS, Source, Task, Warp, dispatch};
use crate::Grey;

const WIDTH: usize = 120;
const HEIGHT: usize = 90;

/// A smooth image at an offset and a contrast.
fn image(x0: f64, y0: f64, contrast: f64) -> Grey {
    let level = |index: usize| {
        let (x, y) = ((index % WIDTH) as f64 + x0, (index / WIDTH) as f64 + y0);
        let wave = (0.31 * x).sin() + (0.23 * y + 0.1 * x).cos() + (0.17 * x * y / 40.0).sin();
        (128.0 + contrast * 36.0 * wave).round() as u8
    };
    Grey { width: WIDTH, height: HEIGHT, pixels: (0..WIDTH * HEIGHT).map(level).collect() }
}

fn shift(x: f32, y: f32, dx: f32, dy: f32) -> Warp {
    Warp { centre: [x + dx, y + dy, 1.0], dx: [1.0, 0.0, 0.0], dy: [0.0, 1.0, 0.0] }
}

#[test]
fn cost_is_smallest_at_the_true_shift_whatever_the_contrast() {
    let (reference, source) = (image(0.0, 0.0, 1.0), image(2.4, -1.25, 0.6));
    let (table, source) = (PatchTable::new(WIDTH), Source::new(&source));
    for (x, y) in [(20, 30), (60, 45), (90, 60), (33, 71)] {
        let patch = table.patch(&reference, x, y).unwrap();
        let cost =
            |dx: f32, dy: f32| Portable::cost(&source, &shift(x as f32, y as f32, dx, dy), &patch);
        let best = cost(-2.4, 1.25);
        assert!(best < 2e-3, "{best}");
        for (dx, dy) in [(0.2, 0.0), (-0.2, 0.0), (0.0, 0.2), (0.0, -0.2), (3.0, 3.0)] {
            assert!(cost(-2.4 + dx, 1.25 + dy) > best);
        }
    }
}

#[test]
fn flat_patches_and_samples_outside_have_no_correlation() {
    let flat = Grey { width: WIDTH, height: HEIGHT, pixels: vec![77; WIDTH * HEIGHT] };
    let table = PatchTable::new(WIDTH);
    assert!(table.patch(&flat, 40, 40).is_none());
    let patch = table.patch(&image(0.0, 0.0, 1.0), 40, 40).unwrap();
    assert_eq!(Portable::cost(&Source::new(&flat), &shift(40.0, 40.0, 0.0, 0.0), &patch), 1.0);
    let source = Source::new(&image(0.0, 0.0, 1.0));
    let behind = Warp { centre: [-40.0, -40.0, -1.0], dx: [-1.0, 0.0, 0.0], dy: [0.0, -1.0, 0.0] };
    let nowhere = Warp { centre: [f32::NAN; 3], ..behind };
    let (radius, last) = (RADIUS as f32, (HEIGHT - 1 - RADIUS) as f32);
    let left = shift(radius - 0.1, 40.0, 0.0, 0.0);
    let below = shift(40.0, last + 0.1, 0.0, 0.0);
    for warp in [left, below, behind, nowhere] {
        assert_eq!(Portable::cost(&source, &warp, &patch), OUTSIDE);
    }
    assert!(Portable::cost(&source, &shift(radius, last - 0.1, 0.0, 0.0), &patch) < OUTSIDE);
}

/// Costs of many patches on one instruction set.
struct Costs<'a>(&'a Grey, &'a Source);

impl Task for Costs<'_> {
    type Output = Vec<u32>;

    #[inline(always)]
    fn run<N: Ncc>(self) -> Vec<u32> {
        let Self(reference, source) = self;
        let table = PatchTable::new(WIDTH);
        let mut rng = Rng::stream(3, &[]);
        let mut random = |from: f64, to: f64| (from + (to - from) * rng.uniform()) as f32;
        let mut costs = Vec::new();
        for _ in 0..20_000 {
            let (x, y) = (random(0.0, WIDTH as f64), random(0.0, HEIGHT as f64));
            let scale = random(0.5, 2.0);
            let at = [x + random(-9.0, 9.0), y + random(-9.0, 9.0), 1.0];
            let warp = Warp {
                centre: at.map(|value| value * scale),
                dx: [random(0.5, 1.5), random(-0.3, 0.3), random(-0.01, 0.01)].map(|d| d * scale),
                dy: [random(-0.3, 0.3), random(0.5, 1.5), random(-0.01, 0.01)].map(|d| d * scale),
            };
            let patch = table.patch(reference, x as usize, y as usize).unwrap();
            costs.push(N::cost(source, &warp, &patch).to_bits());
        }
        costs
    }
}

#[test]
fn costs_have_the_same_bits_on_every_instruction_set() {
    let (reference, source) = (image(0.0, 0.0, 1.0), image(1.3, 0.2, 0.8));
    let source = Source::new(&source);
    let sets = Isa::available();
    let portable = dispatch(*sets.last().unwrap(), Costs(&reference, &source));
    let inside = portable.iter().filter(|bits| **bits != OUTSIDE.to_bits()).count();
    assert!(inside > portable.len() / 2 && inside < portable.len());
    for isa in sets {
        assert_eq!(dispatch(isa, Costs(&reference, &source)), portable, "{isa:?}");
    }
}
