//! Lists the images in folders with their metadata: `list_images INPUT...`.
#![allow(clippy::print_stdout)]

use std::path::PathBuf;

use tiepoint_input::ImageFolder;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let inputs: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let source = ImageFolder::open(&inputs, None)?;
    println!("cameras: {}", source.camera_names().join(", "));
    for (index, image) in source.images().iter().enumerate() {
        let info = match source.info(index) {
            Ok(info) => info,
            Err(error) => {
                println!("{error}");
                continue;
            }
        };
        let or_unknown =
            |value: Option<f64>| value.map_or("unknown".to_owned(), |value| format!("{value:.3}"));
        println!(
            "{} of camera {}: {} × {}, focal length {} px, time {} s",
            image.name,
            image.camera.0,
            info.width,
            info.height,
            or_unknown(info.exif.focal_px(info.width, info.height, None)),
            or_unknown(info.time_s)
        );
    }
    Ok(())
}
