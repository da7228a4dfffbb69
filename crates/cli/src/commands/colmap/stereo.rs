//! `patch_match_stereo` and `stereo_fusion`: a dense workspace that `image_undistorter` made,
//! COLMAP's or tiepoint's.

use std::path::Path;

use tiepoint_colmap::{DepthMapOptions, FuseOptions, estimate_depth_maps, fuse_depth_maps};
use tiepoint_pipeline::dense::fusion::FusionOptions;
use tiepoint_pipeline::io::read_text;
use tiepoint_pipeline::workspace::MapKind;

use super::options::Options;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

/// Images that agree on a point for each pixel that COLMAP asks for, so that both defaults belong
/// together: of 51,012 points that COLMAP 3.8 fused from five pixels or more (fountain-P11, maps of
/// 512 pixels), 0.4 % are from fewer than three images. Half of it would ask for two images by
/// default, which chance brings together; twice of it for six, which small collections have not.
const IMAGES_PER_PIXEL: f64 = 3.0 / 5.0;
/// COLMAP's fusion takes normals that its stereo estimated, and this one takes those of neighbours
/// in the depth map, which scatter more: see the default of `max_normal_error_rad`.
const NORMAL_ERRORS: f64 = 3.0;
/// Longest file of a box: six numbers.
const MAX_BOX_BYTES: u64 = 1 << 16;

pub(super) fn patch_match_stereo(options: &Options, output: &Output) -> Result<(), Failure> {
    let workspace = options.required("workspace_path").map_err(Failure::Usage)?;
    let kind = match options.flag("PatchMatchStereo.geom_consistency") {
        true => MapKind::Geometric,
        false => MapKind::Photometric,
    };
    let of_maps = DepthMapOptions {
        list: options.path("config_path"),
        max_image_size: size(options, "PatchMatchStereo.max_image_size").map_err(Failure::Usage)?,
        kind,
    };
    let mut progress = Progress::new(output);
    let found = estimate_depth_maps(&workspace, &of_maps, &mut |event| progress.watch(event))?;
    drop(progress);
    output.result(&found, || {
        let kept = match found.kept {
            0 => String::new(),
            kept => format!(", {kept} of them made before"),
        };
        format!(
            "{} depth maps{kept}{}\n{}\n",
            found.depth_maps,
            without(&found.without_depth_map, ", no common points with other images in "),
            workspace.join("stereo").display()
        )
    })
}

pub(super) fn stereo_fusion(options: &Options, output: &Output) -> Result<(), Failure> {
    let required = |name| options.required(name).map_err(Failure::Usage);
    let (workspace, to) = (required("workspace_path")?, required("output_path")?);
    let options = fuse_options(options).map_err(Failure::Usage)?;
    let found = fuse_depth_maps(&workspace, &to, &options)?;
    output.result(&found, || {
        format!(
            "{} points of {} depth maps{}\n{}\n",
            found.points,
            found.depth_maps,
            without(&found.without_depth_map, ", no depth map of "),
            to.display()
        )
    })
}

fn fuse_options(options: &Options) -> Result<FuseOptions, String> {
    let kind = match options.text("input_type").to_ascii_lowercase().as_str() {
        "geometric" => MapKind::Geometric,
        "photometric" => MapKind::Photometric,
        other => return Err(format!("there is no --input_type {other}: geometric or photometric")),
    };
    let positive = |name: &str| -> Result<f64, String> {
        let value: f64 = options.number(name)?;
        match value > 0.0 {
            true => Ok(value),
            false => Err(format!("--{name} is {value}: give a number above 0")),
        }
    };
    let pixels = positive("StereoFusion.min_num_pixels")?;
    let fusion = FusionOptions {
        min_views: ((IMAGES_PER_PIXEL * pixels).round() as usize).max(1),
        max_error_px: positive("StereoFusion.max_reproj_error")?,
        max_depth_error: positive("StereoFusion.max_depth_error")?,
        max_normal_error_rad: (NORMAL_ERRORS * positive("StereoFusion.max_normal_error")?)
            .min(180.0)
            .to_radians(),
        ..FusionOptions::default()
    };
    Ok(FuseOptions {
        kind,
        fusion,
        masks: options.path("StereoFusion.mask_path"),
        bounds: options.path("bbox_path").as_deref().map(bounds).transpose()?,
        max_image_size: size(options, "StereoFusion.max_image_size")?,
        overwrite: options.flag("overwrite"),
    })
}

/// A largest size in pixels; COLMAP's −1 is for none.
fn size(options: &Options, name: &str) -> Result<Option<u32>, String> {
    let size: i64 = options.number(name)?;
    Ok(u32::try_from(size).ok().filter(|size| *size > 0))
}

/// The smallest and the largest coordinates in a file, six numbers.
fn bounds(path: &Path) -> Result<[[f32; 3]; 2], String> {
    let text = read_text(path, MAX_BOX_BYTES, "box");
    let text = text.map_err(|error| format!("cannot read {error}"))?;
    let number = |word: &str| word.parse().ok().filter(|number: &f32| number.is_finite());
    let numbers = text.split_whitespace().map(number).collect::<Option<Vec<f32>>>();
    match numbers.as_deref() {
        Some([a, b, c, d, e, f]) => Ok([[*a, *b, *c], [*d, *e, *f]]),
        _ => Err(format!(
            "{} is no box: give six numbers, the smallest x y z and the largest",
            path.display()
        )),
    }
}

/// The images that a result is without, if there are any.
fn without(images: &[String], what: &str) -> String {
    match images {
        [] => String::new(),
        [only] => format!("{what}{only}"),
        [first, rest @ ..] => format!("{what}{first} and {} more", rest.len()),
    }
}
