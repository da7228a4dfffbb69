//! Folders of images: names, cameras, pixels and EXIF data, and errors of damaged files.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use exif::{In, Rational, Tag, Value};
use image::{DynamicImage, GrayImage, ImageFormat, Luma as Grey, Rgb as Pixel, RgbImage};
use tiepoint_input::{ImageFolder, Luma, Rgb};
use tiepoint_io::features::{self, Features, GrayView};
use tiepoint_io::store::MANIFEST;
use tiepoint_io::timestamps;

/// JPEG at quality 95 of a smooth image: a few grey levels.
const JPEG_TOLERANCE: i32 = 6;

/// An image of 24 × 16 pixels, brighter to the right, redder downwards.
fn gradient() -> RgbImage {
    RgbImage::from_fn(24, 16, |x, y| Pixel([(10 * x) as u8, (10 * x) as u8, (15 * y) as u8]))
}

pub(crate) fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Vec::new();
    match format {
        ImageFormat::Jpeg => {
            image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(image)
        }
        _ => image.write_to(&mut Cursor::new(&mut bytes), format),
    }
    .unwrap();
    bytes
}

/// Inserts an EXIF segment after the first two bytes of a JPEG file.
fn with_exif(jpeg: &[u8], fields: &[(Tag, Value)]) -> Vec<u8> {
    let fields: Vec<exif::Field> = fields
        .iter()
        .map(|(tag, value)| exif::Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() })
        .collect();
    let mut writer = exif::experimental::Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut tiff = Cursor::new(b"Exif\0\0".to_vec());
    let mut body = Cursor::new(Vec::new());
    writer.write(&mut body, true).unwrap();
    tiff.get_mut().extend(body.into_inner());
    let segment = tiff.into_inner();
    let length = (segment.len() as u16 + 2).to_be_bytes();
    [&jpeg[..2], &[0xFF, 0xE1], &length, &segment, &jpeg[2..]].concat()
}

pub(crate) fn folder(files: &[(&str, Vec<u8>)]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    dir
}

pub(crate) fn open(dir: &Path) -> Result<ImageFolder, tiepoint_io::Error> {
    ImageFolder::open(&[dir.to_owned()], None)
}

fn names(source: &ImageFolder) -> Vec<(&str, u32)> {
    source.images().iter().map(|image| (image.name.as_str(), image.camera.0)).collect()
}

#[test]
fn cameras_are_folders_and_names_are_in_byte_order() {
    let png = || encoded(&gradient().into(), ImageFormat::Png);
    let one = folder(&[
        ("b.PNG", png()),
        ("B.jpeg", png()),
        ("10.png", png()),
        ("9.png", png()),
        ("notes.txt", vec![]),
    ]);
    let source = open(one.path()).unwrap();
    assert_eq!(names(&source), [("10.png", 0), ("9.png", 0), ("B.jpeg", 0), ("b.PNG", 0)]);
    assert_eq!(source.camera_names().len(), 1);

    let files =
        ["right/1.png", "left/data/2.png", "left/data/1.png", "left/.hidden/1.png", ".git/1.png"];
    let rig = folder(&files.map(|name| (name, png())));
    let source = open(rig.path()).unwrap();
    assert_eq!(
        names(&source),
        [("left/data/1.png", 0), ("left/data/2.png", 0), ("right/1.png", 1)]
    );
    assert_eq!(source.camera_names(), ["left", "right"]);

    // Each folder as an input of its own: the same names.
    let source = ImageFolder::open(&[rig.path().join("right"), rig.path().join("left")], None);
    assert!(source.is_ok_and(|source| names(&source).last() == Some(&("right/1.png", 1))));

    let mixed = folder(&[("1.png", png()), ("left/1.png", png())]);
    let error = open(mixed.path()).unwrap_err().to_string();
    assert!(error.contains("holds both images and a folder of images, `left`"), "{error}");
    let empty = folder(&[("notes.txt", vec![])]);
    assert!(open(empty.path()).unwrap_err().to_string().contains("holds no images"));
    assert!(open(&empty.path().join("absent")).unwrap_err().to_string().contains("absent"));
    assert!(open(&empty.path().join("notes.txt")).is_err());
}

fn manifest(names: &[&str]) -> Vec<u8> {
    let files: Vec<String> = names.iter().map(|name| format!("\"{name}\":[\"0123\"]")).collect();
    format!("{{\"program\":\"tiepoint\",\"files\":{{{}}}}}", files.join(",")).into_bytes()
}

