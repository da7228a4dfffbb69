//! Known calibrations from files, and the photos that they are of.

use std::path::PathBuf;
use std::str::FromStr;

use tiepoint_io::calibration::{self, CameraCalibration};
use tiepoint_io::{ImageFolder, ImageInfo, ImageSource};
use tiepoint_sfm::scene::Camera;

use crate::fingerprint::of_text;
use crate::{Error, Size};

/// A file of calibrations, and the photos that it is of. As a text `PATTERN=FILE#CAMERA`, of which
/// only the file is required.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CalibrationSource {
    /// Folders or names of photos with the wildcards `*` (any characters) and `?` (one); `None` for
    /// all photos.
    pub pattern: Option<String>,
    /// COLMAP's cameras.txt, OpenCV's YAML, Kalibr's camchain or KITTI's calib.txt.
    pub path: PathBuf,
    /// Name of the camera in the file; `None` for its only camera, or, without a pattern, for one
    /// camera a folder.
    pub camera: Option<String>,
}

impl FromStr for CalibrationSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (pattern, rest) = match text.split_once('=') {
            Some((pattern, rest)) => (Some(pattern.to_owned()), rest),
            None => (None, text),
        };
        let (path, camera) = match rest.rsplit_once('#') {
            Some((path, camera)) => (path, Some(camera.to_owned())),
            None => (rest, None),
        };
        if path.is_empty() || camera.as_deref() == Some("") || pattern.as_deref() == Some("") {
            return Err("expected FILE, PATTERN=FILE or PATTERN=FILE#CAMERA, as \
                        left=calib.txt#P2"
                .to_owned());
        }
        Ok(Self { pattern, path: path.into(), camera })
    }
}

impl CalibrationSource {
    /// The source with the fingerprint of the file in place of its path.
    pub(crate) fn fingerprint(&self) -> Result<String, Error> {
        let (pattern, camera) = (self.pattern.as_deref(), self.camera.as_deref());
        let hash = of_text(&self.path)?;
        Ok(format!("{}={hash}#{}", pattern.unwrap_or(""), camera.unwrap_or("")))
    }

    fn error(&self, what: String) -> Error {
        Error::Calibration { path: self.path.clone(), what }
    }
}

/// The calibrations of all sources.
pub(crate) struct Calibrations {
    /// Calibrated cameras, with the source of each.
    cameras: Vec<(usize, CameraCalibration)>,
    sources: Vec<CalibrationSource>,
    /// Of each image of the folder: an index into `cameras`.
    of_image: Vec<Option<usize>>,
}

impl Calibrations {
    /// Reads the sources. Where several are of one photo, the first counts.
    ///
    /// # Errors
    ///
    /// A file cannot be read or is damaged; it has no camera of the given name, or several and none
    /// is given; a pattern matches no photo.
    pub(crate) fn read(sources: &[CalibrationSource], photos: &ImageFolder) -> Result<Self, Error> {
        let mut this = Self {
            cameras: Vec::new(),
            sources: sources.to_vec(),
            of_image: vec![None; photos.images().len()],
        };
        for (index, source) in sources.iter().enumerate() {
            let found = calibration::read(&source.path)?;
            for (camera, images) in assign(source, &found, photos)? {
                this.cameras.push((index, found[camera].clone()));
                for image in images {
                    this.of_image[image].get_or_insert(this.cameras.len() - 1);
                }
            }
        }
        Ok(this)
    }

    /// The calibration of an image, if it has one: an index for [`Calibrations::camera`].
    pub(crate) fn of_image(&self, image: usize) -> Option<usize> {
        self.of_image[image]
    }

    /// The calibrated camera of a photo with this name.
    ///
    /// # Errors
    ///
    /// The size of the photo does not agree.
    pub(crate) fn camera(
        &self,
        index: usize,
        name: &str,
        info: &ImageInfo,
    ) -> Result<Camera, Error> {
        let (source, calibration) = &self.cameras[index];
        camera_of_photo(calibration, name, [info.width, info.height])
            .map_err(|what| self.sources[*source].error(what))
    }
}

/// The calibrated camera of a photo with this name, width and height; an error if they do not fit.
pub(crate) fn camera_of_photo(
    calibration: &CameraCalibration,
    photo: &str,
    [width, height]: [u32; 2],
) -> Result<Camera, String> {
    let CameraCalibration { name, size, intrinsics, .. } = calibration;
    if let Some([w, h]) = *size
        && (w, h) != (width, height)
    {
        return Err(format!(
            "the camera {name} has images of {}, and {photo} has {}: calibrate at the size of the \
            photos, or name the photos that the calibration is of, as PATTERN=FILE",
            Size(w, h),
            Size(width, height)
        ));
    }
    let camera = Camera { intrinsics: *intrinsics, width, height, has_focal_prior: true };
    if !camera.contains(&intrinsics.principal_point()) {
        let [x, y] = [intrinsics.principal_point().x, intrinsics.principal_point().y];
        return Err(format!(
            "the principal point of the camera {name}, ({x}, {y}), lies outside of {photo}, which \
            has {}: is the calibration that of another camera?",
            Size(width, height)
        ));
    }
    Ok(camera)
}

