//! Exact nearest neighbours, both directions, one core, on every instruction set of this machine.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use tiepoint_features::Descriptor;
use tiepoint_matching::{Isa, Options, Prepared, match_prepared, nearest_on};

/// COLMAP's and our maximum of features in an image.
const FEATURES: usize = 8192;

/// Bytes without structure: brute force takes the same time whatever they are.
fn descriptors(seed: u64) -> Vec<Descriptor> {
    let mut state = seed;
    let mut byte = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
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
        bencher.iter(|| match_prepared(black_box(&packed_a), black_box(&packed_b), &Options::default()));
    });
    group.bench_function("packing one image", |bencher| bencher.iter(|| Prepared::new(black_box(&a))));
    group.finish();
}

criterion_group!(benches, brute_force);
criterion_main!(benches);