#[test]
fn images_of_this_program_are_ignored() {
    let names = |dir: &Path| -> Vec<String> {
        open(dir).unwrap().images().iter().map(|image| image.name.clone()).collect()
    };
    let with = |own: Vec<u8>, of_ws: Vec<u8>, of_deep: Vec<u8>| {
        folder(&[
            (MANIFEST, own),
            ("cam/1.png", vec![]),
            ("cam/2.png", vec![]),
            (&format!("ws/{MANIFEST}"), of_ws),
            ("ws/frames/a/1.jpg", vec![]),
            ("ws/theirs.jpg", vec![]),
            (&format!("ws/export/{MANIFEST}"), of_deep),
            ("ws/export/images/1.png", vec![]),
        ])
    };
    let cam = ["cam/1.png", "cam/2.png"];
    let (export, theirs) = ("ws/export/images/1.png", "ws/theirs.jpg");
    let of_ws = || manifest(&["frames/a/1.jpg", "report.json"]);

    let dir = with(vec![], of_ws(), manifest(&["images/1.png"]));
    assert_eq!(names(dir.path()), [cam[0], cam[1], theirs]);
    // Also from the folder above.
    let dir = with(vec![], manifest(&["frames/a/1.jpg", "export/images/1.png"]), vec![]);
    assert_eq!(names(dir.path()), [cam[0], cam[1], theirs]);
    for foreign in [
        b"no JSON".to_vec(),
        b"[]".to_vec(),
        br#"{"program":"other","files":{"images/1.png":[]}}"#.to_vec(),
        br#"{"program":"tiepoint","files":["images/1.png"]}"#.to_vec(),
    ] {
        let dir = with(foreign.clone(), of_ws(), foreign);
        assert_eq!(names(dir.path()), [cam[0], cam[1], export, theirs]);
    }

    // The manifest of the input itself applies unless it names all images.
    let dir = with(manifest(&["cam/1.png"]), of_ws(), vec![]);
    assert_eq!(names(dir.path()), [cam[1], export, theirs]);
    let error = open(&dir.path().join("ws")).unwrap_err().to_string();
    assert!(error.contains("holds both images and a folder of images, `export`"), "{error}");
    fs::remove_file(dir.path().join("ws").join(theirs.trim_start_matches("ws/"))).unwrap();
    assert_eq!(names(&dir.path().join("ws")), ["export/images/1.png"]);
}

#[test]
fn input_with_only_images_of_this_program_is_used() {
    let dir = folder(&[
        (MANIFEST, manifest(&["a/1.png", "a/2.png"])),
        ("a/1.png", vec![]),
        ("a/2.png", vec![]),
    ]);
    assert_eq!(names(&open(dir.path()).unwrap()), [("a/1.png", 0), ("a/2.png", 0)]);
    // From the folder above, they are ignored.
    let above = folder(&[
        ("cam/1.png", vec![]),
        (&format!("ws/{MANIFEST}"), manifest(&["a/1.png"])),
        ("ws/a/1.png", vec![]),
    ]);
    assert_eq!(names(&open(above.path()).unwrap()), [("cam/1.png", 0)]);
}

#[test]
#[cfg(unix)]
fn skipped_files_have_names_and_reasons() {
    let dir = folder(&[
        ("l/1.png", vec![]),
        ("l/a\u{7f}.png", vec![]),
        (" r/1.png", vec![]),
        ("m /1.png", vec![]),
    ]);
    let source = open(dir.path()).unwrap();
    assert_eq!(names(&source), [("l/1.png", 0), ("m /1.png", 1)]);
    let skipped: Vec<&str> = source.skipped().iter().map(|file| file.name.as_str()).collect();
    assert_eq!(skipped, [" r", "l/a\\u{7f}.png"]);
    let reason = &source.skipped()[0].reason;
    assert!(
        reason.contains("/ r: its name begins with white space, with 1 image below it: rename"),
        "{reason}"
    );
    // After the prefix of an input, a leading space is in the middle of the name.
    let inputs = [dir.path().join(" r"), dir.path().join("l")];
    let error = ImageFolder::open(&inputs, None).unwrap_err().to_string();
    assert!(error.contains("/ r: its name begins with white space"), "{error}");
    fs::create_dir(dir.path().join("s")).unwrap();
    fs::write(dir.path().join("s/ 1.png"), "").unwrap();
    let source = ImageFolder::open(&[dir.path().join("s"), dir.path().join("m ")], None).unwrap();
    assert_eq!(names(&source), [("m /1.png", 0), ("s/ 1.png", 1)]);
}

