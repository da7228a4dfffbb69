//! Known calibrations from files, and the photos that they are of.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use tiepoint_io::calibration::{self, CameraCalibration};
use tiepoint_scene::Camera;

use super::known_intrinsics::{assumed_size, camera_of};
use crate::fingerprint::hash_file;
use crate::images::{Exif, ImageFolder, ImageInfo};
use crate::{Error, Size};

/// A file of calibrations, and the photos that it is of. As a text `PATTERN=FILE#CAMERA@WxH`, of
/// which only the file is required. Where the name of a file has `=` or `#`, the first reading that
/// names an existing file counts: the whole text, then without a camera, then with each `=`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CalibrationSource {
    /// Folders or names of photos with the wildcards `*` (any characters) and `?` (one). `None`:
    /// the cameras of the file are found among the folders.
    pub pattern: Option<String>,
    /// COLMAP's cameras.txt, OpenCV's YAML, Kalibr's camchain or KITTI's calib.txt.
    pub path: PathBuf,
    /// Name of the camera in the file; `None` for its only camera, or, without a pattern, for one
    /// camera a folder.
    pub camera: Option<String>,
    /// Width and height of the images of the calibration, in pixels, for a file without them.
    pub size: Option<[u32; 2]>,
}

impl FromStr for CalibrationSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let whole = |(at, _)| (Some(&text[..at]), &text[at + 1..]);
        let mut readings = vec![(None, text)];
        readings.extend(text.match_indices('=').map(whole));
        let exists = |path: &str| Path::new(path).is_file();
        // A name with # or @, with a pattern or without.
        if let Some((pattern, path)) = readings.iter().find(|(_, path)| exists(path)) {
            return Self::new(*pattern, path, None);
        }
        let with_camera = |(pattern, rest): &(_, &'_ str)| {
            let (path, camera) = rest.rsplit_once('#')?;
            exists(path).then(|| Self::new(*pattern, path, Some(camera)))
        };
        if let Some(source) = readings.iter().find_map(with_camera) {
            return source;
        }
        // No such file: the first = and the last # are the separators.
        let (pattern, rest) = readings[usize::from(readings.len() > 1)];
        let (path, camera) = rest.rsplit_once('#').unzip();
        Self::new(pattern, path.unwrap_or(rest), camera)
    }
}

impl CalibrationSource {
    /// From the parts of a text; `camera` is CAMERA, CAMERA@WxH or @WxH.
    fn new(pattern: Option<&str>, path: &str, camera: Option<&str>) -> Result<Self, String> {
        let size = |text: &str| {
            let (width, height) = text.split_once('x')?;
            Some([width.parse().ok()?, height.parse().ok()?])
        };
        let sized = camera.and_then(|text| {
            let (camera, sides) = text.rsplit_once('@')?;
            Some((camera, size(sides)?))
        });
        let (camera, size) = match sized {
            Some((camera, size)) => ((!camera.is_empty()).then_some(camera), Some(size)),
            None => (camera, None),
        };
        if path.is_empty() || camera == Some("") || pattern == Some("") {
            return Err("expected FILE, PATTERN=FILE or PATTERN=FILE#CAMERA, as \
                        left=calib.txt#P2"
                .to_owned());
        }
        let [pattern, camera] = [pattern, camera].map(|text| text.map(str::to_owned));
        Ok(Self { pattern, path: path.into(), camera, size })
    }

    /// The source with the fingerprint of the file in place of its path.
    ///
    /// # Errors
    ///
    /// The file cannot be read.
    pub fn fingerprint(&self) -> Result<String, Error> {
        let (pattern, camera) = (self.pattern.as_deref(), self.camera.as_deref());
        let hash = hash_file(&self.path)?;
        let size = self.size.map_or_else(String::new, |[w, h]| format!("@{w}x{h}"));
        Ok(format!("{}={hash}#{}{size}", pattern.unwrap_or(""), camera.unwrap_or("")))
    }

    fn error(&self, what: String) -> Error {
        Error::Calibration { path: self.path.clone(), what }
    }

