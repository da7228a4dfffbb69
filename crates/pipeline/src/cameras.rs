use tiepoint_io::ImageInfo;
use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics};
use tiepoint_sfm::scene::Camera;

/// Prior knowledge of the intrinsics.
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

impl Default for Calibration {
    fn default() -> Self {
        Self::Unknown { model: CameraModelKind::SimpleRadial, focal_px: None }
    }
}

impl Calibration {
    /// The initial camera of an image.
    pub(crate) fn camera(&self, info: &ImageInfo) -> Camera {
        let ImageInfo { width, height, ref exif, .. } = *info;
        let (intrinsics, has_focal_prior) = match *self {
            Self::Known(intrinsics) => (intrinsics, true),
            Self::Unknown { model, focal_px } => {
                let known = focal_px.or_else(|| exif.focal_px(width, height, None));
                let focal_px = known.unwrap_or(DEFAULT_FOCAL * f64::from(width.max(height)));
                (Intrinsics::centred(model, focal_px, width, height), known.is_some())
            }
        };
        Camera { intrinsics, width, height, has_focal_prior }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_io::Exif;

    #[test]
    fn focal_length_is_the_given_one_or_that_of_exif_or_the_default() {
        let exif = Exif { focal_35mm: Some(36.0), ..Exif::default() };
        let info = |exif| ImageInfo { width: 600, height: 400, time_s: None, exif };
        let focal = |calibration: Calibration, exif| {
            let camera = calibration.camera(&info(exif));
            (camera.intrinsics.mean_focal_px().round(), camera.has_focal_prior)
        };
        let unknown = Calibration::default();
        assert_eq!(focal(unknown, Exif::default()), (720.0, false));
        assert_eq!(focal(unknown, exif.clone()), (600.0, true));
        let model = CameraModelKind::Pinhole;
        assert_eq!(
            focal(Calibration::Unknown { model, focal_px: Some(500.0) }, exif.clone()),
            (500.0, true)
        );
        let known = Intrinsics::new(model, &[400.0, 410.0, 300.0, 200.0]).unwrap();
        assert_eq!(Calibration::Known(known).camera(&info(exif)).intrinsics, known);
    }
}
