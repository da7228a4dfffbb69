//! `undistort`.

use tiepoint_pipeline::models::{
    UndistortFolderOptions, UndistortLayout, UndistortOptions, Undistorted,
    undistort as undistort_folder,
};

use crate::args::Undistort;
use crate::failure::Failure;
use crate::finished_model::open_model;
use crate::output::Output;
use crate::progress::Progress;

pub(crate) fn undistort(args: &Undistort, output: &Output) -> Result<(), Failure> {
    let options = UndistortFolderOptions {
        camera: UndistortOptions {
            blank_pixels: args.blank_pixels,
            min_scale: args.min_scale,
            max_scale: args.max_scale,
            max_image_size: args.max_size,
        },
        images: args.images.clone(),
        masks: args.masks.clone(),
        downscale: args.downscale.clone(),
        has_detected_keypoints: args.detected_keypoints,
        layout: UndistortLayout::Splats,
    };
    let model = open_model(&args.model, output)?;
    let mut progress = Progress::new(output);
    let undistorted =
        undistort_folder(&model, &args.output, &options, &mut |event| progress.watch(event))?;
    drop(progress);
    output.result(&undistorted, || describe(&undistorted))
}

fn describe(undistorted: &Undistorted) -> String {
    let Undistorted { path, images, cameras, points, observations_lost } = undistorted;
    let lost = match observations_lost {
        0 => String::new(),
        count => format!(", {count} observations outside of the undistorted images"),
    };
    let s = if *cameras == 1 { "" } else { "s" };
    format!(
        "{images} images of {cameras} PINHOLE camera{s}, {points} points{lost}\n{}\n",
        path.display()
    )
}
