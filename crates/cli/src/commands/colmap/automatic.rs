//! `automatic_reconstructor`.

use tiepoint_pipeline::input::{Calibration, CameraGrouping};
use tiepoint_pipeline::sfm::geometry::CameraModelKind;
use tiepoint_pipeline::sfm::matching::PairSelection;
use tiepoint_pipeline::stages::{DenseOptions, FeatureOptions, MatchOptions};
use tiepoint_pipeline::{Options as AllOptions, reconstruct};

use super::features::intrinsics;
use super::options::Options;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;
use crate::summary::{self, PhotoOptions};

/// `tiepoint reconstruct`, whose workspace is a COLMAP project.
pub(super) fn automatic_reconstructor(options: &Options, output: &Output) -> Result<(), Failure> {
    let workspace = options.required("workspace_path").map_err(Failure::Usage)?;
    let images = options.required("image_path").map_err(Failure::Usage)?;
    let all = options_of(options).map_err(Failure::Usage)?;
    let mut progress = Progress::new(output);
    let report = reconstruct(&[images], &workspace, &all, &mut |event| progress.watch(event))?;
    drop(progress);
    let photos = PhotoOptions { masks: all.masks.as_deref(), max_size: None };
    output.result(&report, || summary::report(&workspace, &report, photos))
}

fn options_of(options: &Options) -> Result<AllOptions, String> {
    let name = options.text("camera_model");
    let model = CameraModelKind::from_name(&name.to_ascii_uppercase());
    let model = model.map_err(|error| error.to_string())?;
    let calibration = match options.text("camera_params") {
        "" => Calibration::Unknown { model: Some(model), focal_px: None },
        params => Calibration::Known(intrinsics(model, params, "camera_params")?),
    };
    let cameras = match options.flag("single_camera") {
        true => CameraGrouping::Single,
        false => CameraGrouping::Auto,
    };
    // COLMAP reduces the photos to these sizes for features and depth maps.
    let max_size = match options.text("quality").to_ascii_lowercase().as_str() {
        "low" => Some(1000),
        "medium" => Some(1600),
        "high" => Some(2400),
        "extreme" => None,
        other => return Err(format!("there is no quality {other}: low, medium, high or extreme")),
    };
    let pairs = match options.text("data_type").to_ascii_lowercase().as_str() {
        "individual" | "internet" => PairSelection::Auto,
        "video" => PairSelection::Sequential {
            overlap: 10,
            is_thinned: false,
            is_closed: false,
            loops: 10,
        },
        other => {
            return Err(format!("there is no data type {other}: individual, video or internet"));
        }
    };
    let dense = options
        .flag("dense")
        .then(|| DenseOptions { max_image_size: max_size, ..DenseOptions::default() });
    Ok(AllOptions {
        features: FeatureOptions { calibration, cameras, max_size, ..FeatureOptions::default() },
        masks: options.path("mask_path"),
        matching: MatchOptions { pairs, seed: options.seed()?, ..MatchOptions::default() },
        dense,
        ..AllOptions::default()
    })
}
