//! A result in formats of others.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::Serialize;
use tiepoint_io::bal::Bal;
use tiepoint_io::colmap::{self, Format, read_model};
use tiepoint_io::trajectory::{self, TimedPose};
use tiepoint_io::{ply, timestamps};
use tiepoint_sfm::geometry::Rigid3;
use tiepoint_sfm::scene::{Image, Reconstruction};

use crate::Error;
use crate::evaluate::{first_folder, model_folder};

/// A format to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
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
}

/// Formats by name.
const FORMATS: [(&str, ExportFormat); 5] = [
    ("colmap-text", ExportFormat::ColmapText),
    ("ply", ExportFormat::Ply),
    ("tum", ExportFormat::Tum),
    ("kitti", ExportFormat::Kitti),
    ("bal", ExportFormat::Bal),
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
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Exported {
    /// Where.
    pub path: PathBuf,
    /// How many poses, where the format has any.
    pub poses: usize,
    /// How many points, where the format has any.
    pub points: usize,
}

/// Writes a model (a folder, or a workspace) in another format.
pub fn export(from: &Path, format: ExportFormat, to: &Path) -> Result<Exported, Error> {
    let folder = model_folder(from);
    let model = read_model(&folder)?;
    let (mut poses, mut points) = (model.num_registered(), model.num_tracks());
    match format {
        ExportFormat::ColmapText => colmap::write_model(to, &model, Format::Text)?,
        ExportFormat::Bal => {
            let bal = Bal::from_reconstruction(&model).map_err(|error| error.of(&folder))?;
            bal.write(to)?;
        }
        ExportFormat::Ply => {
            ply::write(to, &ply::points(&model))?;
            poses = 0;
        }
        ExportFormat::Kitti => {
            let trajectory: Vec<Rigid3> = trajectory_of(&model).into_iter().map(|(_, pose)| pose).collect();
            trajectory::write_kitti(to, &trajectory)?;
            (poses, points) = (trajectory.len(), 0);
        }
        ExportFormat::Tum => {
            let times = timestamps::read(&folder.join("../../timestamps.csv"))?;
            let timed = trajectory_of(&model).into_iter().filter_map(|(image, cam_from_world)| {
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
    Ok(Exported { path: to.to_owned(), poses, points })
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
