use tiepoint_io::ImageInfo;
use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics};
use tiepoint_sfm::scene::Camera;

/// What is known of the cameras beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Calibration {
    /// They are calibrated along with everything else.
    Unknown {
        /// The model of their lenses.
        model: CameraModelKind,
        /// Their focal length in pixels, roughly; else it is taken from EXIF, else guessed.
        focal_px: Option<f64>,
    },
    /// All have these intrinsics, which stay as they are.
    Known(Intrinsics),
}

/// Focal length of a camera of which nothing is known, relative to the larger side of its images:
/// 45° of view, COLMAP's guess.
const GUESSED_FOCAL: f64 = 1.2;

impl Default for Calibration {
    fn default() -> Self {
        Self::Unknown { model: CameraModelKind::SimpleRadial, focal_px: None }
    }
}

impl Calibration {
    /// The camera that took an image.
    pub(crate) fn camera(&self, info: &ImageInfo) -> Camera {
        let ImageInfo { width, height, exif, .. } = *info;
        let (intrinsics, has_focal_prior) = match *self {
            Self::Known(intrinsics) => (intrinsics, true),
            Self::Unknown { model, focal_px } => {
                let known = focal_px.or_else(|| exif.focal_px(width, height, None));
                let focal_px = known.unwrap_or(GUESSED_FOCAL * f64::from(width.max(height)));
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
    fn the_focal_length_is_given_or_from_exif_or_guessed() {
        let exif = Exif { focal_35mm: Some(36.0), ..Exif::default() };
        let info = |exif| ImageInfo { width: 600, height: 400, time_s: None, exif };
        let focal = |calibration: Calibration, exif| {
            let camera = calibration.camera(&info(exif));
            (camera.intrinsics.mean_focal_px().round(), camera.has_focal_prior)
        };
        let unknown = Calibration::default();
        assert_eq!(focal(unknown, Exif::default()), (720.0, false));
        assert_eq!(focal(unknown, exif), (600.0, true));
        let model = CameraModelKind::Pinhole;
        assert_eq!(
            focal(Calibration::Unknown { model, focal_px: Some(500.0) }, exif),
            (500.0, true)
        );
        let known = Intrinsics::new(model, &[400.0, 410.0, 300.0, 200.0]).unwrap();
        assert_eq!(Calibration::Known(known).camera(&info(exif)).intrinsics, known);
    }
}
