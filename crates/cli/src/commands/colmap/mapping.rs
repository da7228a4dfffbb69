//! `mapper`, `point_triangulator`, `image_registrator` and `rig_configurator`.

use std::fmt::Write;

use tiepoint_colmap::{
    MapDatabaseOptions, MappedFolder, TriangulateOptions, configure_rigs, map, register,
    triangulate,
};
use tiepoint_pipeline::sfm::MapperOptions;
use tiepoint_pipeline::sfm::adjust::RefineIntrinsics;
use tiepoint_pipeline::sfm::geometry::OptionError;
use tiepoint_pipeline::sfm::register::RegisterOptions;
use tiepoint_pipeline::sfm::tracks::{FilterOptions, TrackOptions};

use super::options::Options;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

pub(super) fn mapper(options: &Options, output: &Output) -> Result<(), Failure> {
    let database = options.required("database_path").map_err(Failure::Usage)?;
    let images = options.required("image_path").map_err(Failure::Usage)?;
    let to = options.required("output_path").map_err(Failure::Usage)?;
    let mapping = map_options(options).map_err(Failure::Usage)?;
    let mut progress = Progress::new(output);
    let models = map(&database, Some(&images), &to, &mapping, &mut |event| progress.watch(event))?;
    drop(progress);
    output.result(&models, || models.iter().map(described).collect())
}

pub(super) fn point_triangulator(options: &Options, output: &Output) -> Result<(), Failure> {
    let database = options.required("database_path").map_err(Failure::Usage)?;
    let images = options.path("image_path");
    let from = options.required("input_path").map_err(Failure::Usage)?;
    let to = options.required("output_path").map_err(Failure::Usage)?;
    let triangulation = (|| {
        let refines = options.flag("refine_intrinsics");
        Ok(TriangulateOptions {
            clears_points: options.flag("clear_points"),
            refine: if refines { refine(options, "Mapper.ba_") } else { RefineIntrinsics::NONE },
            tracks: tracks(options)?,
            filter: filter(options)?,
            min_matches: options.number("Mapper.min_num_matches")?,
            extract_colors: options.flag("Mapper.extract_colors"),
        })
    })();
    let triangulation = triangulation.map_err(Failure::Usage)?;
    let mut progress = Progress::new(output);
    let model =
        triangulate(&database, images.as_deref(), &from, &to, &triangulation, &mut |event| {
            progress.watch(event)
        })?;
    drop(progress);
    output.result(&model, || described(&model))
}

pub(super) fn image_registrator(options: &Options, output: &Output) -> Result<(), Failure> {
    let database = options.required("database_path").map_err(Failure::Usage)?;
    let from = options.required("input_path").map_err(Failure::Usage)?;
    let to = options.required("output_path").map_err(Failure::Usage)?;
    let registration = registration(options).map_err(Failure::Usage)?;
    let min_matches = options.number("Mapper.min_num_matches").map_err(Failure::Usage)?;
    let seed = options.seed().map_err(Failure::Usage)?;
    let mut progress = Progress::new(output);
    let model = register(&database, &from, &to, &registration, min_matches, seed, &mut |event| {
        progress.watch(event)
    })?;
    drop(progress);
    output.result(&model, || described(&model))
}

pub(super) fn rig_configurator(options: &Options, output: &Output) -> Result<(), Failure> {
    if options.path("input_path").is_some() || options.path("output_path").is_some() {
        return Err(Failure::Usage(
            "rig_configurator takes extrinsics from the file alone: put cam_from_rig into it, and \
            leave --input_path and --output_path out"
                .to_owned(),
        ));
    }
    let database = options.required("database_path").map_err(Failure::Usage)?;
    let config = options.required("rig_config_path").map_err(Failure::Usage)?;
    let [rigs, frames] = configure_rigs(&database, &config)?;
    let value = serde_json::json!({ "rigs": rigs, "frames": frames });
    output.result(&value, || format!("{rigs} rigs, {frames} frames\n"))
}

