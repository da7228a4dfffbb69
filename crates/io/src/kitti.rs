//! The calibration file of the KITTI odometry benchmark: the projection matrices P0 to P3 of the
//! rectified cameras, and the pose Tr of the laser scanner, by rows.
//!
//! The centre of the top-left pixel is (0, 0) in KITTI; the reader adds half a pixel to the
//! principal points.

use std::path::Path;

use tiepoint_geometry::nalgebra::{Matrix3, Matrix3x4, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};

use crate::text::Lines;
use crate::trajectory::matrix_pose;
use crate::{Error, Result};

/// A rectified camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KittiCamera {
    /// Number of the camera: 0 for P0.
    pub number: u32,
    /// PINHOLE intrinsics; the centre of the top-left pixel is (0.5, 0.5).
    pub intrinsics: Intrinsics,
    /// Transform from camera 0, in metres: a translation.
    pub cam_from_cam0: Rigid3,
}

/// The content of `calib.txt`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KittiCalibration {
    /// The cameras in the order of the file.
    pub cameras: Vec<KittiCamera>,
    /// Transform from the laser scanner to camera 0, in metres.
    pub cam0_from_velodyne: Option<Rigid3>,
}

/// Reads `calib.txt`; ignores lines with other names.
///
/// # Errors
///
/// If the file cannot be read, if a line has no valid matrix, and if there is no matrix P0 to P3.
pub fn read_calibration(path: &Path) -> Result<KittiCalibration> {
    let mut lines = Lines::open(path)?;
    let mut calibration = KittiCalibration::default();
    while let Some(mut words) = lines.next()? {
        let name = words.word("a name")?.trim_end_matches(':');
        if name == "Tr" || name == "Tr_velo_to_cam" {
            calibration.cam0_from_velodyne = Some(matrix_pose(&mut words)?);
        } else if let Some(number) = name.strip_prefix('P').and_then(|number| number.parse().ok()) {
            // P = K [I | t]
            let p = Matrix3x4::from_row_slice(&words.f64s::<12>("a matrix of 12 numbers")?);
            let k: Matrix3<f64> = p.fixed_view::<3, 3>(0, 0).into_owned();
            let params = [k[(0, 0)], k[(1, 1)], k[(0, 2)] + 0.5, k[(1, 2)] + 0.5];
            let intrinsics = Intrinsics::new(CameraModelKind::Pinhole, &params)
                .map_err(|cause| words.error(cause.to_string()))?;
            let off_diagonal = Vector3::new(k[(0, 1)], k[(1, 0)], k[(2, 2)] - 1.0);
            let inverse = k.try_inverse().filter(|_| off_diagonal.norm() == 0.0);
            let translation = inverse
                .ok_or_else(|| words.error("the matrix is none of a rectified camera"))?
                * p.column(3);
            let cam_from_cam0 = Rigid3 { translation, ..Rigid3::identity() };
            calibration.cameras.push(KittiCamera { number, intrinsics, cam_from_cam0 });
        }
    }
    if calibration.cameras.is_empty() {
        return Err(Error::content(path, "holds no matrices P0 to P3"));
    }
    Ok(calibration)
}
