use proptest::prelude::*;
use tiepoint_features::SiftDescriptor;
use tiepoint_simd::Rng;

use super::*;
use crate::brute::nearest_on;
use crate::match_sift::select;
use crate::random::stream;

/// A random descriptor similar to SIFT: a few edges, each interpolated over cells and directions,
/// with norm 512.
fn descriptor(random: &mut Rng) -> SiftDescriptor {
    const EDGES: usize = 8;
    let mut uniform = |end: f64| random.below(1000) as f64 / 1000.0 * end;
    let edges: [[f64; 4]; EDGES] = std::array::from_fn(|_| {
        [uniform(4.0) - 0.5, uniform(4.0) - 0.5, uniform(8.0), uniform(1.0)]
    });
    let share = |distance: f64| (1.0 - distance.abs() / 1.6).max(0.0);
    let entry = |k: usize| {
        let (row, column, direction) = ((k / 32) as f64, (k / 8 % 4) as f64, (k % 8) as f64);
        let of_edge = |&[y, x, angle, weight]: &[f64; 4]| {
            let difference = (direction - angle).rem_euclid(8.0);
            weight * share(row - y) * share(column - x) * share(difference.min(8.0 - difference))
        };
        edges.iter().map(of_edge).sum::<f64>() + 0.01
    };
    normalised(&std::array::from_fn(entry))
}

fn normalised(entries: &[f64; 128]) -> SiftDescriptor {
    let norm = entries.iter().map(|x| x * x).sum::<f64>().sqrt();
    entries.map(|x| (512.0 * x / norm).round().min(255.0) as u8)
}

/// `near` with noise.
fn similar(near: &SiftDescriptor, noise: usize, random: &mut Rng) -> SiftDescriptor {
    normalised(&near.map(|x| f64::from(x) + random.below(noise + 1) as f64))
}

/// Two images. Half of the descriptors of the second are those of the first with increasing noise.
/// Both images have duplicates.
fn images(len: [usize; 2], seed: u64) -> [Vec<SiftDescriptor>; 2] {
    let mut random = stream(seed, 0);
    let mut a: Vec<SiftDescriptor> = (0..len[0]).map(|_| descriptor(&mut random)).collect();
    for k in (0..len[0]).step_by(9) {
        a[k] = similar(&a[(k * 7 + 1) % len[0]], 5, &mut random);
    }
    let mut b: Vec<SiftDescriptor> = (0..len[1])
        .map(|k| match k % 2 {
            0 => similar(&a[(k * 31) % len[0]], k % 100, &mut random),
            _ => descriptor(&mut random),
        })
        .collect();
    for k in (0..len[1]).step_by(11) {
        b[k] = b[(k * 5 + 2) % len[1]];
    }
    [a, b]
}

/// Compares the matches with those of brute force on every instruction set.
fn check(a: &[SiftDescriptor], b: &[SiftDescriptor], options: &Options) {
    let (a, b) = (Prepared::new(a), Prepared::new(b));
    for isa in Isa::supported() {
        let expected = select(&nearest_on(isa, &a, &b), options);
        let acceptance = Acceptance::new(options);
        let found = match_with_limits(isa, &a, &b, &acceptance, usize::MAX);
        assert_eq!(found.as_ref(), Some(&expected), "{isa}");
        if let Some(found) = match_pruned(isa, &a, &b, options) {
            assert_eq!(found, expected, "{isa}");
        }
    }
}

#[test]
fn pruning_gives_the_matches_of_brute_force() {
    for (seed, len) in [(1, [600, 700]), (2, [1000, 521]), (3, [523, 1999])] {
        let [a, b] = images(len, seed);
        for (max_ratio, max_angle_rad) in
            [(Some(0.8), Some(0.7)), (Some(0.6), None), (Some(0.9), Some(0.4)), (None, Some(0.3))]
        {
            let options = Options { max_ratio, max_angle_rad, ..Options::default() };
            check(&a, &b, &options);
        }
    }
}

#[test]
fn pruning_of_any_descriptors() {
    let mut random = stream(9, 0);
    for levels in [2, 3, 256] {
        let mut image = |len: usize| -> Vec<SiftDescriptor> {
            (0..len)
                .map(|_| std::array::from_fn(|_| (random.below(levels) * 255 / (levels - 1)) as u8))
                .collect()
        };
        let (mut a, b) = (image(510), image(540));
        a[..200].copy_from_slice(&b[100..300]);
        check(&a, &b, &Options::default());
    }
    for (a, b) in [([7; 128], [7; 128]), ([7; 128], [0; 128]), ([255; 128], [0; 128])] {
        for max_ratio in [Some(0.8), Some(1.0), None] {
            let options = Options { max_ratio, max_angle_rad: None, ..Options::default() };
            check(&vec![a; 600], &vec![b; 600], &options);
            check(&[a], &vec![b; 600], &options);
            check(&[a], &[b], &options);
        }
    }
    check(&[], &[], &Options::default());
}

#[test]
fn equal_descriptors_take_few_distances_and_too_many_end() {
    let same = Prepared::new(&vec![[7; 128]; 600]);
    let acceptance = Acceptance::new(&Options::default());
    for isa in Isa::supported() {
        let found = |distances| match_with_limits(isa, &same, &same, &acceptance, distances);
        assert_eq!(found(4 * 600), Some(vec![]), "{isa}");
        assert_eq!(found(600), None, "{isa}");
        // Brute force takes less time for few columns.
        assert_eq!(
            match_pruned(isa, &same, &Prepared::new(&[[7; 128]]), &Options::default()),
            None
        );
    }
}

#[test]
fn many_rows_and_repeated_facades() {
    let [a, b] = images([20_000, 300], 4);
    check(&a, &b, &Options::default());
    // Thirty windows, seen 20 times in one image and 30 times in the other.
    let mut random = stream(5, 0);
    let windows: Vec<SiftDescriptor> = (0..30).map(|_| descriptor(&mut random)).collect();
    let mut seen = |times: usize, noise: usize| -> Vec<SiftDescriptor> {
        (0..30 * times).map(|k| similar(&windows[k % 30], noise, &mut random)).collect()
    };
    let (a, b) = (seen(20, 3), seen(30, 10));
    check(&a, &b, &Options::default());
    check(&a, &b, &Options { max_ratio: None, ..Options::default() });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn pruning_of_any_content(
        seed in any::<u64>(),
        rows in 1_usize..40,
        columns in 1_usize..90,
        levels in 2_usize..=256,
        noise in 0_usize..60,
        max_ratio in prop::option::of(0.3_f64..=1.0),
        max_angle_rad in prop::option::of(0.05_f64..3.0),
    ) {
        let mut random = stream(seed, 0);
        let [mut a, b] = images([rows, columns], seed);
        for row in &mut a {
            if random.below(2) == 0 {
                let level = |_| (random.below(levels) * 255 / (levels - 1)) as u8;
                *row = std::array::from_fn(level);
            } else {
                *row = similar(&b[random.below(columns)], noise, &mut random);
            }
        }
        check(&a, &b, &Options { max_ratio, max_angle_rad, ..Options::default() });
    }
}
