//! Calibrations of KITTI and of Strecha et al.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::file;
use tiepoint_io::{kitti, strecha};

fuzz_target!(|data: &[u8]| {
    let _ = kitti::read_calibration(&file("calib.txt", data));
    let path = file("a.jpg.camera", data);
    let _ = strecha::read(path.parent().expect("a folder"));
});