#[test]
fn formats_agree_on_pixels() {
    let colours = DynamicImage::from(gradient());
    let expected = |x: u32, y: u32| {
        let [r, g, b] = gradient().get_pixel(x, y).0.map(f64::from);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let with_alpha = DynamicImage::from(colours.to_rgba8());
    let grey16 = DynamicImage::from(colours.to_luma16());
    let rgb16 = DynamicImage::from(colours.to_rgb16());
    let grey = DynamicImage::from(colours.to_luma8());
    let grey_with_alpha = DynamicImage::from(colours.to_luma_alpha8());
    for (name, image, format) in [
        ("rgb.png", &colours, ImageFormat::Png),
        ("alpha.png", &with_alpha, ImageFormat::Png),
        ("rgb16.png", &rgb16, ImageFormat::Png),
        ("rgb.tif", &colours, ImageFormat::Tiff),
        ("rgb16.tiff", &rgb16, ImageFormat::Tiff),
        ("rgb.jpg", &colours, ImageFormat::Jpeg),
        ("rgb.JFIF", &colours, ImageFormat::Jpeg),
        ("rgb.webp", &colours, ImageFormat::WebP),
        ("rgb.BMP", &colours, ImageFormat::Bmp),
        ("rgb.ppm", &colours, ImageFormat::Pnm),
        // The content decides the format, not the extension.
        ("png_named.jpg", &colours, ImageFormat::Png),
    ] {
        let dir = folder(&[(name, encoded(image, format))]);
        let source = open(dir.path()).unwrap();
        let (luma, rgb, info) =
            (source.luma(0).unwrap(), source.rgb(0).unwrap(), source.info(0).unwrap());
        assert_eq!((luma.width, luma.height, rgb.width, rgb.height), (24, 16, 24, 16), "{name}");
        assert_eq!((info.width, info.height), (24, 16), "{name}");
        let tolerance = if format == ImageFormat::Jpeg { JPEG_TOLERANCE } else { 0 };
        for (x, y) in [(0, 0), (23, 0), (5, 9), (23, 15)] {
            let found = f64::from(luma.data[(24 * y + x) as usize]);
            assert!(
                (found - expected(x, y)).abs() <= f64::from(tolerance) + 0.5,
                "{name} {x} {y}: {found}"
            );
            for (found, expected) in rgb.pixel(x, y).into_iter().zip(gradient().get_pixel(x, y).0) {
                // The blue channel of JPEG with subsampled chroma has a larger error.
                assert!(
                    (i32::from(found) - i32::from(expected)).abs() <= 3 * tolerance,
                    "{name} {x} {y}"
                );
            }
        }
    }
    for (name, image, format) in [
        ("grey16.png", &grey16, ImageFormat::Png),
        ("grey.png", &grey, ImageFormat::Png),
        ("grey_alpha.png", &grey_with_alpha, ImageFormat::Png),
        ("grey.jpg", &grey, ImageFormat::Jpeg),
        ("grey.pgm", &grey, ImageFormat::Pnm),
        ("grey16.pgm", &grey16, ImageFormat::Pnm),
    ] {
        let dir = folder(&[(name, encoded(image, format))]);
        let luma = open(dir.path()).unwrap().luma(0).unwrap();
        for (found, expected) in luma.data.iter().zip(grey.as_bytes()) {
            assert!((i32::from(*found) - i32::from(*expected)).abs() <= JPEG_TOLERANCE, "{name}");
        }
        assert_eq!(open(dir.path()).unwrap().rgb(0).unwrap().data.len(), 3 * 24 * 16);
    }
}

#[test]
fn every_format_that_is_read_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let rgb = Rgb { width: 24, height: 16, data: gradient().into_raw() };
    for name in ["a.jpg", "a.jpe", "a.jfif", "a.png", "a.tif", "a.webp", "a.bmp", "a.ppm", "a.pgm"]
    {
        rgb.write(&dir.path().join(name)).unwrap();
        let found = Rgb::read(&dir.path().join(name)).unwrap();
        assert_eq!((found.width, found.height), (24, 16), "{name}");
    }
}

#[test]
fn photos_that_are_not_read_are_named_with_what_to_do() {
    let png = encoded(&gradient().into(), ImageFormat::Png);
    let mut files: Vec<(String, Vec<u8>)> = vec![("0.png".to_owned(), png)];
    // With a converted photo beside it: a pair of a camera.
    files.push(("0.CR2".to_owned(), Vec::new()));
    for ending in ["avif", "JP2", "jxl", "DNG", "gif", "heic", "MOV"] {
        files.push((format!("1.{ending}"), Vec::new()));
    }
    files.extend((1..=12).map(|index| (format!("{index:02}.nef"), Vec::new())));
    let files: Vec<(&str, Vec<u8>)> =
        files.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())).collect();
    let dir = folder(&files);
    let source = open(dir.path()).unwrap();
    assert_eq!(names(&source), [("0.png", 0)]);
    let reason: Vec<&str> = source.skipped().iter().map(|file| file.reason.as_str()).collect();
    for expected in [
        "1.avif: is an AVIF photo, and these are not read: convert them, as with `avifdec 1.avif \
         1.png`",
        "1.JP2: is a JPEG 2000 photo, and these are not read: convert them, as with \
         `opj_decompress -i 1.JP2 -o 1.png`",
        "`djxl 1.jxl 1.png`",
        "01.nef: is a camera's raw file, as are 02.nef, 03.nef, 04.nef, 05.nef, 06.nef, 07.nef, \
         08.nef, 09.nef and 4 others beside it, and these are not read: develop them",
        "`magick 1.gif 1.png`",
        "`heif-convert 1.heic 1.jpg`",
        "1.MOV: is a video beside photos",
    ] {
        assert!(reason.iter().any(|reason| reason.contains(expected)), "{expected}: {reason:#?}");
    }
    assert_eq!(reason.len(), 7, "{reason:#?}");
}

#[test]
fn jpeg_files_of_other_programs_are_decoded() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    // Written by Pillow, in CMYK as Adobe does it.
    let red = Rgb::read(&data.join("red_cmyk.jpg")).unwrap().pixel(3, 3);
    assert!(red[0] > 240 && red[1] < 15 && red[2] < 15, "{red:?}");
    let luma = Luma::read(&data.join("red_cmyk.jpg")).unwrap().data[50];
    assert!((48..=60).contains(&luma), "{luma}");
    // Progressive, chroma at half resolution, odd sides; pixel (x, y) is (7x, 15y, 128).
    let luma = Luma::read(&data.join("gradient_progressive.jpg")).unwrap();
    assert_eq!((luma.width, luma.height), (33, 17));
    let expected = 0.2126 * 70.0 + 0.7152 * 120.0 + 0.0722 * 128.0;
    assert!((f64::from(luma.data[33 * 8 + 10]) - expected).abs() < f64::from(JPEG_TOLERANCE));
}

