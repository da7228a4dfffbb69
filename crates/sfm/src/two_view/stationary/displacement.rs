//! How far the keypoints of a match are apart.

use tiepoint_scene::{ImagePair, Keypoint, Match};

/// A match with a smaller displacement stands still, in pixels: three standard deviations of the
/// distance of two keypoints of half a pixel.
pub(super) const STILL_PX: f64 = 1.5;
/// A match with a larger displacement moves, in pixels. Between the two are the tails of both.
pub(super) const MOVING_PX: f64 = 3.0 * STILL_PX;

/// The displacement of a match, in pixels; `None` if a keypoint does not exist.
pub(super) fn displacement_px(
    keypoints: &[&[Keypoint]],
    pair: ImagePair,
    m: &Match,
) -> Option<f64> {
    let one = keypoints[pair.a.index()].get(m.a as usize)?;
    let other = keypoints[pair.b.index()].get(m.b as usize)?;
    Some((one.pixel - other.pixel).norm())
}
