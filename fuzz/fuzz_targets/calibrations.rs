//! Calibrations of KITTI and of Strecha et al., and those of `--calibration` and
//! `--rig-calibration`.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::file;
use tiepoint_io::{calibration, kitti, rig_calibration, strecha};

fuzz_target!(|data: &[u8]| {
    for name in ["cameras.txt", "a.yaml"] {
        if let Ok(cameras) = calibration::read(&file(name, data)) {
            assert!(!cameras.is_empty());
        }
    }
    for name in ["rig_config.json", "a.yaml"] {
        if let Ok(rigs) = rig_calibration::read(&file(name, data)) {
            assert!(rigs.iter().all(|rig| !rig.is_empty()) && !rigs.is_empty());
        }
    }
    let _ = kitti::read_calibration(&file("calib.txt", data));
    let path = file("a.jpg.camera", data);
    let _ = strecha::read(path.parent().expect("a folder"));
});
