//! Which photos share a camera.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use tiepoint_io::{Device, ImageInfo};

/// The photos that share a camera, i.e. one set of intrinsics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraGrouping {
    /// Photos of one folder that agree in size (after the rotation of EXIF), camera body, lens and
    /// focal length.
    #[default]
    Auto,
    /// The photos of a folder.
    Folder,
    /// Each photo has a camera of its own.
    Image,
    /// All photos.
    Single,
}

impl CameraGrouping {
    const ALL: [(Self, &str); 4] = [
        (Self::Auto, "auto"),
        (Self::Folder, "folder"),
        (Self::Image, "image"),
        (Self::Single, "single"),
    ];
}

impl fmt::Display for CameraGrouping {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Self::ALL.iter().find(|(own, _)| own == self).map_or("", |(_, name)| name);
        f.write_str(name)
    }
}

impl FromStr for CameraGrouping {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(_, name)| *name == text);
        found
            .map(|(own, _)| *own)
            .ok_or_else(|| "expected auto, folder, image or single".to_owned())
    }
}

/// Camera body, lens and its setting. Photos that do not say agree with each other only. Focal
/// lengths are compared exactly: a body writes the same number for the same setting.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct LensKey {
    /// Index of the folder's camera in the source of the photos.
    folder: usize,
    device: Device,
    /// Bits of the focal length, of its 35 mm equivalent, and of the digital zoom.
    setting: [Option<u64>; 3],
}

impl LensKey {
    fn new(folder: usize, info: &ImageInfo) -> Self {
        let exif = &info.exif;
        let setting = [exif.focal_mm, exif.focal_35mm, exif.digital_zoom];
        Self {
            folder,
            device: exif.device.clone(),
            setting: setting.map(|number| number.map(f64::to_bits)),
        }
    }
}

/// What the photos of a camera have in common.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum CameraKey {
    /// The number of the lens, and width and height.
    Lens(usize, [u32; 2]),
    Folder(usize),
    Image(usize),
    All,
}

/// A photo, as far as grouping needs it.
pub(crate) struct GroupedPhoto<'a> {
    /// Its number among the usable photos.
    pub(crate) index: usize,
    /// Number of its folder.
    pub(crate) folder: usize,
    /// Number of its known calibration.
    pub(crate) calibration: Option<usize>,
    pub(crate) info: &'a ImageInfo,
}

/// Numbers lenses and cameras in the order of their first photos.
pub(crate) struct CameraNumbers {
    grouping: CameraGrouping,
    lenses: BTreeMap<LensKey, usize>,
    cameras: BTreeMap<(CameraKey, Option<usize>), usize>,
}

impl CameraNumbers {
    pub(crate) fn new(grouping: CameraGrouping) -> Self {
        Self { grouping, lenses: BTreeMap::new(), cameras: BTreeMap::new() }
    }

    /// The numbers of lens and camera of a photo. Photos with different calibrations never share a
    /// camera; photos with one share it whatever EXIF says.
    pub(crate) fn of(&mut self, photo: &GroupedPhoto) -> (usize, usize) {
        let &GroupedPhoto { index, folder, calibration, info } = photo;
        let next = self.lenses.len();
        let lens = *self.lenses.entry(LensKey::new(folder, info)).or_insert(next);
        let key = match self.grouping {
            CameraGrouping::Auto if calibration.is_some() => CameraKey::Folder(folder),
            CameraGrouping::Auto => CameraKey::Lens(lens, [info.width, info.height]),
            CameraGrouping::Folder => CameraKey::Folder(folder),
            CameraGrouping::Image => CameraKey::Image(index),
            CameraGrouping::Single => CameraKey::All,
        };
        let next = self.cameras.len();
        let camera = *self.cameras.entry((key, calibration)).or_insert(next);
        (lens, camera)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_io::Exif;

    fn info(width: u32, height: u32, exif: Exif) -> ImageInfo {
        ImageInfo { width, height, time_s: None, exif }
    }

    fn numbers(grouping: CameraGrouping, photos: &[(usize, ImageInfo)]) -> Vec<usize> {
        let mut numbers = CameraNumbers::new(grouping);
        photos
            .iter()
            .enumerate()
            .map(|(index, (folder, info))| {
                numbers.of(&GroupedPhoto { index, folder: *folder, calibration: None, info }).1
            })
            .collect()
    }

    #[test]
    fn photos_of_one_setting_share_a_camera() {
        let of = |body: &str, lens: &str, serial: Option<&str>| Device {
            make: Some("Maker".to_owned()),
            model: Some(body.to_owned()),
            lens: Some(lens.to_owned()),
            serial: serial.map(str::to_owned),
            ..Device::default()
        };
        let wide = Exif { focal_mm: Some(4.2), device: of("A", "1x", None), ..Exif::default() };
        let tele = Exif { focal_mm: Some(9.0), device: of("A", "2x", None), ..Exif::default() };
        let zoomed = Exif { digital_zoom: Some(1.5), ..wide.clone() };
        let cropped_film = Exif { focal_35mm: Some(26.0), ..wide.clone() };
        let serial = Exif { device: of("A", "1x", Some("7")), ..wide.clone() };
        let timed = Exif { time_s: Some(1.0), orientation: 6, ..wide.clone() };
        let photos: Vec<(usize, ImageInfo)> = [
            (0, info(400, 300, wide.clone())),
            (0, info(400, 300, tele)),
            (0, info(300, 400, wide.clone())),
            (0, info(400, 300, timed)),
            (0, info(400, 300, zoomed)),
            (0, info(400, 300, cropped_film)),
            (0, info(400, 300, serial)),
            (0, info(400, 300, Exif::default())),
            (0, info(200, 150, wide.clone())),
            (1, info(400, 300, wide)),
        ]
        .into();
        let with = |grouping| numbers(grouping, &photos);
        assert_eq!(with(CameraGrouping::Auto), [0, 1, 2, 0, 3, 4, 5, 6, 7, 8]);
        assert_eq!(with(CameraGrouping::Folder), [0, 0, 0, 0, 0, 0, 0, 0, 0, 1]);
        assert_eq!(with(CameraGrouping::Image), [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]);
        assert_eq!(with(CameraGrouping::Single), [0; 10]);
    }

    #[test]
    fn names_are_those_of_the_command_line() {
        for (grouping, name) in CameraGrouping::ALL {
            assert_eq!(grouping.to_string(), name);
            assert_eq!(name.parse(), Ok(grouping));
        }
        assert!("auto ".parse::<CameraGrouping>().unwrap_err().contains("single"));
    }
}
