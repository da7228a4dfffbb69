//! Draws the keypoints of a photo as circles proportional to the scale, with a radius along the
//! orientation.
//!
//! `cargo run --release -p tiepoint-features --example keypoints -- photo.jpg keypoints.png`

#![allow(clippy::print_stdout)] // A program.

use image::{Rgb, RgbImage};
use tiepoint_features::{GrayView, Keypoint, Options, extract};

/// Radius of the circles over the scale: the side of a descriptor cell.
const RADIUS_IN_SCALES: f32 = 3.0;

fn dot(canvas: &mut RgbImage, x: f32, y: f32, colour: Rgb<u8>) {
    if x >= 0.0 && y >= 0.0 && x < canvas.width() as f32 && y < canvas.height() as f32 {
        canvas.put_pixel(x as u32, y as u32, colour);
    }
}

fn draw(canvas: &mut RgbImage, keypoint: &Keypoint) {
    let radius = RADIUS_IN_SCALES * keypoint.scale;
    let steps = (std::f32::consts::TAU * radius).ceil().max(8.0) as usize;
    for i in 0..steps {
        let (sin, cos) = (std::f32::consts::TAU * i as f32 / steps as f32).sin_cos();
        dot(canvas, keypoint.x + radius * cos, keypoint.y + radius * sin, Rgb([255, 220, 0]));
    }
    let (sin, cos) = keypoint.orientation.sin_cos();
    for i in 0..=radius as usize {
        dot(canvas, keypoint.x + i as f32 * cos, keypoint.y + i as f32 * sin, Rgb([0, 255, 120]));
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let (Some(input), Some(output)) = (args.next(), args.next()) else {
        return Err("usage: keypoints PHOTO OUTPUT.png [MAX_FEATURES]".into());
    };
    let photo = image::open(input)?;
    let grey = photo.to_luma8();
    let mut options = Options::default();
    if let Some(max) = args.next() {
        options.max_features = max.parse()?;
    }
    let view = GrayView::new(grey.as_raw(), grey.width() as usize, grey.height() as usize);
    let features = extract(&view, &options)?;
    let mut canvas = image::DynamicImage::ImageLuma8(grey).to_rgb8();
    for keypoint in &features.keypoints {
        draw(&mut canvas, keypoint);
    }
    canvas.save(output)?;
    println!("{} features", features.keypoints.len());
    Ok(())
}
