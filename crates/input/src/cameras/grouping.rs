//! Which photos share a camera.

use std::collections::BTreeMap;
use std::fmt;

use crate::images::{Device, ImageInfo};

/// The photos that share a camera, i.e. one set of intrinsics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraGrouping {
    /// Photos of one folder that agree in size, EXIF orientation, camera body, lens and focal
    /// length.
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
    /// All groupings.
    pub const ALL: [Self; 4] = [Self::Auto, Self::Folder, Self::Image, Self::Single];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Folder => "folder",
            Self::Image => "image",
            Self::Single => "single",
        }
    }
}

impl fmt::Display for CameraGrouping {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Largest ratio of the focal lengths of one camera, minus 1. Focusing from infinity to m focal
/// lengths changes the focal length in pixels by the factor 1 + 1/m, and most bodies do not write
/// it: photos of one written focal length differ by 1 % at m = 100, i.e. 3 m in front of a lens of
/// 28 mm. Zoom settings are written in whole millimetres, of which neighbours differ by more up to
/// 100 mm.
const FOCAL_TOLERANCE: f64 = 0.01;

/// Camera body, lens and digital setting. Photos that do not say agree with each other only. The
/// numbers are compared exactly: a body writes the same number for the same setting.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct DeviceKey {
    /// Index of the folder's camera in the source of the photos.
    folder: usize,
    device: Device,
    /// Bits of the 35 mm equivalent of the focal length, and of the digital zoom.
    setting: [Option<u64>; 2],
}

impl DeviceKey {
    fn new(folder: usize, info: &ImageInfo) -> Self {
        let exif = &info.exif;
        let setting = [exif.focal_35mm, exif.digital_zoom];
        Self {
            folder,
            device: exif.device.clone(),
            setting: setting.map(|number| number.map(f64::to_bits)),
        }
    }
}

/// The focal lengths that photos of a device have, in classes that differ by [`FOCAL_TOLERANCE`] at
/// most. They depend on the set of the photos alone: each class begins with the least focal length
/// that no other class has.
#[derive(Default)]
struct FocalClasses {
    /// The least focal length of each class, in millimetres, ascending.
    starts_mm: BTreeMap<DeviceKey, Vec<f64>>,
}

impl FocalClasses {
    fn new<'a>(photos: impl Iterator<Item = (usize, &'a ImageInfo)>) -> Self {
        let mut starts_mm: BTreeMap<DeviceKey, Vec<f64>> = BTreeMap::new();
        for (folder, info) in photos {
            let focal_mm = info.exif.focal_mm;
            starts_mm.entry(DeviceKey::new(folder, info)).or_default().extend(focal_mm);
        }
        for focals in starts_mm.values_mut() {
            focals.sort_by(f64::total_cmp);
            let mut start = f64::NEG_INFINITY;
            focals.retain(|&focal| {
                let begins = start == f64::NEG_INFINITY || focal > start * (1.0 + FOCAL_TOLERANCE);
                if begins {
                    start = focal;
                }
                begins
            });
        }
        Self { starts_mm }
    }

    /// The number of the class of a photo; `None` for a photo without a focal length.
    fn of(&self, key: &DeviceKey, info: &ImageInfo) -> Option<usize> {
        let focal_mm = info.exif.focal_mm?;
        let starts = self.starts_mm.get(key).map_or(&[][..], Vec::as_slice);
        Some(starts.partition_point(|&start| start <= focal_mm))
    }
}

/// What the photos of a camera have in common.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum CameraKey {
    /// The number of the lens, width and height, and the EXIF orientation: the principal point of a
    /// turned image lies elsewhere.
    Lens(usize, [u32; 2], u8),
    /// The folder, and width and height, of photos with a known calibration.
    Calibrated(usize, [u32; 2]),
    Folder(usize),
    Image(usize),
    All,
}

/// A photo, as far as grouping needs it.
pub(crate) struct GroupedPhoto<'a> {
    /// Its number among the usable photos.
    pub index: usize,
    /// Number of its folder.
    pub folder: usize,
    /// Number of its known calibration.
    pub calibration: Option<usize>,
    pub info: &'a ImageInfo,
}

/// Numbers lenses and cameras in the order of their first photos.
pub(crate) struct CameraNumbers {
    grouping: CameraGrouping,
    focals: FocalClasses,
    lenses: BTreeMap<(DeviceKey, Option<usize>), usize>,
    /// Number of a camera, by what its photos have in common, and by their calibration and EXIF
    /// orientation.
    cameras: BTreeMap<(CameraKey, Option<(usize, u8)>), usize>,
}

