//! Images that claim more than they hold, or more than anybody's photos have, are refused before
//! memory is set aside.

use std::fs;
use std::io::Cursor;

use image::{DynamicImage, ImageFormat, RgbImage};
use tiepoint_input::{ABSOLUTE_MAX_PIXELS, DEFAULT_MAX_PIXELS, ImageFolder, Luma, Rgb};

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Vec::new();
    image.write_to(&mut Cursor::new(&mut bytes), format).unwrap();
    bytes
}

fn noise(width: u32, height: u32) -> DynamicImage {
    let hash = |x: u32, y: u32| (x.wrapping_mul(0x9E37_79B9) ^ y.wrapping_mul(0x85EB_CA6B)) >> 13;
    RgbImage::from_fn(width, height, |x, y| image::Rgb([hash(x, y) as u8; 3])).into()
}

/// A file of 28 kB that says it has 20,000 × 10,000 pixels.
fn claiming_jpeg() -> Vec<u8> {
    let mut bytes = encoded(&noise(200, 200), ImageFormat::Jpeg);
    let frame = bytes.windows(2).position(|pair| pair == [0xFF, 0xC0]).unwrap();
    bytes[frame + 5..frame + 7].copy_from_slice(&10_000u16.to_be_bytes());
    bytes[frame + 7..frame + 9].copy_from_slice(&20_000u16.to_be_bytes());
    assert!((10_000..50_000).contains(&bytes.len()), "{}", bytes.len());
    bytes
}

/// A file with two frame headers of different heights. The first one follows a restart marker,
/// which has no length; the decoder reads one and skips the header.
fn jpeg_of_two_sizes() -> Vec<u8> {
    let mut bytes = encoded(&noise(200, 200), ImageFormat::Jpeg);
    let frame = bytes.windows(2).position(|pair| pair == [0xFF, 0xC0]).unwrap();
    let length = u16::from_be_bytes([bytes[frame + 2], bytes[frame + 3]]);
    let mut first = bytes[frame..][..2 + usize::from(length)].to_vec();
    first[5..7].copy_from_slice(&100u16.to_be_bytes());
    let skipped = (first.len() as u16 + 2).to_be_bytes();
    bytes.splice(frame..frame, [&[0xFF, 0xD1][..], &skipped, &first].concat());
    bytes
}

/// CRC 32 of PNG (ISO 3309).
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 * (crc & 1)))
    })
}

fn claiming_png(width: u32, height: u32) -> Vec<u8> {
    resized_png(&noise(8, 8), width, height)
}

fn resized_png(image: &DynamicImage, width: u32, height: u32) -> Vec<u8> {
    let mut bytes = encoded(image, ImageFormat::Png);
    bytes[16..20].copy_from_slice(&width.to_be_bytes());
    bytes[20..24].copy_from_slice(&height.to_be_bytes());
    let sum = crc(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&sum.to_be_bytes());
    bytes
}

fn claiming_tiff(side: u32) -> Vec<u8> {
    let mut bytes = encoded(&noise(8, 8), ImageFormat::Tiff);
    for tag in [256u16, 257] {
        let entry = [&tag.to_le_bytes()[..], &[4, 0, 1, 0, 0, 0]].concat();
        let at = bytes.windows(8).position(|window| *window == entry).unwrap();
        bytes[at + 8..at + 12].copy_from_slice(&side.to_le_bytes());
    }
    bytes
}

fn folder(name: &str, bytes: &[u8]) -> (tempfile::TempDir, ImageFolder) {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join(name), bytes).unwrap();
    let folder = ImageFolder::open(&[dir.path().to_owned()], None).unwrap();
    (dir, folder)
}

fn refused(name: &str, bytes: &[u8], says: &str) {
    let (_dir, folder) = folder(name, bytes);
    for error in [folder.info(0).map(drop), folder.luma(0).map(drop), folder.rgb(0).map(drop)] {
        let error = error.expect_err(name).to_string();
        assert!(error.contains(name) && error.contains(says), "{error}");
    }
}

/// The size in the header, which becomes that of the camera, is that of the pixels.
#[test]
fn a_jpeg_of_two_sizes_is_refused() {
    let (_dir, folder) = folder("a.jpg", &jpeg_of_two_sizes());
    for error in [folder.luma(0).map(drop), folder.rgb(0).map(drop)] {
        let error = error.unwrap_err().to_string();
        assert!(
            error.contains("a.jpg") && error.contains("200 × 100 and of 200 × 200 pixels"),
            "{error}"
        );
    }
}

#[test]
fn claims_that_no_file_of_that_length_can_hold() {
    refused("a.jpg", &claiming_jpeg(), "claims 20000 × 10000 pixels, which take");
    refused("a.png", &claiming_png(10_000, 10_000), "claims 10000 × 10000 pixels, which take");
    refused("a.tif", &claiming_tiff(100_000), "a.tif");
}

/// The bytes that such sizes would take do not fit 64 bits.
#[test]
fn the_largest_sizes_that_headers_can_name() {
    refused("a.tif", &claiming_tiff(u32::MAX), "a.tif: ");
    let deep: DynamicImage = noise(8, 8).to_rgba16().into();
    let side = i32::MAX as u32;
    refused("a.png", &resized_png(&deep, side, side), "a.png: ");
}

