//! Videos: frames with times and sound, which frames to take, and the offset of two recordings.

mod audio_offset;
mod frame_selection;
mod gopro;
mod klv;
mod mp4;
mod reader;
mod telemetry;
mod tone_map;

pub use audio_offset::{RATE_HZ, start_offset_s};
pub use frame_selection::{Candidate, FrameSelector, STRETCH_S, Selected};
pub use reader::*;
pub use telemetry::{Measurements, Telemetry};