/// The grey image and the features of a file.
/// Writes a file and reads it as an image.
fn read_bytes(bytes: &[u8]) -> Result<Rgb, tiepoint_io::Error> {
    let dir = folder(&[("a.jpg", bytes.to_vec())]);
    open(dir.path()).unwrap().rgb(0)
}

#[test]
fn a_complete_jpeg_file_needs_no_end_marker() {
    const END: [u8; 2] = [0xFF, 0xD9];
    // Detail everywhere, so that every block has codes.
    let value = |x: u32, y: u32| (x * 97 + y * 61 + x * y * 13) as u8;
    let image = RgbImage::from_fn(40, 24, |x, y| Pixel([value(x, y), value(y, x), 90]));
    let colour = encoded(&image.clone().into(), ImageFormat::Jpeg);
    let grey = encoded(&DynamicImage::from(image).to_luma8().into(), ImageFormat::Jpeg);
    let progressive = include_bytes!("../data/gradient_progressive.jpg").to_vec();
    for (kind, bytes) in [("colour", colour), ("grey", grey), ("progressive", progressive)] {
        assert_eq!(bytes[bytes.len() - 2..], END, "{kind}");
        let whole = read_bytes(&bytes).unwrap();
        let without = &bytes[..bytes.len() - 2];
        let half_a_marker = [without, &[0xFF]].concat();
        let unwritten = |fill: u8| [without, &[fill; 700]].concat();
        for complete in [without, &half_a_marker, &unwritten(0x00), &unwritten(0xFF)] {
            assert_eq!(read_bytes(complete).unwrap(), whole, "{kind}");
        }
        // Cut anywhere in the scans, by a few bytes and by many, also with the rest unwritten.
        let begin = bytes.windows(2).position(|two| two == [0xFF, 0xDA]).unwrap() + 20;
        let cuts = (begin..without.len() - 4).step_by(7).chain([without.len() - 4]);
        for cut in cuts {
            for rest in [vec![], vec![0; 900]] {
                let truncated = [&bytes[..cut], &rest].concat();
                let found = read_bytes(&truncated).map(|image| image.width);
                let error = found.unwrap_err().to_string();
                assert!(error.contains("the JPEG data is truncated"), "{kind} {cut}: {error}");
            }
        }
    }
}

fn extracted(bytes: Vec<u8>) -> (Luma, Features) {
    let dir = folder(&[("a", bytes)]);
    let luma = Luma::read(&dir.path().join("a")).unwrap();
    let view = GrayView::new(&luma.data, luma.width as usize, luma.height as usize);
    let features = features::extract(&view, &features::Options::default()).unwrap();
    (luma, features)
}

#[test]
fn images_of_any_shape_go_from_file_to_features() {
    /// The longest side of a JPEG image.
    const JPEG_SIDE: u32 = 65_535;
    for (width, height) in
        [(1, 1), (2, 1), (1, 2), (2, 2), (1, 100_000), (100_000, 1), (1, JPEG_SIDE), (160, 120)]
    {
        let constant = DynamicImage::from(GrayImage::from_pixel(width, height, Grey([77])));
        for format in [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Jpeg] {
            if format == ImageFormat::Jpeg && width.max(height) > JPEG_SIDE {
                continue;
            }
            let (luma, features) = extracted(encoded(&constant, format));
            assert_eq!((luma.width, luma.height), (width, height), "{format:?}");
            assert!(
                luma.data.iter().all(|&grey| grey == 77) && features.keypoints.is_empty(),
                "{width} x {height}"
            );
        }
    }
    // Not constant, and too narrow for any keypoint.
    let stripes = GrayImage::from_fn(1, 100_000, |_, y| Grey([if y % 40 < 20 { 20 } else { 220 }]));
    assert!(extracted(encoded(&stripes.into(), ImageFormat::Png)).1.keypoints.is_empty());
}

