//! Work on finished models on disk, as COLMAP's `model_analyzer`, `model_transformer`,
//! `model_aligner`, `model_cropper` and `model_merger` do it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tiepoint_io::names::ByName;
use tiepoint_io::{position_priors, positions, similarity};
use tiepoint_sfm::geometry::geodesy::Geodetic;
use tiepoint_sfm::geometry::nalgebra::Vector3;
use tiepoint_sfm::geometry::{RansacOptions, Sim3, estimate};
use tiepoint_sfm::model_tools::{BoundingBox, align_models, crop, merge_model};
use tiepoint_sfm::positions::may_be_mirrored;
use tiepoint_sfm::scene::{Georeference, Position, Reconstruction};
use tiepoint_store::{Replace, write_file};

use crate::Error;
use crate::stages::control_points::{ControlPoints, UPSIDE_DOWN};
use crate::workspace::control_report::ControlPointReport;
use crate::workspace::format::path_text;
use crate::workspace::located_model::LocatedModel;
use crate::workspace::model_output::refuse_foreign_model;

/// A camera of a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraInfo {
    /// COLMAP's name of the model.
    pub model: &'static str,
    /// Names of the parameters.
    pub param_names: &'static [&'static str],
    /// The parameters, in pixels.
    pub params: Vec<f64>,
    /// Width of the images, in pixels.
    pub width: u32,
    /// Height of the images, in pixels.
    pub height: u32,
    /// Number of its images that have a pose.
    pub images: usize,
}

/// Statistics of a model. The numbers are those of COLMAP's `model_analyzer`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelInfo {
    /// The folder of the model.
    #[serde(serialize_with = "path_text")]
    pub path: PathBuf,
    /// The cameras.
    pub cameras: Vec<CameraInfo>,
    /// Number of rigs of more than one camera.
    pub rigs: usize,
    /// Number of frames of these rigs.
    pub frames: usize,
    /// Number of images with a pose.
    pub images: usize,
    /// Number of points.
    pub points: usize,
    /// Number of observations of all points.
    pub observations: usize,
    /// Mean number of observations of a point.
    pub mean_track_length: f64,
    /// Mean number of observations of an image.
    pub mean_observations_per_image: f64,
    /// Mean over the points of their mean reprojection errors, in pixels.
    pub mean_reprojection_error_px: f64,
    /// Least coordinates of the points, in units of the model; `None` without points.
    pub min: Option<[f64; 3]>,
    /// Largest coordinates of the points.
    pub max: Option<[f64; 3]>,
}

/// A similarity transform new_from_old.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SimilarityInfo {
    /// Length in the new frame of a unit length of the old one.
    pub scale: f64,
    /// Rotation, a Hamilton quaternion.
    pub rotation_wxyz: [f64; 4],
    /// The old origin in the new frame.
    pub translation: [f64; 3],
}

impl From<&Sim3> for SimilarityInfo {
    fn from(similarity: &Sim3) -> Self {
        let q = similarity.rotation;
        Self {
            scale: similarity.scale,
            rotation_wxyz: [q.w, q.i, q.j, q.k],
            translation: similarity.translation.into(),
        }
    }
}

/// Result of a command on models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelChange {
    /// The folder of the new model.
    #[serde(serialize_with = "path_text")]
    pub path: PathBuf,
    /// Number of images with a pose in the new model.
    pub images: usize,
    /// Number of points in the new model.
    pub points: usize,
    /// The transform that was applied, new_from_old.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transform: Option<SimilarityInfo>,
    /// Quality of the alignment, if the transform was estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alignment: Option<AlignmentInfo>,
    /// The frame of the new model, as a sentence, if it is on the earth or that of measurements.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
    /// The control points of the alignment.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub control_points: Vec<ControlPointReport>,
    /// The further models of a merge, in the order in which they were merged.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub merged: Vec<MergedInfo>,
}

/// Quality of an alignment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AlignmentInfo {
    /// Number of images with a pose in both.
    pub common_images: usize,
    /// Number of data that were compared: common observations of two models, or positions.
    pub compared: usize,
    /// Number of those that fit.
    pub inliers: usize,
    /// Mean distance of the camera centres of common images from their places after the alignment,
    /// in units of the new frame; of positions, those that fit.
    pub mean_distance: f64,
}

/// A model that was merged into the first one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MergedInfo {
    /// The model.
    #[serde(serialize_with = "path_text")]
    pub path: PathBuf,
    /// How it fits.
    pub alignment: AlignmentInfo,
    /// Number of images that it added.
    pub new_images: usize,
    /// Number of points that it added.
    pub new_points: usize,
    /// Number of points that got observations of it.
    pub merged_points: usize,
}

