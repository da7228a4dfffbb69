//! Known intrinsics at a photo: turned as its EXIF orientation asks for, and checked against its
//! size.

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::Camera;

use crate::Size;
use crate::images::{ImageInfo, is_plausible_focal};

/// Largest distance of the principal point from the centre over the image side, for intrinsics
/// whose image size is not known. Those of twice the size have it 1/2 off, and those of half the
/// size 1/4: half of the nearest wrong one.
const MAX_OFFSET: f64 = 0.125;

/// Where the axes x and y of the upright image come from: the axis of the stored image (0 is x),
/// and whether it is reversed.
type Axes = [(usize, bool); 2];

/// The axes of an EXIF orientation (CIPA DC-008, tag Orientation).
fn axes(orientation: u8) -> Axes {
    match orientation {
        2 => [(0, true), (1, false)],
        3 => [(0, true), (1, true)],
        4 => [(0, false), (1, true)],
        5 => [(1, false), (0, false)],
        6 => [(1, true), (0, false)],
        7 => [(1, true), (0, true)],
        8 => [(1, false), (0, true)],
        _ => [(0, false), (1, false)],
    }
}

/// Parameters that form a vector in the image plane, by their names: tangential distortion is
/// q r² + 2 (q·u) u with q = (p2, p1), or (p0, p1) of RAD_TAN_THIN_PRISM_FISHEYE, and the thin
/// prism is s r² and s r⁴.
const VECTORS: [[&str; 2]; 5] =
    [["p2", "p1"], ["p0", "p1"], ["sx1", "sy1"], ["s0", "s2"], ["s1", "s3"]];

/// Intrinsics of the upright image from those of the stored one, which has these sides in pixels.
/// `None` for a spherical model that would have to be turned: its image has an upright direction.
fn upright(intrinsics: &Intrinsics, orientation: u8, stored: [u32; 2]) -> Option<Intrinsics> {
    let axes = axes(orientation);
    if orientation == 1 {
        return Some(*intrinsics);
    }
    let kind = intrinsics.kind();
    let &[cx, cy] = kind.principal_point_indices() else { return None };
    let old = intrinsics.params();
    let mut turned = *intrinsics;
    let new = turned.params_mut();
    for (target, (source, is_reversed)) in [cx, cy].into_iter().zip(axes) {
        let value = old[[cx, cy][source]];
        new[target] = if is_reversed { f64::from(stored[source]) - value } else { value };
    }
    if let &[fx, fy] = kind.focal_indices() {
        for (target, (source, _)) in [fx, fy].into_iter().zip(axes) {
            new[target] = old[[fx, fy][source]];
        }
    }
    let index_of = |name: &str| kind.param_names().iter().position(|known| *known == name);
    for [x, y] in VECTORS {
        let (Some(x), Some(y)) = (index_of(x), index_of(y)) else { continue };
        for (target, (source, is_reversed)) in [x, y].into_iter().zip(axes) {
            let value = old[[x, y][source]];
            new[target] = if is_reversed { -value } else { value };
        }
    }
    Some(turned)
}

/// Width and height of the stored photo, before the rotation that EXIF asks for.
fn stored_size(info: &ImageInfo) -> [u32; 2] {
    let ImageInfo { width, height, .. } = *info;
    if info.exif.orientation >= 5 { [height, width] } else { [width, height] }
}

/// Largest distance of the principal point from the centre over the image side.
fn offset(intrinsics: &Intrinsics, [width, height]: [u32; 2]) -> f64 {
    let centre = intrinsics.principal_point();
    let off = |value: f64, side: u32| (value / f64::from(side) - 0.5).abs();
    off(centre.x, width).max(off(centre.y, height))
}

/// The image size of intrinsics that come without one: the size of the photo as stored or as turned
/// upright by EXIF, whichever has its centre nearer to the principal point. OpenCV calibrates
/// upright photos, other programs photos as they are stored.
pub(crate) fn assumed_size(intrinsics: &Intrinsics, info: &ImageInfo) -> [u32; 2] {
    let (stored, upright) = (stored_size(info), [info.width, info.height]);
    if offset(intrinsics, upright) < offset(intrinsics, stored) { upright } else { stored }
}

