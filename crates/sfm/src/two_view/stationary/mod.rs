//! Matches that stand still in the image while the scene moves: logos, time stamps, a bonnet, dirt
//! on the lens, the background of a turntable.
//!
//! One pair does not tell an overlay from a distant point or from a camera that stands still.
//! Many images of one camera do. Keypoints that matches without displacement connect are a
//! *component*: one spot of the image. A spot of an overlay stays exactly where it is, in all pairs
//! of its images; it matches nothing elsewhere; and the rest of these images moves. A distant point
//! drifts with the rotations of the camera. A point of the scene that stands still while a vehicle
//! stops has moved before or moves after it, it or those around it. What a camera drives to
//! stands still in the image, too: at the epipoles.

mod candidates;
mod cells;
mod displacement;
mod overlay;
mod search;
mod spot;

pub use candidates::{Candidates, MovedPairs};
pub use overlay::{Overlay, Stationary};
pub use search::StationarySearch;
