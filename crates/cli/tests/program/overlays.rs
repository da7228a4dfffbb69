//! Photos with a logo, and photos from one spot.

use std::fs;
use std::path::Path;

use image::{GrayImage, Luma};
use serde_json::Value;
use tiepoint_pipeline::sfm::geometry::nalgebra::Vector3;
use tiepoint_pipeline::sfm::geometry::{Rigid3, Rng};

use crate::photos::{WIDTH, cam_from_world, photo, photo_from};
use crate::tiepoint_in;

/// Photos of each of two rooms that have nothing in common.
const PHOTOS: usize = 6;
const ROOMS: [u64; 2] = [0, 77];
/// The logo in the top right corner, in pixels, and the side of its squares: a third of the width.
const LOGO_PX: [u32; 2] = [108, 36];
const SQUARE_PX: u32 = 4;
/// Angle between photos from one spot: most of the view is common.
const TURN_DEG: f64 = 4.0;

fn paste_logo(photo: &mut GrayImage) {
    for y in 0..LOGO_PX[1] {
        for x in 0..LOGO_PX[0] {
            let square = [x / SQUARE_PX, y / SQUARE_PX].map(u64::from);
            let grey = Rng::stream(7, &square).next_u64() as u8;
            photo.put_pixel(WIDTH - LOGO_PX[0] - 6 + x, 6 + y, Luma([grey]));
        }
    }
}

fn write_rooms(folder: &Path) {
    fs::create_dir(folder).unwrap();
    for (room, seed) in ROOMS.into_iter().enumerate() {
        for index in 0..PHOTOS {
            let mut photo = photo(index, seed);
            paste_logo(&mut photo);
            photo.save(folder.join(format!("{room}_{index}.png"))).unwrap();
        }
    }
}

#[test]
fn two_places_with_one_logo_are_two_models() {
    let dir = tempfile::tempdir().unwrap();
    write_rooms(&dir.path().join("photos"));
    let text = tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/w").done().stdout();
    for part in [
        "warnings",
        "stand still while the scene moves",
        "no other matches",
        "2 models",
        "missing   6 of 12 images have no pose in sparse/0",
        "6 in sparse/1",
    ] {
        assert!(text.contains(part), "{text}");
    }
    let report: Value =
        serde_json::from_slice(&fs::read(dir.path().join("w/report.json")).unwrap()).unwrap();
    let kinds: Vec<&Value> =
        report["warnings"].as_array().unwrap().iter().map(|warning| &warning["kind"]).collect();
    assert_eq!(kinds, ["stationary_matches", "several_models"], "{report}");
    assert_eq!(report["stages"]["match"]["watermark_pairs"], PHOTOS * PHOTOS, "{report}");
    for model in report["models"].as_array().unwrap() {
        assert_eq!(model["registered"], PHOTOS, "{model}");
        let rooms: Vec<char> = model["unregistered"]
            .as_array()
            .unwrap()
            .iter()
            .filter_map(|name| name.as_str()?.chars().next())
            .collect();
        assert!(rooms.iter().all(|room| *room == rooms[0]), "images of one room: {model}");
    }
    tiepoint_in(dir.path(), "view {}/w").done();
    let page = fs::read_to_string(dir.path().join("w/report.html")).unwrap();
    assert!(page.contains("stand still while the scene moves"), "the page says it, too");
}

#[test]
fn a_pure_pan_is_told_to_move() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    fs::create_dir(&folder).unwrap();
    for index in 0..5 {
        let angle = (f64::from(index) - 2.0) * TURN_DEG.to_radians();
        let turn = Rigid3::from_axis_angle(Vector3::y() * angle, Vector3::zeros());
        let photo = photo_from(&(turn * cam_from_world(2)), 0);
        photo.save(folder.join(format!("{index}.png"))).unwrap();
    }
    tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/w --focal-prior 330")
        .failed(1, &["turned on one spot", "take photos from different places"]);
}
