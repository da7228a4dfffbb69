//! `feature_extractor`.

use std::sync::Arc;

use tiepoint_colmap::{ExtractOptions, SharedCamera, create_database, extract};
use tiepoint_pipeline::Error;
use tiepoint_pipeline::io::features::{
    self as sift, DomainSizes, Normalization, Orientation, SiftExtractor,
};
use tiepoint_pipeline::sfm::geometry::{CameraModelKind, Intrinsics};

use super::options::Options;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

/// An empty database. One that is there stays.
pub(super) fn database_creator(options: &Options, output: &Output) -> Result<(), Failure> {
    let database = options.required("database_path").map_err(Failure::Usage)?;
    create_database(&database)?;
    output.result(&database, || format!("{}\n", database.display()))
}

pub(super) fn feature_extractor(options: &Options, output: &Output) -> Result<(), Failure> {
    let database = options.required("database_path").map_err(Failure::Usage)?;
    let images = options.required("image_path").map_err(Failure::Usage)?;
    let detector = detector(options).map_err(Failure::Usage)?;
    let extractor = SiftExtractor::new(detector).map_err(Error::from)?;
    let extraction = extraction(options, extractor).map_err(Failure::Usage)?;
    let mut progress = Progress::new(output);
    let found = extract(&database, &images, &extraction, &mut |event| progress.watch(event))?;
    drop(progress);
    output.result(&found, || {
        format!(
            "{} images, {} keypoints, {} new cameras; {} images had features before, {} skipped; \
            {:.1} s\n",
            found.images, found.keypoints, found.cameras, found.kept, found.skipped, found.seconds
        )
    })
}

fn extraction(options: &Options, extractor: SiftExtractor) -> Result<ExtractOptions, String> {
    let name = options.text("ImageReader.camera_model");
    let model =
        CameraModelKind::from_name(&name.to_ascii_uppercase()).map_err(|e| e.to_string())?;
    let params = options.text("ImageReader.camera_params");
    let params = if params.is_empty() {
        None
    } else {
        Some(intrinsics(model, params, "ImageReader.camera_params")?)
    };
    let most: i64 = options.number("SiftExtraction.max_image_size")?;
    Ok(ExtractOptions {
        masks: options.path("ImageReader.mask_path"),
        camera_mask: options.path("ImageReader.camera_mask_path"),
        names: options.lines("image_list_path")?,
        cameras: cameras(options)?,
        model,
        params,
        focal_factor: options.number("ImageReader.default_focal_length_factor")?,
        max_image_size: u32::try_from(most).ok().filter(|most| *most > 0),
        extractor: Arc::new(extractor),
    })
}

/// The intrinsics that an option gives.
pub(super) fn intrinsics(
    model: CameraModelKind,
    params: &str,
    option: &str,
) -> Result<Intrinsics, String> {
    let numbers: Result<Vec<f64>, _> =
        params.split(',').map(|number| number.trim().parse::<f64>()).collect();
    let numbers = numbers.map_err(|_| format!("--{option} is {params}, not a list of numbers"))?;
    Intrinsics::new(model, &numbers).map_err(|cause| format!("--{option} {params}: {cause}"))
}

/// The modes of `--camera_mode` are 0 (by EXIF), 1 (single), 2 (folder), 3 (image).
fn cameras(options: &Options) -> Result<SharedCamera, String> {
    let existing: i64 = options.number("ImageReader.existing_camera_id")?;
    match options.number::<i64>("camera_mode")? {
        -1 => {}
        0 => return Ok(SharedCamera::Exif),
        1 => return Ok(SharedCamera::Single),
        2 => return Ok(SharedCamera::Folder),
        3 => return Ok(SharedCamera::Image),
        mode => return Err(format!("--camera_mode is {mode}, and there are 0, 1, 2 and 3")),
    }
    Ok(if existing >= 0 {
        SharedCamera::Existing(existing)
    } else if options.flag("ImageReader.single_camera_per_image") {
        SharedCamera::Image
    } else if options.flag("ImageReader.single_camera_per_folder") {
        SharedCamera::Folder
    } else if options.flag("ImageReader.single_camera") {
        SharedCamera::Single
    } else {
        SharedCamera::Exif
    })
}

fn detector(options: &Options) -> Result<sift::Options, String> {
    let number = |name: &str| options.number::<usize>(&format!("SiftExtraction.{name}"));
    let real = |name: &str| options.number::<f32>(&format!("SiftExtraction.{name}"));
    let has_domain_sizes = options.flag("SiftExtraction.domain_size_pooling");
    let domain_sizes = DomainSizes {
        min: real("dsp_min_scale")?,
        max: real("dsp_max_scale")?,
        count: number("dsp_num_scales")?,
    };
    let normalization = match options.is_given("SiftExtraction.normalization") {
        true => options.text("SiftExtraction.normalization"),
        false => options.text("descriptor_normalization"),
    };
    let defaults = sift::Options::default();
    Ok(sift::Options {
        first_octave: options.number("SiftExtraction.first_octave")?,
        octaves: number("num_octaves")?,
        levels: number("octave_resolution")?,
        peak_threshold: real("peak_threshold")?,
        edge_threshold: real("edge_threshold")?,
        max_features: number("max_num_features")?,
        max_orientations: number("max_num_orientations")?,
        orientation: if options.flag("SiftExtraction.upright") {
            Orientation::Upright
        } else {
            Orientation::Dominant
        },
        normalization: match normalization.to_ascii_lowercase().as_str() {
            "l1_root" => Normalization::RootL1,
            "l2" => Normalization::L2,
            other => return Err(format!("there is no normalization {other}: l1_root or l2")),
        },
        domain_sizes: has_domain_sizes.then_some(domain_sizes),
        ..defaults
    })
}
