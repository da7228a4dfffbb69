//! The initial cameras of the photos, and what is known of them.

use std::collections::BTreeMap;

use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::{Camera, CameraId};

use super::calibration::Calibrations;
use super::facts::CalibrationFacts;
use super::known_intrinsics::{assumed_size, camera_of};
use super::photos::{Photo, Photos};
use crate::images::{Device, ImageInfo, is_plausible_focal};
use crate::{CameraGrouping, Error, Size};

/// Prior knowledge of the intrinsics of the cameras without a calibration file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Calibration {
    /// The mapper estimates the intrinsics.
    Unknown {
        /// Camera model; `None`: SIMPLE_RADIAL, from which the mapper may select another one.
        model: Option<CameraModelKind>,
        /// Initial focal length of all cameras, in pixels; `None`: from EXIF, else the default. It
        /// is that of the largest photos of a lens that EXIF names.
        focal_px: Option<f64>,
    },
    /// All cameras have these intrinsics, which stay fixed. They are those of the stored photos,
    /// and are turned where EXIF says so.
    Known(Intrinsics),
}

/// Default focal length over the larger image side, as in COLMAP: a field of view of 45°.
const DEFAULT_FOCAL: f64 = 1.2;
/// The same for a fisheye: an equidistant view of 180°, 1/π.
const DEFAULT_FISHEYE_FOCAL: f64 = std::f64::consts::FRAC_1_PI;

impl Default for Calibration {
    fn default() -> Self {
        Self::Unknown { model: None, focal_px: None }
    }
}

impl Calibration {
    /// The camera model of an unknown lens, as in COLMAP.
    pub const DEFAULT_MODEL: CameraModelKind = CameraModelKind::SimpleRadial;

    /// The initial camera of a photo on its own.
    ///
    /// # Errors
    ///
    /// Known intrinsics do not fit the photo, or a given focal length is that of no lens.
    pub fn of_photo(&self, name: &str, info: &ImageInfo) -> Result<Camera, Error> {
        self.camera(name, info, sides(info))
    }

    /// The initial camera of a photo with this name. `largest`: sides of the largest image of its
    /// lens, the longer one first. A smaller image may be scaled or cropped. Its focal length
    /// begins as that of a scaled one and is no prior. A given focal length is scaled only if EXIF
    /// says that the lens is the same.
    fn camera(&self, name: &str, info: &ImageInfo, largest: (u32, u32)) -> Result<Camera, Error> {
        let ImageInfo { width, height, ref exif, .. } = *info;
        let longest = width.max(height);
        let (model, focal_px) = match *self {
            Self::Known(intrinsics) => {
                return camera_of(&intrinsics, None, name, info)
                    .map_err(|what| Error::Intrinsics { what });
            }
            Self::Unknown { model, focal_px } => (model.unwrap_or(Self::DEFAULT_MODEL), focal_px),
        };
        let has_device = exif.device != Device::default();
        let scale = if has_device { f64::from(longest) / f64::from(largest.0) } else { 1.0 };
        let given = focal_px.map(|focal_px| focal_px * scale);
        if let Some(focal_px) = given
            && !is_plausible_focal(focal_px, width, height)
        {
            let (image, size) = (name.to_owned(), Size(width, height));
            return Err(Error::FocalPrior { focal_px, image, size });
        }
        let known = given.or_else(|| exif.focal_px(width, height, None));
        let is_original = largest == sides(info) || given.is_some() && !has_device;
        let default = if model.is_fisheye() { DEFAULT_FISHEYE_FOCAL } else { DEFAULT_FOCAL };
        let focal_px = known.unwrap_or(default * f64::from(longest));
        let intrinsics = Intrinsics::centred(model, focal_px, width, height);
        let is_calibrated = known.is_some() || model.focal_indices().is_empty();
        Ok(Camera { intrinsics, width, height, has_focal_prior: is_calibrated && is_original })
    }
}

/// The cameras of the photos.
pub struct FoundCameras {
    /// Initial intrinsics.
    pub cameras: Vec<Camera>,
    /// Which of them are calibrated, and which share a lens.
    pub facts: CalibrationFacts,
}

