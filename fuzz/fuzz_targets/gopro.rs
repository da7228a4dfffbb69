//! What a GoPro says of itself in a video.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tiepoint_fuzz::file;
use tiepoint_input::video::{Telemetry, is_stabilised};

fuzz_target!(|data: &[u8]| {
    let path = file("a.mp4", data);
    let _ = is_stabilised(&path);
    if let Ok(Some(found)) = Telemetry::read(&path) {
        let track = found.positions();
        assert!(track.positions().iter().all(|position| position.place.validate().is_ok()));
    }
});
