//! `bundle_adjuster`, `color_extractor`, `model_aligner`, `model_analyzer`, `model_converter`,
//! `model_merger` and `model_orientation_aligner`.

use std::path::PathBuf;

use tiepoint_colmap::{
    AdjustModelOptions, AlignedTo, adjust, align, color, convert_to_ply, merge, write_as,
};
use tiepoint_pipeline::io::colmap::Format;
use tiepoint_pipeline::models::model_info;

use super::mapping::refine;
use super::options::Options;
use crate::failure::Failure;
use crate::finished_model::open_model;
use crate::output::Output;
use crate::progress::Progress;

/// The model to read and the folder to write.
fn paths(options: &Options) -> Result<[PathBuf; 2], Failure> {
    let required = |name| options.required(name).map_err(Failure::Usage);
    Ok([required("input_path")?, required("output_path")?])
}

pub(super) fn bundle_adjuster(options: &Options, output: &Output) -> Result<(), Failure> {
    let [from, to] = paths(options)?;
    let number = |name| options.number(name).map_err(Failure::Usage);
    let tolerance: f64 = number("BundleAdjustment.function_tolerance")?;
    let iterations: f64 = number("BundleAdjustment.max_num_iterations")?;
    let adjustment = AdjustModelOptions {
        refine: refine(options, "BundleAdjustment."),
        constant_poses: !options.flag("BundleAdjustment.refine_extrinsics"),
        constant_rigs: !options.flag("BundleAdjustment.refine_sensor_from_rig"),
        max_iterations: iterations.max(0.0) as usize,
        // COLMAP's 0 is for as long as the cost decreases.
        function_tolerance: (tolerance > 0.0).then_some(tolerance),
    };
    let mut progress = Progress::new(output);
    let report = adjust(&from, &to, &adjustment, &mut |event| progress.watch(event))?;
    drop(progress);
    output.result(&report, || {
        format!(
            "{} images, {} points, {} residuals\ncost {:.6e} -> {:.6e} in {} iterations, {:.2} s\n",
            report.images,
            report.points,
            report.residuals,
            report.initial_cost,
            report.final_cost,
            report.iterations,
            report.seconds
        )
    })
}

pub(super) fn model_aligner(options: &Options, output: &Output) -> Result<(), Failure> {
    let [from, to] = paths(options)?;
    let kind = options.text("alignment_type");
    let positions = options.path("ref_images_path");
    let max_error: f64 = options.number("robust_alignment_max_error").map_err(Failure::Usage)?;
    let target = match (kind, &positions) {
        ("plane", None) => AlignedTo::Plane,
        ("custom", Some(path)) if options.is_given("ref_is_gps") && options.flag("ref_is_gps") => {
            return Err(Failure::Usage(format!(
                "the positions in {} are latitude, longitude and altitude by --ref_is_gps 1, which \
                tiepoint does not convert: give them in metres, with --ref_is_gps 0",
                path.display()
            )));
        }
        ("custom", Some(path)) => AlignedTo::Positions {
            path,
            max_error: (options.flag("robust_alignment") && max_error > 0.0).then_some(max_error),
            min_common_images: options.number("min_common_images").map_err(Failure::Usage)?,
        },
        ("custom", None) => {
            return Err(Failure::Usage("model_aligner needs --ref_images_path".to_owned()));
        }
        (kind, _) => {
            return Err(Failure::Usage(format!(
                "--alignment_type {kind} is not what tiepoint does here: it has plane without \
                positions and custom with --ref_images_path"
            )));
        }
    };
    let transform_to = options.path("transform_path");
    let aligned = align(&from, target, &to, transform_to.as_deref(), options.flag("overwrite"))?;
    output.result(&aligned, || {
        let distance = aligned.mean_distance.map_or_else(String::new, |distance| {
            format!(", mean distance of the centres {distance:.6}")
        });
        format!("{} images, {} points{distance}\n", aligned.images, aligned.points)
    })
}

/// Up is −y in the result, as in COLMAP.
pub(super) fn model_orientation_aligner(options: &Options, output: &Output) -> Result<(), Failure> {
    let [from, to] = paths(options)?;
    let method = options.text("method");
    if !method.eq_ignore_ascii_case("IMAGE-ORIENTATION") {
        return Err(Failure::Usage(format!(
            "--method {method} looks for vanishing points, which tiepoint does not: give --method \
            IMAGE-ORIENTATION, which takes the mean of the images' own up directions"
        )));
    }
    let aligned = align(&from, AlignedTo::Upright, &to, None, false)?;
    output.result(&aligned, || format!("{} images, {} points\n", aligned.images, aligned.points))
}

pub(super) fn color_extractor(options: &Options, output: &Output) -> Result<(), Failure> {
    let [from, to] = paths(options)?;
    let images = options.required("image_path").map_err(Failure::Usage)?;
    let points = color(&from, &images, &to)?;
    output.result(&points, || format!("{points} points\n"))
}

/// The lines are those of COLMAP, which scripts parse.
pub(super) fn model_analyzer(options: &Options, output: &Output) -> Result<(), Failure> {
    let path = options.required("path").map_err(Failure::Usage)?;
    let info = model_info(&open_model(&path, output)?);
    output.result(&info, || {
        format!(
            "Cameras: {}\nImages: {}\nRegistered images: {}\nPoints: {}\nObservations: {}\n\
            Mean track length: {:.6}\nMean observations per image: {:.6}\n\
            Mean reprojection error: {:.6}px\n",
            info.cameras.len(),
            info.images,
            info.images,
            info.points,
            info.observations,
            info.mean_track_length,
            info.mean_observations_per_image,
            info.mean_reprojection_error_px
        )
    })
}

pub(super) fn model_converter(options: &Options, output: &Output) -> Result<(), Failure> {
    let [from, to] = paths(options)?;
    match options.text("output_type").to_ascii_uppercase().as_str() {
        "BIN" => write_as(&from, &to, Format::Binary)?,
        "TXT" => write_as(&from, &to, Format::Text)?,
        "PLY" => convert_to_ply(&from, &to, options.flag("overwrite"))?,
        "" => return Err(Failure::Usage("model_converter needs --output_type".to_owned())),
        other => {
            return Err(Failure::Usage(format!(
                "--output_type {other} is none that tiepoint writes: give BIN, TXT or PLY"
            )));
        }
    }
    output.result(&to, || format!("{}\n", to.display()))
}

pub(super) fn model_merger(options: &Options, output: &Output) -> Result<(), Failure> {
    let required = |name| options.required(name).map_err(Failure::Usage);
    let (first, second) = (required("input_path1")?, required("input_path2")?);
    let to = required("output_path")?;
    let max_error_px: f64 = options.number("max_reproj_error").map_err(Failure::Usage)?;
    let merged = merge([&first, &second], max_error_px, &to)?;
    output.result(&merged, || format!("{} images, {} points\n", merged["images"], merged["points"]))
}
