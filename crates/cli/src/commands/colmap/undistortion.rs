//! `image_undistorter`.

use tiepoint_pipeline::models::{
    UndistortFolderOptions, UndistortLayout, UndistortOptions, undistort,
};

use super::options::Options;
use crate::failure::Failure;
use crate::finished_model::open_model;
use crate::output::Output;
use crate::progress::Progress;

pub(super) fn image_undistorter(options: &Options, output: &Output) -> Result<(), Failure> {
    let required = |name| options.required(name).map_err(Failure::Usage);
    let (images, from) = (required("image_path")?, required("input_path")?);
    let to = required("output_path")?;
    let kind = options.text("output_type");
    if !kind.eq_ignore_ascii_case("COLMAP") {
        return Err(Failure::Usage(format!(
            "--output_type {kind} is none that tiepoint writes: give COLMAP"
        )));
    }
    let options = UndistortFolderOptions {
        camera: camera(options).map_err(Failure::Usage)?,
        images: Some(images),
        layout: UndistortLayout::Colmap,
        ..UndistortFolderOptions::default()
    };
    let from = open_model(&from, output)?;
    let mut progress = Progress::new(output);
    let found = undistort(&from, &to, &options, &mut |event| progress.watch(event))?;
    drop(progress);
    output.result(&found, || {
        format!("{} images, {} points\n{}\n", found.images, found.points, found.path.display())
    })
}

fn camera(options: &Options) -> Result<UndistortOptions, String> {
    let most: i64 = options.number("max_image_size")?;
    Ok(UndistortOptions {
        blank_pixels: options.number("blank_pixels")?,
        min_scale: options.number("min_scale")?,
        max_scale: options.number("max_scale")?,
        max_image_size: u32::try_from(most).ok().filter(|most| *most > 0),
    })
}
