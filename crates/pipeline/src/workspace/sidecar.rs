//! `tiepoint.json` beside the files of a COLMAP model: what those do not hold.
//!
//! It carries hashes of the files that it belongs to. Another program may write a model in their
//! place, which it says nothing of.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tiepoint_input::fingerprint::hash_files;
use tiepoint_io::colmap::{Format, MODEL_FILES};
use tiepoint_sfm::geometry::geodesy::{Geodetic, LocalFrame};
use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics};
use tiepoint_sfm::rolling_shutter::RollingShutter;
use tiepoint_sfm::scene::{CameraId, Georeference, IntrinsicsPrior, PointId, Reconstruction};

use crate::Error;
use crate::workspace::format;
use crate::workspace::rig_file::RigFile;

/// Name of the file.
pub(crate) const SIDECAR: &str = "tiepoint.json";

/// The file's content. Ids are those of COLMAP's files.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub(crate) struct Sidecar {
    /// Hashes of the files of the model by their names.
    files: BTreeMap<String, String>,
    cameras: Vec<CameraFacts>,
    /// Cameras of one lens whose images have portrait and landscape format.
    portrait_landscape_pairs: Vec<[u64; 2]>,
    images: Vec<ImageFacts>,
    /// Points that take no part in adjustments.
    held_out_points: Vec<u64>,
    /// Extrinsics and clocks of the rig.
    rig: Option<RigFile>,
    /// Where the world frame is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    georeference: Option<GeoreferenceFacts>,
}

/// Where the world frame is: metric, x and y horizontal, z up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "frame", rename_all = "lowercase")]
pub(crate) enum GeoreferenceFacts {
    /// East, north and up, WGS 84, at this origin, whose height may not be known.
    Enu {
        latitude_deg: f64,
        longitude_deg: f64,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        height_m: Option<f64>,
    },
    /// The coordinates of the positions are those of the model plus `offset`.
    Cartesian { offset: [f64; 3] },
}

impl From<&Georeference> for GeoreferenceFacts {
    fn from(georeference: &Georeference) -> Self {
        match georeference {
            Georeference::Enu { frame, has_height } => {
                let Geodetic { latitude_deg, longitude_deg, height_m } = *frame.origin();
                let height_m = has_height.then_some(height_m);
                Self::Enu { latitude_deg, longitude_deg, height_m }
            }
            Georeference::Cartesian { offset } => Self::Cartesian { offset: (*offset).into() },
        }
    }
}

impl From<GeoreferenceFacts> for Georeference {
    fn from(facts: GeoreferenceFacts) -> Self {
        match facts {
            GeoreferenceFacts::Enu { latitude_deg, longitude_deg, height_m } => {
                let has_height = height_m.is_some();
                let height_m = height_m.unwrap_or(0.0);
                let origin = Geodetic { latitude_deg, longitude_deg, height_m };
                Self::Enu { frame: LocalFrame::new(origin), has_height }
            }
            GeoreferenceFacts::Cartesian { offset } => Self::Cartesian { offset: offset.into() },
        }
    }
}

/// What COLMAP's files do not say of a camera.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object that describes a camera")]
struct CameraFacts {
    id: u64,
    /// Whether its intrinsics are known, so that adjustments keep them.
    is_calibrated: bool,
    /// Whether its focal length was known before, at least roughly.
    has_focal_prior: bool,
    /// The calibration around which adjustments have their prior.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    calibration: Option<CalibrationFacts>,
    /// Time between the exposures of the first and the last row of a rolling shutter, in seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    readout_s: Option<f64>,
    /// Its standard deviation, if it was estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    readout_sd_s: Option<f64>,
    /// Whether it was estimated and the images do not determine it: an infinite deviation, which
    /// JSON does not have.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    is_readout_unobservable: bool,
}

/// A calibration of a camera, for the model that its intrinsics have.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object that describes a calibration")]
struct CalibrationFacts {
    params: Vec<f64>,
    /// Standard deviations; `None` for an infinite one, which JSON does not have.
    sigmas: Vec<Option<f64>>,
}

impl CalibrationFacts {
    fn new(prior: &IntrinsicsPrior) -> Self {
        Self { params: prior.mean.params().to_vec(), sigmas: format::finite(&prior.sigmas) }
    }

