//! JPEG, PNG, TIFF, WebP, BMP and PNM with their EXIF data, as photos and as masks.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tiepoint_fuzz::{folder, write};
use tiepoint_input::ImageFolder;

/// Large images take time and show nothing.
const DEFAULT_MAX_PIXELS: u64 = 1 << 21;

fuzz_target!(|data: &[u8]| {
    let dir = folder();
    write(&dir.join("photos/a.jpg"), data);
    write(&dir.join("masks/a.jpg.png"), data);
    let inputs = [dir.join("photos")];
    let Ok(photos) = ImageFolder::open(&inputs, Some(&dir.join("masks"))) else { return };
    let photos = photos.with_max_pixels(DEFAULT_MAX_PIXELS);
    let info = photos.info(0);
    if let (Ok(info), Ok(luma)) = (&info, photos.luma(0)) {
        assert_eq!((info.width, info.height), (luma.width, luma.height));
        assert_eq!(luma.data.len(), luma.width as usize * luma.height as usize);
    }
    let _ = (photos.rgb(0), photos.mask(0));
});
