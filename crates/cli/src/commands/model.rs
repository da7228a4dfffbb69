//! `model info`, `transform`, `align`, `crop` and `merge`.

use std::fmt::Write;
use std::path::PathBuf;

use tiepoint_pipeline::models::{
    AlignTo, AlignmentInfo, CropTo, ModelChange, ModelInfo, align_model, crop_model, merge_models,
    model_info, transform_model,
};

use crate::args::{AlignModel, CropModel, MergeModels, ModelCommand};
use crate::failure::Failure;
use crate::finished_model::open_model;
use crate::output::Output;
use crate::points;

pub(crate) fn model(command: &ModelCommand, output: &Output) -> Result<(), Failure> {
    let change = match command {
        ModelCommand::Info(args) => {
            let info = model_info(&open_model(&args.model, output)?);
            return output.result(&info, || describe(&info));
        }
        ModelCommand::Transform(args) => {
            let model = open_model(&args.model, output)?;
            transform_model(&model, &args.by, args.inverse, &args.output)?
        }
        ModelCommand::Align(args) => align(args, output)?,
        ModelCommand::Crop(args) => crop(args, output)?,
        ModelCommand::Merge(args) => merge(args, output)?,
    };
    output.result(&change, || describe_change(&change))
}

fn align(args: &AlignModel, output: &Output) -> Result<ModelChange, Failure> {
    let model = open_model(&args.model, output)?;
    let reference = args.to.as_deref().map(|path| open_model(path, output)).transpose()?;
    let target = match (&reference, &args.positions, args.max_error, &args.control_points) {
        (Some(reference), ..) => AlignTo::Model { reference, max_error_px: args.max_error_px },
        (None, Some(path), Some(max_error), _) => AlignTo::Positions { path, max_error },
        (None, _, _, Some(path)) => AlignTo::ControlPoints { path },
        // Clap requires one of them, and --max-error with --positions.
        (None, ..) => return Err(Failure::Usage("give --to or --positions".to_owned())),
    };
    Ok(align_model(&model, target, &args.output, args.save_transform.as_deref(), args.overwrite)?)
}

fn crop(args: &CropModel, output: &Output) -> Result<ModelChange, Failure> {
    let crop_to = match (args.bounds, args.quantiles) {
        (Some(bounds), _) => CropTo::Box(bounds.0),
        (None, Some(quantiles)) => CropTo::Quantiles(quantiles.0, quantiles.1),
        // Clap requires one of them.
        (None, None) => return Err(Failure::Usage("give --box or --quantiles".to_owned())),
    };
    Ok(crop_model(&open_model(&args.model, output)?, crop_to, &args.output)?)
}

fn merge(args: &MergeModels, output: &Output) -> Result<ModelChange, Failure> {
    let open = |path: &PathBuf| open_model(path, output);
    let models = args.models.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    let Some((first, others)) = models.split_first() else {
        return Err(Failure::Usage("give two models or more".to_owned()));
    };
    Ok(merge_models(first, others, args.max_error_px, &args.output)?)
}

// Writing to a string does not fail.
fn describe(info: &ModelInfo) -> String {
    let mut text = String::new();
    for (number, camera) in (1..).zip(&info.cameras) {
        let params = camera.param_names.iter().zip(&camera.params);
        let params: Vec<String> =
            params.map(|(name, value)| format!("{name} {}", six_digits(*value))).collect();
        let _ = writeln!(
            text,
            "camera {number}: {} {} x {}, {} images, {}",
            camera.model,
            camera.width,
            camera.height,
            camera.images,
            params.join(", ")
        );
    }
    let rigs = match info.rigs {
        0 => String::new(),
        rigs => format!(", {rigs} rigs, {} frames", info.frames),
    };
    let _ = writeln!(
        text,
        "{} images, {} points, {} observations{rigs}",
        info.images, info.points, info.observations
    );
    let _ = writeln!(
        text,
        "{:.3} observations a point, {:.1} an image, mean reprojection error {:.4} px",
        info.mean_track_length, info.mean_observations_per_image, info.mean_reprojection_error_px
    );
    if let (Some(min), Some(max)) = (info.min, info.max) {
        let [min, max] = [min, max].map(|corner| corner.map(six_digits).join(", "));
        let _ = writeln!(text, "points from ({min}) to ({max})");
    }
    text
}

/// A number with six significant digits: what is written to files has all.
fn six_digits(value: f64) -> String {
    let digits = 5 - value.abs().max(f64::MIN_POSITIVE).log10().floor() as i32;
    let rounded = format!("{value:.*}", digits.clamp(0, 12) as usize);
    match rounded.contains('.') {
        true => rounded.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => rounded,
    }
}

fn describe_change(change: &ModelChange) -> String {
    let mut text = String::new();
    if let Some(alignment) = &change.alignment {
        text += &describe_alignment(alignment);
    }
    if let Some(frame) = &change.frame {
        let _ = writeln!(text, "frame: {frame}");
    }
    for point in &change.control_points {
        let _ = writeln!(text, "{}", points::line(point));
    }
    for merged in &change.merged {
        let _ = writeln!(
            text,
            "{}: {} new images, {} new points, {} points merged",
            merged.path.display(),
            merged.new_images,
            merged.new_points,
            merged.merged_points
        );
        text += &describe_alignment(&merged.alignment);
    }
    if let Some(transform) = &change.transform {
        let _ = writeln!(
            text,
            "scale {}, rotation wxyz {:?}, translation {:?}",
            transform.scale, transform.rotation_wxyz, transform.translation
        );
    }
    let _ = writeln!(
        text,
        "{} images, {} points\n{}",
        change.images,
        change.points,
        change.path.display()
    );
    text
}

fn describe_alignment(alignment: &AlignmentInfo) -> String {
    format!(
        "{} common images, {} of {} fit, mean distance of the centres {:.6}\n",
        alignment.common_images, alignment.inliers, alignment.compared, alignment.mean_distance
    )
}
