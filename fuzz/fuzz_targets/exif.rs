//! EXIF data by themselves: a TIFF file without pixels, and the same in a JPEG file.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tiepoint_fuzz::file;
use tiepoint_input::Exif;

fuzz_target!(|data: &[u8]| {
    let length = (data.len() as u16).saturating_add(8).to_be_bytes();
    let jpeg = [&[0xFF, 0xD8, 0xFF, 0xE1][..], &length, b"Exif\0\0", data].concat();
    for bytes in [data, &jpeg] {
        let Ok(exif) = Exif::read(&file("a.jpg", bytes)) else { return };
        assert!((1..=8).contains(&exif.orientation));
        for sensor_width_mm in [None, Some(36.0)] {
            let focal_px = exif.focal_px(640, 480, sensor_width_mm);
            assert!(focal_px.is_none_or(|focal_px| focal_px.is_finite() && focal_px > 0.0));
        }
        assert!(exif.time_s.is_none_or(f64::is_finite));
    }
});
