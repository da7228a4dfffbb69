//! Comparison of the kernels with a triple loop, on every instruction set of the CPU.

use proptest::prelude::*;
use tiepoint_features::SiftDescriptor;
use tiepoint_matching::sift::{Isa, Nearest, NearestBothWays, Prepared, nearest, nearest_on};
use tiepoint_matching::{Match, Options};
use tiepoint_simd::Rng;

use crate::match_sift;

/// The reference implementation.
fn triple_loop(a: &[SiftDescriptor], b: &[SiftDescriptor]) -> NearestBothWays {
    let one_way = |from: &[SiftDescriptor], to: &[SiftDescriptor]| {
        let nearest_of = |x: &SiftDescriptor| {
            let mut found = Nearest::NONE;
            for (index, y) in to.iter().enumerate() {
                let mut distance = 0;
                for k in 0..128 {
                    let difference = i32::from(x[k]) - i32::from(y[k]);
                    distance += (difference * difference) as u32;
                }
                if distance < found.distance {
                    found = Nearest { index: index as u32, distance, second: found.distance };
                } else if distance < found.second {
                    found.second = distance;
                }
            }
            found
        };
        from.iter().map(nearest_of).collect()
    };
    NearestBothWays { of_a: one_way(a, b), of_b: one_way(b, a) }
}

fn check(a: &[SiftDescriptor], b: &[SiftDescriptor]) {
    let expected = triple_loop(a, b);
    let (a, b) = (Prepared::new(a), Prepared::new(b));
    for isa in Isa::supported() {
        let found = nearest_on(isa, &a, &b);
        assert_eq!(found.of_a, expected.of_a, "{isa}, {} x {}", a.len(), b.len());
        assert_eq!(found.of_b, expected.of_b, "{isa}, {} x {}", a.len(), b.len());
    }
    assert_eq!(nearest(&a, &b), expected);
}

fn random_numbers(seed: u64) -> impl FnMut() -> u64 {
    let mut rng = Rng::from_state(seed);
    move || rng.next_u64()
}

/// Random descriptors with `levels` equally spaced values per byte: 2 gives 0 and 255, 256 gives
/// all.
fn descriptors(count: usize, levels: u64, seed: u64) -> Vec<SiftDescriptor> {
    let mut next = random_numbers(seed);
    let mut byte = || (next() % levels * 255 / (levels - 1).max(1)) as u8;
    (0..count).map(|_| std::array::from_fn(|_| byte())).collect()
}

#[test]
fn sizes_around_all_block_boundaries() {
    // Lanes are 4, 8, 16; tiles 8, 16, 64 columns and 4 or 6 rows; row blocks 96.
    let sizes = [0, 1, 2, 3, 5, 6, 7, 8, 15, 16, 17, 31, 33, 63, 64, 65, 95, 96, 97, 130, 193];
    for (k, &n) in sizes.iter().enumerate() {
        for (l, &m) in sizes.iter().enumerate() {
            check(&descriptors(n, 256, k as u64), &descriptors(m, 256, 100 + l as u64));
        }
    }
}

#[test]
fn more_columns_than_a_key_can_index() {
    // Keys index 256 vectors: 4096 columns for AVX-512, 2048 for AVX2, 1024 for the portable
    // kernel. Few levels give equal distances.
    for (n, m, levels) in [(7, 4096 + 70, 256), (100, 2048 + 9, 3), (13, 9000, 2)] {
        let (mut a, mut b) = (descriptors(n, levels, 1), descriptors(m, levels, 2));
        check(&a, &b);
        // Equal neighbours in the first column of a merge and in the last column of the previous
        // one.
        a[0] = b[1023];
        for copy in [1024, 2047, 2048, 4095, 4096] {
            if copy < m {
                b[copy] = b[1023];
            }
        }
        check(&a, &b);
        check(&b, &a);
    }
}