impl CameraNumbers {
    /// `photos`: all photos that will be numbered, each with the number of its folder.
    pub(crate) fn new<'a>(
        grouping: CameraGrouping,
        photos: impl Iterator<Item = (usize, &'a ImageInfo)>,
    ) -> Self {
        let focals = FocalClasses::new(photos);
        Self { grouping, focals, lenses: BTreeMap::new(), cameras: BTreeMap::new() }
    }

    /// The numbers of lens and camera of a photo. Photos with different calibrations, or with one
    /// that is turned for them differently, never share a camera; others with one calibration share
    /// it whatever EXIF says.
    pub(crate) fn of(&mut self, photo: &GroupedPhoto) -> (usize, usize) {
        let &GroupedPhoto { index, folder, calibration, info } = photo;
        let device = DeviceKey::new(folder, info);
        let focal = self.focals.of(&device, info);
        let next = self.lenses.len();
        let lens = *self.lenses.entry((device, focal)).or_insert(next);
        let (size, orientation) = ([info.width, info.height], info.exif.orientation);
        let key = match self.grouping {
            CameraGrouping::Auto if calibration.is_some() => CameraKey::Calibrated(folder, size),
            CameraGrouping::Auto => CameraKey::Lens(lens, size, orientation),
            CameraGrouping::Folder => CameraKey::Folder(folder),
            CameraGrouping::Image => CameraKey::Image(index),
            CameraGrouping::Single => CameraKey::All,
        };
        let next = self.cameras.len();
        let calibration = calibration.map(|calibration| (calibration, orientation));
        let camera = *self.cameras.entry((key, calibration)).or_insert(next);
        (lens, camera)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Exif;

    fn info(width: u32, height: u32, exif: Exif) -> ImageInfo {
        ImageInfo { width, height, time_s: None, exif }
    }

    fn numbers(grouping: CameraGrouping, photos: &[(usize, ImageInfo)]) -> Vec<usize> {
        let infos = photos.iter().map(|(folder, info)| (*folder, info));
        let mut numbers = CameraNumbers::new(grouping, infos);
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
        let timed = Exif { time_s: Some(1.0), ..wide.clone() };
        let upside_down = Exif { orientation: 3, ..wide.clone() };
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
            (0, info(400, 300, upside_down)),
        ]
        .into();
        let with = |grouping| numbers(grouping, &photos);
        assert_eq!(with(CameraGrouping::Auto), [0, 1, 2, 0, 3, 4, 5, 6, 7, 8, 9]);
        assert_eq!(with(CameraGrouping::Folder), [0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0]);
        assert_eq!(with(CameraGrouping::Image), [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
        assert_eq!(with(CameraGrouping::Single), [0; 11]);
    }

    #[test]
    fn focusing_changes_no_camera_and_zooming_does() {
        let of = |focal_mm: f64| {
            (0, info(400, 300, Exif { focal_mm: Some(focal_mm), ..Exif::default() }))
        };
        let mut photos: Vec<_> = (0..40).map(|step| of(4.25 + 0.001 * f64::from(step))).collect();
        assert_eq!(numbers(CameraGrouping::Auto, &photos), [0; 40]);
        photos.push(of(4.35));
        photos.push(of(8.5));
        let found = numbers(CameraGrouping::Auto, &photos);
        assert_eq!(found[38..], [0, 0, 1, 2]);
        // The same cameras in another order of the photos.
        photos.reverse();
        let reversed = numbers(CameraGrouping::Auto, &photos);
        assert_eq!(reversed[..4], [0, 1, 2, 2]);
        assert_eq!(reversed[4..], [2; 38]);
    }

    #[test]
    fn a_calibration_is_turned_with_the_photos() {
        let turned = |orientation| info(400, 300, Exif { orientation, ..Exif::default() });
        for grouping in [CameraGrouping::Auto, CameraGrouping::Single] {
            let mut numbers = CameraNumbers::new(grouping, std::iter::empty());
            let found: Vec<usize> = [1, 3, 1]
                .map(turned)
                .iter()
                .map(|info| {
                    let calibration = Some(0);
                    numbers.of(&GroupedPhoto { index: 0, folder: 0, calibration, info }).1
                })
                .collect();
            assert_eq!(found, [0, 1, 0], "{grouping}");
        }
    }
}
