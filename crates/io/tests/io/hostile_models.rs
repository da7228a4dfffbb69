//! COLMAP models that break what their format takes for granted.

use tempfile::TempDir;
use tiepoint_io::colmap::{self, Format};
use tiepoint_scene::Reconstruction;

const CAMERAS: &str = "1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 640 480 500 500 320 240\n";

fn read(files: &[(&str, &str)]) -> Result<Reconstruction, String> {
    let dir = tempfile::tempdir().unwrap();
    for (name, text) in files {
        std::fs::write(dir.path().join(name), text).unwrap();
    }
    colmap::read_model(dir.path()).map_err(|error| error.to_string())
}

/// Writes a model into a new folder and gives what was read back, or why it was not written.
fn written(model: &Reconstruction, format: Format) -> Result<Reconstruction, String> {
    let dir: TempDir = tempfile::tempdir().unwrap();
    let path = dir.path().join("model");
    colmap::write_model(&path, model, format).map_err(|error| error.to_string())?;
    Ok(colmap::read_model(&path).unwrap())
}

/// Keypoints that see no point have that number: a track could claim one of them twice.
#[test]
fn no_point_has_the_number_that_means_none() {
    let images = "1 1 0 0 0 0 0 0 1 a.jpg\n1 2 -1\n";
    let points = format!("{} 0 0 5 1 2 3 0 1 0 1 0\n", u64::MAX);
    let read = read(&[("cameras.txt", CAMERAS), ("images.txt", images), ("points3D.txt", &points)]);
    let error = read.unwrap_err();
    assert!(error.contains("a point has the id 18446744073709551615, which means none"), "{error}");
}

#[test]
fn names_that_a_format_cannot_hold_are_not_written() {
    let images = "1 1 0 0 0 0 0 0 1 a\0b.jpg\n\n";
    let model =
        read(&[("cameras.txt", CAMERAS), ("images.txt", images), ("points3D.txt", "")]).unwrap();
    let error = written(&model, Format::Binary).unwrap_err();
    assert!(error.contains(r#"the name "a\0b.jpg" holds a zero byte"#), "{error}");
    assert_eq!(written(&model, Format::Text).unwrap(), model);

    let mut nameless = Reconstruction::default();
    let (_, camera) = model.cameras().next().unwrap();
    let camera = nameless.add_camera(*camera);
    let image = nameless.add_image(tiepoint_scene::Image::new("", camera, vec![]));
    nameless.register(image, tiepoint_geometry::Rigid3::identity());
    let error = written(&nameless, Format::Text).unwrap_err();
    assert!(error.contains(r#"the name "" cannot stand in a line of text"#), "{error}");
    assert_eq!(written(&nameless, Format::Binary).unwrap(), nameless);
}

/// COLMAP wants the pose of the rig for each image.
#[test]
fn poses_of_the_rig_that_overflow_are_not_written() {
    let images = "1 1 0 0 0 0 0 0 1 a.jpg\n\n2 1 0 0 0 -1e308 0 0 2 b.jpg\n\n\
                  3 1 0 0 0 -1e308 0 0 2 c.jpg\n\n";
    let model = read(&[
        ("cameras.txt", CAMERAS),
        ("images.txt", images),
        ("points3D.txt", ""),
        ("rigs.txt", "1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 1e308 0 0\n"),
        ("frames.txt", "1 1 1 0 0 0 0 0 0 1 CAMERA 1 1\n"),
    ])
    .unwrap();
    for format in Format::ALL {
        let error = written(&model, format).unwrap_err();
        assert!(error.contains("the pose of the rig at image b.jpg overflows"), "{error}");
    }
}