#[test]
fn equal_descriptors_give_the_lowest_index() {
    let a = vec![[7; 128]; 300];
    let b = vec![[9; 128]; 5000];
    check(&a, &b);
    for nearest in nearest(&Prepared::new(&a), &Prepared::new(&b)).of_a {
        assert_eq!(nearest, Nearest { index: 0, distance: 4 * 128, second: 4 * 128 });
    }
}

#[test]
fn extreme_bytes() {
    let extremes: Vec<SiftDescriptor> =
        [0, 1, 127, 128, 129, 254, 255].into_iter().map(|x| [x; 128]).collect();
    check(&extremes, &extremes);
    for one in &extremes {
        for other in &extremes {
            check(&[*one], &[*other]);
            check(&vec![*one; 100], &vec![*other; 70]);
        }
    }
    check(&descriptors(97, 2, 5), &descriptors(65, 2, 6));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_content(
        a in prop::collection::vec(prop::collection::vec(any::<u8>(), 128), 0..40),
        b in prop::collection::vec(prop::collection::vec(any::<u8>(), 128), 0..90),
        copies in prop::collection::vec(
            (any::<prop::sample::Index>(), any::<prop::sample::Index>()),
            0..8,
        ),
    ) {
        let fixed = |list: &[Vec<u8>]| {
            list.iter().map(|d| d.as_slice().try_into().unwrap()).collect::<Vec<SiftDescriptor>>()
        };
        let (a, mut b) = (fixed(&a), fixed(&b));
        for (from, to) in copies {
            if !a.is_empty() && !b.is_empty() {
                let to = to.index(b.len());
                b[to] = a[from.index(a.len())];
            }
        }
        check(&a, &b);
    }

    #[test]
    fn matches_by_the_definition(
        a in prop::collection::vec(prop::collection::vec(0u8..120, 8), 0..30),
        b in prop::collection::vec(prop::collection::vec(0u8..120, 8), 0..30),
        mutual in any::<bool>(),
        max_ratio in prop::option::of(0.3f64..1.0),
        max_angle_rad in prop::option::of(0.05f64..0.7),
    ) {
        let padded = |list: &[Vec<u8>]| {
            list.iter()
                .map(|d| std::array::from_fn(|k| *d.get(k).unwrap_or(&0)))
                .collect::<Vec<SiftDescriptor>>()
        };
        let (a, b) = (padded(&a), padded(&b));
        let options =
            Options { max_ratio, max_angle_rad, mutual, preempt: None, ..Options::default() };
        let nearest = triple_loop(&a, &b);
        let angle =
            |distance: u32| 2.0 * (f64::from(distance).sqrt() / 1024.0).min(0.5f64.sqrt()).asin();
        let passes = |n: &Nearest| {
            n.index != u32::MAX
                && max_angle_rad.is_none_or(|max| angle(n.distance) <= max)
                && max_ratio.is_none_or(|r| angle(n.distance) < r * angle(n.second))
        };
        let mut expected = Vec::new();
        for (i, n) in nearest.of_a.iter().enumerate() {
            if passes(n)
                && (!mutual
                    || (nearest.of_b[n.index as usize].index == i as u32
                        && passes(&nearest.of_b[n.index as usize])))
            {
                expected.push(Match { a: i as u32, b: n.index, distance: n.distance.into() });
            }
        }
        prop_assert_eq!(match_sift(&a, &b, &options), expected);
    }
}

#[test]
fn empty_images_and_zero_descriptors() {
    let options = Options::default();
    assert_eq!(match_sift(&[], &[], &options), []);
    assert_eq!(match_sift(&[[1; 128]], &[], &options), []);
    assert_eq!(match_sift(&[], &[[1; 128]], &options), []);
    assert_eq!(
        match_sift(&[[0; 128]], &[[0; 128]], &options),
        [Match { a: 0, b: 0, distance: 0.0 }]
    );
    // Two equal candidates fail the ratio test.
    assert_eq!(match_sift(&[[0; 128]], &[[0; 128]; 2], &options), []);
}