/// Target of an alignment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlignTo<'a> {
    /// A model with common images, by the keypoints that observe points in both.
    Model {
        /// The model.
        reference: &'a LocatedModel,
        /// Maximum transfer error of an inlier, in pixels.
        max_error_px: f64,
    },
    /// Camera centres: a text file with lines `name x y z`, or a CSV file of [`position_priors`],
    /// which sets the [`Georeference`] of the model.
    Positions {
        /// The file.
        path: &'a Path,
        /// Maximum distance of an inlier, in the unit of the file.
        max_error: f64,
    },
    /// Control points that are marked in images ([`tiepoint_io::control_points`]).
    ControlPoints {
        /// The file.
        path: &'a Path,
    },
}

/// Which part of a model is kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CropTo {
    /// The points in a box, in units of the model.
    Box(BoundingBox),
    /// The points in the box between two quantiles of each coordinate, from 0 to 1.
    Quantiles(f64, f64),
}

/// Minimum number of images of an alignment to positions, which three determine.
const MIN_POSITIONS: usize = 3;

/// Writes a changed model into `to` in the format that it was read in. No file of `inputs` is
/// replaced.
fn write(located: &LocatedModel, to: &Path, inputs: &[PathBuf]) -> Result<ModelChange, Error> {
    located.write(to, inputs)?;
    Ok(ModelChange {
        path: to.to_owned(),
        images: located.reconstruction.num_registered(),
        points: located.reconstruction.num_tracks(),
        transform: None,
        alignment: None,
        frame: None,
        control_points: Vec::new(),
        merged: Vec::new(),
    })
}

/// Applies a similarity.
fn transform(located: &LocatedModel, new_from_old: &Sim3) -> Result<LocatedModel, Error> {
    let mut model = located.reconstruction.clone();
    model.transform(new_from_old);
    // A transform of huge numbers may overflow. The model was valid when it was read.
    let overflows = |_| Error::TransformOverflows { path: located.folder().to_owned() };
    model.validate().map_err(overflows)?;
    Ok(located.changed(model))
}

/// Counts and errors of a model.
pub fn model_info(located: &LocatedModel) -> ModelInfo {
    let model = &located.reconstruction;
    let cameras = model.cameras().map(|(id, camera)| CameraInfo {
        model: camera.intrinsics.kind().name(),
        param_names: camera.intrinsics.kind().param_names(),
        params: camera.intrinsics.params().to_vec(),
        width: camera.width,
        height: camera.height,
        images: model.registered().filter(|(_, image, _)| image.camera == id).count(),
    });
    let bounds = BoundingBox::of_points(model, 0.0, 1.0);
    let images = model.num_registered();
    ModelInfo {
        path: located.folder().to_owned(),
        cameras: cameras.collect(),
        rigs: model.rigs.len(),
        frames: model.frames.len(),
        images,
        points: model.num_tracks(),
        observations: model.num_observations(),
        mean_track_length: model.mean_track_length(),
        mean_observations_per_image: model.num_observations() as f64 / images.max(1) as f64,
        mean_reprojection_error_px: model.mean_reprojection_error_px(),
        min: bounds.map(|bounds| bounds.min.into()),
        max: bounds.map(|bounds| bounds.max.into()),
    }
}

/// Transforms a model by the similarity in a file (or its inverse), and writes it to `to`.
///
/// # Errors
///
/// The file cannot be read, or the result cannot be written.
pub fn transform_model(
    located: &LocatedModel,
    file: &Path,
    is_inverse: bool,
    to: &Path,
) -> Result<ModelChange, Error> {
    let new_from_old = similarity::read(file)?;
    let new_from_old = if is_inverse { new_from_old.inverse() } else { new_from_old };
    let mut inputs = located.files();
    inputs.push(file.to_owned());
    let change = write(&transform(located, &new_from_old)?, to, &inputs)?;
    Ok(ModelChange { transform: Some((&new_from_old).into()), ..change })
}

