//! The initial cameras of the photos, and what is known of them.

use std::collections::BTreeMap;

use tiepoint_io::ImageInfo;
use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics};
use tiepoint_sfm::scene::{Camera, CameraId};

use crate::calibration::Calibrations;
use crate::camera_facts::CameraFacts;
use crate::photos::{Photo, Photos};
use crate::{CameraGrouping, Error, Size};

/// Prior knowledge of the intrinsics of the cameras without a calibration file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Calibration {
    /// The mapper estimates the intrinsics.
    Unknown {
        /// Camera model.
        model: CameraModelKind,
        /// Initial focal length of all cameras, in pixels; `None`: from EXIF, else the default.
        focal_px: Option<f64>,
    },
    /// All cameras have these intrinsics, which stay fixed.
    Known(Intrinsics),
}

/// Default focal length over the larger image side, as in COLMAP: a field of view of 45°.
const DEFAULT_FOCAL: f64 = 1.2;
/// The same for a fisheye: an equidistant view of 180°, 1/π.
const DEFAULT_FISHEYE_FOCAL: f64 = std::f64::consts::FRAC_1_PI;

impl Default for Calibration {
    fn default() -> Self {
        Self::Unknown { model: CameraModelKind::SimpleRadial, focal_px: None }
    }
}

impl Calibration {
    /// The initial camera of a photo on its own.
    pub(crate) fn of_photo(&self, info: &ImageInfo) -> Camera {
        self.camera(info, sides(info))
    }

    /// The initial camera of an image. `largest`: sides of the largest image of its lens, the
    /// longer one first. A smaller image may be scaled or cropped. Its focal length begins as that
    /// of a scaled one and is no prior.
    fn camera(&self, info: &ImageInfo, largest: (u32, u32)) -> Camera {
        let ImageInfo { width, height, ref exif, .. } = *info;
        let longest = width.max(height);
        let (intrinsics, has_focal_prior) = match *self {
            Self::Known(intrinsics) => (intrinsics, true),
            Self::Unknown { model, focal_px } => {
                let given = focal_px.map(|focal| focal * f64::from(longest) / f64::from(largest.0));
                let known = given.or_else(|| exif.focal_px(width, height, None));
                let is_original = largest == sides(info);
                let default =
                    if model.is_fisheye() { DEFAULT_FISHEYE_FOCAL } else { DEFAULT_FOCAL };
                let focal_px = known.unwrap_or(default * f64::from(longest));
                let intrinsics = Intrinsics::centred(model, focal_px, width, height);
                let is_calibrated = known.is_some() || model.focal_indices().is_empty();
                (intrinsics, is_calibrated && is_original)
            }
        };
        Camera { intrinsics, width, height, has_focal_prior }
    }
}

/// The cameras of the photos.
pub(crate) struct FoundCameras {
    /// Initial intrinsics.
    pub(crate) cameras: Vec<Camera>,
    /// What else is known of them.
    pub(crate) facts: CameraFacts,
}

impl FoundCameras {
    /// The cameras of usable photos.
    ///
    /// # Errors
    ///
    /// The size of a photo does not agree with its calibration, or one calibration is for photos of
    /// several sizes.
    pub(crate) fn new(
        photos: &Photos,
        usable: &[Photo],
        calibration: &Calibration,
        calibrations: &Calibrations,
        grouping: CameraGrouping,
    ) -> Result<Self, Error> {
        let firsts: Vec<&Photo> = firsts(usable).collect();
        if matches!(calibration, Calibration::Known(_)) {
            require_one_size(photos, &firsts)?;
        }
        // The sides of the largest image of each lens.
        let mut largest: BTreeMap<usize, (u32, u32)> = BTreeMap::new();
        for photo in &firsts {
            let most = largest.entry(photo.lens).or_default();
            *most = (*most).max(sides(&photo.info));
        }
        let mut cameras = Vec::new();
        let mut facts = CameraFacts::default();
        for photo in &firsts {
            cameras.push(match photo.calibration {
                None => calibration.camera(&photo.info, largest[&photo.lens]),
                Some(index) => {
                    facts.calibrated.insert(CameraId::from_index(photo.camera));
                    calibrations.camera(index, photos.name(photo), &photo.info)?
                }
            });
        }
        let found = if grouping == CameraGrouping::Auto { &firsts[..] } else { &[] };
        for (index, photo) in found.iter().enumerate() {
            let is_turned = |other: &&&Photo| {
                let (one, other_info) = (&photo.info, &other.info);
                other.lens == photo.lens
                    && (photo.calibration, other.calibration) == (None, None)
                    && (one.width, one.height) == (other_info.height, other_info.width)
            };
            facts.turned.extend(found[..index].iter().find(is_turned).map(|other| {
                [CameraId::from_index(other.camera), CameraId::from_index(photo.camera)]
            }));
        }
        Ok(Self { cameras, facts })
    }
}

/// The longer and the shorter side of an image.
fn sides(info: &ImageInfo) -> (u32, u32) {
    (info.width.max(info.height), info.width.min(info.height))
}

/// Checks that the photos of a folder have one size, since they have the intrinsics of one camera.
fn require_one_size(photos: &Photos, firsts: &[&Photo]) -> Result<(), Error> {
    let size = |photo: &Photo| Size(photo.info.width, photo.info.height);
    for (index, other) in firsts.iter().enumerate() {
        let is_beside = |first: &&&Photo| {
            photos.folder_of(first) == photos.folder_of(other) && size(first) != size(other)
        };
        if let Some(first) = firsts[..index].iter().find(is_beside) {
            return Err(Error::IntrinsicsOfSizes {
                first: photos.name(first).to_owned(),
                first_size: size(first),
                other: photos.name(other).to_owned(),
                other_size: size(other),
            });
        }
    }
    Ok(())
}

/// The first photo of each camera. Cameras are numbered in the order of their first photos.
pub(crate) fn firsts(usable: &[Photo]) -> impl Iterator<Item = &Photo> {
    let mut known = 0;
    usable.iter().filter(move |photo| {
        let is_first = photo.camera == known;
        known += usize::from(is_first);
        is_first
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_io::Exif;

    #[test]
    fn focal_length_is_the_given_one_or_that_of_exif_or_the_default() {
        let exif = Exif { focal_35mm: Some(36.0), ..Exif::default() };
        let info = |exif| ImageInfo { width: 600, height: 400, time_s: None, exif };
        let focal = |calibration: Calibration, exif, largest| {
            let camera = calibration.camera(&info(exif), largest);
            (camera.intrinsics.mean_focal_px().round(), camera.has_focal_prior)
        };
        let unknown = Calibration::default();
        let (own, larger) = ((600, 400), (1200, 800));
        assert_eq!(focal(unknown, Exif::default(), own), (720.0, false));
        assert_eq!(focal(unknown, exif.clone(), own), (600.0, true));
        assert_eq!(focal(unknown, exif.clone(), larger), (600.0, false));
        let model = CameraModelKind::Pinhole;
        let given = Calibration::Unknown { model, focal_px: Some(500.0) };
        assert_eq!(focal(given, exif.clone(), own), (500.0, true));
        assert_eq!(focal(given, exif.clone(), larger), (250.0, false));
        let known = Intrinsics::new(model, &[400.0, 410.0, 300.0, 200.0]).unwrap();
        assert_eq!(Calibration::Known(known).camera(&info(exif), own).intrinsics, known);
    }
}