/// The camera of an upright photo with known intrinsics. `size`: the image size of the intrinsics,
/// in pixels, if it is known. Intrinsics of the size of the stored photo are turned with it; those
/// of the upright size are not. An error says what does not fit `photo`.
pub(crate) fn camera_of(
    intrinsics: &Intrinsics,
    size: Option<[u32; 2]>,
    photo: &str,
    info: &ImageInfo,
) -> Result<Camera, String> {
    let (stored, orientation) = (stored_size(info), info.exif.orientation);
    let ImageInfo { width, height, .. } = *info;
    let assumed = size.unwrap_or_else(|| assumed_size(intrinsics, info));
    let turned = if assumed == stored {
        upright(intrinsics, orientation, stored).ok_or_else(|| {
            let name = intrinsics.kind().name();
            format!("{photo} has the EXIF orientation {orientation}, and {name} cannot be turned")
        })?
    } else if assumed == [width, height] {
        *intrinsics
    } else {
        let [w, h] = assumed;
        return Err(format!(
            "the images of the calibration have {}, and {photo} has {}: calibrate at the size of \
            the photos, or name the photos that the calibration is of, as PATTERN=FILE",
            Size(w, h),
            Size(stored[0], stored[1])
        ));
    };
    let camera = Camera { intrinsics: turned, width, height, has_focal_prior: true };
    let [x, y] = [intrinsics.principal_point().x, intrinsics.principal_point().y];
    if !camera.contains(&turned.principal_point()) {
        return Err(format!(
            "the principal point ({x}, {y}) lies outside of {photo}, which has {}: is the \
            calibration that of another camera?",
            Size(width, height)
        ));
    }
    if size.is_none() && offset(intrinsics, assumed) > MAX_OFFSET {
        return Err(format!(
            "the principal point ({x}, {y}) is far from the centre of {photo}, which has {}: is \
            the calibration that of another image size? If not, state it, as \
            `features.calibration` FILE#P0@{}x{}",
            Size(width, height),
            assumed[0],
            assumed[1]
        ));
    }
    if !is_plausible(&camera) {
        return Err(format!(
            "no lens has the focal lengths and the distortion of the calibration at {photo}, which \
            has {}",
            Size(width, height)
        ));
    }
    Ok(camera)
}