    /// The cameras of the file, with the size that this source states.
    fn read(&self) -> Result<Vec<CameraCalibration>, Error> {
        let Self { pattern, path, camera, size } = self;
        if (pattern.is_some() || camera.is_some()) && !path.exists() {
            let [pattern, camera] = [pattern, camera].map(|text| text.as_deref().unwrap_or("none"));
            let what = format!(
                "No such file: `features.calibration` was read as the pattern {pattern}, this \
                file, and its camera {camera}"
            );
            return Err(self.error(what));
        }
        let mut found = calibration::read(path)?;
        if let Some([width, height]) = *size {
            for camera in &mut found {
                let own = *camera.size.get_or_insert([width, height]);
                if own != [width, height] {
                    let (stated, own) = (Size(width, height), Size(own[0], own[1]));
                    let name = &camera.name;
                    let what = format!("the camera {name} has images of {own}, and not {stated}");
                    return Err(self.error(what));
                }
            }
        }
        Ok(found)
    }
}

/// The calibrations of all sources.
pub struct Calibrations {
    /// Calibrated cameras, with the source of each.
    cameras: Vec<(usize, CameraCalibration)>,
    sources: Vec<CalibrationSource>,
    /// For each image of the folder, an index into `cameras`.
    of_image: Vec<Option<usize>>,
}

impl Calibrations {
    /// Reads the sources. If several calibrate one photo, the first one counts.
    ///
    /// # Errors
    ///
    /// A file cannot be read or is damaged; it has no camera of the given name, or several and none
    /// is given; a pattern matches no photo; without a pattern, the cameras of the file are not
    /// those of the folders; earlier sources calibrate all photos of a source.
    pub fn read(sources: &[CalibrationSource], photos: &ImageFolder) -> Result<Self, Error> {
        let mut this = Self {
            cameras: Vec::new(),
            sources: sources.to_vec(),
            of_image: vec![None; photos.images().len()],
        };
        // For each source, the folders without a camera in it.
        let mut left_out: Vec<BTreeSet<usize>> = Vec::new();
        for (index, source) in sources.iter().enumerate() {
            let found = source.read()?;
            let assigned = assign(source, &found, photos)?;
            for (camera, images) in assigned.cameras {
                this.cameras.push((index, found[camera].clone()));
                for image in images {
                    this.of_image[image].get_or_insert(this.cameras.len() - 1);
                }
            }
            left_out.push(assigned.left_out);
        }
        for (index, source) in sources.iter().enumerate() {
            let is_own = |calibration: &usize| this.cameras[*calibration].0 == index;
            if !this.of_image.iter().flatten().any(is_own) {
                let what = "calibrates no photo, since another `features.calibration` of all its \
                photos stands before it: give the photos of each, as PATTERN=FILE";
                return Err(source.error(what.to_owned()));
            }
            // Folders without a camera in this source may be calibrated by another source.
            let is_uncalibrated = |folder: &&usize| {
                let mut images = photos.images().iter().zip(&this.of_image);
                images.any(|(image, own)| image.camera.index() == **folder && own.is_none())
            };
            if let Some(folder) = left_out[index].iter().find(is_uncalibrated) {
                let folder = &photos.camera_names()[*folder];
                let what = format!(
                    "has no camera named as the folder {folder}, and has those of other folders: \
                    say which is which, as {folder}={}#CAMERA",
                    source.path.display()
                );
                return Err(source.error(what));
            }
        }
        Ok(this)
    }

    /// The calibration of an image, if it has one: an index for [`Calibrations::camera`].
    pub fn of_image(&self, image: usize) -> Option<usize> {
        self.of_image[image]
    }

    /// The calibrated camera of a photo with this name.
    ///
    /// # Errors
    ///
    /// The intrinsics or their size do not fit the photo.
    pub fn camera(&self, index: usize, name: &str, info: &ImageInfo) -> Result<Camera, Error> {
        let (source, CameraCalibration { name: camera, size, intrinsics, .. }) =
            &self.cameras[index];
        camera_of(intrinsics, *size, name, info)
            .map_err(|what| self.sources[*source].error(format!("the camera {camera}: {what}")))
    }

