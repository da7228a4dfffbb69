//! Time to read and write a model of 100 images with 4096 keypoints each, and to decode a photo.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_io::colmap::{Format, read_model, write_model};
use tiepoint_scene::{Camera, Image, ImageId, Keypoint, Observation, Reconstruction, Track};
use tiepoint_input::{Luma, Rgb};

const IMAGES: u32 = 100;
const KEYPOINTS: u32 = 4096;

/// Every second keypoint observes a point; tracks have five observations.
fn model() -> Reconstruction {
    let mut rng = Rng::stream(1, &[]);
    let mut model = Reconstruction::default();
    let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, 1000.0, 1920, 1080);
    let camera =
        model.add_camera(Camera { intrinsics, width: 1920, height: 1080, has_focal_prior: false });
    for index in 0..IMAGES {
        let keypoint = |_| Keypoint {
            pixel: Vector2::new(1920.0 * rng.uniform(), 1080.0 * rng.uniform()),
            scale_px: 2.0,
        };
        let keypoints = (0..KEYPOINTS).map(keypoint).collect();
        let image = model.add_image(Image::new(format!("{index:06}.jpg"), camera, keypoints));
        model.register(image, Rigid3::identity());
    }
    for first in (0..IMAGES).step_by(5) {
        for keypoint in (0..KEYPOINTS).step_by(2) {
            let seen =
                (first..first + 5).map(|image| Observation { image: ImageId(image), keypoint });
            let xyz = Vector3::new(rng.normal(), rng.normal(), 5.0 + rng.uniform());
            model.add_track(Track::new(xyz, seen.collect()));
        }
    }
    model
}

fn models(criterion: &mut Criterion) {
    let model = model();
    let dir = std::env::temp_dir().join(format!("tiepoint-bench-{}", std::process::id()));
    for (format, name) in [(Format::Binary, "binary"), (Format::Text, "text")] {
        let dir = dir.join(name);
        let mut group = criterion.benchmark_group(name);
        group.throughput(Throughput::Elements(u64::from(IMAGES * KEYPOINTS))).sample_size(10);
        group.bench_function("write", |b| b.iter(|| write_model(&dir, &model, format)));
        group.bench_function("read", |b| b.iter(|| black_box(read_model(&dir))));
        group.finish();
    }
    // A failure to remove the folder is ignored.
    let _ = std::fs::remove_dir_all(dir);
}

fn photo(criterion: &mut Criterion) {
    let (width, height) = (3072, 2048);
    let noisy =
        |x: u32, y: u32| [(x / 7) as u8 ^ (y / 5) as u8, (x * y / 1000) as u8, (y / 9) as u8];
    let image = image::RgbImage::from_fn(width, height, |x, y| image::Rgb(noisy(x, y)));
    let path = std::env::temp_dir().join(format!("tiepoint-bench-{}.jpg", std::process::id()));
    image.save(&path).expect("the folder for temporary files can be written");
    let mut group = criterion.benchmark_group("jpeg 3072 × 2048");
    group.sample_size(20);
    group.bench_function("luma", |b| b.iter(|| black_box(Luma::read(&path))));
    group.bench_function("rgb", |b| b.iter(|| black_box(Rgb::read(&path))));
    group.finish();
    let _ = std::fs::remove_file(path);
}

criterion_group!(benches, models, photo);
criterion_main!(benches);
