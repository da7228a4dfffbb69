//! A result in formats of others.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use rayon::prelude::*;
use serde::Serialize;
use tiepoint_io::bal::Bal;
use tiepoint_io::colmap::{self, Format, read_model};
use tiepoint_io::trajectory::{self, TimedPose};
use tiepoint_io::{
    AtomicFile, ImageFolder, ImageSource, Rgb, nerfstudio, openmvs, ply, timestamps, undistort,
};
use tiepoint_sfm::geometry::Rigid3;
use tiepoint_sfm::scene::{Image, Reconstruction};

use crate::Error;
use crate::evaluate::{first_folder, model_folder};
use crate::kalibr;
use crate::records::Records;
use crate::rigid::{RigidReport, rigid_model};
use crate::workspace::{RIG, STAGES};

/// A format to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// COLMAP's binary files, in a folder.
    Colmap,
    /// COLMAP's text files, in a folder.
    ColmapText,
    /// The cloud.
    Ply,
    /// Poses with times, of the camera of the first image.
    Tum,
    /// Poses line by line, of the camera of the first image.
    Kitti,
    /// A bundle adjustment problem.
    Bal,
    /// `scene.mvs` and undistorted images, in a folder.
    OpenMvs,
    /// `transforms.json`, the images and the cloud, in a folder.
    Nerfstudio,
    /// The rig with its clocks, as Kalibr's `camchain.yaml`.
    Kalibr,
}

/// Formats by name.
const FORMATS: [(&str, ExportFormat); 9] = [
    ("colmap", ExportFormat::Colmap),
    ("openmvs", ExportFormat::OpenMvs),
    ("nerfstudio", ExportFormat::Nerfstudio),
    ("colmap-text", ExportFormat::ColmapText),
    ("ply", ExportFormat::Ply),
    ("tum", ExportFormat::Tum),
    ("kitti", ExportFormat::Kitti),
    ("bal", ExportFormat::Bal),
    ("kalibr", ExportFormat::Kalibr),
];

impl FromStr for ExportFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = FORMATS.iter().find(|(name, _)| *name == text).map(|(_, format)| *format);
        found
            .ok_or_else(|| format!("unknown format: use one of {}", FORMATS.map(|(name, _)| name).join(", ")))
    }
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Exported {
    /// Where.
    pub path: PathBuf,
    /// How many poses, where the format has any.
    pub poses: usize,
    /// How many points, where the format has any.
    pub points: usize,
    /// What it took to make the cameras rigid, where that was asked for.
    pub rigid: Option<RigidReport>,
}

/// Writes a model (a folder, or a workspace) in another format.
pub fn export(from: &Path, format: ExportFormat, to: &Path) -> Result<Exported, Error> {
    write_as(from, &read_model(&model_folder(from))?, format, to)
}

/// Adjusts a model with its cameras held exactly to one calibration first, whatever it was held to before; its moments are frames of a rig
/// then. What is on disk is not changed.
pub fn export_rigid(from: &Path, format: ExportFormat, to: &Path) -> Result<Exported, Error> {
    if format == ExportFormat::Kalibr {
        return Err(Error::NoPoses { path: to.to_owned() });
    }
    let (model, rigid) = rigid_model(from)?;
    Ok(Exported { rigid: Some(rigid), ..write_as(from, &model, format, to)? })
}

