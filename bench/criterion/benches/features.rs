//! Time of feature extraction for several image sizes and options.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::Duration;
use tiepoint_features::{GrayView, Options, Sift};

/// Waves of six wavelengths, so that every octave has as many extrema as in a detailed photo.
fn texture(width: usize, height: usize) -> Vec<u8> {
    let value = |i: usize| {
        let (x, y) = ((i % width) as f32, (i / width) as f32);
        let mut sum = 128.0;
        for octave in 0..6 {
            let length = 5.0 * 1.8f32.powi(octave);
            let (a, b) = ((x + 0.3 * y) / length, (y - 0.4 * x) / length);
            sum += 22.0 * (a + (0.37 * b).sin() * 2.0).sin() * (b + (0.29 * a).cos() * 2.0).cos();
        }
        sum.clamp(0.0, 255.0) as u8
    };
    (0..width * height).map(value).collect()
}

fn bench(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("extract");
    group.sample_size(10).measurement_time(Duration::from_secs(4));
    for (width, height) in [(640, 480), (1920, 1080), (3072, 2048)] {
        let image = texture(width, height);
        let view = GrayView::new(&image, width, height);
        group.throughput(Throughput::Elements((width * height) as u64));
        for (name, first_octave, max_features) in
            [("default", -1, 8192), ("all octaves", -1, 1_000_000), ("not doubled", 0, 1_000_000)]
        {
            let options = Options { first_octave, max_features, ..Options::default() };
            let Ok(mut sift) = Sift::new(options) else { continue };
            group.bench_function(format!("{width}x{height} {name}"), |b| {
                b.iter(|| black_box(sift.extract(black_box(&view), None)));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
