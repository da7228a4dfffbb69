//! Malicious input that would exhaust memory or time, or control the terminal.

use std::fs;
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use tiepoint_pipeline::io::colmap::{Format, read_model, write_model};

use crate::{photos, tiepoint, tiepoint_in};

fn jpeg(index: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 98).encode_image(&photos::photo(index, 0)).unwrap();
    bytes
}

/// The same JPEG file with EXIF data of one field: the focal length in millimetres on 35 mm film.
fn with_focal_length(jpeg: &[u8], film_mm: u16) -> Vec<u8> {
    let [high, low] = film_mm.to_be_bytes();
    let tiff = [
        b"MM\0*\0\0\0\x08".as_slice(),
        // One field, a long: where the EXIF fields lie. None follows.
        &[0, 1, 0x87, 0x69, 0, 4, 0, 0, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0],
        // One field, a short.
        &[0, 1, 0xA4, 0x05, 0, 3, 0, 0, 0, 1, high, low, 0, 0, 0, 0, 0, 0],
    ]
    .concat();
    let length = (2 + 6 + tiff.len() as u16).to_be_bytes();
    [&jpeg[..2], &[0xFF, 0xE1], &length, b"Exif\0\0", &tiff, &jpeg[2..]].concat()
}

#[test]
fn a_photo_that_claims_two_hundred_megapixels_is_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    photos::write(&folder, 4, 0);
    let mut bytes = jpeg(0);
    let frame = bytes.windows(2).position(|pair| pair == [0xFF, 0xC0]).unwrap();
    bytes[frame + 5..frame + 9].copy_from_slice(&[0x27, 0x10, 0x4E, 0x20]);
    fs::write(folder.join("0a.jpg"), &bytes).unwrap();
    let run = tiepoint_in(dir.path(), "features {}/photos -o {}/ws").done();
    let said = run.stderr();
    assert!(said.contains("0a.jpg: claims 20000 × 10000 pixels, which take"), "{said}");
    assert!(run.stdout().contains("4 images"), "{}", run.stdout());
}

/// XMP data as attributes and as elements; the property of another program; a photo twice.
#[test]
fn panoramas_and_copies_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    photos::write(&folder, 2, 0);
    let plain = jpeg(2);
    let texts = [
        "<rdf:Description GPano:ProjectionType=\"equirectangular\"/>",
        "<GPano:ProjectionType>cylindrical</GPano:ProjectionType>",
        "<Other:ProjectionType>flat</Other:ProjectionType>",
    ];
    for (name, text) in ["p0.jpg", "p1.jpg", "q.jpg"].iter().zip(texts) {
        let xmp = [b"http://ns.adobe.com/xap/1.0/\0".as_slice(), text.as_bytes()].concat();
        let length = (2 + xmp.len() as u16).to_be_bytes();
        let photo = [&plain[..2], &[0xFF, 0xE1], &length, &xmp, &plain[2..]].concat();
        fs::write(folder.join(name), photo).unwrap();
    }
    fs::write(folder.join("0.jpg"), jpeg(0)).unwrap();
    fs::copy(folder.join("1.png"), folder.join("z.png")).unwrap();
    let run = tiepoint_in(dir.path(), "features {}/photos -o {}/ws").done();
    let said = run.stderr();
    for part in [
        "2 photos say that they are panoramas, which have no lens: p0.jpg, p1.jpg; give \
         --camera-model EQUIRECTANGULAR",
        "1 photo is there twice; the second one adds little: 1.png and z.png",
        "1 photo is there twice by its name; the second one adds little: 0.jpg and 0.png",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let line = "features {}/photos -o {}/w2 --camera-model EQUIRECTANGULAR";
    assert!(!tiepoint_in(dir.path(), line).done().stderr().contains("panoramas"));
}