    /// The prior of a camera of this model; an error in words.
    fn prior(&self, kind: CameraModelKind) -> Result<IntrinsicsPrior, String> {
        let mean = Intrinsics::new(kind, &self.params).map_err(|error| error.to_string())?;
        let sigmas: Vec<f64> =
            self.sigmas.iter().map(|sigma| sigma.unwrap_or(f64::INFINITY)).collect();
        match sigmas.len() == kind.num_params() && sigmas.iter().all(|sigma| *sigma > 0.0) {
            true => Ok(IntrinsicsPrior { mean, sigmas }),
            false => Err(format!("{} positive sigmas are expected", kind.num_params())),
        }
    }
}

/// What COLMAP's files do not say of an image.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object that describes an image")]
struct ImageFacts {
    id: u64,
    stream: String,
    /// Capture time on the clock of its camera, in seconds.
    time_s: Option<f64>,
}

/// Shutters and rig of a model.
pub(crate) type ShuttersAndRig = (Vec<RollingShutter>, Option<RigFile>);

impl Sidecar {
    /// Of a model with its rolling shutters and its rig. `files`: names and paths of its files.
    ///
    /// # Errors
    ///
    /// A file of the model cannot be read.
    pub(crate) fn new(
        files: impl IntoIterator<Item = (String, PathBuf)>,
        model: &Reconstruction,
        shutters: &[RollingShutter],
        rig: Option<RigFile>,
    ) -> Result<Self, Error> {
        let ids = &model.original_ids;
        let hash = |(name, path)| Ok((name, hash_files(&[path])?));
        let camera = |id: CameraId| {
            let shutter = shutters.iter().find(|shutter| shutter.camera == id);
            let sd_s = shutter.and_then(|shutter| shutter.readout_sd_s);
            CameraFacts {
                id: ids.camera(id),
                is_calibrated: model.calibrated.contains(&id),
                has_focal_prior: model.camera(id).has_focal_prior,
                calibration: model.intrinsics_priors.get(&id).map(CalibrationFacts::new),
                readout_s: shutter.map(|shutter| shutter.readout_s),
                readout_sd_s: sd_s.filter(|sd_s| sd_s.is_finite()),
                is_readout_unobservable: sd_s == Some(f64::INFINITY),
            }
        };
        let image = |(id, image, _): (_, &tiepoint_sfm::scene::Image, _)| ImageFacts {
            id: ids.image(id),
            stream: image.stream.to_string(),
            time_s: image.time_s,
        };
        let held_out = model.tracks().filter(|(_, track)| track.is_held_out);
        let pairs = model.portrait_landscape_pairs.iter();
        Ok(Self {
            files: files.into_iter().map(hash).collect::<Result<_, Error>>()?,
            cameras: model.cameras().map(|(id, _)| camera(id)).collect(),
            portrait_landscape_pairs: pairs.map(|pair| pair.map(|id| ids.camera(id))).collect(),
            images: model.registered().map(image).collect(),
            held_out_points: held_out.map(|(id, _)| ids.point(id)).collect(),
            rig,
            georeference: model.georeference.as_ref().map(GeoreferenceFacts::from),
        })
    }

    /// Parses the content of the file at `path`.
    ///
    /// # Errors
    ///
    /// The content is not JSON of this form or has another format, or its rig is not one.
    pub(crate) fn from_json(path: &Path, text: &[u8]) -> Result<Self, Error> {
        let broken = |what: String| Error::Broken { path: path.to_owned(), what };
        let this: Self = format::from_json(path, text, broken)?;
        this.rig.iter().try_for_each(|rig| rig.validate(path))?;
        Ok(this)
    }

    /// The content of the file.
    pub(crate) fn to_json(&self) -> Vec<u8> {
        format::to_json(self)
    }

    /// Whether the model that is read from a folder is the one that this belongs to. Both formats
    /// may be there.
    pub(crate) fn is_of(&self, folder: &Path, format: Format) -> bool {
        let names = MODEL_FILES.map(|name| format!("{name}.{}", format.suffix()));
        let is_same = |name: &String| {
            let found = hash_files(&[folder.join(name)]).ok();
            found.is_some() && found.as_ref() == self.files.get(name)
        };
        self.files.len() == names.len() && names.iter().all(is_same)
    }

