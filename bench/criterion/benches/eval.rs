//! Distances of a cloud of 100 000 points to a scan of a million, and relative poses of all pairs
//! of 500 cameras.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use tiepoint_eval::{Cloud, auc, relative_pose_errors_rad};
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{Rigid3, Rng};

fn evaluation(criterion: &mut Criterion) {
    let mut rng = Rng::stream(1, &[]);
    let mut vector = |scale: f64| Vector3::new(rng.normal(), rng.normal(), rng.normal()) * scale;
    let scan: Vec<_> = (0..1_000_000).map(|_| vector(50.0)).collect();
    let cloud: Vec<_> = (0..100_000).map(|_| vector(50.0)).collect();
    let truth: Vec<_> =
        (0..500).map(|_| Rigid3::from_axis_angle(vector(1.0), vector(10.0))).collect();
    let model: Vec<_> = truth.iter().copied().map(Some).collect();
    let mut group = criterion.benchmark_group("eval");
    group.sample_size(10);
    group.bench_function("index a million points", |b| {
        b.iter(|| black_box(Cloud::new(scan.clone())))
    });
    let indexed = Cloud::new(scan.clone()).expect("finite points");
    group.bench_function("distances of 100 000 points", |b| {
        b.iter(|| black_box(indexed.distances_of(&cloud)))
    });
    group.bench_function("AUC of 500 cameras", |b| {
        b.iter(|| auc(&relative_pose_errors_rad(&model, &truth, 0.0), 5f64.to_radians()));
    });
    group.finish();
}

criterion_group!(benches, evaluation);
criterion_main!(benches);