#[test]
fn the_limit_on_pixels_is_an_option_that_is_remembered() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 4, 0);
    // A TIFF file that claims 17,000 × 17,000 pixels: their data may be anywhere.
    let path = dir.path().join("photos/9.tif");
    image::RgbImage::new(8, 8).save(&path).unwrap();
    let mut tiff = fs::read(&path).unwrap();
    for tag in [0, 1] {
        let entry = [tag, 1, 4, 0, 1, 0, 0, 0];
        let at = tiff.windows(8).position(|window| window == entry).unwrap();
        tiff[at + 8..at + 12].copy_from_slice(&17_000u32.to_le_bytes());
    }
    fs::write(&path, tiff).unwrap();
    let run = tiepoint_in(dir.path(), "features {}/photos -o {}/ws").done();
    let said = run.stderr();
    assert!(
        said.contains("more than 256 million: if it is a photo, give --max-megapixels 289"),
        "{said}"
    );
    photos::write(&dir.path().join("small"), 4, 0);
    tiepoint_in(dir.path(), "features {}/small -o {}/of_small").done();
    tiepoint_in(dir.path(), "features {}/small -o {}/of_small --max-megapixels 289")
        .failed(1, &["--max-megapixels 256 and not 289", "--redo features"]);
    // If no usable photo is left, the message has the reason.
    for index in 0..4 {
        fs::remove_file(dir.path().join(format!("photos/{index}.png"))).unwrap();
    }
    fs::copy(&path, dir.path().join("photos/8.tif")).unwrap();
    tiepoint_in(dir.path(), "features {}/photos -o {}/other")
        .failed(1, &["0 usable photos of 2", "2 skipped", "give --max-megapixels 289"]);
    for wrong in ["0", "1001", "many"] {
        tiepoint_in(
            dir.path(),
            &format!("features {{}}/photos -o {{}}/ws --max-megapixels {wrong}"),
        )
        .failed(2, &["--max-megapixels"]);
    }
}

#[test]
fn threads_beyond_reason() {
    let dir = tempfile::tempdir().unwrap();
    for wrong in ["100000", "1025", "18446744073709551616", "0"] {
        tiepoint_in(dir.path(), &format!("match {{}}/ws --threads {wrong}"))
            .failed(2, &["--threads", "from 1 to 1024"]);
    }
}

#[test]
fn impossible_focal_lengths_are_reported_and_ignored() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    fs::create_dir(&folder).unwrap();
    for index in 0..4 {
        fs::write(folder.join(format!("{index}.jpg")), with_focal_length(&jpeg(index), 65_535))
            .unwrap();
    }
    let run = tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/ws").done();
    let said = run.stderr();
    assert!(said.contains("0.jpg: its EXIF focal length of 6.0"), "{said}");
    assert!(said.contains("--focal-prior") && said.lines().count() == 2, "{said}");
    assert!(run.stdout().contains("4 of 4 images"), "{}", run.stdout());
}

#[test]
fn message_on_missing_overlap_mentions_the_focal_length_of_exif() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    fs::create_dir(&folder).unwrap();
    // Photos of two rooms. A focal length of 2000 mm is possible.
    let other = {
        let mut bytes = Vec::new();
        JpegEncoder::new(&mut bytes).encode_image(&photos::photo(1, 77)).unwrap();
        bytes
    };
    for (name, bytes) in [("0.jpg", jpeg(0)), ("1.jpg", other)] {
        fs::write(folder.join(name), with_focal_length(&bytes, 2000)).unwrap();
    }
    let says = ["overlap more, or give --focal-prior PX", "EXIF", "320 x 240"];
    tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/ws").failed(1, &says);
}

#[test]
fn a_line_of_ten_megabytes_is_not_repeated() {
    let dir = tempfile::tempdir().unwrap();
    for text in ["1 1 0 ".to_owned() + &"9".repeat(10_000_000), "x".repeat(10_000_000)] {
        fs::write(dir.path().join("bal.txt"), text).unwrap();
        let run = tiepoint_in(dir.path(), "adjust {}/bal.txt").failed(1, &["bal.txt: line 1", "…"]);
        assert!(run.stderr().len() < 500, "{} bytes", run.stderr().len());
    }
}

