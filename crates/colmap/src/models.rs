//! `bundle_adjuster`, `color_extractor`, `model_aligner`, `model_converter`, `model_merger` and
//! `model_orientation_aligner`: models in folders that may be input and output at once.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;
use tiepoint_pipeline::input::ImageFolder;
use tiepoint_pipeline::io::colmap::{Format, read_model};
use tiepoint_pipeline::io::names::ByName;
use tiepoint_pipeline::io::{ply, positions, similarity};
use tiepoint_pipeline::models::{AdjustReport, SimilarityInfo};
use tiepoint_pipeline::sfm;
use tiepoint_pipeline::sfm::adjust::{AdjustOptions, RefineIntrinsics, Scope};
use tiepoint_pipeline::sfm::geometry::nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tiepoint_pipeline::sfm::geometry::{Loss, RansacOptions, Sim3, estimate, so3};
use tiepoint_pipeline::sfm::model_tools::merge_model;
use tiepoint_pipeline::sfm::scene::{ImageId, Reconstruction};
use tiepoint_pipeline::stages::color_points;
use tiepoint_pipeline::store::{Replace, write_file};
use tiepoint_pipeline::workspace::{PLY_MARK, model_files};
use tiepoint_pipeline::{Error, Event, Watch};

use super::output::{refuse_foreign_model, write_model};

/// Standard deviation of the priors of the intrinsics, which COLMAP does not have: none.
const NO_PRIOR: f64 = 1e6;

/// Options of [`adjust`].
#[derive(Clone, Copy, Debug)]
pub struct AdjustModelOptions {
    /// Intrinsics that are refined.
    pub refine: RefineIntrinsics,
    /// Whether poses are constant.
    pub constant_poses: bool,
    /// Whether the extrinsics of rigs are constant.
    pub constant_rigs: bool,
    /// Maximum number of iterations.
    pub max_iterations: usize,
    /// Relative decrease of the cost below which the adjustment ends; `None` for the own default.
    pub function_tolerance: Option<f64>,
}

/// Bundle adjustment of a model without priors and without a robust loss, as COLMAP does it.
///
/// # Errors
///
/// The model cannot be read, adjusted or written, or `watch` returns `Break`.
pub fn adjust(
    input: &Path,
    output: &Path,
    options: &AdjustModelOptions,
    watch: Watch,
) -> Result<AdjustReport, Error> {
    let mut model = read_model(input)?;
    let posed: BTreeSet<ImageId> = model.registered().map(|(id, ..)| id).collect();
    let defaults = AdjustOptions::default();
    let adjust = AdjustOptions {
        refine: options.refine,
        loss: Loss::Trivial,
        principal_point_sigma: NO_PRIOR,
        distortion_sigma: NO_PRIOR,
        constant_poses: options.constant_poses.then_some(&posed),
        constant_rigs: options.constant_rigs || options.constant_poses,
        max_iterations: options.max_iterations,
        function_tolerance: options.function_tolerance.unwrap_or(defaults.function_tolerance),
        ..defaults
    };
    let start = Instant::now();
    let summary = sfm::adjust::adjust(&mut model, &Scope::Global, &adjust, &mut [], &mut |step| {
        watch(&Event::AdjustmentStep { step: step.number, cost: step.cost })
    })
    .map_err(Error::adjusting(input))?;
    let report = AdjustReport::new(&summary, start, model.num_registered(), model.num_tracks())?;
    write_model(output, &model, Format::Binary)?;
    Ok(report)
}

/// Target of an alignment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlignedTo<'a> {
    /// The plane of the points: it becomes z = 0, with the cameras on the positive side.
    Plane,
    /// The mean up direction of the images, which becomes −y.
    Upright,
    /// A text file with lines `name x y z`: camera centres.
    Positions {
        /// The file.
        path: &'a Path,
        /// Maximum distance of an inlier, in the unit of the file; `None`: all positions are
        /// inliers.
        max_error: Option<f64>,
        /// Fewest common images.
        min_common_images: usize,
    },
}