    /// Checks that two photos of a calibration without an image size have one size.
    ///
    /// # Errors
    ///
    /// They have two.
    pub fn require_one_size(
        &self,
        index: usize,
        photos: [(&str, &ImageInfo); 2],
    ) -> Result<(), Error> {
        let (source, CameraCalibration { name, size, intrinsics, .. }) = &self.cameras[index];
        let [one, other] = photos.map(|(_, info)| assumed_size(intrinsics, info));
        if size.is_some() || one == other {
            return Ok(());
        }
        let [(first, _), (second, _)] = photos;
        let what = format!(
            "the camera {name} has no image size, but {first} is {} and {second} {}: give the \
            photos of one size, as PATTERN=FILE",
            Size(one[0], one[1]),
            Size(other[0], other[1])
        );
        Err(self.sources[*source].error(what))
    }

    /// File and camera of a calibration, as `FILE#CAMERA`.
    pub fn shown(&self, index: usize) -> String {
        let (source, camera) = &self.cameras[index];
        format!("{}#{}", self.sources[*source].path.display(), camera.name)
    }
}

/// Names of cameras that a message lists.
const MAX_LISTED: usize = 12;

/// The images of the cameras of a file.
struct Assigned {
    /// Indices of cameras, each with its images.
    cameras: Vec<(usize, Vec<usize>)>,
    /// Folders that none of the cameras is of, though others have the names of cameras.
    left_out: BTreeSet<usize>,
}

/// The calibrated camera of upright photos with this name, width and height; an error if they do
/// not fit.
///
/// # Errors
///
/// The calibration is of another size than the photo, as a sentence.
pub fn camera_of_photo(
    calibration: &CameraCalibration,
    photo: &str,
    [width, height]: [u32; 2],
) -> Result<Camera, String> {
    let CameraCalibration { name, size, intrinsics, .. } = calibration;
    let info = ImageInfo { width, height, time_s: None, exif: Exif::default() };
    camera_of(intrinsics, *size, photo, &info).map_err(|what| format!("the camera {name}: {what}"))
}

