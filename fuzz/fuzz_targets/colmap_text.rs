//! COLMAP's models, text. What is read is valid, and comes back when it is written.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{files, folder};
use tiepoint_io::colmap::{Format, read_model, write_model};

fuzz_target!(|data: &[u8]| {
    let dir = folder();
    let names = ["cameras.txt", "images.txt", "points3D.txt", "rigs.txt", "frames.txt"];
    files(&dir, &names, data);
    let Ok(model) = read_model(&dir) else { return };
    model.validate().expect("what is read is valid");
    // Rigs of one camera vanish, and names may be such that no text holds them: writing may be
    // refused.
    let copy = dir.join("copy");
    if write_model(&copy, &model, Format::Binary).is_ok() {
        let back = read_model(&copy).expect("what was written can be read");
        assert_eq!(back.num_registered(), model.num_registered());
        assert_eq!(back.num_tracks(), model.num_tracks());
    }
});
