//! The manifest of a folder: which images this program has made.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tiepoint_fuzz::{folder, write};
use tiepoint_input::ImageFolder;
use tiepoint_io::store::MANIFEST;

fuzz_target!(|data: &[u8]| {
    let dir = folder();
    for name in ["a/1.jpg", "a/2.png", "b/1.heic", "b/1.jpg"] {
        write(&dir.join(name), b"");
    }
    write(&dir.join("a").join(MANIFEST), data);
    write(&dir.join(MANIFEST), data);
    let _ = ImageFolder::open(&[dir], None);
});