fn write_as(from: &Path, model: &Reconstruction, format: ExportFormat, to: &Path) -> Result<Exported, Error> {
    let folder = model_folder(from);
    let (mut poses, mut points) = (model.num_registered(), model.num_tracks());
    match format {
        ExportFormat::Colmap => colmap::write_model(to, model, Format::Binary)?,
        ExportFormat::ColmapText => colmap::write_model(to, model, Format::Text)?,
        ExportFormat::Bal => {
            let bal = Bal::from_reconstruction(model).map_err(|error| error.of(&folder))?;
            bal.write(to)?;
        }
        ExportFormat::OpenMvs => export_openmvs(from, model, to)?,
        ExportFormat::Nerfstudio => export_nerfstudio(from, model, to)?,
        ExportFormat::Kalibr => {
            let (text, cameras) = kalibr::camchain(model, &folder.join("../..").join(RIG))?;
            AtomicFile::write_with(to, |out| out.write_all(text.as_bytes()))?;
            (poses, points) = (cameras, 0);
        }
        ExportFormat::Ply => {
            ply::write(to, &ply::points(model))?;
            poses = 0;
        }
        ExportFormat::Kitti => {
            let trajectory: Vec<Rigid3> = trajectory_of(model).into_iter().map(|(_, pose)| pose).collect();
            trajectory::write_kitti(to, &trajectory)?;
            (poses, points) = (trajectory.len(), 0);
        }
        ExportFormat::Tum => {
            let times = timestamps::read(&folder.join("../../timestamps.csv"))?;
            let timed = trajectory_of(model).into_iter().filter_map(|(image, cam_from_world)| {
                Some(TimedPose { time_s: *times.get(&image.name)?, cam_from_world })
            });
            let mut timed: Vec<TimedPose> = timed.collect();
            timed.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
            if timed.is_empty() {
                return Err(Error::NoTimes { model: folder });
            }
            trajectory::write_tum(to, &timed)?;
            (poses, points) = (timed.len(), 0);
        }
    }
    Ok(Exported { path: to.to_owned(), poses, points, rigid: None })
}

/// Where the images lie in the folder of an export.
const IMAGES: &str = "images";

/// OpenMVS takes images to be free of distortion: they are written anew, as pinhole cameras would have taken them.
fn export_openmvs(from: &Path, model: &Reconstruction, to: &Path) -> Result<(), Error> {
    let undistorted = undistort::undistort_model(model);
    for_each_photo(from, model, |image, path| {
        let (old, new) = (model.camera(image.camera), undistorted.camera(image.camera));
        let target = place(to, image)?;
        Ok(undistort::undistort_image(&Rgb::read(path)?, old, new).write(&target)?)
    })?;
    Ok(openmvs::write(&to.join("scene.mvs"), &undistorted, IMAGES)?)
}

/// nerfstudio knows distortion: the photos are copied as they are.
fn export_nerfstudio(from: &Path, model: &Reconstruction, to: &Path) -> Result<(), Error> {
    for_each_photo(from, model, |image, path| {
        let target = place(to, image)?;
        std::fs::copy(path, &target).map(|_| ()).map_err(|cause| Error::Output { path: target, cause })
    })?;
    ply::write(&to.join("points.ply"), &ply::points(model))?;
    Ok(nerfstudio::write(&to.join("transforms.json"), model, IMAGES, Some("points.ply"))?)
}

/// Where an image goes, its folder being made.
fn place(to: &Path, image: &Image) -> Result<PathBuf, Error> {
    let path = to.join(IMAGES).join(&image.name);
    let made = path.parent().map_or(Ok(()), std::fs::create_dir_all);
    made.map_err(|cause| Error::Output { path: path.clone(), cause })?;
    Ok(path)
}

/// Calls `work` with each registered image and its file, in parallel.
fn for_each_photo(
    from: &Path,
    model: &Reconstruction,
    work: impl Fn(&Image, &Path) -> Result<(), Error> + Sync,
) -> Result<(), Error> {
    let stages = from.join(STAGES);
    if !stages.is_file() {
        return Err(Error::NoPhotos { path: from.to_owned() });
    }
    let inputs = Records::read(&stages)?.inputs;
    let folder = ImageFolder::open(&inputs, None)?;
    let by_name: BTreeMap<&str, usize> =
        folder.images().iter().enumerate().map(|(index, image)| (image.name.as_str(), index)).collect();
    let images: Vec<&Image> = model.registered().map(|(_, image, _)| image).collect();
    images.par_iter().try_for_each(|image| {
        let missing = || Error::NoPhoto { image: image.name.clone(), inputs: inputs.clone() };
        let index = by_name.get(image.name.as_str()).ok_or_else(missing)?;
        work(image, folder.path(*index))
    })
}

/// The registered images of the first camera, by name.
fn trajectory_of(model: &Reconstruction) -> Vec<(&Image, Rigid3)> {
    let prefix = first_folder(model);
    let mut images: Vec<(&Image, Rigid3)> = model
        .registered()
        .filter(|(_, image, _)| image.name.starts_with(&prefix))
        .map(|(_, image, pose)| (image, *pose))
        .collect();
    images.sort_by(|a, b| a.0.name.cmp(&b.0.name));
    images
}