/// The result of [`align`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Aligned {
    /// Number of images with a pose.
    pub images: usize,
    /// Number of points.
    pub points: usize,
    /// The transform new_from_old.
    pub transform: SimilarityInfo,
    /// Mean distance of the camera centres from their positions, of those that fit.
    pub mean_distance: Option<f64>,
}

/// Aligns a model and writes it to `output`, and the transform to the file `transform_to`, where
/// `overwrite` permits to replace a file.
///
/// # Errors
///
/// An input cannot be read, it does not determine the alignment, `transform_to` is an input or
/// another file that may not be replaced, or writing fails.
pub fn align(
    input: &Path,
    to: AlignedTo,
    output: &Path,
    transform_to: Option<&Path>,
    overwrite: bool,
) -> Result<Aligned, Error> {
    let mut model = read_model(input)?;
    let failed = |what: String| Error::Colmap { path: input.to_owned(), what };
    let mut inputs = Vec::new();
    let (new_from_old, mean_distance) = match to {
        AlignedTo::Plane => (plane_from_world(&model).map_err(failed)?, None),
        AlignedTo::Upright => {
            let rotations = model.registered().map(|(.., pose)| &pose.rotation);
            let rotation = so3::upright(rotations, &-Vector3::y());
            (Sim3 { rotation, ..Sim3::identity() }, None)
        }
        AlignedTo::Positions { path, max_error, min_common_images } => {
            let file = ByName::new(positions::read(path)?);
            inputs.push(path.to_owned());
            let (from, to): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) = model
                .registered()
                .filter_map(|(_, image, pose)| Some((pose.origin_in_a(), *file.get(&image.name)?)))
                .unzip();
            let found = similarity_of(&from, &to, max_error, min_common_images.max(3));
            let found = found.map_err(|reason| failed(format!("{reason} {}", path.display())))?;
            let distances = from.iter().zip(&to).map(|(from, to)| (found * *from - to).norm());
            let is_inlier =
                |distance: &f64| max_error.is_none_or(|max_error| *distance <= max_error);
            let distances: Vec<f64> = distances.filter(is_inlier).collect();
            (found, Some(distances.iter().sum::<f64>() / distances.len().max(1) as f64))
        }
    };
    model.transform(&new_from_old);
    model.validate().map_err(|_| Error::TransformOverflows { path: input.to_owned() })?;
    // Both results are refused before either is written.
    refuse_foreign_model(output)?;
    if let Some(file) = transform_to {
        inputs.extend(model_files(input));
        // The result may be in this folder, too.
        inputs.extend(model_files(output));
        let replace = Replace::new(None, overwrite);
        write_file(file, inputs.iter().map(PathBuf::as_path), replace, |file| {
            Ok::<_, Error>(similarity::write(file, &new_from_old)?)
        })?;
    }
    write_model(output, &model, Format::Binary)?;
    Ok(Aligned {
        images: model.num_registered(),
        points: model.num_tracks(),
        transform: (&new_from_old).into(),
        mean_distance,
    })
}

/// The frame of the points' principal plane: x and y along their largest extents.
fn plane_from_world(model: &Reconstruction) -> Result<Sim3, String> {
    let count = model.num_tracks() as f64;
    if count < 3.0 {
        return Err(format!("has {count} points, and a plane needs three"));
    }
    let mean = model.tracks().map(|(_, track)| track.xyz).sum::<Vector3<f64>>() / count;
    let mut scatter = Matrix3::zeros();
    for (_, track) in model.tracks() {
        let offset = track.xyz - mean;
        scatter += offset * offset.transpose();
    }
    let eigen = scatter.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let axis = |index: usize| eigen.eigenvectors.column(order[index]).into_owned();
    let (x, mut y) = (axis(0), axis(1));
    let centres: Vec<Vector3<f64>> =
        model.registered().map(|(_, _, pose)| pose.origin_in_a()).collect();
    let height = |y: &Vector3<f64>| {
        centres.iter().map(|centre| x.cross(y).dot(&(centre - mean))).sum::<f64>()
    };
    if height(&y) < 0.0 {
        y = -y;
    }
    let rows = Matrix3::from_columns(&[x, y, x.cross(&y)]).transpose();
    let rotation = UnitQuaternion::from_matrix(&rows);
    Ok(Sim3 { scale: 1.0, rotation, translation: -(rotation * mean) })
}