/// Whether the focal lengths are those of a lens, and also the one that the distortion makes of
/// them: the distance from the principal point over the angle to the optical axis, at a quarter of
/// the longer side towards the farther border. A quarter is well inside of each image.
fn is_plausible(camera: &Camera) -> bool {
    let Camera { intrinsics, width, height, .. } = camera;
    if intrinsics.kind() == CameraModelKind::Equirectangular {
        return true;
    }
    let is_plausible = |focal_px: f64| is_plausible_focal(focal_px, *width, *height);
    let centre = intrinsics.principal_point();
    let distance = 0.25 * f64::from(*width.max(height));
    let (side, direction, at) = if width >= height {
        (*width, Vector2::x(), centre.x)
    } else {
        (*height, Vector2::y(), centre.y)
    };
    let sign = if at <= 0.5 * f64::from(side) { 1.0 } else { -1.0 };
    let ray = intrinsics.unproject(&(centre + direction * (sign * distance)));
    let effective = ray.map(|ray| distance / ray.xy().norm().atan2(ray.z));
    intrinsics.focal_lengths_px().into_iter().all(is_plausible)
        && effective.is_some_and(is_plausible)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Exif;
    use tiepoint_geometry::nalgebra::Vector3;

    fn info(width: u32, height: u32, orientation: u8) -> ImageInfo {
        let exif = Exif { orientation, ..Exif::default() };
        ImageInfo { width, height, time_s: None, exif }
    }

    fn pinhole(params: [f64; 4]) -> Intrinsics {
        Intrinsics::new(CameraModelKind::Pinhole, &params).unwrap()
    }

    /// A pixel of the stored image in the upright one, as `image::DynamicImage` turns it.
    fn turn(pixel: Vector2<f64>, orientation: u8, [w, h]: [f64; 2]) -> Vector2<f64> {
        let [x, y] = pixel.into();
        match orientation {
            1 => Vector2::new(x, y),
            2 => Vector2::new(w - x, y),
            3 => Vector2::new(w - x, h - y),
            4 => Vector2::new(x, h - y),
            5 => Vector2::new(y, x),
            6 => Vector2::new(h - y, x),
            7 => Vector2::new(h - y, w - x),
            _ => Vector2::new(y, w - x),
        }
    }

    #[test]
    fn turned_intrinsics_project_turned_points_to_turned_pixels() {
        let stored = [640, 480];
        for &kind in CameraModelKind::ALL {
            let distortion = |index: usize| 0.002 * (index + 1) as f64;
            let params: Vec<f64> = kind
                .param_names()
                .iter()
                .enumerate()
                .map(|(index, name)| match *name {
                    "f" | "fx" => 500.0,
                    "fy" => 520.0,
                    "cx" => 330.0,
                    "cy" => 231.0,
                    "w" => 640.0,
                    "h" => 480.0,
                    "beta" => 1.1,
                    _ => distortion(index),
                })
                .collect();
            let intrinsics = Intrinsics::new(kind, &params).unwrap();
            for orientation in 1..=8 {
                let Some(turned) = upright(&intrinsics, orientation, stored) else {
                    assert_eq!(kind, CameraModelKind::Equirectangular);
                    continue;
                };
                for (x, y) in [(0.3, 0.1), (-0.2, 0.25)] {
                    let pixel = intrinsics.project(&Vector3::new(x, y, 1.0)).unwrap();
                    // The axes turn with the image; the origin stays.
                    let axes = turn(Vector2::new(x, y), orientation, [0.0, 0.0]);
                    let found = turned.project(&axes.push(1.0)).unwrap();
                    let expected = turn(pixel, orientation, [640.0, 480.0]);
                    assert!((found - expected).norm() < 1e-9, "{kind:?} {orientation}");
                }
            }
        }
    }

    #[test]
    fn one_calibration_serves_all_orientations_of_a_phone() {
        let known = pinhole([500.0, 510.0, 330.0, 231.0]);
        let camera = |info: &ImageInfo, size| camera_of(&known, size, "a.jpg", info).unwrap();
        for size in [None, Some([640, 480])] {
            for (info, expected) in [
                (info(640, 480, 1), [500.0, 510.0, 330.0, 231.0]),
                (info(640, 480, 3), [500.0, 510.0, 310.0, 249.0]),
                (info(480, 640, 6), [510.0, 500.0, 249.0, 330.0]),
                (info(480, 640, 8), [510.0, 500.0, 231.0, 310.0]),
            ] {
                assert_eq!(camera(&info, size).intrinsics, pinhole(expected));
            }
        }
        // A calibration of upright photos, as OpenCV reads them, is that of the pixels.
        let upright = pinhole([500.0, 510.0, 231.0, 330.0]);
        for size in [None, Some([480, 640])] {
            let camera = camera_of(&upright, size, "a.jpg", &info(480, 640, 6)).unwrap();
            assert_eq!(camera.intrinsics, upright);
        }
    }

    #[test]
    fn intrinsics_of_another_size_or_of_no_lens_are_refused() {
        let photo = info(640, 480, 1);
        let refused = |params: [f64; 4], size| {
            camera_of(&pinhole(params), size, "a.jpg", &photo).unwrap_err()
        };
        let good = [500.0, 500.0, 320.0, 240.0];
        // Half and twice the size.
        for factor in [0.5, 2.0] {
            let error = refused(good.map(|value| factor * value), None);
            assert!(error.contains("principal point") && error.contains("640 x 480"), "{error}");
        }
        assert!(refused([500.0, 500.0, 420.0, 240.0], None).contains("FILE#P0@640x480"));
        let shifted = pinhole([500.0, 500.0, 420.0, 240.0]);
        assert!(camera_of(&shifted, Some([640, 480]), "a.jpg", &photo).is_ok());
        assert!(refused(good, Some([480, 640])).contains("480 x 640, and a.jpg has 640 x 480"));
        assert!(refused([500.0, 500.0, 5000.0, 5000.0], None).contains("outside of a.jpg"));
        for focal in [1e308, 1.0] {
            assert!(refused([focal, 500.0, 320.0, 240.0], None).contains("no lens"));
        }
        for k1 in [1e300, -1e300] {
            let params = [500.0, 500.0, 320.0, 240.0, k1, 0.0, 0.0, 0.0];
            let opencv = Intrinsics::new(CameraModelKind::Opencv, &params).unwrap();
            let error = camera_of(&opencv, None, "a.jpg", &photo).unwrap_err();
            assert!(error.contains("no lens"), "{error}");
        }
        let panorama = Intrinsics::centred(CameraModelKind::Equirectangular, 1.0, 640, 480);
        assert!(camera_of(&panorama, None, "a.jpg", &photo).is_ok());
        let error = camera_of(&panorama, None, "a.jpg", &info(640, 480, 3)).unwrap_err();
        assert!(error.contains("cannot be turned"), "{error}");
    }
}
