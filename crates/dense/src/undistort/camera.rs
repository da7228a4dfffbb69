//! The PINHOLE camera of a distorted one, with the options and the sizes of COLMAP's
//! `UndistortCamera`.

use tiepoint_geometry::cameras::MIN_DEPTH;
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::Camera;

use crate::Error;

/// Options of [`undistort_camera`]; the defaults are COLMAP's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UndistortOptions {
    /// Blank pixels in the undistorted image: 0 none, 1 as many as all pixels of the distorted
    /// image need, and between them linearly.
    pub blank_pixels: f64,
    /// Smallest size of the undistorted image, relative to the distorted one.
    pub min_scale: f64,
    /// Largest size of the undistorted image, relative to the distorted one.
    pub max_scale: f64,
    /// Largest width and height of the undistorted image, in pixels.
    pub max_image_size: Option<u32>,
}

impl Default for UndistortOptions {
    fn default() -> Self {
        Self { blank_pixels: 0.0, min_scale: 0.2, max_scale: 2.0, max_image_size: None }
    }
}

impl UndistortOptions {
    /// Checks the ranges of the options.
    ///
    /// # Errors
    ///
    /// [`Error::Option`] for the first option out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        let Self { blank_pixels, min_scale, max_scale, max_image_size } = *self;
        let check = |is_valid: bool, name, value, range| match is_valid {
            true => Ok(()),
            false => Err(Error::Option { name, value, range }),
        };
        check(
            (0.0..=1.0).contains(&blank_pixels),
            "blank_pixels",
            blank_pixels,
            "give a share from 0 to 1",
        )?;
        check(
            min_scale > 0.0 && min_scale.is_finite(),
            "min_scale",
            min_scale,
            "give a positive number",
        )?;
        check(
            max_scale >= min_scale && max_scale.is_finite(),
            "max_scale",
            max_scale,
            "give at least min_scale",
        )?;
        check(max_image_size != Some(0), "max_image_size", 0.0, "give at least 1 pixel")
    }
}

/// The PINHOLE camera with the focal lengths of `camera`. Its size, and with it the principal
/// point, is chosen by [`UndistortOptions::blank_pixels`], separately for width and height. A
/// camera without distortion keeps its size. Both are then scaled down to
/// [`UndistortOptions::max_image_size`].
///
/// # Errors
/// [`Error::Option`] if an option is out of its range; [`Error::NoPinhole`] for a spherical camera.
pub fn undistort_camera(camera: &Camera, options: &UndistortOptions) -> Result<Camera, Error> {
    options.validate()?;
    if camera.intrinsics.kind() == CameraModelKind::Equirectangular {
        return Err(Error::NoPinhole { model: CameraModelKind::Equirectangular.name() });
    }
    let k = camera.intrinsics.calibration_matrix();
    let mut focal = [k[(0, 0)], k[(1, 1)]];
    let mut centre = [k[(0, 2)], k[(1, 2)]];
    let mut size = [camera.width, camera.height];
    let kind = camera.intrinsics.kind();
    if !matches!(kind, CameraModelKind::SimplePinhole | CameraModelKind::Pinhole) {
        for axis in 0..2 {
            let border = Border::of(camera, axis);
            let old = f64::from(size[axis]);
            let scale = border.scale(centre[axis], old, options.blank_pixels);
            let scale = scale.clamp(options.min_scale, options.max_scale);
            size[axis] = (scale * old).max(1.0) as u32;
            centre[axis] *= f64::from(size[axis]) / old;
        }
    }
    let longest = f64::from(size[0].max(size[1]));
    if let Some(limit) = options.max_image_size.map(f64::from).filter(|limit| *limit < longest) {
        for axis in 0..2 {
            let old = f64::from(size[axis]);
            size[axis] = (old * limit / longest).round().max(1.0) as u32;
            let scale = f64::from(size[axis]) / old;
            focal[axis] *= scale;
            centre[axis] *= scale;
        }
    }
    let params = [focal[0], focal[1], centre[0], centre[1]];
    // Valid parameters stay valid; an invalid camera is returned unchanged.
    let intrinsics =
        Intrinsics::new(CameraModelKind::Pinhole, &params).unwrap_or(camera.intrinsics);
    Ok(Camera { intrinsics, width: size[0], height: size[1], ..*camera })
}

