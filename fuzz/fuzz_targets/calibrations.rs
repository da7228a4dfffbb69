//! Calibrations of KITTI and of Strecha et al., and those of `--calibration`.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::file;
use tiepoint_io::{calibration, kitti, strecha};

fuzz_target!(|data: &[u8]| {
    for name in ["cameras.txt", "a.yaml"] {
        if let Ok(cameras) = calibration::read(&file(name, data)) {
            assert!(!cameras.is_empty());
        }
    }
    let _ = kitti::read_calibration(&file("calib.txt", data));
    let path = file("a.jpg.camera", data);
    let _ = strecha::read(path.parent().expect("a folder"));
});
