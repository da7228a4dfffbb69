//! How far the keypoints of a match are apart.

use tiepoint_scene::{ImagePair, Keypoint, Match};

/// A match with a smaller displacement stands still, in pixels: three standard deviations of one
/// axis of the difference of two keypoints that scatter by half a pixel. On the sets of
/// `bench/overlays.py`, half changes nothing, and double (with [`MOVING_PX`]) finds one time stamp
/// more.
pub(super) const STILL_PX: f64 = 1.5;
/// A match with a larger displacement moves, in pixels. Between the two are the tails of both. Half
/// changes nothing on these sets; with double, a vehicle that waits loses a fifth of its matches.
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