/// The cameras of a file, each with its images.
fn assign(
    source: &CalibrationSource,
    found: &[CameraCalibration],
    photos: &ImageFolder,
) -> Result<Assigned, Error> {
    let names = || {
        let listed = found.iter().take(MAX_LISTED).map(|camera| camera.name.as_str());
        let rest = if found.len() > MAX_LISTED { ", …" } else { "" };
        listed.collect::<Vec<_>>().join(", ") + rest
    };
    let folders = photos.camera_names();
    let images = photos.images();
    let of_folders = |is_own: &dyn Fn(usize) -> bool| -> Vec<usize> {
        (0..images.len()).filter(|&image| is_own(images[image].camera.index())).collect()
    };
    let all = |cameras| Assigned { cameras, left_out: BTreeSet::new() };
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
    let path = source.path.display();
    if let Some(pattern) = &source.pattern {
        let Some(camera) = only else {
            let what = format!(
                "has the cameras {}: say which {pattern} is, as {pattern}={path}#{}",
                names(),
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
        return Ok(all(vec![(camera, matching)]));
    }
    if let Some(camera) = only {
        if folders.len() == 1 {
            return Ok(all(vec![(camera, (0..images.len()).collect())]));
        }
        // The file of one camera may be named as its folder.
        let CameraCalibration { name, topic, .. } = &found[camera];
        let stem = source.path.file_stem().and_then(|stem| stem.to_str()).unwrap_or("");
        let by_name = |folder: usize| is_named(name, topic.as_deref(), &folders[folder]);
        let by_stem = |folder: usize| is_named(stem, None, &folders[folder]);
        let own = [of_folders(&by_name), of_folders(&by_stem)];
        if let Some(images) = own.into_iter().find(|images| !images.is_empty()) {
            return Ok(all(vec![(camera, images)]));
        }
        let chosen = source.camera.as_ref().map_or_else(String::new, |name| format!("#{name}"));
        let what = format!(
            "is of one camera, and the photos have the folders {}: say which it is, as \
            {}={path}{chosen}, or *={path}{chosen} for all",
            folders.join(", "),
            folders[0]
        );
        return Err(source.error(what));
    }
    // Of each folder: the cameras with its name, or else those whose topic has its name.
    let mut camera_of: Vec<Option<usize>> = Vec::new();
    for folder in folders {
        let with = |is_own: &dyn Fn(&CameraCalibration) -> bool| -> Vec<usize> {
            (0..found.len()).filter(|&index| is_own(&found[index])).collect()
        };
        let mut own = with(&|camera| is_named(&camera.name, None, folder));
        if own.is_empty() {
            own = with(&|camera| is_named("", camera.topic.as_deref(), folder));
        }
        if let [one, other, ..] = own[..] {
            let what = format!(
                "has two cameras with the name of the folder {folder}, {} and {}: say which it is, \
                as {folder}={path}#{0}",
                found[one].name, found[other].name
            );
            return Err(source.error(what));
        }
        camera_of.push(own.first().copied());
    }
    if camera_of.iter().any(Option::is_some) {
        let cameras: BTreeSet<usize> = camera_of.iter().copied().flatten().collect();
        let images = |camera| of_folders(&|folder| camera_of[folder] == Some(camera));
        return Ok(Assigned {
            cameras: cameras.into_iter().map(|camera| (camera, images(camera))).collect(),
            left_out: (0..folders.len()).filter(|&folder| camera_of[folder].is_none()).collect(),
        });
    }
    if found.len() == folders.len() {
        let images = |camera| of_folders(&|folder| folder == camera);
        return Ok(all((0..found.len()).map(|camera| (camera, images(camera))).collect()));
    }
    let what = format!(
        "has the cameras {}, and the photos have the folders {}: say which is which, as \
        {}={path}#{}",
        names(),
        folders.join(", "),
        folders[0],
        found[0].name
    );
    Err(source.error(what))
}

/// Whether a camera of a file is named as a folder: by its name, or by a part of its topic.
pub fn is_named(name: &str, topic: Option<&str>, folder: &str) -> bool {
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
            size: None,
        };
        assert_eq!("a/calib.txt".parse(), Ok(source(None, "a/calib.txt", None)));
        assert_eq!("left*=c.yaml#cam0".parse(), Ok(source(Some("left*"), "c.yaml", Some("cam0"))));
        let sized = |camera| CalibrationSource {
            size: Some([1226, 370]),
            ..source(Some("left"), "c.txt", camera)
        };
        assert_eq!("left=c.txt#P2@1226x370".parse(), Ok(sized(Some("P2"))));
        assert_eq!("left=c.txt#@1226x370".parse(), Ok(sized(None)));
        assert_eq!("c.txt#a@b".parse(), Ok(source(None, "c.txt", Some("a@b"))));
        for wrong in ["", "=a", "left=", "a#", "left=#P0"] {
            let error = wrong.parse::<CalibrationSource>().unwrap_err();
            assert!(error.contains("PATTERN=FILE#CAMERA"), "{error}");
        }
        // Files with the separators in their names.
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a=b#1.txt");
        std::fs::write(&path, "").unwrap();
        let path = path.to_str().unwrap();
        assert_eq!(path.parse(), Ok(source(None, path, None)));
        let text = format!("left={path}#P2");
        assert_eq!(text.parse(), Ok(source(Some("left"), path, Some("P2"))));
        assert_eq!(format!("x=y={path}").parse(), Ok(source(Some("x=y"), path, None)));
    }

    /// Calibrations of photos in these folders, one a folder: their names, or the error.
    fn calibrated(folders: &[&str], files: &[(&str, &str)]) -> Result<Vec<String>, String> {
        let dir = tempfile::tempdir().unwrap();
        for folder in folders {
            let folder = dir.path().join("photos").join(folder);
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join("0.jpg"), "").unwrap();
        }
        let mut sources = Vec::new();
        for (option, text) in files {
            let (before, name) = option.rsplit_once('=').map_or(("", *option), |(p, n)| (p, n));
            let path = dir.path().join(name);
            std::fs::write(&path, text).unwrap();
            let equals = if before.is_empty() { "" } else { "=" };
            sources.push(format!("{before}{equals}{}", path.display()).parse().unwrap());
        }
        let inputs: Vec<PathBuf> = if folders.iter().any(|folder| folder.matches('/').count() > 0) {
            let tops: BTreeSet<&str> =
                folders.iter().filter_map(|folder| folder.split('/').next()).collect();
            tops.into_iter().map(|top| dir.path().join("photos").join(top)).collect()
        } else {
            vec![dir.path().join("photos")]
        };
        let photos = ImageFolder::open(&inputs, None).unwrap();
        let found = Calibrations::read(&sources, &photos).map_err(|error| error.to_string())?;
        let shown = |index| match found.of_image(index) {
            Some(calibration) => {
                let shown = found.shown(calibration);
                shown.rsplit('/').next().unwrap_or("").to_owned()
            }
            None => "none".to_owned(),
        };
        Ok((0..photos.images().len()).map(shown).collect())
    }

    const ONE: &str = "camera_matrix: [[9, 0, 5], [0, 9, 5], [0, 0, 1]]\n";

    fn camchain(topics: &[&str]) -> String {
        let camera = |(index, topic): (usize, &&str)| {
            format!(
                "cam{index}:\n  camera_model: pinhole\n  intrinsics: [9, 9, 5, 5]\n  rostopic: \
                 {topic}\n"
            )
        };
        topics.iter().enumerate().map(camera).collect()
    }

    #[test]
    fn a_file_of_one_camera_is_of_the_folder_of_its_name() {
        let two = ["left", "right"];
        let both = calibrated(&two, &[("left.yaml", ONE), ("right.yaml", ONE)]).unwrap();
        assert_eq!(both, ["left.yaml#camera", "right.yaml#camera"]);
        let named = format!("camera_name: right\n{ONE}");
        assert_eq!(calibrated(&two, &[("a.yaml", &named)]).unwrap(), ["none", "a.yaml#camera"]);
        assert_eq!(calibrated(&["left"], &[("a.yaml", ONE)]).unwrap(), ["a.yaml#camera"]);
        assert_eq!(calibrated(&two, &[("*=a.yaml", ONE)]).unwrap(), ["a.yaml#camera"; 2]);
        let error = calibrated(&two, &[("a.yaml", ONE)]).unwrap_err();
        assert!(error.contains("folders left, right") && error.contains("or *="), "{error}");
        let error = calibrated(&["left"], &[("a.yaml", ONE), ("b.yaml", ONE)]).unwrap_err();
        assert!(error.contains("b.yaml: calibrates no photo"), "{error}");
    }

    #[test]
    fn cameras_of_a_file_are_of_all_folders_of_their_names() {
        let chain = camchain(&["/left/image_raw", "/right/image_raw"]);
        let chain = [("c.yaml", chain.as_str())];
        assert_eq!(calibrated(&["left", "right"], &chain).unwrap(), ["c.yaml#cam0", "c.yaml#cam1"]);
        assert_eq!(calibrated(&["right"], &chain).unwrap(), ["c.yaml#cam1"]);
        let days = ["day1/left", "day1/right", "day2/left", "day2/right"];
        let found = calibrated(&days, &chain).unwrap();
        assert_eq!(found, ["c.yaml#cam0", "c.yaml#cam1", "c.yaml#cam0", "c.yaml#cam1"]);
        assert_eq!(calibrated(&["a", "b"], &chain).unwrap(), ["c.yaml#cam0", "c.yaml#cam1"]);
        let error = calibrated(&["left", "links"], &chain).unwrap_err();
        assert!(error.contains("no camera named as the folder links"), "{error}");
        let rest = [chain[0], ("links=a.yaml", ONE)];
        assert_eq!(
            calibrated(&["left", "links"], &rest).unwrap(),
            ["c.yaml#cam0", "a.yaml#camera"]
        );
        let topics = camchain(&["/camera/left", "/camera/right"]);
        let error = calibrated(&["camera", "b"], &[("c.yaml", &topics)]).unwrap_err();
        assert!(error.contains("two cameras with the name of the folder camera"), "{error}");
        let error = calibrated(&["a", "b", "c"], &chain).unwrap_err();
        assert!(error.contains("cam0, cam1") && error.contains("a, b, c"), "{error}");
    }
}
