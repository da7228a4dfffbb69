//! Videos: frames with times and sound, which frames to take, and the offset of two recordings.

mod audio_offset;
mod frame_selection;
mod gopro;
mod reader;
mod tone_map;

pub use audio_offset::{RATE_HZ, start_offset_s};
pub use frame_selection::{Candidate, FrameSelector, STRETCH_S, Selected};
pub use reader::*;
