//! The calibration of one camera.

use tiepoint_geometry::{CameraModelKind, Intrinsics};

/// Pixel coordinates of COLMAP minus those of OpenCV, Kalibr and KITTI.
const PIXEL_CENTRE_OFFSET_PX: f64 = 0.5;

/// The calibration of one camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraCalibration {
    /// Its name in the file: the id in COLMAP's, `cam0` in Kalibr's, `P0` in KITTI's, `P_rect_00`
    /// in KITTI's raw recordings; `M1` and `M2` in OpenCV's of a stereo pair, else `camera`.
    pub name: String,
    /// Kalibr's name of the recording, such as `/left/image_raw`; `camera_name` of ROS; the folder
    /// of the images of KITTI's raw recordings, such as `image_00`.
    pub topic: Option<String>,
    /// Width and height of its images in pixels, if the file has them.
    pub size: Option<[u32; 2]>,
    /// Model and parameters; the centre of the top-left pixel is (0.5, 0.5).
    pub intrinsics: Intrinsics,
}

/// Intrinsics from fx, fy, cx, cy with the centre of the top-left pixel at (0, 0), and the further
/// parameters of a model.
pub(super) fn intrinsics(
    model: &str,
    [fx, fy, cx, cy]: [f64; 4],
    further: &[f64],
) -> std::result::Result<Intrinsics, String> {
    let kind = CameraModelKind::from_name(model).map_err(|cause| cause.to_string())?;
    let mut params = vec![fx, fy, cx + PIXEL_CENTRE_OFFSET_PX, cy + PIXEL_CENTRE_OFFSET_PX];
    params.extend(further);
    Intrinsics::new(kind, &params).map_err(|cause| cause.to_string())
}
