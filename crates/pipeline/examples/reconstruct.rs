//! Reconstruction by library calls: `cargo run --release --example reconstruct PHOTOS WORKSPACE`.

use std::error::Error;
use std::ops::ControlFlow;
use std::path::PathBuf;

use tiepoint_pipeline::{Event, Options, reconstruct};

#[expect(clippy::print_stdout, reason = "an example prints")]
fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [photos, workspace] = paths.as_slice() else {
        return Err("usage: reconstruct PHOTOS WORKSPACE".into());
    };
    let report =
        reconstruct(std::slice::from_ref(photos), workspace, &Options::default(), &mut |event| {
            match event {
                Event::StageDone { stage, seconds } => println!("{stage}: {seconds:.1} s"),
                Event::ImageSkipped { reason, .. } => println!("skipped: {reason}"),
                Event::ImageRegistered { image, points, .. } => {
                    println!("{image}: {points} points")
                }
                _ => {}
            }
            // `Break` would stop the run. Completed work is kept, and the next run resumes.
            ControlFlow::Continue(())
        })?;
    for model in &report.models {
        let (registered, images, error_px) =
            (model.registered, model.images, model.mean_reprojection_error_px);
        println!("{}: {registered} of {images} images, {error_px:.2} px", model.path);
    }
    Ok(())
}
