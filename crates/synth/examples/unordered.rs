//! Photos in no order with the pairs that see the same points, for `bench/pairs.py`.
//!
//! ```text
//! cargo run --release -p tiepoint-synth --example unordered -- FOLDER [PHOTOS] [SEED]
//! ```
//!
//! Five cameras (front, front-right, right, rear, left) drive one and a half loops around a block.
//! PHOTOS of their images are drawn at random and written as `FOLDER/photos/NNNN.jpg`, numbered in
//! random order. `FOLDER/truth.csv` has a line `image1,image2,points` for every pair with common
//! points: `FeatureScene` draws about a thousand points of each image from its pixels, and tests
//! which other images see them (occlusion, scale, viewing angle).

#![allow(clippy::print_stdout)]

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use rayon::prelude::*;
use tiepoint_geometry::Rng;
use tiepoint_synth::image::{DynamicImage, codecs::jpeg::JpegEncoder};
use tiepoint_synth::trajectory::Motion;
use tiepoint_synth::{
    Drive, DriveOptions, FeatureOptions, FeatureScene, Mount, RouteKind, ViewDirection,
};

/// Length of the loop for each photo, in metres.
const METRES_PER_PHOTO: f64 = 0.3;
/// Observations of points in an image.
const OBSERVATIONS: usize = 1000;
const JPEG_QUALITY: u8 = 92;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(arguments.first().ok_or("usage: unordered FOLDER [PHOTOS] [SEED]")?);
    let count: usize = arguments.get(1).map_or(Ok(1000), |text| text.parse())?;
    let seed: u64 = arguments.get(2).map_or(Ok(1), |text| text.parse())?;
    let length_m = METRES_PER_PHOTO * count as f64;
    let drive = Drive::new(&DriveOptions {
        seed,
        route: RouteKind::Loop,
        length_m,
        mounts: ViewDirection::ALL.map(Mount::facing).to_vec(),
        motion: Motion { overlap_m: 0.5 * length_m, ..Motion::default() },
        effects: "all".parse()?,
        rate_hz: 5.0,
        ..DriveOptions::default()
    })?;
    let truth = drive.truth();
    let names: Vec<&str> = truth.images().map(|(_, image)| image.name.as_str()).collect();
    // The place of each image in the random order; the first `count` are written.
    let mut order: Vec<usize> = (0..names.len()).collect();
    let mut rng = Rng::stream(seed, &[1]);
    for end in (2..=order.len()).rev() {
        order.swap(end - 1, rng.below(end));
    }
    let mut number = vec![None; names.len()];
    order.iter().take(count).enumerate().for_each(|(place, &image)| number[image] = Some(place));

    let photos = folder.join("photos");
    std::fs::create_dir_all(&photos)?;
    let renderers: Vec<_> =
        (0..drive.cameras().len()).map(|camera| drive.renderer(camera)).collect();
    let write = |(&name, number): (&&str, &Option<usize>)| -> Result<(), String> {
        let Some(number) = number else { return Ok(()) };
        let (camera, exposure) = drive.find(name).ok_or("no such image")?;
        let image = DynamicImage::from(drive.render(camera, exposure, &renderers[camera]));
        let path = photos.join(format!("{number:04}.jpg"));
        let file = std::fs::File::create(path).map_err(|error| error.to_string())?;
        let encoder = JpegEncoder::new_with_quality(file, JPEG_QUALITY);
        image.write_with_encoder(encoder).map_err(|error| error.to_string())
    };
    names.par_iter().zip(&number).try_for_each(write)?;

    let options = FeatureOptions {
        seed,
        observations: OBSERVATIONS * names.len(),
        ..FeatureOptions::default()
    };
    let scene = FeatureScene::new(&drive, &options)?;
    let mut common: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (_, track) in scene.truth().tracks() {
        let mut seen: Vec<usize> =
            track.observations.iter().filter_map(|o| number[o.image.index()]).collect();
        seen.sort_unstable();
        seen.dedup();
        for (k, &a) in seen.iter().enumerate() {
            seen[k + 1..].iter().for_each(|&b| *common.entry((a, b)).or_default() += 1);
        }
    }
    let mut text = String::from("image1,image2,points\n");
    for ((a, b), points) in &common {
        writeln!(text, "{a:04}.jpg,{b:04}.jpg,{points}")?;
    }
    std::fs::write(folder.join("truth.csv"), text)?;
    println!("{count} photos of {} images, {} pairs with common points", names.len(), common.len());
    Ok(())
}