#[test]
fn images_of_any_kind_go_from_file_to_features() {
    let spots = GrayImage::from_fn(160, 120, |x, y| {
        let (dx, dy) = (f64::from(x % 40) - 20.0, f64::from(y % 40) - 20.0);
        Grey([(40.0 + 160.0 * (-(dx * dx + dy * dy) / 30.0).exp()) as u8])
    });
    let grey = DynamicImage::from(spots);
    let (luma, expected) = extracted(encoded(&grey, ImageFormat::Png));
    assert!(
        luma.data == grey.as_bytes() && expected.keypoints.len() >= 12,
        "{}",
        expected.keypoints.len()
    );
    let kinds = [
        DynamicImage::from(grey.to_luma16()),
        DynamicImage::from(grey.to_luma_alpha8()),
        DynamicImage::from(grey.to_luma_alpha16()),
        DynamicImage::from(grey.to_rgb8()),
        DynamicImage::from(grey.to_rgb16()),
        DynamicImage::from(grey.to_rgba8()),
        DynamicImage::from(grey.to_rgba16()),
    ];
    for image in kinds {
        assert!(extracted(encoded(&image, ImageFormat::Png)).1 == expected, "{:?}", image.color());
    }
    // Nothing is seen through a pixel that is not there.
    let mut hidden = grey.to_rgba8();
    hidden.pixels_mut().for_each(|pixel| pixel.0[3] = 0);
    assert!(extracted(encoded(&hidden.into(), ImageFormat::Png)).1 == expected);
    for name in ["red_cmyk.jpg", "gradient_progressive.jpg"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
        let (luma, features) = extracted(fs::read(path).unwrap());
        assert!(
            luma.width >= 8 && features.keypoints.len() == features.descriptors.len(),
            "{name}"
        );
    }
}

#[test]
fn orientation_turns_pixels_and_sizes() {
    let jpeg = encoded(&gradient().into(), ImageFormat::Jpeg);
    let stored = gradient();
    // The position of the stored pixel (x, y) in the upright image, from the definition of each
    // value: the sides of row 0 and column 0.
    type Seen = fn(u32, u32) -> (u32, u32);
    let seen: [Seen; 8] = [
        |x, y| (x, y),
        |x, y| (23 - x, y),
        |x, y| (23 - x, 15 - y),
        |x, y| (x, 15 - y),
        |x, y| (y, x),
        |x, y| (15 - y, x),
        |x, y| (15 - y, 23 - x),
        |x, y| (y, 23 - x),
    ];
    for (orientation, seen) in (1u16..).zip(seen) {
        let turned = with_exif(&jpeg, &[(Tag::Orientation, Value::Short(vec![orientation]))]);
        let dir = folder(&[("a.jpg", turned)]);
        let source = open(dir.path()).unwrap();
        let (info, rgb, luma) =
            (source.info(0).unwrap(), source.rgb(0).unwrap(), source.luma(0).unwrap());
        let size = if orientation < 5 { (24, 16) } else { (16, 24) };
        assert_eq!(
            ((info.width, info.height), (rgb.width, rgb.height), (luma.width, luma.height)),
            (size, size, size)
        );
        for (x, y) in [(0, 0), (23, 0), (0, 15), (12, 3)] {
            let (u, v) = seen(x, y);
            let difference = i32::from(rgb.pixel(u, v)[0]) - i32::from(stored.get_pixel(x, y).0[0]);
            assert!(
                difference.abs() < 3 * JPEG_TOLERANCE,
                "orientation {orientation} at {x} {y}: {difference}"
            );
        }
    }
}

#[test]
fn exif_gives_focal_length_and_time() {
    let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
    let ascii = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
    let jpeg = encoded(&gradient().into(), ImageFormat::Jpeg);
    let fields = [
        (Tag::FocalLength, rational(36, 2)),
        (Tag::FocalPlaneXResolution, rational(1000, 1)),
        (Tag::FocalPlaneResolutionUnit, Value::Short(vec![3])),
        (Tag::PixelXDimension, Value::Long(vec![48])),
        (Tag::PixelYDimension, Value::Long(vec![32])),
        (Tag::DateTimeOriginal, ascii("2024:02:29 12:34:56")),
        (Tag::SubSecTimeOriginal, ascii("25")),
    ];
    let dir = folder(&[
        ("a.jpg", with_exif(&jpeg, &fields)),
        (
            "b.jpg",
            with_exif(&jpeg, &[(Tag::FocalLength, rational(1, 0)), (Tag::Orientation, ascii("x"))]),
        ),
        ("1403636579763555584.jpg", with_exif(&jpeg, &fields)),
        ("c.jpg", jpeg.clone()),
    ]);
    let source = open(dir.path()).unwrap();
    let info = |name: &str| {
        source.info(source.images().iter().position(|image| image.name == name).unwrap()).unwrap()
    };
    // 18 mm · 100 px/mm for 48 pixels, of which 24 remain.
    assert_eq!(info("a.jpg").exif.focal_px(24, 16, None), Some(900.0));
    assert_eq!(info("a.jpg").time_s, Some(1_709_210_096.25));
    assert_eq!(info("1403636579763555584.jpg").time_s, Some(1_403_636_579.763_555_6));
    for name in ["b.jpg", "c.jpg"] {
        assert_eq!(info(name).exif, tiepoint_input::Exif::default());
        assert_eq!(info(name).time_s, None);
    }
}

