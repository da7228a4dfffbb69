//! `undistort`: the files that trainers of Gaussian splats read.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::sfm::geometry::CameraModelKind;

use crate::tiepoint_in;

/// A model of two images in two folders, as COLMAP's text files.
fn write_model(folder: &Path, camera: &str) {
    fs::create_dir_all(folder).unwrap();
    let put = |name: &str, text: &str| fs::write(folder.join(name), text).unwrap();
    put("cameras.txt", &format!("1 {camera}\n"));
    put(
        "images.txt",
        "1 1 0 0 0 0 0 0 1 a/1.png\n10.5 20.5 1 48 30 2 60 12 -1\n\
         2 1 0 0 0 -1 0 0 1 b/1.jpg\n9.5 20.5 1 47 30 2\n",
    );
    put("points3D.txt", "1 0 0 5 200 100 0 0.5 1 0 2 0\n2 1 1 5 1 2 3 0.5 1 1 2 1\n");
}

fn write_photos(folder: &Path) -> image::RgbImage {
    let photo = image::RgbImage::from_fn(97, 61, |x, y| {
        image::Rgb([(2 * x) as u8, (3 * y) as u8, (x * y / 40) as u8])
    });
    for name in ["a/1.png", "b/1.jpg"] {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        photo.save(path).unwrap();
    }
    // COLMAP allows photos beside folders, which are no images of the model.
    photo.save(folder.join("other.png")).unwrap();
    photo
}

#[test]
fn undistorted_images_and_model_have_the_names_of_the_photos() {
    const CAMERA: &str = "RADIAL 97 61 70 48.5 30.5 0.1 0.02";
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_photos(&dir.join("photos"));
    write_model(&dir.join("model"), CAMERA);
    let mask = image::GrayImage::from_fn(97, 61, |x, _| image::Luma([if x < 30 { 0 } else { 9 }]));
    fs::create_dir_all(dir.join("masks/a")).unwrap();
    mask.save(dir.join("masks/a/1.png.png")).unwrap();
    let line = "undistort {}/model --images {}/photos -o {}/out";
    let with = format!("{line} --masks {{}}/masks --downscale 2,4 --blank-pixels 1 --json");
    let done = tiepoint_in(dir, &with).done().json();
    assert_eq!((&done["images"], &done["points"]), (&2.into(), &2.into()), "{done}");
    let model = read_model(&dir.join("out/sparse/0")).unwrap();
    let (_, camera) = model.cameras().next().unwrap();
    assert_eq!(camera.intrinsics.kind(), CameraModelKind::Pinhole);
    let size = |path: &str| image::image_dimensions(dir.join("out").join(path)).unwrap();
    let (w, h) = (camera.width, camera.height);
    for name in ["a/1.png", "b/1.jpg"] {
        for (folder, size_there) in
            [("images", (w, h)), ("images_2", (w / 2, h / 2)), ("images_4", (w / 4, h / 4))]
        {
            assert_eq!(size(&format!("{folder}/{name}")), size_there, "{folder}/{name}");
            let masks = folder.replace("images", "masks");
            assert_eq!(size(&format!("{masks}/{name}.png")), size_there, "{masks}/{name}");
        }
    }
    let mask = |name: &str| image::open(dir.join("out").join(name)).unwrap().to_luma8();
    // Corners of a pincushion have no source. The other photo has no mask of its own.
    let (of_a, of_b) = (mask("masks/a/1.png.png"), mask("masks/b/1.jpg.png"));
    let count = |mask: &image::GrayImage| mask.pixels().filter(|value| value.0[0] == 255).count();
    assert!(of_a.pixels().chain(of_b.pixels()).all(|value| [0, 255].contains(&value.0[0])));
    assert!(count(&of_a) > 0 && count(&of_a) < count(&of_b), "{} {}", count(&of_a), count(&of_b));
    assert!(count(&of_b) < (w * h) as usize);
    // Without options: no blank pixels. Files without a successor are removed, and the folder of
    // photos may be the output of another run.
    tiepoint_in(dir, line).done();
    for gone in ["images_2", "images_4", "masks", "masks_2"] {
        assert!(!dir.join("out").join(gone).join("a/1.png").exists(), "{gone}");
        assert!(!dir.join("out").join(gone).join("a/1.png.png").exists(), "{gone}");
    }
    let before = fs::read(dir.join("out/images/a/1.png")).unwrap();
    tiepoint_in(dir, "undistort {}/out/sparse/0 --images {}/out/images -o {}/again").done();
    assert_eq!(
        image::open(dir.join("again/images/a/1.png")).unwrap(),
        image::load_from_memory(&before).unwrap(),
        "a PINHOLE image stays as it is"
    );
    // Neither photos nor foreign files are replaced.
    tiepoint_in(dir, "undistort {}/out/sparse/0 --images {}/out/images -o {}/out")
        .failed(1, &["is read by this command"]);
    fs::create_dir_all(dir.join("full/images/a")).unwrap();
    fs::write(dir.join("full/images/a/1.png"), "precious").unwrap();
    tiepoint_in(dir, &line.replace("out", "full")).failed(1, &["a/1.png exists"]);
}

