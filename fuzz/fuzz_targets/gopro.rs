//! What a GoPro says of itself in a video.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tiepoint_fuzz::file;
use tiepoint_input::video::is_stabilised;

fuzz_target!(|data: &[u8]| {
    let _ = is_stabilised(&file("a.mp4", data));
});