/// The similarity that brings centres to positions.
fn similarity_of(
    from: &[Vector3<f64>],
    to: &[Vector3<f64>],
    max_error: Option<f64>,
    required: usize,
) -> Result<Sim3, String> {
    if from.len() < required {
        let found = from.len();
        return Err(format!("has {found} images with a position, and {required} are needed in"));
    }
    let max_error = max_error.unwrap_or(f64::MAX.sqrt());
    let options = RansacOptions { max_error, ..RansacOptions::default() };
    let found = estimate::similarity(from, to, true, &options);
    found
        .filter(|found| found.num_inliers >= required)
        .map(|found| found.model)
        .ok_or_else(|| "has too few images that fit one similarity to the positions in".to_owned())
}

/// Colours the points of a model by photos, whose names are relative to the folder `images`.
/// Returns the number of points.
///
/// # Errors
///
/// The model or a photo cannot be read, or writing fails.
pub fn color(input: &Path, images: &Path, output: &Path) -> Result<usize, Error> {
    let mut model = read_model(input)?;
    let folder = ImageFolder::as_stored(images, None)?;
    color_points(&folder, std::iter::once(&mut model))?;
    write_model(output, &model, Format::Binary)?;
    Ok(model.num_tracks())
}

/// Writes a model in a format of COLMAP into a folder.
///
/// # Errors
///
/// The model cannot be read or written.
pub fn write_as(input: &Path, output: &Path, format: Format) -> Result<(), Error> {
    write_model(output, &read_model(input)?, format)
}

/// Writes the points of a model as a PLY file. A PLY file of this program is replaced, and any file
/// that is not an input with `overwrite`.
///
/// # Errors
///
/// The model cannot be read, `output` is an input or another file that this program did not make,
/// or writing fails.
pub fn convert_to_ply(input: &Path, output: &Path, overwrite: bool) -> Result<(), Error> {
    let points = ply::points(&read_model(input)?);
    let inputs = model_files(input);
    let replace = Replace::new(Some(PLY_MARK), overwrite);
    write_file(output, inputs.iter().map(PathBuf::as_path), replace, |output| {
        Ok(ply::write(output, &points)?)
    })
}

/// Merges a model into another one, in the frame of the first, and writes the result to `output`.
/// Returns the number of images with a pose and of points.
///
/// # Errors
///
/// A model cannot be read, they do not fit, or writing fails.
pub fn merge(
    inputs: [&Path; 2],
    max_error_px: f64,
    output: &Path,
) -> Result<BTreeMap<&'static str, usize>, Error> {
    let [mut first, second] = [read_model(inputs[0])?, read_model(inputs[1])?];
    let outcome =
        merge_model(&mut first, &second, max_error_px).map_err(Error::adjusting(inputs[1]))?;
    if outcome.alignment.reference_from_model.is_none() {
        let what = format!(
            "cannot be merged with {}: {} images are in both, and {} of their {} common \
             observations fit one similarity",
            inputs[0].display(),
            outcome.alignment.num_common_images,
            outcome.alignment.num_inliers,
            outcome.alignment.num_common_observations
        );
        return Err(Error::Colmap { path: inputs[1].to_owned(), what });
    }
    write_model(output, &first, Format::Binary)?;
    Ok([("images", first.num_registered()), ("points", first.num_tracks())].into())
}