#[test]
fn cameras_without_a_pinhole_and_absent_photos_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_photos(&dir.join("photos"));
    let line = "undistort {}/model --images {}/photos -o {}/out";
    // 97 pixels at 30 pixels a radian are 185 degrees.
    write_model(&dir.join("model"), "OPENCV_FISHEYE 97 61 30 30 48.5 30.5 0 0 0 0");
    tiepoint_in(dir, line).failed(1, &["a/1.png sees 180 degrees or more", "into views"]);
    write_model(&dir.join("model"), "OPENCV_FISHEYE 97 61 32 32 48.5 30.5 0 0 0 0");
    tiepoint_in(dir, line).done();
    write_model(&dir.join("model"), "EQUIRECTANGULAR 97 61 97 61");
    tiepoint_in(dir, line).failed(1, &["PINHOLE", "into views"]);
    write_model(&dir.join("model"), "PINHOLE 97 60 70 70 48.5 30");
    tiepoint_in(dir, line).failed(1, &["97 × 61", "97 × 60"]);
    tiepoint_in(dir, "undistort {}/model -o {}/out").failed(1, &["--images"]);
    tiepoint_in(dir, &format!("{line} --min-scale 3")).failed(1, &["max_scale is 2"]);
    fs::remove_file(dir.join("photos/b/1.jpg")).unwrap();
    tiepoint_in(dir, line).failed(1, &["b/1.jpg", "photos"]);
}

/// A model without rolling shutters: gsplat's reader of COLMAP's files takes the photos and
/// `sparse/0`, its `rasterization` the arguments in `rolling_shutter.json`.
#[test]
fn export_for_gsplat_needs_no_rolling_shutter() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_photos(&dir.join("photos"));
    write_model(&dir.join("model"), "RADIAL 97 61 70 48.5 30.5 0.1 0.02");
    tiepoint_in(dir, "export {}/model --to gsplat --images {}/photos -o {}/out").done();
    for name in ["a/1.png", "b/1.jpg"] {
        let photo = fs::read(dir.join("photos").join(name)).unwrap();
        assert!(fs::read(dir.join("out/images").join(name)).unwrap() == photo, "{name}");
    }
    let (from, to) = (read_model(&dir.join("model")), read_model(&dir.join("out/sparse/0")));
    let (from, to) = (from.unwrap(), to.unwrap());
    assert_eq!(to.cameras().collect::<Vec<_>>(), from.cameras().collect::<Vec<_>>());
    assert_eq!((to.num_tracks(), to.num_registered()), (2, 2));
    let text = fs::read(dir.join("out/rolling_shutter.json")).unwrap();
    let frames: Value = serde_json::from_slice(&text).unwrap();
    let frames = frames["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 2);
    for frame in frames {
        assert_eq!(frame["rolling_shutter"], "GLOBAL");
        assert_eq!(frame["viewmats"], frame["viewmats_rs"]);
        assert_eq!(frame["radial_coeffs"].as_array().unwrap().len(), 6);
    }
    // The other trainer for rolling shutters needs their motion.
    tiepoint_in(dir, "export {}/model --to 3dgs-deblur --images {}/photos -o {}/deblur")
        .failed(1, &["no rolling shutter", "tiepoint undistort"]);
}

#[test]
fn models_are_described_in_a_few_digits_and_mistakes_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_model(&dir.join("model"), "RADIAL 97 61 70.123456789 48.5 30.5 0.1 0.02");
    let text = tiepoint_in(dir, "model info {}/model").done().stdout();
    for part in ["f 70.1235,", "k1 0.1,", "points from (0, 0, 5) to (1, 1, 5)"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains("rigs"), "{text}");
    tiepoint_in(dir, "export {}/model --to gltf -o {}/a.gltf").failed(1, &["a.gltf", ".glb"]);
    tiepoint_in(dir, "export {}/model --to gltf -o {}/a.glb").done();
    tiepoint_in(dir, "undistort {}/model -o {}/out --downscale 3x").failed(2, &["as 2,4,8"]);
    // A truth of other names.
    write_model(&dir.join("truth"), "RADIAL 97 61 70 48.5 30.5 0.1 0.02");
    let images = fs::read_to_string(dir.join("truth/images.txt")).unwrap();
    fs::write(dir.join("truth/images.txt"), images.replace("/1.", "/7.")).unwrap();
    tiepoint_in(dir, "evaluate poses {}/model --truth colmap:{}/truth")
        .failed(1, &["only 0 images", "the model has a/1.png, the truth a/7.png"]);
}
