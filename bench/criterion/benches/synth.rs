//! Time to render an image: 2000 × 1500 and 640 × 480 pixels through an action lens with a rolling
//! shutter and moving cars.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use tiepoint_synth::{Drive, DriveOptions, Effects, Mount, ViewDirection};

fn render(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("render");
    group.sample_size(10);
    for (width, height) in [(640, 480), (2000, 1500)] {
        for direction in [ViewDirection::Front, ViewDirection::Right] {
            let mounts = vec![Mount::facing(direction)];
            let effects = Effects::all();
            let options =
                DriveOptions { mounts, width, height, effects, ..DriveOptions::default() };
            let drive = Drive::new(&options).expect("the default drive can be driven");
            let renderer = drive.renderer(0);
            let exposure = &drive.cameras()[0].exposures[40];
            group.bench_function(format!("{} {width}x{height}", direction.name()), |bencher| {
                bencher
                    .iter(|| renderer.render(|y| drive.row_pose(0, black_box(exposure.time_s), y)));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, render);
criterion_main!(benches);