#[test]
#[cfg(unix)]
fn control_characters_of_names_are_escaped_on_stdout() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    let photos = dir.path().join("photos");
    let workspace = dir.path().join("ws\u{1b}[2J\u{9b}5n\u{202e}\n");
    let arguments = |json: bool| {
        let path = |path: &Path| path.to_str().unwrap().to_owned();
        let json = json.then(|| "--json".to_owned());
        ["features".to_owned(), path(&photos), "-o".to_owned(), path(&workspace)]
            .into_iter()
            .chain(json)
    };
    let plain = tiepoint(arguments(false)).done().stdout();
    assert!(plain.contains(r"ws\u{1b}[2J\u{9b}5n\u{202e}\n"), "{plain}");
    let commands = |c: char| (c.is_control() && c != '\n') || c == '\u{202e}';
    assert!(!plain.contains(commands), "{plain:?}");
    let run = tiepoint(arguments(true)).done();
    assert!(
        !run.stdout().contains(commands) && !run.stderr().contains(commands),
        "{:?}",
        run.stdout()
    );
    run.json();
}

#[test]
fn camera_of_a_huge_size_is_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), 4, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    let path = dir.join("ws/sparse/0");
    let mut model = read_model(&path).unwrap();
    let id = model.cameras().next().unwrap().0;
    let camera = model.camera_mut(id);
    (camera.width, camera.height) = (1 << 31, 1 << 31);
    write_model(&dir.join("huge"), &model, Format::Binary).unwrap();
    for line in [
        "undistort {}/huge --images {}/photos -o {}/out",
        "colmap image_undistorter --input_path {}/huge --image_path {}/photos --output_path {}/out",
        "export {}/huge --images {}/photos --to openmvs -o {}/out",
        "export {}/huge --images {}/photos --to nerfstudio -o {}/out",
    ] {
        tiepoint_in(dir, line).failed(1, &["photos/", "320 × 240"]);
    }
}

#[test]
fn threads_of_colmap_beyond_reason() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    let line = "colmap feature_extractor --database_path {}/x.db --image_path {}/photos \
                --SiftExtraction.num_threads";
    for wrong in ["100000", "1025"] {
        tiepoint_in(dir.path(), &format!("{line} {wrong}"))
            .failed(1, &["num_threads", "from 1 to 1024"]);
    }
    tiepoint_in(dir.path(), &format!("{line} -1")).done();
}

/// A pipe that nobody writes to, and a device without end, are no files.
#[cfg(unix)]
#[test]
fn pipes_and_devices_in_place_of_files_are_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), 2, 0);
    tiepoint_in(dir, "features {}/photos -o {}/ws").done();
    let fifo = |name: &str| {
        let made = std::process::Command::new("mkfifo").arg(dir.join(name)).status().unwrap();
        assert!(made.success());
    };
    fifo("fifo");
    for line in [
        "features {}/photos -o {}/other --database {}/fifo",
        "adjust {}/fifo",
        "colmap mapper --database_path {}/fifo --output_path {}/out --image_path {}/photos",
        "colmap exhaustive_matcher --database_path {}/fifo",
        "colmap exhaustive_matcher --database_path {}/x.db --project_path {}/fifo",
        "colmap exhaustive_matcher --database_path {}/x.db --project_path /dev/zero",
        "colmap feature_extractor --database_path {}/x.db --image_path {}/photos \
         --image_list_path /dev/zero",
    ] {
        let run = tiepoint_in(dir, line);
        assert!(run.stderr().contains("and no regular file"), "{line}: {}", run.stderr());
    }
    for name in ["stages.json", "report.json"] {
        fs::remove_file(dir.join("ws").join(name)).unwrap();
        fifo(&format!("ws/{name}"));
        let run = tiepoint_in(dir, "match {}/ws");
        assert!(run.stderr().contains(name), "{}", run.stderr());
        assert_eq!(run.code(), 1, "{}", run.stderr());
        fs::remove_file(dir.join("ws").join(name)).unwrap();
    }
}