#[test]
fn the_limit_can_be_raised_to_the_largest_cameras_and_no_farther() {
    // Larger than any camera of a shop, and as much as a TIFF file may claim in no bytes at all.
    let (_dir, folder) = folder("a.tif", &claiming_tiff(17_000));
    let error = folder.info(0).unwrap_err().to_string();
    assert!(
        error.contains(
            "more than 256 million: if it is a photo, give `features.max_megapixels` 289"
        ),
        "{error}"
    );
    assert_eq!(folder.clone().with_max_pixels(289_000_000).info(0).unwrap().width, 17_000);
    assert!(folder.with_max_pixels(288_999_999).info(0).is_err());
    let (_dir, all) = self::folder("a.tif", &claiming_tiff(40_000));
    let error = all.with_max_pixels(u64::MAX).info(0).unwrap_err().to_string();
    assert!(error.contains("more than 1000 million are never read"), "{error}");
    // Phase One's IQ4 and the largest sensors in telephones.
    const {
        assert!(
            DEFAULT_MAX_PIXELS > 14_204 * 10_652
                && DEFAULT_MAX_PIXELS > 16_320 * 12_240
                && DEFAULT_MAX_PIXELS < ABSOLUTE_MAX_PIXELS
        )
    };
}

#[test]
fn real_files_are_far_from_what_their_length_can_hold() {
    // Flat images are the smallest of their size.
    for (width, height) in [(1, 1), (7, 9), (333, 1000), (4000, 3000)] {
        let flat: DynamicImage = RgbImage::from_pixel(width, height, image::Rgb([90; 3])).into();
        let grey: DynamicImage = flat.to_luma8().into();
        for image in [flat, grey] {
            for (name, format) in [
                ("a.jpg", ImageFormat::Jpeg),
                ("a.png", ImageFormat::Png),
                ("a.tif", ImageFormat::Tiff),
            ] {
                let (_dir, folder) = folder(name, &encoded(&image, format));
                let info = folder.info(0).unwrap_or_else(|error| panic!("{error}"));
                assert_eq!((info.width, info.height), (width, height));
            }
        }
    }
}

#[test]
fn a_file_too_long_for_its_pixels_is_not_read() {
    let (dir, folder) = folder("a.jpg", &encoded(&noise(64, 48), ImageFormat::Jpeg));
    assert!(folder.luma(0).is_ok());
    // A terabyte of nothing behind it takes no room on the disk.
    let file = fs::OpenOptions::new().write(true).open(dir.path().join("a.jpg")).unwrap();
    file.set_len(1 << 40).unwrap();
    for error in [folder.info(0).map(drop), folder.luma(0).map(drop)] {
        let error = error.unwrap_err().to_string();
        assert!(error.contains("1099511627776 bytes, far too many for 64 × 48 pixels"), "{error}");
    }
}

#[test]
fn masks_and_photos_of_other_sizes_are_not_decoded() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        path
    };
    let photo = write("photos/a.jpg", &encoded(&noise(64, 48), ImageFormat::Jpeg));
    write("masks/a.png", &claiming_tiff(15_000));
    let folder =
        ImageFolder::open(&[dir.path().join("photos")], Some(&dir.path().join("masks"))).unwrap();
    let error = folder.mask(0).unwrap_err().to_string();
    assert!(
        error.contains("the mask has 15000 × 15000 pixels, its image a.jpg has 64 × 48"),
        "{error}"
    );
    assert!(Rgb::read_of_size(&photo, 64, 48).is_ok());
    let error = Rgb::read_of_size(&photo, 48, 64).unwrap_err().to_string();
    assert!(
        error.contains("the photo has 64 × 48 pixels, the camera of its model has 48 × 64"),
        "{error}"
    );
    assert!(Luma::read(&photo).is_ok());
}

#[test]
fn photos_of_telephones_are_named_with_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let (jpeg, heic) = (encoded(&noise(8, 8), ImageFormat::Jpeg), b"\0\0\0\x18ftypheic".to_vec());
    for (name, bytes) in [
        ("1.jpg", &jpeg),
        ("2.HEIC", &heic),
        ("3.heif", &heic),
        ("4.heic", &heic),
        ("4.jpg", &jpeg),
    ] {
        fs::write(dir.path().join(name), bytes).unwrap();
    }
    let folder = ImageFolder::open(&[dir.path().to_owned()], None).unwrap();
    assert_eq!(folder.images().len(), 2);
    let [skipped] = folder.skipped() else { panic!("{:?}", folder.skipped()) };
    let expected = "is a HEIC photo, as is 3.heif, and these are not read: \
    convert them to JPEG, as with \
                    `heif-convert 2.HEIC 2.jpg`";
    assert_eq!((skipped.name.as_str(), skipped.others), ("2.HEIC", 1));
    assert!(skipped.reason.ends_with(expected), "{}", skipped.reason);
    // Nothing else there: the error says so, too.
    for name in ["1.jpg", "4.jpg"] {
        fs::remove_file(dir.path().join(name)).unwrap();
    }
    let error = ImageFolder::open(&[dir.path().to_owned()], None).unwrap_err().to_string();
    assert!(error.contains("is a HEIC photo, as are 3.heif and 4.heic"), "{error}");
    assert!(error.contains("3 skipped"), "{error}");
}