fn described(model: &MappedFolder) -> String {
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = writeln!(
        text,
        "{}: {} images, {} points, mean reprojection error {:.4} px",
        model.path.display(),
        model.images,
        model.points,
        model.mean_reprojection_error_px
    );
    text
}

fn map_options(options: &Options) -> Result<MapDatabaseOptions, String> {
    let models = match options.flag("Mapper.multiple_models") {
        true => options.number("Mapper.max_num_models")?,
        false => 1,
    };
    let names = options.lines("image_list_path")?;
    let mapper = MapperOptions {
        refine: refine(options, "Mapper.ba_"),
        tracks: tracks(options)?,
        filter: filter(options)?,
        register: registration(options)?,
        min_model_size: options.number("Mapper.min_model_size")?,
        local_images: options.number("Mapper.ba_local_num_images")?,
        global_growth: options.number("Mapper.ba_global_images_ratio")?,
        seed: options.seed()?,
        ..MapperOptions::default()
    };
    mapper.validate().map_err(by_flag)?;
    Ok(MapDatabaseOptions {
        mapper,
        names: names.map(|names| names.into_iter().collect()),
        min_matches: options.number("Mapper.min_num_matches")?,
        max_models: models,
        extract_colors: options.flag("Mapper.extract_colors"),
        refine_extrinsics: options.flag("Mapper.ba_refine_sensor_from_rig"),
        input: options.path("input_path"),
        constant_poses: options.flag("Mapper.fix_existing_images"),
        project: Some(options.project()),
    })
}

/// An option out of its range, under COLMAP's name.
fn by_flag(OptionError { name, range, .. }: OptionError) -> String {
    let flag = match name {
        "tracks.max_merge_error_px" => "tri_merge_max_reproj_error",
        "tracks.min_angle_rad" => "tri_min_angle",
        "filter.max_error_px" => "filter_max_reproj_error",
        "filter.min_angle_rad" => "filter_min_tri_angle",
        "register.max_error_px" => "abs_pose_max_error",
        "register.min_num_inliers" => "abs_pose_min_num_inliers",
        "register.min_inlier_ratio" => "abs_pose_min_inlier_ratio",
        "local_images" => "ba_local_num_images",
        "global_growth" => "ba_global_images_ratio",
        other => other,
    };
    // COLMAP's angles are in degrees.
    let range = if name.ends_with("_rad") { "0 to 180" } else { range };
    format!("--Mapper.{flag} is out of range: {range}")
}

/// What the options with a prefix refine. Two focal lengths are two parameters, as in COLMAP.
pub(super) fn refine(options: &Options, prefix: &str) -> RefineIntrinsics {
    let flag = |name: &str| options.flag(&format!("{prefix}{name}"));
    let focal = flag("refine_focal_length");
    RefineIntrinsics {
        focal,
        aspect: focal,
        principal_point: flag("refine_principal_point"),
        distortion: flag("refine_extra_params"),
        prism: flag("refine_extra_params"),
    }
}

fn tracks(options: &Options) -> Result<TrackOptions, String> {
    Ok(TrackOptions {
        max_merge_error_px: options.number("Mapper.tri_merge_max_reproj_error")?,
        min_angle_rad: options.number::<f64>("Mapper.tri_min_angle")?.to_radians(),
        two_view: !options.flag("Mapper.tri_ignore_two_view_tracks"),
        max_transitivity: options.number("Mapper.tri_complete_max_transitivity")?,
        ..TrackOptions::default()
    })
}

fn filter(options: &Options) -> Result<FilterOptions, String> {
    Ok(FilterOptions {
        max_error_px: options.number("Mapper.filter_max_reproj_error")?,
        min_angle_rad: options.number::<f64>("Mapper.filter_min_tri_angle")?.to_radians(),
    })
}

fn registration(options: &Options) -> Result<RegisterOptions, String> {
    Ok(RegisterOptions {
        max_error_px: options.number("Mapper.abs_pose_max_error")?,
        min_num_inliers: options.number("Mapper.abs_pose_min_num_inliers")?,
        min_inlier_ratio: options.number("Mapper.abs_pose_min_inlier_ratio")?,
    })
}