    /// Completes the model that was read from the files.
    ///
    /// # Errors
    ///
    /// The parameters of a camera are not those of its model; in words.
    pub(crate) fn add_to(self, model: &mut Reconstruction) -> Result<ShuttersAndRig, String> {
        let ids = &model.original_ids;
        let cameras: BTreeMap<u64, CameraId> =
            model.cameras().map(|(id, _)| (ids.camera(id), id)).collect();
        let images: BTreeMap<u64, _> = model.images().map(|(id, _)| (ids.image(id), id)).collect();
        let points: BTreeMap<u64, PointId> =
            model.tracks().map(|(id, _)| (ids.point(id), id)).collect();
        let mut shutters = Vec::new();
        for facts in self.cameras {
            let Some(&id) = cameras.get(&facts.id) else { continue };
            let camera = model.camera_mut(id);
            camera.has_focal_prior = facts.has_focal_prior;
            if let Some(calibration) = facts.calibration {
                let prior = calibration
                    .prior(camera.intrinsics.kind())
                    .map_err(|error| format!("the calibration of a camera: {error}"))?;
                model.intrinsics_priors.insert(id, prior);
            }
            if facts.is_calibrated {
                model.calibrated.insert(id);
            }
            shutters.extend(facts.readout_s.map(|readout_s| RollingShutter {
                camera: id,
                readout_s,
                readout_sd_s: match facts.is_readout_unobservable {
                    true => Some(f64::INFINITY),
                    false => facts.readout_sd_s,
                },
            }));
        }
        for facts in self.images {
            if let Some(&id) = images.get(&facts.id) {
                model.set_time(id, facts.time_s);
                model.set_stream(id, facts.stream.into());
            }
        }
        let pairs = self.portrait_landscape_pairs.into_iter();
        model.portrait_landscape_pairs = pairs
            .filter_map(|[one, other]| Some([*cameras.get(&one)?, *cameras.get(&other)?]))
            .filter(|[one, other]| one != other)
            .collect();
        for id in self.held_out_points.iter().filter_map(|id| points.get(id)) {
            if let Some(track) = model.track_mut(*id) {
                track.is_held_out = true;
            }
        }
        model.georeference = self.georeference.map(Georeference::from);
        Ok((shutters, self.rig))
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_sfm::geometry::nalgebra::{Vector2, Vector3};
    use tiepoint_sfm::geometry::{CameraModelKind, Rigid3};
    use tiepoint_sfm::scene::{Camera, Image, Keypoint, Observation, Track};
    use tiepoint_store::OutputFolder;

    use super::*;
    use crate::workspace::located_model::LocatedModel;
    use crate::workspace::model_output::stage_with_sidecar;

    /// Two cameras and three images of two streams, one of them without a pose, and two points.
    fn model() -> Reconstruction {
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, 500.0, 640, 480);
        let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: false };
        let cameras = [0, 1].map(|_| model.add_camera(camera));
        let keypoint = Keypoint { pixel: Vector2::new(1.0, 2.0), scale_px: 1.0 };
        for (name, camera, time_s) in
            [("0.png", 0, None), ("a/1.png", 0, Some(0.1)), ("2.png", 1, Some(1.7e9 + 1.0 / 3.0))]
        {
            let image = Image::new(name, cameras[camera], vec![keypoint; 2]);
            let image = model.add_image(image);
            model.set_stream(image, "front".into());
            model.set_time(image, time_s);
            if name != "0.png" {
                model.register(image, Rigid3::identity());
            }
        }
        for keypoint in 0..2 {
            let observations = [1, 2]
                .map(|image| Observation { image: tiepoint_sfm::scene::ImageId(image), keypoint });
            model.add_track(Track::new(Vector3::new(0.0, 0.0, 5.0), observations.to_vec()));
        }
        model.track_mut(PointId(1)).unwrap().is_held_out = true;
        model.calibrated.insert(cameras[1]);
        let prior = IntrinsicsPrior::new(intrinsics, 640, 480, 0.7);
        model.intrinsics_priors.insert(cameras[0], prior);
        model.portrait_landscape_pairs = vec![cameras];
        let origin = Geodetic { latitude_deg: 55.7, longitude_deg: 13.2, height_m: 1.0 / 3.0 };
        let frame = LocalFrame::new(origin);
        model.georeference = Some(Georeference::Enu { frame, has_height: true });
        model
    }

    /// Writes the model into a folder, and opens it again.
    fn written(
        dir: &Path,
        model: &Reconstruction,
        format: Format,
        shutters: &[RollingShutter],
    ) -> LocatedModel {
        let mut folder = OutputFolder::open(dir).unwrap();
        let known = (shutters.to_vec(), Some(RigFile::default()));
        let names = stage_with_sidecar(&folder, None, model, format, Some(&known)).unwrap();
        folder.publish(&names, &[]).unwrap();
        LocatedModel::open(dir).unwrap()
    }

    #[test]
    fn what_colmap_does_not_hold_is_read_again() {
        let model = model();
        let shutter = |camera, readout_sd_s| RollingShutter {
            camera: CameraId(camera),
            readout_s: 0.1 + 0.2,
            readout_sd_s,
        };
        for sd_s in [None, Some(1e-4), Some(f64::INFINITY)] {
            for format in Format::ALL {
                let dir = tempfile::tempdir().unwrap();
                let shutters = [shutter(0, None), shutter(1, sd_s)];
                let found = written(dir.path(), &model, format, &shutters);
                assert_eq!((found.note(), found.format()), (None, format));
                assert_eq!(found.shutters, shutters);
                assert_eq!(found.rig, Some(RigFile::default()));
                let read = &found.reconstruction;
                let images = |model: &Reconstruction| -> Vec<_> {
                    let of =
                        |image: &Image| (image.name.clone(), image.stream.clone(), image.time_s);
                    model.registered().map(|(_, image, _)| of(image)).collect()
                };
                assert_eq!(images(read), images(&model));
                assert_eq!(read.calibrated, model.calibrated);
                assert_eq!(read.intrinsics_priors, model.intrinsics_priors);
                assert_eq!(read.portrait_landscape_pairs, model.portrait_landscape_pairs);
                assert_eq!(read.georeference, model.georeference);
                assert!(read.cameras().eq(model.cameras()));
                assert!(read.tracks().map(|(_, t)| t.is_held_out).eq([false, true]));
                // A copy says the same.
                let copy = tempfile::tempdir().unwrap();
                found.write(copy.path(), &[]).unwrap();
                let copy = LocatedModel::open(copy.path()).unwrap();
                assert_eq!((copy.reconstruction, copy.rig), (found.reconstruction, found.rig));
            }
        }
    }

    #[test]
    fn a_model_that_another_program_changed_is_taken_without_it_and_says_so() {
        let dir = tempfile::tempdir().unwrap();
        written(dir.path(), &model(), Format::Binary, &[]);
        let points = dir.path().join("points3D.bin");
        let mut bytes = std::fs::read(&points).unwrap();
        // The first coordinate of the first point, behind the count and its id.
        bytes[16] ^= 1;
        std::fs::write(&points, bytes).unwrap();
        let found = LocatedModel::open(dir.path()).unwrap();
        let note = found.note().unwrap();
        assert!(
            note.contains("tiepoint.json is not used") && note.contains("has changed"),
            "{note}"
        );
        assert!(found.rig.is_none() && found.reconstruction.calibrated.is_empty());
        assert!(found.reconstruction.images().all(|(_, image)| image.time_s.is_none()));
        // A model in the format that is read first hides the one that the file belongs to.
        let dir = tempfile::tempdir().unwrap();
        written(dir.path(), &model(), Format::Text, &[]);
        let binary = tempfile::tempdir().unwrap();
        written(binary.path(), &model(), Format::Binary, &[]);
        for name in MODEL_FILES.map(|name| format!("{name}.bin")) {
            std::fs::copy(binary.path().join(&name), dir.path().join(&name)).unwrap();
        }
        assert!(LocatedModel::open(dir.path()).unwrap().note().is_some());
        // Nothing is said of it beside what is written.
        let copy = tempfile::tempdir().unwrap();
        found.write(copy.path(), &[]).unwrap();
        assert!(!copy.path().join(SIDECAR).exists());
    }

    #[test]
    fn a_damaged_file_is_no_reason_to_refuse_the_model() {
        let dir = tempfile::tempdir().unwrap();
        written(dir.path(), &model(), Format::Binary, &[]);
        let text = std::fs::read_to_string(dir.path().join(SIDECAR)).unwrap();
        let with_file = |name: &str| text.replace("cameras.bin", name);
        for (text, reason) in [
            ("{".to_owned(), "EOF"),
            (text.replace("\"format\": 1", "\"format\": 2"), "format 2"),
            (text.replace("true", "7"), "expected a boolean"),
            (with_file("../cameras.bin"), "has changed"),
            (with_file("/etc/passwd"), "has changed"),
            (text.replace("500.0,", ""), "the calibration of a camera"),
        ] {
            std::fs::write(dir.path().join(SIDECAR), &text).unwrap();
            let found = LocatedModel::open(dir.path()).unwrap();
            let note = found.note().unwrap();
            assert!(note.contains(reason), "{note}");
            assert_eq!(found.reconstruction.num_tracks(), 2);
        }
    }
}