/// The cameras of a file, each with its images.
fn assign(
    source: &CalibrationSource,
    found: &[CameraCalibration],
    photos: &ImageFolder,
) -> Result<Vec<(usize, Vec<usize>)>, Error> {
    let names = || found.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>().join(", ");
    let folders = photos.camera_names();
    let images = photos.images();
    let of_folder = |folder: usize| -> Vec<usize> {
        (0..images.len()).filter(|&image| images[image].camera.index() == folder).collect()
    };
    let chosen =
        match &source.camera {
            None => None,
            Some(name) => {
                let camera = found.iter().position(|camera| camera.name == *name);
                Some(camera.ok_or_else(|| {
                    source.error(format!("has no camera {name:?}, only {}", names()))
                })?)
            }
        };
    let only = chosen.or((found.len() == 1).then_some(0));
    if let Some(pattern) = &source.pattern {
        let Some(camera) = only else {
            let what = format!(
                "has the cameras {}: say which {pattern} is, as {pattern}={}#{}",
                names(),
                source.path.display(),
                found[0].name
            );
            return Err(source.error(what));
        };
        let matching: Vec<usize> = (0..images.len())
            .filter(|&image| {
                let name = &images[image].name;
                let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
                matches(pattern, folder)
                    || matches(pattern, name)
                    || matches(pattern, &folders[images[image].camera.index()])
            })
            .collect();
        if matching.is_empty() {
            let what = format!(
                "is given for {pattern:?}, which matches no photo: there are the folders {}",
                folders.join(", ")
            );
            return Err(source.error(what));
        }
        return Ok(vec![(camera, matching)]);
    }
    if let Some(camera) = only {
        return Ok(vec![(camera, (0..images.len()).collect())]);
    }
    let by_name: Vec<(usize, Vec<usize>)> = found
        .iter()
        .enumerate()
        .filter_map(|(index, camera)| {
            let topic = camera.topic.as_deref();
            let is_own = |folder: &String| is_named(&camera.name, topic, folder);
            let folder = folders.iter().position(is_own)?;
            Some((index, of_folder(folder)))
        })
        .collect();
    if !by_name.is_empty() {
        return Ok(by_name);
    }
    if found.len() == folders.len() {
        return Ok((0..found.len()).map(|index| (index, of_folder(index))).collect());
    }
    let what = format!(
        "has the cameras {}, and the photos have the folders {}: say which is which, as {}={}#{}",
        names(),
        folders.join(", "),
        folders[0],
        source.path.display(),
        found[0].name
    );
    Err(source.error(what))
}

/// Whether a camera of a file is named as a folder: by its name, or by a part of its topic.
pub(crate) fn is_named(name: &str, topic: Option<&str>, folder: &str) -> bool {
    let last = folder.rsplit('/').next().unwrap_or(folder);
    let mut parts = topic.unwrap_or("").split('/').filter(|part| !part.is_empty());
    name == folder || name == last || parts.any(|part| part == last)
}

/// Whether a text matches a pattern with the wildcards `*` and `?`.
fn matches(pattern: &str, text: &str) -> bool {
    let (pattern, text): (Vec<char>, Vec<char>) =
        (pattern.chars().collect(), text.chars().collect());
    let (mut p, mut t) = (0, 0);
    // The last `*`, and the end of what it stands for.
    let mut star: Option<(usize, usize)> = None;
    while t < text.len() {
        match pattern.get(p) {
            Some('*') => {
                star = Some((p, t));
                p += 1;
            }
            Some(c) if *c == '?' || *c == text[t] => (p, t) = (p + 1, t + 1),
            _ => {
                let Some((at, end)) = star else { return false };
                star = Some((at, end + 1));
                (p, t) = (at + 1, end + 1);
            }
        }
    }
    pattern[p..].iter().all(|c| *c == '*')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wildcards_match_as_in_shells() {
        for (pattern, text, expected) in [
            ("*", "", true),
            ("left", "left", true),
            ("left", "left2", false),
            ("left*", "left2", true),
            ("*/cam?", "a/b/cam1", true),
            ("*/cam?", "a/b/cam", false),
            ("*a*b", "xaxxbxb", true),
            ("*a*b", "xaxxbx", false),
            ("é?", "éa", true),
        ] {
            assert_eq!(matches(pattern, text), expected, "{pattern} {text}");
        }
    }

    #[test]
    fn a_camera_has_the_folder_of_its_name_or_topic() {
        assert!(is_named("cam0", None, "drive/cam0"));
        assert!(is_named("cam0", Some("/left/image_raw"), "left"));
        assert!(!is_named("cam0", Some("/left/image_raw"), "right"));
        assert!(!is_named("cam0", Some("/left/image_raw"), ""));
    }

    #[test]
    fn a_source_has_a_pattern_a_file_and_a_camera() {
        let source = |pattern: Option<&str>, path: &str, camera: Option<&str>| CalibrationSource {
            pattern: pattern.map(str::to_owned),
            path: path.into(),
            camera: camera.map(str::to_owned),
        };
        assert_eq!("a/calib.txt".parse(), Ok(source(None, "a/calib.txt", None)));
        assert_eq!("left*=c.yaml#cam0".parse(), Ok(source(Some("left*"), "c.yaml", Some("cam0"))));
        for wrong in ["", "=a", "left=", "a#", "left=#P0"] {
            let error = wrong.parse::<CalibrationSource>().unwrap_err();
            assert!(error.contains("PATTERN=FILE#CAMERA"), "{error}");
        }
    }
}