#[test]
fn the_time_is_that_of_the_best_field_with_a_date() {
    const AT_S: f64 = 1_709_210_096.0;
    let ascii = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
    let at = |second: u32| ascii(&format!("2024:02:29 12:34:{second}"));
    let blank = || ascii("    :  :     :  :  ");
    use Tag as T;
    let cases: [(&[(Tag, Value)], f64); 8] = [
        (&[(T::DateTimeOriginal, at(56)), (T::DateTimeDigitized, at(57))], 0.0),
        (&[(T::DateTimeDigitized, at(57)), (T::DateTime, at(58))], 1.0),
        (&[(T::DateTimeOriginal, blank()), (T::DateTime, at(58))], 2.0),
        // The fraction of another field is not taken.
        (&[(T::DateTime, at(58)), (T::SubSecTimeOriginal, ascii("5"))], 2.0),
        (&[(T::DateTime, at(58)), (T::SubSecTime, ascii("5 "))], 2.5),
        (&[(T::DateTimeOriginal, at(56)), (T::SubSecTimeOriginal, ascii("1e5"))], 0.1),
        (&[(T::DateTimeOriginal, at(56)), (T::SubSecTimeOriginal, ascii("-25"))], 0.0),
        (&[(T::DateTimeOriginal, Value::Undefined(b"2024:02:29 12:34:56.5\0".to_vec(), 0))], 0.5),
    ];
    let jpeg = encoded(&gradient().into(), ImageFormat::Jpeg);
    for (fields, after_s) in cases {
        let dir = folder(&[("a.jpg", with_exif(&jpeg, fields))]);
        let time_s = open(dir.path()).unwrap().info(0).unwrap().time_s;
        assert_eq!(time_s, Some(AT_S + after_s), "{fields:?}");
    }
}

#[test]
fn errors_name_damaged_images() {
    let jpeg = encoded(&gradient().into(), ImageFormat::Jpeg);
    let png = encoded(&gradient().into(), ImageFormat::Png);
    let tiff = encoded(&gradient().into(), ImageFormat::Tiff);
    let huge = [
        b"II*\0\x08\0\0\0".as_slice(),
        &[3, 0],
        &[0, 1, 4, 0, 1, 0, 0, 0, 255, 255, 255, 127],
        &[1, 1, 4, 0, 1, 0, 0, 0, 255, 255, 255, 127],
    ]
    .concat();
    for (name, bytes, expected) in [
        ("empty.jpg", vec![], "is empty"),
        ("text.jpg", b"this is no image".to_vec(), "is no JPEG, PNG, TIFF, WebP, BMP or PNM image"),
        ("cut.jpg", jpeg[..jpeg.len() - 20].to_vec(), "truncated"),
        ("half.jpg", jpeg[..jpeg.len() / 2].to_vec(), "truncated"),
        ("cut.png", png[..png.len() / 2].to_vec(), "cut.png"),
        ("cut.tif", tiff[..tiff.len() / 2].to_vec(), "cut.tif"),
        ("huge.tif", huge, "huge.tif"),
    ] {
        let dir = folder(&[(name, bytes)]);
        let source = open(dir.path()).unwrap();
        for error in [source.luma(0).map(drop), source.rgb(0).map(drop)] {
            let error = error.expect_err(name).to_string();
            assert!(error.contains(expected) && error.contains(name), "{error}");
        }
        assert!(source.info(0).is_ok() || source.info(0).unwrap_err().to_string().contains(name));
    }
}

#[test]
fn masks_are_found_by_name_and_have_the_size_of_the_image() {
    let png = encoded(&gradient().into(), ImageFormat::Png);
    let images =
        folder(&["l/1.png", "l/2.jpg", "l/3.jpg", "l/4.png"].map(|name| (name, png.clone())));
    let small = encoded(&DynamicImage::new_luma8(2, 2), ImageFormat::Png);
    let masks =
        folder(&[("l/1.png.png", png.clone()), ("l/2.png", png.clone()), ("l/4.png", small)]);
    let source = ImageFolder::open(&[images.path().to_owned()], Some(masks.path())).unwrap();
    assert!(source.mask(0).unwrap().is_some() && source.mask(1).unwrap().is_some());
    assert_eq!(source.mask(2).unwrap(), None);
    let error = source.mask(3).unwrap_err().to_string();
    assert!(error.contains("the mask has 2 × 2 pixels, its image l/4.png has 24 × 16"), "{error}");
    // As rembg, Metashape and trainers of splats name them.
    let masks = folder(&[("l/1.mask.png", png.clone()), ("l/2_mask.png", png.clone())]);
    let source = ImageFolder::open(&[images.path().to_owned()], Some(masks.path())).unwrap();
    assert!(source.mask(0).unwrap().is_some() && source.mask(1).unwrap().is_some());
    assert_eq!(source.mask(2).unwrap(), None);
    let none = tempfile::tempdir().unwrap();
    let error =
        ImageFolder::open(&[images.path().to_owned()], Some(none.path())).unwrap_err().to_string();
    assert!(error.contains("holds no mask: for l/1.png, `l/1.png.png` was looked for"), "{error}");
}

/// Whether exactly the left half of an image of 24 × 16 pixels is masked.
fn left_half(mask: &Luma) -> bool {
    let is_seen = |index: usize| index % 24 >= 12;
    mask.data.iter().enumerate().all(|(index, value)| (*value > 0) == is_seen(index))
}