impl FoundCameras {
    /// The cameras of usable photos.
    ///
    /// # Errors
    ///
    /// Known intrinsics do not fit a photo, or are for photos of several sizes, or a given focal
    /// length is that of no lens.
    pub fn new(
        photos: &Photos,
        usable: &[Photo],
        calibration: &Calibration,
        calibrations: &Calibrations,
        grouping: CameraGrouping,
    ) -> Result<Self, Error> {
        let firsts: Vec<&Photo> = firsts(usable).collect();
        if let Calibration::Known(intrinsics) = calibration {
            require_one_size(photos, &firsts, intrinsics)?;
            require_one_orientation(photos, usable, &firsts)?;
        }
        // The sides of the largest image of each lens.
        let mut largest: BTreeMap<usize, (u32, u32)> = BTreeMap::new();
        for photo in &firsts {
            let most = largest.entry(photo.lens).or_default();
            *most = (*most).max(sides(&photo.info));
        }
        let mut cameras = Vec::new();
        let mut facts = CalibrationFacts::default();
        // The first photo of each calibration.
        let mut calibrated: BTreeMap<usize, &Photo> = BTreeMap::new();
        for photo in &firsts {
            let name = photos.name(photo);
            let Some(index) = photo.calibration else {
                cameras.push(calibration.camera(name, &photo.info, largest[&photo.lens])?);
                continue;
            };
            facts.calibrated.insert(CameraId::from_index(photo.camera));
            cameras.push(calibrations.camera(index, name, &photo.info)?);
            let first = calibrated.entry(index).or_insert(photo);
            calibrations.require_one_size(
                index,
                [(photos.name(first), &first.info), (name, &photo.info)],
            )?;
        }
        if grouping == CameraGrouping::Auto {
            let uncalibrated: Vec<&Photo> =
                firsts.into_iter().filter(|photo| photo.calibration.is_none()).collect();
            facts.portrait_landscape_pairs = portrait_landscape_pairs(&uncalibrated, &cameras);
        }
        Ok(Self { cameras, facts })
    }
}

/// Pairs of cameras of one lens whose images have portrait and landscape format. `firsts`: the
/// first photo of each camera.
fn portrait_landscape_pairs(firsts: &[&Photo], cameras: &[Camera]) -> Vec<[CameraId; 2]> {
    let mut lenses: BTreeMap<(usize, (u32, u32)), Vec<&Photo>> = BTreeMap::new();
    for photo in firsts {
        lenses.entry((photo.lens, sides(&photo.info))).or_default().push(photo);
    }
    let mut pairs = Vec::new();
    for photos in lenses.values() {
        for (index, photo) in photos.iter().enumerate() {
            // A pair exchanges fx and fy. Upside down they keep their places.
            let has_one_focal = cameras[photo.camera].intrinsics.kind().focal_indices().len() == 1;
            let others = photos[..index].iter();
            let others = others.filter(|other| has_one_focal || is_quarter_turn(other, photo));
            pairs.extend(others.map(|other| [other.camera, photo.camera]));
        }
    }
    pairs.sort_by_key(|pair| (pair[1], pair[0]));
    pairs.into_iter().map(|pair| pair.map(CameraId::from_index)).collect()
}

/// Whether the images of two cameras with equal sides are turned by 90° against each other.
/// Programs that turn photos remove the orientation, so that the sides decide; those of a square
/// do not tell.
fn is_quarter_turn(one: &Photo, other: &Photo) -> bool {
    let swaps = |photo: &Photo| photo.info.exif.orientation >= 5;
    if one.info.width == one.info.height {
        swaps(one) != swaps(other)
    } else {
        one.info.width != other.info.width
    }
}

/// The longer and the shorter side of an image.
fn sides(info: &ImageInfo) -> (u32, u32) {
    (info.width.max(info.height), info.width.min(info.height))
}

/// Checks that the photos have one size: `--intrinsics` holds for all cameras and has no image size
/// of its own.
fn require_one_size(
    photos: &Photos,
    firsts: &[&Photo],
    intrinsics: &Intrinsics,
) -> Result<(), Error> {
    let size = |photo: &Photo| assumed_size(intrinsics, &photo.info);
    let Some((first, others)) = firsts.split_first() else { return Ok(()) };
    let Some(other) = others.iter().find(|other| size(first) != size(other)) else {
        return Ok(());
    };
    let shown = |[width, height]: [u32; 2]| Size(width, height);
    Err(Error::IntrinsicsOfSizes {
        first: photos.name(first).to_owned(),
        first_size: shown(size(first)),
        other: photos.name(other).to_owned(),
        other_size: shown(size(other)),
    })
}

