//! Undistorts an image of raw bytes, for `bench/undistort.py`: prints the PINHOLE camera (width,
//! height, fx, fy, cx, cy) and the least time of the runs in seconds, and writes the image.
//!
//! Arguments: the camera model, width, height, its parameters joined by commas, blank_pixels, the
//! number of runs, the file of the image (three bytes a pixel) and the file to write.

#![allow(clippy::print_stdout)]

use std::error::Error;
use std::time::Instant;

use tiepoint_dense::undistort::{UndistortOptions, Undistortion, undistort_camera};
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::Camera;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, width, height, params, blank_pixels, runs, from, to] = &arguments[..] else {
        return Err("give MODEL WIDTH HEIGHT PARAMS BLANK_PIXELS RUNS IN OUT".into());
    };
    let kind = CameraModelKind::ALL.iter().find(|kind| kind.name() == *model);
    let params: Vec<f64> = params.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let intrinsics = Intrinsics::new(*kind.ok_or("unknown camera model")?, &params)?;
    let (width, height) = (width.parse()?, height.parse()?);
    let camera = Camera { intrinsics, width, height, has_focal_prior: true };
    let options =
        UndistortOptions { blank_pixels: blank_pixels.parse()?, ..UndistortOptions::default() };
    let new = undistort_camera(&camera, &options)?;
    let pixels = std::fs::read(from)?;
    let (mut least_s, mut image) = (f64::INFINITY, Vec::new());
    for _ in 0..runs.parse::<usize>()?.max(1) {
        let start = Instant::now();
        image = Undistortion::new(&camera, &new).image::<3>(&pixels)?;
        least_s = least_s.min(start.elapsed().as_secs_f64());
    }
    std::fs::write(to, image)?;
    let params = new.intrinsics.params().iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    println!("{} {} {params} {least_s}", new.width, new.height);
    Ok(())
}