#[test]
fn masks_of_any_kind_mask_the_same() {
    let is_seen = |x: u32| x >= 12;
    let of = |seen: [u8; 4], hidden: [u8; 4]| {
        image::RgbaImage::from_fn(24, 16, |x, _| {
            image::Rgba(if is_seen(x) { seen } else { hidden })
        })
    };
    let grey = |seen: u8| {
        DynamicImage::from(GrayImage::from_fn(24, 16, |x, _| Grey([seen * u8::from(is_seen(x))])))
    };
    let deep = |seen: u16| {
        DynamicImage::from(image::ImageBuffer::<Grey<u16>, _>::from_fn(24, 16, |x, _| {
            Grey([seen * u16::from(is_seen(x))])
        }))
    };
    let white = [255; 4];
    let photo = encoded(&gradient().into(), ImageFormat::Png);
    for (kind, mask) in [
        ("8 bits", grey(255)),
        ("0 and 1", grey(1)),
        ("16 bits", deep(u16::MAX)),
        ("0 and 1 of 16 bits", deep(1)),
        ("colours", DynamicImage::from(of([0, 0, 1, 255], [0, 0, 0, 255])).to_rgb8().into()),
        ("colours and alpha", of(white, [0, 0, 0, 255]).into()),
        ("cut-out of white", of(white, [255, 255, 255, 0]).into()),
        ("cut-out of a photo", of([90, 80, 70, 255], [10, 20, 30, 0]).into()),
        ("cut-out of black", of([0, 0, 0, 255], [0; 4]).into()),
        ("soft cut-out", of([0, 0, 0, 200], [0, 0, 0, 40]).into()),
        (
            "cut-out of 16 bits",
            DynamicImage::from(of(white, [255, 255, 255, 0])).to_rgba16().into(),
        ),
    ] {
        let images = folder(&[("1.png", photo.clone())]);
        let masks = folder(&[("1.png", encoded(&mask, ImageFormat::Png))]);
        let source = ImageFolder::open(&[images.path().to_owned()], Some(masks.path())).unwrap();
        assert!(left_half(&source.mask(0).unwrap().unwrap()), "{kind}");
        // A photo that is cut out itself, under a mask of nothing.
        if mask.color().has_alpha() && kind != "colours and alpha" {
            let images = folder(&[("1.png", encoded(&mask, ImageFormat::Png))]);
            let alone = open(images.path()).unwrap();
            assert!(left_half(&alone.mask(0).unwrap().unwrap()), "{kind}");
            let all = folder(&[(
                "1.png",
                encoded(
                    &DynamicImage::from(GrayImage::from_pixel(24, 16, Grey([255]))),
                    ImageFormat::Png,
                ),
            )]);
            let both = ImageFolder::open(&[images.path().to_owned()], Some(all.path())).unwrap();
            assert!(left_half(&both.mask(0).unwrap().unwrap()), "{kind}");
        }
    }
    // An opaque photo has no mask.
    let opaque = DynamicImage::from(gradient()).to_rgba8();
    let images = folder(&[("1.png", encoded(&opaque.into(), ImageFormat::Png))]);
    assert_eq!(open(images.path()).unwrap().mask(0).unwrap(), None);
}

#[test]
fn masks_for_some_photos_are_noted() {
    let png = encoded(&gradient().into(), ImageFormat::Png);
    let photos: Vec<String> = (10..24).map(|index| format!("{index}.png")).collect();
    let files: Vec<(&str, Vec<u8>)> =
        photos.iter().map(|name| (name.as_str(), png.clone())).collect();
    let images = folder(&files);
    let of = |count: usize| -> Vec<String> {
        let masks = folder(&files[..count]);
        let source = ImageFolder::open(&[images.path().to_owned()], Some(masks.path())).unwrap();
        source.notes().to_vec()
    };
    assert_eq!(of(14), Vec::<String>::new());
    assert_eq!(of(12), ["2 of 14 photos have no mask and are used whole: 22.png, 23.png"]);
    let many = &of(2)[0];
    assert!(many.starts_with("12 of 14 photos") && many.ends_with("19.png and 4 more"), "{many}");
}

