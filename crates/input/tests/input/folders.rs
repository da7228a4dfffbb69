//! What lies beside photos: folders of systems, thumbnails, masks and copies; files with other
//! names. The cases are those of public reports on this and other programs.

use image::{DynamicImage, ImageFormat};
use tiepoint_input::ImageFolder;
use tiepoint_input::cameras::{Calibrations, CameraGrouping, Photos};

use crate::images::{encoded, folder, open};

fn png(width: u32, height: u32) -> Vec<u8> {
    encoded(&DynamicImage::new_rgb8(width, height), ImageFormat::Png)
}

fn jpeg() -> Vec<u8> {
    encoded(&DynamicImage::new_rgb8(8, 8), ImageFormat::Jpeg)
}

fn listed(names: &[&str]) -> (Vec<String>, Vec<String>) {
    let files: Vec<(&str, Vec<u8>)> = names.iter().map(|name| (*name, png(8, 8))).collect();
    let dir = folder(&files);
    let source = open(dir.path()).unwrap();
    (source.images().iter().map(|image| image.name.clone()).collect(), source.notes().to_vec())
}

#[test]
fn folders_of_systems_and_of_thumbnails_are_no_cameras() {
    let (names, notes) = listed(&[
        "cam/0.png",
        "cam/@eaDir/0.png/SYNOPHOTO_THUMB_M.png",
        "cam/Thumbs/0.png",
        "$RECYCLE.BIN/$RA1B2C3.png",
        "__MACOSX/cam/._0.png",
        "right/1.png",
    ]);
    assert_eq!(names, ["cam/0.png", "right/1.png"]);
    assert_eq!(
        notes,
        ["3 images are passed over in folders of the system or of thumbnails: $RECYCLE.BIN, \
          cam/@eaDir, cam/Thumbs"]
    );
    // Photos in one folder are one camera, whatever a NAS put beside them.
    assert_eq!(listed(&["0.png", "@eaDir/0.png"]).0, ["0.png"]);
    // A folder of this name that is a camera's own.
    assert_eq!(listed(&["thumbs/0.png", "left/0.png"]).0, ["left/0.png", "thumbs/0.png"]);
}

#[test]
fn folders_made_from_photos_are_no_cameras() {
    let (names, notes) =
        listed(&["images/0.png", "images/1.png", "masks/0.png.png", "depth/0.png", "depth/1.png"]);
    assert_eq!(names, ["images/0.png", "images/1.png"]);
    assert!(
        notes
            .iter()
            .any(|note| note.contains("masks: its images") && note.contains("`features.masks`"))
    );
    assert!(notes.iter().any(|note| note.contains("depth: its images")), "{notes:?}");
    // A rig has equal names, and a camera may have any name; a depth camera's own images too.
    for rig in [["left/0.png", "right/0.png"], ["images/0.png", "depth/7.png"]] {
        let (names, notes) = listed(&rig);
        assert_eq!((names.len(), notes.len()), (2, 0), "{rig:?}");
    }
    // Half the size by the name, and by the pixels.
    for (size, cameras) in [((5, 4), 1), ((4, 4), 1), ((9, 8), 2), ((3, 4), 2)] {
        let dir = folder(&[("images/0.png", png(9, 8)), ("images_2/0.png", png(size.0, size.1))]);
        assert_eq!(open(dir.path()).unwrap().camera_names().len(), cameras, "{size:?}");
    }
}

#[test]
fn jpeg_files_with_other_names_are_named() {
    let dir = folder(&[
        ("a.HEIC", jpeg()),
        ("b.jpg", jpeg()),
        ("c.jpg_large", jpeg()),
        ("d", jpeg()),
        ("e.heic", b"\0\0\0\x18ftypheic".to_vec()),
        ("notes.txt", b"text".to_vec()),
    ]);
    let source = open(dir.path()).unwrap();
    let reason: Vec<&str> = source.skipped().iter().map(|file| file.reason.as_str()).collect();
    assert_eq!(reason.len(), 2, "{reason:?}");
    for part in ["a.HEIC: is a JPEG file by its content", "c.jpg_large and d", "a.HEIC to a.jpg"] {
        assert!(reason[0].contains(part), "{reason:?}");
    }
    assert!(reason[1].contains("e.heic: is a HEIC photo"), "{reason:?}");
}

#[test]
fn masks_are_found_by_names_that_look_equal() {
    let photos = folder(&[
        ("Geb\u{e4}ude.jpg", png(8, 8)),
        ("b.png", png(8, 8)),
        ("c.jpg", png(8, 8)),
        ("d.jpg", png(8, 8)),
    ]);
    let masks = folder(&[
        ("Geba\u{308}ude.jpg.png", png(8, 8)),
        ("b.PNG", png(8, 8)),
        ("c.JPG.png", png(8, 8)),
        ("d.png", png(8, 8)),
    ]);
    let inputs = [photos.path().to_owned()];
    let source = ImageFolder::open(&inputs, Some(masks.path())).unwrap();
    let found: Vec<bool> = (0..4).map(|index| source.mask_path(index).is_some()).collect();
    assert_eq!(found, [true; 4]);
}

#[test]
fn a_photo_is_no_mask_of_its_own() {
    let dir = folder(&[("a.png", png(8, 8)), ("a_mask.png", png(8, 8))]);
    let error = ImageFolder::open(&[dir.path().to_owned()], Some(dir.path())).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("is the photo a.png itself") && error.contains("`features.masks`"),
        "{error}"
    );
}

#[test]
fn photos_that_lost_their_time_are_named() {
    let names: Vec<String> = (0..4)
        .map(|k| format!("left/140363657976355558{k}.png"))
        .chain(["left/x.png".to_owned(), "right/y.png".to_owned(), "right/z.png".to_owned()])
        .collect();
    let files: Vec<(&str, Vec<u8>)> = names.iter().map(|name| (&**name, png(8, 8))).collect();
    let dir = folder(&files);
    let photos = Photos::open(&[dir.path().to_owned()], None).unwrap();
    let calibrations = Calibrations::read(&[], &photos.folder).unwrap();
    let (usable, _) = photos.survey(CameraGrouping::default(), &calibrations).unwrap();
    let times: Vec<(&str, f64)> =
        usable.iter().filter_map(|photo| Some((photos.name(photo), photo.info.time_s?))).collect();
    let notes = photos.notes_on_times(&usable, &times);
    // No photo of the other folder has one.
    assert_eq!(notes.len(), 1, "{notes:?}");
    assert!(notes[0].starts_with("left: 1 of 5 photos has no time"), "{notes:?}");
    assert!(
        notes[0].contains("left/x.png") && notes[0].contains("`features.timestamps`"),
        "{notes:?}"
    );
}