/// Aligns a model to another one or to positions, and writes it to `to`, and the transform to
/// `transform_to`, where `overwrite` permits to replace a file.
///
/// # Errors
///
/// An input cannot be read, the inputs do not determine the alignment, or the result cannot be
/// written.
pub fn align_model(
    located: &LocatedModel,
    align_to: AlignTo,
    to: &Path,
    transform_to: Option<&Path>,
    overwrite: bool,
) -> Result<ModelChange, Error> {
    let mut inputs = located.files();
    let mut control_points = Vec::new();
    let (new_from_old, alignment, georeference) = match align_to {
        AlignTo::Model { reference, max_error_px } => {
            inputs.extend(reference.files());
            let (similarity, info) = align_to_model(located, reference, max_error_px)?;
            (similarity, Some(info), reference.reconstruction.georeference)
        }
        AlignTo::Positions { path: file, max_error } => {
            inputs.push(file.to_owned());
            let (positions, georeference) = read_positions(file)?;
            let is_up = georeference.is_some();
            let (similarity, info) =
                align_to_positions(located, &positions, file, max_error, is_up)?;
            (similarity, Some(info), georeference)
        }
        AlignTo::ControlPoints { path: file } => {
            inputs.push(file.to_owned());
            let points = ControlPoints::read(file)?;
            let model = (located.folder(), &located.reconstruction);
            let (similarity, reports) = points.align(model, &located.shutters)?;
            control_points = reports;
            (similarity, None, Some(points.georeference()))
        }
    };
    let mut model = transform(located, &new_from_old)?;
    model.reconstruction.georeference = georeference;
    if let Some(file) = transform_to {
        // Both results are refused before either is written.
        refuse_foreign_model(to, &inputs)?;
        let replace = Replace::new(None, overwrite);
        write_file(file, inputs.iter().map(PathBuf::as_path), replace, |file| {
            Ok::<_, Error>(similarity::write(file, &new_from_old)?)
        })?;
        inputs.push(file.to_owned());
    }
    let change = write(&model, to, &inputs)?;
    let transform = Some((&new_from_old).into());
    let frame = georeference.as_ref().map(frame_in_words);
    Ok(ModelChange { transform, alignment, frame, control_points, ..change })
}

/// The frame of a georeferenced model, as a sentence.
pub(super) fn frame_in_words(georeference: &Georeference) -> String {
    match georeference {
        Georeference::Enu { frame, has_height } => {
            let Geodetic { latitude_deg, longitude_deg, height_m } = frame.origin();
            let altitude = match has_height {
                true => format!("altitude {height_m:.2} m"),
                false => "an altitude that is not known".to_owned(),
            };
            format!(
                "x is east, y north and z up, in metres from latitude {latitude_deg:.7}°, \
                 longitude {longitude_deg:.7}° and {altitude}"
            )
        }
        Georeference::Cartesian { offset } => {
            format!("that of the positions, in metres from {:?}", offset.as_slice())
        }
    }
}

/// Positions by the names of images, and the frame that they are in, if it is known.
fn read_positions(file: &Path) -> Result<(ByName<Vector3<f64>>, Option<Georeference>), Error> {
    if !position_priors::has_header(file)? {
        return Ok((ByName::new(positions::read(file)?), None));
    }
    let measured = position_priors::read(file)?;
    let measured = measured.into_iter().filter(|(_, position)| !position.place.is_null());
    let measured: BTreeMap<String, Position> = measured.collect();
    let georeference = Georeference::near(measured.values().map(|position| &position.place));
    let local = measured
        .into_iter()
        .filter_map(|(name, position)| Some((name, georeference?.to_local(&position.place)?)));
    Ok((ByName::new(local.collect()), georeference))
}

fn align_to_model(
    model: &LocatedModel,
    reference: &LocatedModel,
    max_error_px: f64,
) -> Result<(Sim3, AlignmentInfo), Error> {
    let (one, other) = (&model.reconstruction, &reference.reconstruction);
    let found = align_models(one, other, max_error_px).map_err(Error::adjusting(model.folder()))?;
    let Some(similarity) = found.reference_from_model else {
        return Err(Error::NoAlignment {
            model: model.folder().to_owned(),
            reference: reference.folder().to_owned(),
            reason: why_apart(&found),
        });
    };
    Ok((similarity, info_of(&found, mean_distance(one, other, &similarity))))
}

/// Why two models were not aligned.
fn why_apart(found: &tiepoint_sfm::model_tools::ModelAlignment) -> String {
    match (found.num_common_images, found.num_common_observations) {
        (0, _) => "no image has a pose in both; images are compared by name".to_owned(),
        (images, 0) => format!(
            "{images} images have a pose in both, but none of their keypoints observes a point in \
             both; both models must be made from the same features"
        ),
        (images, observations) => format!(
            "{images} images have a pose in both, but only {} of their {observations} common \
             observations fit one similarity",
            found.num_inliers
        ),
    }
}

fn info_of(found: &tiepoint_sfm::model_tools::ModelAlignment, mean_distance: f64) -> AlignmentInfo {
    AlignmentInfo {
        common_images: found.num_common_images,
        compared: found.num_compared,
        inliers: found.num_inliers,
        mean_distance,
    }
}

/// Mean distance of the centres of common images.
fn mean_distance(model: &Reconstruction, reference: &Reconstruction, similarity: &Sim3) -> f64 {
    let by_name: BTreeMap<&str, Vector3<f64>> = reference
        .registered()
        .map(|(_, image, pose)| (image.name.as_str(), pose.origin_in_a()))
        .collect();
    let distances = model.registered().filter_map(|(_, image, pose)| {
        let there = by_name.get(image.name.as_str())?;
        Some((*similarity * pose.origin_in_a() - there).norm())
    });
    mean(distances)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), value| (sum + value, count + 1));
    sum / count.max(1) as f64
}

