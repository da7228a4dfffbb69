//! Times of images: CSV. What is read comes back when it is written.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{file, folder};
use tiepoint_io::timestamps;

fuzz_target!(|data: &[u8]| {
    let Ok(times) = timestamps::read(&file("times.csv", data)) else { return };
    let path = folder().join("times.csv");
    timestamps::write(&path, times.iter().map(|(name, time_s)| (name.as_str(), *time_s)))
        .expect("it can be written");
    assert_eq!(timestamps::read(&path).expect("what was written can be read"), times);
});
