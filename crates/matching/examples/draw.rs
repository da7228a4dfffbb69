//! Draws the matches of two photos side by side. Lines are coloured by their position in the first
//! photo, so that wrong matches are visible.
//!
//! `cargo run --release -p tiepoint-matching --example draw -- a.jpg b.jpg matches.png [MAX_LINES]`

#![expect(clippy::print_stdout, reason = "an example is a program")]

use std::error::Error;

use image::{DynamicImage, GrayImage, Rgb, RgbImage, imageops};
use tiepoint_features::{Features, GrayView, extract};
use tiepoint_matching::{Options, match_features};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (a, b, output, max) = match arguments.as_slice() {
        [a, b, output] => (a, b, output, usize::MAX),
        [a, b, output, max] => (a, b, output, max.parse()?),
        _ => return Err("usage: draw A B OUTPUT.png [MAX_LINES]".into()),
    };
    let (a, b) = (read(a)?, read(b)?);
    let (features_a, features_b) = (features(&a)?, features(&b)?);
    let options = Options::default();
    let mut matches = match_features(&features_a.descriptors, &features_b.descriptors, &options);
    println!(
        "{} matches of {} and {} features",
        matches.len(),
        features_a.keypoints.len(),
        features_b.keypoints.len()
    );
    // Matches of the smallest distances are drawn last, over the others.
    matches.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    matches.truncate(max);
    let mut canvas = RgbImage::new(a.width() + b.width(), a.height().max(b.height()));
    imageops::replace(&mut canvas, &DynamicImage::from(a.clone()).to_rgb8(), 0, 0);
    imageops::replace(&mut canvas, &DynamicImage::from(b).to_rgb8(), i64::from(a.width()), 0);
    for m in matches.iter().rev() {
        let (p, q) = (features_a.keypoints[m.a as usize], features_b.keypoints[m.b as usize]);
        let colour = colour(p.x / a.width() as f32, p.y / a.height() as f32);
        line(&mut canvas, (p.x, p.y), (q.x + a.width() as f32, q.y), colour);
    }
    canvas.save(output)?;
    Ok(())
}

fn read(path: &str) -> Result<GrayImage, Box<dyn Error>> {
    Ok(image::open(path).map_err(|error| format!("{path}: {error}"))?.to_luma8())
}

fn features(image: &GrayImage) -> Result<Features, Box<dyn Error>> {
    let view = GrayView::new(image.as_raw(), image.width() as usize, image.height() as usize);
    Ok(extract(&view, &tiepoint_features::Options::default())?)
}

/// A colour for a position in the unit square. Near positions have similar colours.
fn colour(x: f32, y: f32) -> Rgb<u8> {
    let wave =
        |phase: f32| (255.0 * (0.5 + 0.5 * (std::f32::consts::TAU * (y + phase)).sin())) as u8;
    Rgb([wave(0.0), wave(1.0 / 3.0), (255.0 * x) as u8])
}

fn line(canvas: &mut RgbImage, from: (f32, f32), to: (f32, f32), colour: Rgb<u8>) {
    // Lines stay visible if the image is downscaled.
    let thickness = (canvas.width() / 1500).max(1);
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let steps = dx.abs().max(dy.abs()).ceil().max(1.0);
    for step in 0..=steps as u32 {
        let t = step as f32 / steps;
        let (x, y) = ((from.0 + t * dx) as u32, (from.1 + t * dy) as u32);
        for (x, y) in (0..thickness * thickness).map(|k| (x + k % thickness, y + k / thickness)) {
            if x < canvas.width() && y < canvas.height() {
                canvas.put_pixel(x, y, colour);
            }
        }
    }
}