/// Whether a camera sees a direction at 90 degrees or more from its axis on the row or the column
/// of its principal point: 180 degrees or more from border to border, which a PINHOLE camera of
/// the same axis cuts off at any size. Corners alone may see more.
pub fn is_too_wide_for_pinhole(camera: &Camera) -> bool {
    if camera.intrinsics.kind() == CameraModelKind::Equirectangular {
        return true;
    }
    let k = camera.intrinsics.calibration_matrix();
    let centre = Vector2::new(k[(0, 2)], k[(1, 2)]);
    let sizes = [camera.width, camera.height];
    let outermost = |axis: usize, outward: bool| {
        // From the border inwards, as an image may have pixels without a ray.
        (0..sizes[axis]).find_map(|pixels| {
            let pixels = f64::from(pixels) + 0.5;
            let mut place = centre;
            place[axis] = if outward { f64::from(sizes[axis]) - pixels } else { pixels };
            camera.intrinsics.unproject(&place)
        })
    };
    (0..2).any(|axis| {
        [false, true].into_iter().any(|outward| {
            outermost(axis, outward).is_some_and(|ray| ray.z <= MIN_DEPTH * ray.norm())
        })
    })
}

/// Range of the undistorted coordinate along a border of the image; empty if no pixel of the
/// border has a ray in front of the pinhole.
#[derive(Clone, Copy, Debug)]
struct Range {
    min: f64,
    max: f64,
}

impl Range {
    const EMPTY: Self = Self { min: f64::INFINITY, max: f64::NEG_INFINITY };

    fn with(self, value: f64) -> Self {
        Self { min: self.min.min(value), max: self.max.max(value) }
    }
}

/// Undistorted coordinates of the two borders across an axis: left and right, or top and bottom.
struct Border {
    low: Range,
    high: Range,
}

impl Border {
    /// The borders of an image through the pinhole of the same focal lengths and principal point.
    /// As in COLMAP, the border is the line of pixel centres.
    fn of(camera: &Camera, axis: usize) -> Self {
        let size = [camera.width, camera.height];
        let k = camera.intrinsics.calibration_matrix();
        let along = |position: f64| {
            let coordinate = |other: u32| {
                let mut pixel = Vector2::repeat(f64::from(other) + 0.5);
                pixel[axis] = position;
                let ray = camera.intrinsics.unproject(&pixel)?;
                (ray.z > MIN_DEPTH).then(|| k[(axis, axis)] * ray[axis] / ray.z + k[(axis, 2)])
            };
            (0..size[1 - axis]).filter_map(coordinate).fold(Range::EMPTY, Range::with)
        };
        Self { low: along(0.5), high: along(f64::from(size[axis]) - 0.5) }
    }

    /// Scale of the size about the principal point `centre` for a share of blank pixels.
    fn scale(&self, centre: f64, size: f64, blank_pixels: f64) -> f64 {
        // Distances from the principal point to both borders, after over before.
        let end = size - 0.5 - centre;
        let all = ((centre - self.low.min) / centre).max((self.high.max - centre) / end);
        let none = ((centre - self.low.max) / centre).min((self.high.min - centre) / end);
        // COLMAP interpolates the inverse.
        let inverse = blank_pixels / all + (1.0 - blank_pixels) / none;
        // A border without rays in front of the pinhole is infinitely far away. A border beyond
        // the principal point has no scale without blank pixels; the smallest size has fewest.
        if inverse > 0.0 {
            1.0 / inverse
        } else if none > 0.0 {
            f64::INFINITY
        } else {
            0.0
        }
    }
}
