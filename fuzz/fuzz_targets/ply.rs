//! PLY clouds.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::file;
use tiepoint_io::ply;

fuzz_target!(|data: &[u8]| {
    if let Ok(vertices) = ply::read(&file("cloud.ply", data)) {
        assert!(vertices.iter().all(|vertex| vertex.xyz.iter().all(|value| value.is_finite())));
    }
});