/// `is_up`: z of the positions is up.
fn align_to_positions(
    model: &LocatedModel,
    positions: &ByName<Vector3<f64>>,
    file: &Path,
    max_error: f64,
    is_up: bool,
) -> Result<(Sim3, AlignmentInfo), Error> {
    let pairs = model
        .reconstruction
        .registered()
        .filter_map(|(_, image, pose)| Some((pose.origin_in_a(), *positions.get(&image.name)?)));
    let (from, to): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) = pairs.unzip();
    let failed = |reason: String| Error::NoAlignment {
        model: model.folder().to_owned(),
        reference: file.to_owned(),
        reason,
    };
    if from.len() < MIN_POSITIONS {
        let reason = format!(
            "{} of its images with a pose are in the file, and at least {MIN_POSITIONS} are needed",
            from.len()
        );
        return Err(failed(reason));
    }
    let options = RansacOptions { max_error, ..RansacOptions::default() };
    let report = estimate::similarity(&from, &to, true, &options)
        .filter(|report| report.num_inliers >= MIN_POSITIONS)
        .ok_or_else(|| {
            failed(format!(
                "fewer than {MIN_POSITIONS} of {} positions that are not on a line fit one \
                 similarity to within {max_error}",
                from.len()
            ))
        })?;
    let distance = |(from, to): (&Vector3<f64>, &Vector3<f64>)| (report.model * *from - to).norm();
    let fits = from.iter().zip(&to).filter(|pair| distance(*pair) <= max_error);
    let (distances, places): (Vec<f64>, Vec<Vector3<f64>>) =
        fits.map(|pair| (distance(pair), *pair.1)).unzip();
    // Those that fit are within three deviations.
    if is_up && may_be_mirrored(&model.reconstruction, &report.model, &places, max_error / 3.0) {
        return Err(failed(UPSIDE_DOWN.to_owned()));
    }
    let info = AlignmentInfo {
        common_images: from.len(),
        compared: from.len(),
        inliers: report.num_inliers,
        mean_distance: mean(distances.into_iter()),
    };
    Ok((report.model, info))
}

/// Keeps a part of a model and writes it to `to`.
///
/// # Errors
///
/// No point is in the box, or the result cannot be written.
pub fn crop_model(
    located: &LocatedModel,
    crop_to: CropTo,
    to: &Path,
) -> Result<ModelChange, Error> {
    let mut model = located.reconstruction.clone();
    let bounds = match crop_to {
        CropTo::Box(bounds) => Some(bounds),
        CropTo::Quantiles(low, high) => BoundingBox::of_points(&model, low, high),
    };
    let points = model.num_tracks();
    if let Some(bounds) = bounds {
        crop(&mut model, &bounds);
    }
    if model.num_tracks() == 0 {
        return Err(Error::EmptyCrop { path: located.folder().to_owned(), points });
    }
    write(&located.changed(model), to, &located.files())
}

/// Merges models into the frame of the first one and writes the result to `to`. A model that has
/// nothing in common with the first may fit after another one.
///
/// # Errors
///
/// A model fits none of the others, or the result cannot be written.
pub fn merge_models(
    located: &LocatedModel,
    others: &[LocatedModel],
    max_error_px: f64,
    to: &Path,
) -> Result<ModelChange, Error> {
    let all = std::iter::once(located).chain(others);
    let inputs: Vec<PathBuf> = all.flat_map(LocatedModel::files).collect();
    let mut first = located.reconstruction.clone();
    let mut models: Vec<&LocatedModel> = others.iter().collect();
    let mut merged = Vec::new();
    while !models.is_empty() {
        let mut last_failure = None;
        let before = models.len();
        let mut left = Vec::new();
        for model in models {
            let before_merge = first.clone();
            let outcome = merge_model(&mut first, &model.reconstruction, max_error_px)
                .map_err(Error::adjusting(model.folder()))?;
            if let Some(similarity) = &outcome.alignment.reference_from_model {
                let distance = mean_distance(&model.reconstruction, &before_merge, similarity);
                merged.push(MergedInfo {
                    path: model.folder().to_owned(),
                    alignment: info_of(&outcome.alignment, distance),
                    new_images: outcome.new_images,
                    new_points: outcome.new_points,
                    merged_points: outcome.merged_points,
                });
            } else {
                last_failure = Some((model.folder().to_owned(), why_apart(&outcome.alignment)));
                left.push(model);
            }
        }
        models = left;
        if let Some((model, reason)) = last_failure.filter(|_| models.len() == before) {
            let reference = located.folder().to_owned();
            return Err(Error::NoAlignment { model, reference, reason });
        }
    }
    let change = write(&located.changed(first), to, &inputs)?;
    Ok(ModelChange { merged, ..change })
}