/// Checks that the photos that were asked to share a camera are turned equally.
fn require_one_orientation(
    photos: &Photos,
    usable: &[Photo],
    firsts: &[&Photo],
) -> Result<(), Error> {
    for photo in usable {
        let first = firsts[photo.camera];
        let [one, other] = [first, photo].map(|photo| photo.info.exif.orientation);
        if one != other {
            let what = format!(
                "{} has the EXIF orientation {one} and {} {other}, so that one camera cannot have \
                these intrinsics in both: leave out `features.cameras`",
                photos.name(first),
                photos.name(photo)
            );
            return Err(Error::Intrinsics { what });
        }
    }
    Ok(())
}

/// The first photo of each camera. Cameras are numbered in the order of their first photos.
pub fn firsts(usable: &[Photo]) -> impl Iterator<Item = &Photo> {
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
    use crate::Exif;

    #[test]
    fn focal_length_is_the_given_one_or_that_of_exif_or_the_default() {
        let device = Device { model: Some("A".to_owned()), ..Device::default() };
        let without = Exif { focal_35mm: Some(36.0), ..Exif::default() };
        let exif = Exif { device, ..without.clone() };
        let info = |exif| ImageInfo { width: 600, height: 400, time_s: None, exif };
        let focal = |calibration: Calibration, exif, largest| {
            let camera = calibration.camera("a.jpg", &info(exif), largest).unwrap();
            (camera.intrinsics.mean_focal_px().round(), camera.has_focal_prior)
        };
        let unknown = Calibration::default();
        let (own, larger) = ((600, 400), (1200, 800));
        assert_eq!(focal(unknown, Exif::default(), own), (720.0, false));
        assert_eq!(focal(unknown, exif.clone(), own), (600.0, true));
        assert_eq!(focal(unknown, exif.clone(), larger), (600.0, false));
        let model = CameraModelKind::Pinhole;
        let given =
            |focal_px| Calibration::Unknown { model: Some(model), focal_px: Some(focal_px) };
        assert_eq!(focal(given(500.0), exif.clone(), own), (500.0, true));
        assert_eq!(focal(given(500.0), exif.clone(), larger), (250.0, false));
        // Photos that do not name their lens may be of several.
        assert_eq!(focal(given(500.0), without, larger), (500.0, true));
        for impossible in [1e306, 1.0] {
            let error = given(impossible).camera("a.jpg", &info(exif.clone()), own).unwrap_err();
            let error = error.to_string();
            assert!(
                error.contains("`features.focal_prior`") && error.contains("600 x 400"),
                "{error}"
            );
        }
        let known = Intrinsics::new(model, &[400.0, 410.0, 300.0, 200.0]).unwrap();
        let camera = Calibration::Known(known).camera("a.jpg", &info(exif), own).unwrap();
        assert_eq!(camera.intrinsics, known);
    }

    #[test]
    fn cameras_of_one_lens_share_it_however_it_is_held() {
        let photo = |camera: usize, orientation: u8| {
            let (width, height) = if orientation >= 5 { (300, 400) } else { (400, 300) };
            let exif = Exif { orientation, ..Exif::default() };
            let info = ImageInfo { width, height, time_s: None, exif };
            Photo { index: camera, camera, lens: 0, calibration: None, info }
        };
        let pairs = |model, orientations: &[u8]| -> Vec<[u32; 2]> {
            let photos: Vec<Photo> = (0..).zip(orientations).map(|(i, o)| photo(i, *o)).collect();
            let camera = |photo: &Photo| Camera {
                intrinsics: Intrinsics::centred(model, 500.0, photo.info.width, photo.info.height),
                width: photo.info.width,
                height: photo.info.height,
                has_focal_prior: false,
            };
            let cameras: Vec<Camera> = photos.iter().map(camera).collect();
            let firsts: Vec<&Photo> = photos.iter().collect();
            portrait_landscape_pairs(&firsts, &cameras)
                .into_iter()
                .map(|pair| pair.map(|id| id.0))
                .collect()
        };
        let one = CameraModelKind::SimpleRadial;
        assert_eq!(pairs(one, &[1, 6]), [[0, 1]]);
        assert_eq!(pairs(one, &[1, 3]), [[0, 1]]);
        assert_eq!(pairs(one, &[1, 3, 8]), [[0, 1], [0, 2], [1, 2]]);
        // Two focal lengths: upside down they keep their places, and a pair exchanges them.
        let two = CameraModelKind::Opencv;
        assert_eq!(pairs(two, &[1, 3]), [[0; 2]; 0]);
        assert_eq!(pairs(two, &[1, 3, 8]), [[0, 2], [1, 2]]);
    }
}
