//! Time on one core of brute force in both directions on every instruction set of the CPU, of a
//! kd-forest and of guided matching. `bench/matching.py` measures time and recall on photos.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use tiepoint_features::{Features, Keypoint, SiftDescriptor};
use tiepoint_matching::forest::{Checks, Forest, ForestOptions};
use tiepoint_matching::sift::{Isa, Prepared, match_prepared, nearest_on};
use tiepoint_matching::{EpipolarGuide, Options, match_guided};

/// Number of features: the default maximum of COLMAP and of `tiepoint-features`.
const FEATURES: usize = 8192;

/// Random bytes: the time of brute force does not depend on the values.
fn descriptors(seed: u64) -> Vec<SiftDescriptor> {
    let mut state = seed;
    let mut byte = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 57) as u8
    };
    (0..FEATURES).map(|_| std::array::from_fn(|_| byte())).collect()
}

fn brute_force(criterion: &mut Criterion) {
    let (a, b) = (descriptors(1), descriptors(2));
    let mut group = criterion.benchmark_group("brute force 8192 x 8192, both directions");
    group.sample_size(10).throughput(Throughput::Elements((FEATURES * FEATURES) as u64));
    let (packed_a, packed_b) = (Prepared::new(&a), Prepared::new(&b));
    for isa in Isa::supported() {
        group.bench_function(BenchmarkId::from_parameter(isa), |bencher| {
            bencher.iter(|| nearest_on(isa, black_box(&packed_a), black_box(&packed_b)));
        });
    }
    group.bench_function("with ratio and mutual test", |bencher| {
        bencher.iter(|| {
            match_prepared(black_box(&packed_a), black_box(&packed_b), &Options::default())
        });
    });
    group.bench_function("packing one image", |bencher| {
        bencher.iter(|| Prepared::new(black_box(&a)))
    });
    group.finish();
}

fn forest(criterion: &mut Criterion) {
    let (a, b) = (descriptors(1), descriptors(2));
    let mut group = criterion.benchmark_group("forest of 8 trees, 8192 points");
    group.sample_size(10);
    group.bench_function("growing", |bencher| {
        bencher.iter(|| Forest::new(black_box(&b), &ForestOptions::default()));
    });
    let forest = Forest::new(&b, &ForestOptions::default());
    group.throughput(Throughput::Elements(FEATURES as u64));
    for checks in [32, 64, 128] {
        group.bench_function(BenchmarkId::new("8192 queries, checks", checks), |bencher| {
            bencher.iter(|| forest.nearest(black_box(&a), Checks::Total(checks)));
        });
    }
    group.finish();
}

fn guided(criterion: &mut Criterion) {
    // Images of 3000 x 2000 pixels with a translation along x.
    let features = |seed| {
        let descriptors = descriptors(seed);
        let keypoint = |d: &SiftDescriptor| {
            let fraction = |at: usize| (f32::from(d[at]) + f32::from(d[at + 1]) / 128.0) / 128.0;
            Keypoint {
                x: 3000.0 * fraction(0),
                y: 2000.0 * fraction(2),
                scale: 2.0,
                orientation: 0.0,
            }
        };
        let keypoints = descriptors.iter().map(keypoint).collect();
        Features { keypoints, descriptors: descriptors.into() }
    };
    let (a, b) = (features(1), features(2));
    let fundamental = [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];
    let guide = EpipolarGuide { fundamental, max_error_px: 4.0 };
    criterion.bench_function("guided, 8192 x 8192", |bencher| {
        bencher.iter(|| match_guided(black_box(&a), black_box(&b), &guide, &Options::default()));
    });
}

criterion_group!(benches, brute_force, forest, guided);
criterion_main!(benches);