#[test]
fn masks_stored_like_turned_photos_are_turned_like_them() {
    let jpeg = encoded(&gradient().into(), ImageFormat::Jpeg);
    let photo =
        |orientation: u16| with_exif(&jpeg, &[(Tag::Orientation, Value::Short(vec![orientation]))]);
    // Only the corner of the first stored pixels is seen.
    let corner = DynamicImage::from(GrayImage::from_fn(24, 16, |x, y| {
        Grey([if x < 4 && y < 4 { 255 } else { 0 }])
    }));
    let stored = encoded(&corner, ImageFormat::Png);
    let turned = |orientation: u8| {
        let mut image = corner.clone();
        image.apply_orientation(image::metadata::Orientation::from_exif(orientation).unwrap());
        encoded(&image, ImageFormat::Png)
    };
    // Whether the corner is where the photo shows its first stored pixels.
    let fits = |source: &ImageFolder, index: usize, orientation: u8| {
        let expected = image::load_from_memory(&turned(orientation)).unwrap().to_luma8();
        source.mask(index).unwrap().unwrap().data == expected.into_raw()
    };
    let source_of = |orientations: &[u16], masks: &[Vec<u8>]| {
        let names: Vec<String> = orientations.iter().map(|o| format!("{o}.jpg")).collect();
        let files: Vec<(&str, Vec<u8>)> =
            names.iter().map(String::as_str).zip(orientations.iter().map(|&o| photo(o))).collect();
        let of_masks: Vec<(&str, Vec<u8>)> =
            names.iter().map(String::as_str).zip(masks.iter().cloned()).collect();
        let (images, masks) = (folder(&files), folder(&of_masks));
        let source = ImageFolder::open(&[images.path().to_owned()], Some(masks.path())).unwrap();
        (source, images, masks)
    };
    // Stored like the photos: sizes tell it for 6 and 8, and then it holds for 3.
    let (source, _images, _masks) =
        source_of(&[1, 3, 6, 8], &[stored.clone(), stored.clone(), stored.clone(), stored.clone()]);
    for (index, orientation) in [(0, 1), (1, 3), (2, 6), (3, 8)] {
        source.check_mask(index).unwrap();
        assert!(fits(&source, index, orientation), "{orientation}");
    }
    assert!(source.notes()[0].starts_with("2 masks are stored like"), "{:?}", source.notes());
    // Upright.
    let (source, _images, _masks) = source_of(&[3, 6], &[turned(3), turned(6)]);
    assert!(fits(&source, 0, 3) && fits(&source, 1, 6) && source.notes().is_empty());
    // Nothing tells.
    let (source, _images, _masks) = source_of(&[1, 3], &[stored.clone(), turned(3)]);
    assert!(fits(&source, 1, 3));
    assert!(source.notes()[0].contains("taken as upright: 3.jpg"), "{:?}", source.notes());
}

#[test]
fn values_of_few_bits_in_files_of_16_are_scaled_alike_for_a_camera() {
    type Deep = image::ImageBuffer<Grey<u16>, Vec<u16>>;
    // Values up to 1020 of 1023, and darker ones.
    let deep = |factor: u16| Deep::from_fn(24, 16, |x, y| Grey([factor * (4 * x + y) as u16]));
    let png = |factor: u16| encoded(&deep(factor).into(), ImageFormat::Png);
    let tiff = |factor: u16| encoded(&deep(factor).into(), ImageFormat::Tiff);
    let dir = folder(&[
        ("ten/1.png", png(1)),
        ("ten/2.png", png(9)),
        ("ten/3.tif", tiff(3)),
        ("all/1.png", png(600)),
        ("all/2.png", png(9)),
        ("eight/1.png", encoded(&gradient().into(), ImageFormat::Png)),
    ]);
    let source = open(dir.path()).unwrap();
    let brightest = |name: &str| {
        let index = source.images().iter().position(|image| image.name == name).unwrap();
        let (luma, rgb) = (source.luma(index).unwrap(), source.rgb(index).unwrap());
        assert_eq!(luma.data.iter().max(), rgb.data.iter().max(), "{name}");
        *luma.data.iter().max().unwrap()
    };
    let most = 4.0 * 23.0 + 15.0;
    let expected = |factor: f64, range: f64| (255.0 * factor * most / range).round() as u8;
    assert_eq!(brightest("ten/1.png"), expected(1.0, 1023.0));
    assert_eq!(brightest("ten/2.png"), expected(9.0, 1023.0));
    assert_eq!(brightest("ten/3.tif"), expected(3.0, 1023.0));
    assert_eq!(brightest("all/1.png"), expected(600.0, 65_535.0));
    assert_eq!(brightest("all/2.png"), expected(9.0, 65_535.0));
    assert_eq!(
        source.notes_on_bits(),
        ["ten: its files of 16 bits a channel use 10, and are scaled from these to 8"]
    );
}

#[test]
fn timestamps_are_read_as_written() {
    let dir = tempfile::tempdir().unwrap();
    let path: PathBuf = dir.path().join("timestamps.csv");
    let times = [
        ("left/a, b  c.png", 5.0),
        ("left/a,b.png", 1_403_636_579.763_555_5),
        ("right/1.png", -1e-9),
        ("x", 0.1 + 0.2),
    ];
    timestamps::write(&path, times).unwrap();
    let read = timestamps::read(&path).unwrap();
    assert_eq!(
        read.iter().map(|(name, seconds)| (name.as_str(), *seconds)).collect::<Vec<_>>(),
        times
    );
    for (content, expected) in [
        ("", "line 1: must be `image,seconds`"),
        ("name,t\n", "line 1: must be `image,seconds`"),
        ("image,seconds\na\n", "line 2: `a` has no comma"),
        ("image,seconds\n\na,x\n", "line 3: the time of a is not a number of seconds"),
        ("image,seconds\na,NaN\n", "line 2: the time of a is not"),
        ("image,seconds\na,1\na,2\n", "line 3: the image a is listed twice"),
        ("image,seconds\na,1\nb,1712345678901\n", "line 3: the time of b is 1712345678901 s"),
        ("image,seconds\na,1712345678901\n", "seconds are expected, not milliseconds"),
        ("image,seconds\na,-1.7e15\n", "seconds are expected, not microseconds"),
        ("image,seconds\na,1712345678901234567\n", "seconds are expected, not nanoseconds"),
        ("image,seconds\na,1e300\n", "the time of a is 1e300 s"),
    ] {
        fs::write(&path, content).unwrap();
        let error = timestamps::read(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}
