//! `model info`, `transform`, `align`, `crop` and `merge`.

use std::f64::consts::FRAC_PI_2;
use std::fs;
use std::path::Path;

use serde_json::Value;
use tiepoint_pipeline::io::colmap::{Format, read_model, write_model};
use tiepoint_pipeline::io::ply;
use tiepoint_pipeline::sfm::geometry::crs::Crs;
use tiepoint_pipeline::sfm::geometry::geodesy::{Geodetic, LocalFrame};
use tiepoint_pipeline::sfm::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_pipeline::sfm::geometry::{CameraModelKind, Intrinsics, Rigid3, Sim3, so3};
use tiepoint_pipeline::sfm::scene::{
    Camera, Image, ImageId, Keypoint, Observation, Reconstruction, Track,
};

use crate::tiepoint_in;

const NUM_IMAGES: usize = 8;
/// Numbers in files keep all bits; some operations round.
const ROUNDING: f64 = 1e-9;
/// Metres and degrees are printed to a tenth of a millimetre; the alignment is exact to a tenth of
/// that.
const PRINTED_M: f64 = 2e-4;

/// Eight images on a curve, looking at points in a slab ahead of them.
fn scene() -> Reconstruction {
    let mut model = Reconstruction::default();
    let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, 500.0, 640, 480);
    let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
    let camera = model.add_camera(camera);
    let points: Vec<Vector3<f64>> = (0..160)
        .map(|k| {
            let at = |step: usize, count: usize| f64::from(((k * step) % count) as u32);
            Vector3::new(0.25 * at(1, 40) - 5.0, 0.2 * at(7, 17) - 1.7, 6.0 + 0.3 * at(5, 11))
        })
        .collect();
    let mut tracks: Vec<Vec<Observation>> = vec![Vec::new(); points.len()];
    for index in 0..NUM_IMAGES {
        let s = index as f64 - 3.5;
        let pose = Rigid3::from_axis_angle(
            Vector3::new(0.02 * s, -0.03 * s, 0.0),
            Vector3::new(-s, 0.1 * s * s, 0.05 * s),
        );
        let mut keypoints = Vec::new();
        for (track, xyz) in tracks.iter_mut().zip(&points) {
            let pixel = intrinsics.project(&(pose * *xyz)).expect("ahead");
            if camera_contains(&pixel) {
                let keypoint = keypoints.len() as u32;
                track.push(Observation { image: ImageId(index as u32), keypoint });
                keypoints.push(Keypoint { pixel, scale_px: 1.0 });
            }
        }
        let image = model.add_image(Image::new(format!("left/{index} a.png"), camera, keypoints));
        model.register(image, pose);
    }
    for (observations, xyz) in tracks.into_iter().zip(points) {
        if observations.len() >= 2 {
            model.add_track(Track::new(xyz, observations));
        }
    }
    model
}

fn camera_contains(pixel: &Vector2<f64>) -> bool {
    (0.0..=640.0).contains(&pixel.x) && (0.0..=480.0).contains(&pixel.y)
}

fn write(dir: &Path, name: &str, model: &Reconstruction) {
    write_model(&dir.join(name), model, Format::Binary).unwrap();
}

/// The model with the images that `is_kept` chooses.
fn part(model: &Reconstruction, is_kept: impl Fn(usize) -> bool) -> Reconstruction {
    let mut part = model.clone();
    for index in (0..NUM_IMAGES).filter(|index| !is_kept(*index)) {
        part.deregister(ImageId(index as u32));
    }
    part
}

fn similarity() -> Sim3 {
    Sim3 {
        scale: 2.5,
        rotation: so3::exp(&Vector3::new(0.3, -1.2, 0.5)),
        translation: Vector3::new(100.0, -20.0, 3.0),
    }
}

/// The largest difference of centres of images of one name, and of rotations in radians.
fn difference(one: &Reconstruction, other: &Reconstruction) -> f64 {
    assert_eq!(one.num_registered(), other.num_registered());
    one.registered()
        .map(|(_, image, pose)| {
            let (.., there) =
                other.registered().find(|(_, found, _)| found.name == image.name).unwrap();
            let distance = (pose.origin_in_a() - there.origin_in_a()).norm();
            distance.max(pose.rotation.angle_to(&there.rotation))
        })
        .fold(0.0, f64::max)
}

fn read(dir: &Path, name: &str) -> Reconstruction {
    read_model(&dir.join(name)).unwrap()
}

#[test]
fn info_counts_and_measures() {
    let dir = tempfile::tempdir().unwrap();
    let model = scene();
    write(dir.path(), "a", &model);
    let info = tiepoint_in(dir.path(), "model info {}/a --json").done().json();
    assert_eq!(info["images"], NUM_IMAGES);
    assert_eq!(info["points"], model.num_tracks());
    assert_eq!(info["observations"], model.num_observations());
    assert_eq!(info["cameras"][0]["model"], "SIMPLE_RADIAL");
    assert_eq!(info["cameras"][0]["images"], NUM_IMAGES);
    assert!(info["mean_reprojection_error_px"].as_f64().unwrap() < ROUNDING);
    let text = tiepoint_in(dir.path(), "model info {}/a").done().stdout();
    assert!(text.contains("f 500") && text.contains(&format!("{NUM_IMAGES} images")), "{text}");
}

#[test]
fn transform_and_its_inverse() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let (mut model, transform) = (scene(), similarity());
    write_model(&dir.join("a"), &model, Format::Text).unwrap();
    let q = transform.rotation;
    let numbers = format!("2.5 {} {} {} {} 100 -20 3\n", q.w, q.i, q.j, q.k);
    fs::write(dir.join("t.txt"), numbers).unwrap();
    tiepoint_in(dir, "model transform {}/a --by {}/t.txt -o {}/b").done();
    assert!(dir.join("b/images.txt").is_file(), "the format of the input");
    tiepoint_in(dir, "model transform {}/b --by {}/t.txt --inverse -o {}/c").done();
    assert!(difference(&read(dir, "c"), &model) < ROUNDING);
    model.transform(&transform);
    assert!(difference(&read(dir, "b"), &model) < ROUNDING);
    assert!(read(dir, "b").mean_reprojection_error_px() < ROUNDING);

    for (text, part) in [
        ("", "ends where"),
        ("1 1 0 0 0 0 0", "ends where"),
        ("0 1 0 0 0 0 0 0", "not above zero"),
        ("nan 1 0 0 0 0 0 0", "the scale is NaN"),
        ("1 0 0 0 0 0 0 0", "no rotation"),
        ("1 1 0 0 0 0 0 0 0", "follows"),
        ("1 1 0 0 0 0 0 0\n1 1 0 0 0 0 0 0", "follows the only similarity"),
        ("1e308 1 0 0 0 0 0 0", "check the scale"),
    ] {
        fs::write(dir.join("t.txt"), text).unwrap();
        tiepoint_in(dir, "model transform {}/a --by {}/t.txt -o {}/bad").failed(1, &[part]);
        assert!(!dir.join("bad").exists(), "{text}");
    }
    // The output is the input.
    fs::write(dir.join("t.txt"), "2 1 0 0 0 0 0 0").unwrap();
    let before = fs::read(dir.join("a/images.txt")).unwrap();
    tiepoint_in(dir, "model transform {}/a --by {}/t.txt -o {}/a").failed(1, &["cameras.txt"]);
    assert_eq!(fs::read(dir.join("a/images.txt")).unwrap(), before);
}

#[test]
fn alignment_to_positions_ignores_wrong_ones() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let (mut model, transform) = (scene(), similarity());
    write(dir, "a", &model);
    model.transform(&transform);
    let mut text = String::from("# name x y z\nnot there.png 1 2 3\n");
    for (id, image, pose) in model.registered() {
        let c = pose.origin_in_a() + Vector3::x() * if id.0 == 2 { 50.0 } else { 0.0 };
        text += &format!("{}  {}   {}\t {}\n", image.name, c.x, c.y, c.z);
    }
    fs::write(dir.join("p.txt"), &text).unwrap();
    let line = "model align {}/a --positions {}/p.txt --max-error 0.1 -o {}/b --json \
                --save-transform {}/t.txt";
    let found = tiepoint_in(dir, line).done().json();
    assert_eq!(found["alignment"]["inliers"], NUM_IMAGES - 1, "{found}");
    assert!(difference(&read(dir, "b"), &model) < 1e-6, "{found}");
    tiepoint_in(dir, "model transform {}/a --by {}/t.txt -o {}/c").done();
    assert!(difference(&read(dir, "c"), &read(dir, "b")) < ROUNDING);

    // Without --json an error is one sentence.
    let line = &line.replace(" --json", "");
    fs::write(dir.join("p.txt"), "x.png 1 2 3\n").unwrap();
    tiepoint_in(dir, line).failed(1, &["p.txt", "0 of its images", "at least 3"]);
    for (text, part) in [
        ("a.png 1 2\n", "x is `a.png`, not a number: expected `name x y z`"),
        ("1 2 3\n", "has no name"),
        ("a.png 1 2 nan\n", "z is `nan`"),
        ("a.png 1 2 3\na.png 1 2 3\n", "listed twice"),
    ] {
        fs::write(dir.join("p.txt"), text).unwrap();
        tiepoint_in(dir, line).failed(1, &["p.txt: line", part]);
    }
    let on_a_line: String = (0..NUM_IMAGES).map(|k| format!("left/{k} a.png {k} 0 0\n")).collect();
    fs::write(dir.join("p.txt"), on_a_line).unwrap();
    tiepoint_in(dir, &line.replace("0.1", "1e-9")).failed(1, &["not on a line"]);
}

/// Of the aligned model in `b`; `truth` has its true coordinates in `frame`.
fn exports_are_in_the_system_that_is_asked_for(
    dir: &Path,
    frame: &LocalFrame,
    truth: &Reconstruction,
) {
    let in_crs = |epsg: u32, local: &Vector3<f64>| {
        Crs::from_epsg(epsg).unwrap().project(&frame.to_geodetic(local))
    };
    let centre = |image: &str| {
        let (.., pose) = truth.registered().find(|(_, found, _)| found.name == image).unwrap();
        pose.origin_in_a()
    };
    let line = "export {}/b --to csv -o {}/c.csv --overwrite";
    let rows = |command: &str, columns: &str| -> Vec<(String, Vec<Option<f64>>)> {
        tiepoint_in(dir, command).done();
        let text = fs::read_to_string(dir.join("c.csv")).unwrap();
        let (header, rows) = text.split_once('\n').unwrap();
        assert_eq!(header, format!("image,{columns}"));
        let row = |row: &str| {
            let mut words = row.split(',');
            let name = words.next().unwrap().to_owned();
            (name, words.map(|word| word.parse().ok()).collect())
        };
        rows.lines().map(row).collect()
    };
    // The model is on both sides of the date line, between these zones.
    for (epsg, columns) in [(32760, "x,y,z"), (32701, "x,y,z"), (4978, "x,y,z")] {
        let rows = rows(&format!("{line} --crs EPSG:{epsg}"), columns);
        assert_eq!(rows.len(), NUM_IMAGES);
        for (name, found) in rows {
            let found: Vec<f64> = found.into_iter().flatten().collect();
            let difference = Vector3::from_column_slice(&found) - in_crs(epsg, &centre(&name));
            assert!(difference.norm() < PRINTED_M, "{epsg} {name}: {found:?}");
        }
    }
    let places_are_true = |line: &str| {
        for (name, found) in rows(&format!("{line} --crs epsg:4979"), "lat,lon,alt") {
            let found: Vec<f64> = found.into_iter().flatten().collect();
            let [latitude_deg, longitude_deg, height_m] = found[..] else { panic!("{found:?}") };
            let there = frame.to_local(&Geodetic { latitude_deg, longitude_deg, height_m });
            assert!((there - centre(&name)).norm() < PRINTED_M, "{name}: {found:?}");
        }
    };
    places_are_true(line);
    // The centres of the cameras are positions for the next model.
    fs::copy(dir.join("c.csv"), dir.join("positions.csv")).unwrap();
    tiepoint_in(dir, "model align {}/a --positions {}/positions.csv --max-error 0.1 -o {}/again")
        .done();
    places_are_true(&line.replace("{}/b", "{}/again"));
    // Without a system they are those of the model.
    let model = read(dir, "b");
    let local = rows(line, "x,y,z");
    for ((_, image, pose), (name, found)) in model.registered().zip(local) {
        let found: Vec<f64> = found.into_iter().flatten().collect();
        let difference = Vector3::from_column_slice(&found) - pose.origin_in_a();
        // Their unit may be any, so that all digits are written.
        assert!(image.name == name && difference.norm() == 0.0, "{name}: {found:?}");
    }

    clouds_are_in_the_system_that_is_asked_for(dir, &in_crs, truth);
    // Heights that are not known.
    let file = dir.join("again/tiepoint.json");
    let mut sidecar: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    sidecar["georeference"].as_object_mut().unwrap().remove("height_m");
    fs::write(&file, sidecar.to_string()).unwrap();
    let line = line.replace("{}/b", "{}/again");
    let text = tiepoint_in(dir, &format!("{line} --crs EPSG:32760")).done().stdout();
    assert!(text.contains("height above the model's origin"), "{text}");
    let rows = rows(&format!("{line} --crs EPSG:4326"), "lat,lon,alt");
    assert!(rows.iter().all(|(_, found)| found[0].is_some() && found[2].is_none()), "{rows:?}");
    tiepoint_in(dir, &format!("{line} --crs EPSG:4978")).failed(1, &["takes heights"]);
}

fn clouds_are_in_the_system_that_is_asked_for(
    dir: &Path,
    in_crs: &dyn Fn(u32, &Vector3<f64>) -> Vector3<f64>,
    truth: &Reconstruction,
) {
    let text = tiepoint_in(dir, "export {}/b --to ply -o {}/c.ply --crs EPSG:32760").done();
    assert!(text.stdout().contains("EPSG:32760 (easting and northing, m; height above the ell"));
    let bytes = fs::read(dir.join("c.ply")).unwrap();
    let header = String::from_utf8_lossy(&bytes[..300]).into_owned();
    assert!(header.contains("property double x") && header.contains("comment EPSG:32760"));
    let cloud = ply::read(&dir.join("c.ply")).unwrap();
    assert_eq!(cloud.len(), truth.num_tracks());
    for (found, (_, track)) in cloud.iter().zip(truth.tracks()) {
        let difference = found.xyz - in_crs(32760, &track.xyz);
        assert!(difference.norm() < PRINTED_M, "{}", found.xyz);
    }
    // The result of another export is this program's.
    tiepoint_in(dir, "export {}/b --to ply -o {}/c.ply").done();

    tiepoint_in(dir, "export {}/b --to gpx -o {}/c.gpx --crs EPSG:4326").done();
    for (command, parts) in [
        ("export {}/b --to gpx -o {}/d.gpx --crs EPSG:32760", ["gpx is not written in EPSG:32760"]),
        ("export {}/b --to tum -o {}/d.tum --crs EPSG:4326", ["tum is not written in EPSG:4326"]),
        ("export {}/a --to ply -o {}/d.ply --crs EPSG:4326", ["--position-priors"]),
        ("export {}/b --to geojson -o {}/d.json --rigid", ["leave its frame on the earth"]),
        ("export {}/b --to ply -o {}/d.ply --crs EPSG:32660", ["there, the zone of UTM is EPSG:3"]),
    ] {
        tiepoint_in(dir, command).failed(1, &parts);
    }
    tiepoint_in(dir, "export {}/b --to ply -o {}/d.ply --crs EPSG:31467")
        .failed(2, &["EPSG:31467", "EPSG:25828"]);
    assert!(!dir.join("d.ply").exists());
}

#[test]
fn alignment_to_places_on_the_earth_gives_east_north_up() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let (mut model, transform) = (scene(), similarity());
    write(dir, "a", &model);
    model.transform(&transform);
    let origin = Geodetic { latitude_deg: -17.0, longitude_deg: 179.99999, height_m: 20.0 };
    let frame = LocalFrame::new(origin);
    let place = |c: &Vector3<f64>| frame.to_geodetic(c);
    let mut text = String::from("image,lat,lon,alt,sigma\nnot there.png,1,2,3,4\n");
    for (id, image, pose) in model.registered() {
        // A receiver without a fix.
        let Geodetic { latitude_deg, longitude_deg, height_m } = match id.0 {
            2 => Geodetic::default(),
            _ => place(&pose.origin_in_a()),
        };
        text += &format!("{},{latitude_deg},{longitude_deg},{height_m},2\n", image.name);
    }
    fs::write(dir.join("p.csv"), &text).unwrap();
    let line = "model align {}/a --positions {}/p.csv --max-error 0.1 -o {}/b";
    let found = tiepoint_in(dir, &format!("{line} --json")).done().json();
    assert_eq!(found["alignment"]["inliers"], NUM_IMAGES - 1, "{found}");
    assert!(found["frame"].as_str().unwrap().starts_with("x is east, y north and z up"), "{found}");
    let sidecar: Value =
        serde_json::from_slice(&fs::read(dir.join("b/tiepoint.json")).unwrap()).unwrap();
    let number = |name: &str| sidecar["georeference"][name].as_f64().unwrap();
    let found = LocalFrame::new(Geodetic {
        latitude_deg: number("latitude_deg"),
        longitude_deg: number("longitude_deg"),
        height_m: number("height_m"),
    });
    for (aligned, truth) in read(dir, "b").registered().zip(model.registered()) {
        let there = frame.to_local(&found.to_geodetic(&aligned.2.origin_in_a()));
        assert!((there - truth.2.origin_in_a()).norm() < 1e-6, "{there}");
    }
    // A change of the frame drops it, and a part keeps it.
    fs::write(dir.join("t.txt"), "2 1 0 0 0 1 2 3\n").unwrap();
    tiepoint_in(dir, "model transform {}/b --by {}/t.txt -o {}/c").done();
    assert!(!fs::read_to_string(dir.join("c/tiepoint.json")).unwrap().contains("latitude"));
    tiepoint_in(dir, "model crop {}/b --quantiles 0.1,0.9 -o {}/d").done();
    assert!(fs::read_to_string(dir.join("d/tiepoint.json")).unwrap().contains("latitude"));
    // Exports do not tell where the model is.
    tiepoint_in(dir, "export {}/b --to colmap -o {}/e").done();
    assert!(!fs::read_to_string(dir.join("e/tiepoint.json")).unwrap().contains("latitude"));
    exports_are_in_the_system_that_is_asked_for(dir, &frame, &model);
    fs::write(dir.join("p.csv"), text.replace(',', ";")).unwrap();
    tiepoint_in(dir, line).failed(1, &["p.csv: line 1", "must be"]);
    fs::write(dir.join("p.csv"), "image,lat,lon,alt\nleft/0 a.png,139.7,35.6,0\n").unwrap();
    tiepoint_in(dir, line).failed(1, &["p.csv: line 2", "latitude comes before longitude"]);
}

/// A flat path fits its mirror image, after which the photos are upside down.
#[test]
fn alignment_to_swapped_coordinates_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let mut model = Reconstruction::default();
    let camera = model.add_camera(*scene().camera_of(ImageId(0)));
    let [mut right, mut swapped] = [String::from("image,x,y,z\n"), String::from("image,x,y,z\n")];
    // The optical axis is along y, and z is up.
    let rotation = so3::exp(&(FRAC_PI_2 * Vector3::x()));
    for k in 0..8 {
        let centre = Vector3::new(f64::from(k), f64::from(k * k) / 10.0, 0.0);
        let id = model.add_image(Image::new(format!("{k}.png"), camera, Vec::new()));
        model.register(id, Rigid3::new(rotation, -(rotation * centre)));
        right += &format!("{k}.png,{},{},0\n", centre.x, centre.y);
        swapped += &format!("{k}.png,{},{},0\n", centre.y, centre.x);
    }
    write(dir, "a", &model);
    let line = "model align {}/a --positions {}/p.csv --max-error 0.1 -o {}/b";
    fs::write(dir.join("p.csv"), right).unwrap();
    tiepoint_in(dir, line).done();
    fs::write(dir.join("p.csv"), swapped).unwrap();
    tiepoint_in(dir, line).failed(1, &["upside down: are two coordinates swapped?"]);
}

#[test]
fn alignment_to_control_points_names_the_wrong_one() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let (mut model, transform) = (scene(), similarity());
    write(dir, "a", &model);
    // Thirteen deviations: marks of 3 px determine these points to 15 cm.
    const WRONG_M: f64 = 2.0;
    type Marked = (Vector3<f64>, Vec<(String, Vector2<f64>)>);
    let observed: Vec<Marked> = model
        .tracks()
        .filter(|(_, track)| track.observations.len() >= 4)
        .step_by(8)
        .take(7)
        .map(|(_, track)| {
            let mark = |o: &Observation| {
                let image = model.image(o.image);
                (image.name.replace(' ', "_"), image.keypoints[o.keypoint as usize].pixel)
            };
            (transform * track.xyz, track.observations.iter().map(mark).collect())
        })
        .collect();
    assert_eq!(observed.len(), 7);
    // Names in the file have no spaces.
    let file = |wrong: Option<usize>| {
        let mut text = String::from("local\n");
        for (k, (xyz, marks)) in observed.iter().enumerate() {
            let name = if k == 6 { "CHK-6".to_owned() } else { format!("p{k}") };
            let x = xyz.x + if wrong == Some(k) { WRONG_M } else { 0.0 };
            for (image, pixel) in marks {
                let [y, z] = [xyz.y, xyz.z];
                text += &format!("{x} {y} {z} {} {} {image} {name}\n", pixel.x, pixel.y);
            }
        }
        text
    };
    let mut renamed = Reconstruction::default();
    let camera = renamed.add_camera(*model.camera_of(ImageId(0)));
    for (_, image, pose) in model.registered() {
        let name = image.name.replace(' ', "_");
        let id = renamed.add_image(Image::new(name, camera, Vec::new()));
        renamed.register(id, *pose);
    }
    write(dir, "renamed", &renamed);
    model.transform(&transform);
    let line = "model align {}/renamed --control-points {}/gcp.txt -o {}/b --json";
    fs::write(dir.join("gcp.txt"), file(None)).unwrap();
    let found = tiepoint_in(dir, line).done().json();
    let points = found["control_points"].as_array().unwrap();
    assert!(points.iter().all(|point| point["is_wrong"] == false), "{found}");
    assert_eq!(points[6]["is_check"], true);
    assert!(points.iter().all(|point| point["inlier_marks"] == point["marks"]), "{found}");
    let largest_m = |point: &Value| -> f64 {
        let error = point["error_m"].as_array().unwrap();
        error.iter().map(|value| value.as_f64().unwrap().abs()).fold(0.0, f64::max)
    };
    assert!(points.iter().all(|point| largest_m(point) < 1e-6), "{found}");
    let centres = |model: &Reconstruction| -> Vec<Vector3<f64>> {
        model.registered().map(|(_, _, pose)| pose.origin_in_a()).collect()
    };
    let aligned = centres(&read(dir, "b"));
    let near = |(a, b): (&Vector3<f64>, &Vector3<f64>)| (a - b).norm() < 1e-6;
    assert!(aligned.iter().zip(&centres(&model)).all(near), "{found}");

    fs::write(dir.join("gcp.txt"), file(Some(2))).unwrap();
    let found = tiepoint_in(dir, line).done().json();
    let wrong = |point: &&Value| point["is_wrong"] == true;
    let wrong: Vec<&Value> =
        found["control_points"].as_array().unwrap().iter().filter(wrong).collect();
    assert!(wrong.len() == 1 && wrong[0]["name"] == "p2", "{found}");
    assert!((largest_m(wrong[0]) - WRONG_M).abs() < 1e-6, "{found}");
    let line = &line.replace(" --json", "");
    let text = tiepoint_in(dir, line).done().stdout();
    assert!(text.contains("control point p2: ") && text.contains("not used"), "{text}");

    fs::write(dir.join("gcp.txt"), "local\n1 2 3 4 5 left/0_a.png p\n").unwrap();
    tiepoint_in(dir, line).failed(1, &["gcp.txt", "0 of 1 control points are usable"]);
    fs::write(dir.join("gcp.txt"), "EPSG:1\n").unwrap();
    tiepoint_in(dir, line).failed(1, &["gcp.txt", "line 1", "must be EPSG:4326"]);
}

/// CSV of seven points of a model, the last one of which is a check point.
fn control_points_csv(
    model: &Reconstruction,
    place: &dyn Fn(usize, Vector3<f64>) -> Vector3<f64>,
) -> String {
    let mut text = String::from("point,x,y,z,image,px,py,sigma\n");
    let seen = model.tracks().filter(|(_, track)| track.observations.len() >= 4);
    for (k, (_, track)) in seen.step_by(8).take(7).enumerate() {
        let name = if k == 6 { "CHK-6".to_owned() } else { format!("p{k}") };
        let [x, y, z] = place(k, track.xyz).into();
        for observation in &track.observations {
            let image = model.image(observation.image);
            let pixel = image.keypoints[observation.keypoint as usize].pixel;
            text += &format!("{name},{x},{y},{z},{},{},{},0.02\n", image.name, pixel.x, pixel.y);
        }
    }
    text
}

#[test]
fn adjustment_with_control_points_names_wrong_points_and_marks() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let (model, transform) = (scene(), similarity());
    write(dir, "a", &model);
    let right = control_points_csv(&model, &|_, xyz| transform * xyz);
    fs::write(dir.join("gcp.csv"), &right).unwrap();
    let line = "adjust {}/a --control-points {}/gcp.csv -o {}/b --json";
    let found = tiepoint_in(dir, line).done().json();
    let points = found["control_points"]["points"].as_array().unwrap().clone();
    assert!(points.iter().all(|point| point["is_wrong"] == false), "{found}");
    // Keypoints and coordinates are exact.
    let rms_m = |found: &Value, kind: &str| -> f64 {
        let rms_m = found[kind]["rms_m"].as_array().unwrap();
        rms_m.iter().map(|value| value.as_f64().unwrap()).fold(0.0, f64::max)
    };
    for (kind, count) in [("control", 6), ("check", 1)] {
        assert_eq!(found["control_points"][kind]["points"], count, "{found}");
        assert!(rms_m(&found["control_points"], kind) < 1e-5, "{found}");
    }
    let mut there = model.clone();
    there.transform(&transform);
    assert!(difference(&read(dir, "b"), &there) < 1e-5);
    // The model is in the frame of the points, and is not changed.
    let before = fs::read(dir.join("b/images.bin")).unwrap();
    let evaluated = tiepoint_in(dir, "evaluate points {}/b {}/gcp.csv --json").done().json();
    // Without the adjustment there are no sizes of errors that it would detect.
    for (evaluated, point) in evaluated["points"].as_array().unwrap().iter().zip(&points) {
        assert_eq!(evaluated["error_m"], point["error_m"]);
        let is_tested = point["is_check"] == false;
        assert_eq!(point["detectable_m"].is_array(), is_tested, "{point}");
        assert_eq!(point["separable_m"].is_array(), is_tested, "{point}");
    }
    assert_eq!(fs::read(dir.join("b/images.bin")).unwrap(), before);
    let text = tiepoint_in(dir, "evaluate points {}/b {}/gcp.csv").done().stdout();
    assert!(text.contains("1 check points: root mean square errors 0.0000"), "{text}");

    const WRONG_M: f64 = 2.0;
    let off = |k, xyz| transform * xyz + Vector3::x() * if k == 2 { WRONG_M } else { 0.0 };
    let wrong = control_points_csv(&model, &off);
    // The first mark of the first point is beside it.
    let mut lines: Vec<String> = wrong.lines().map(str::to_owned).collect();
    let mut fields: Vec<String> = lines[1].split(',').map(str::to_owned).collect();
    fields[5] = (fields[5].parse::<f64>().unwrap() + 50.0).to_string();
    let image = fields[4].clone();
    lines[1] = fields.join(",");
    fs::write(dir.join("gcp.csv"), lines.join("\n")).unwrap();
    let found = tiepoint_in(dir, line).done().json();
    let points = found["control_points"]["points"].as_array().unwrap();
    let wrong: Vec<&Value> = points.iter().filter(|point| point["is_wrong"] == true).collect();
    assert!(wrong.len() == 1 && wrong[0]["name"] == "p2", "{found}");
    assert!((wrong[0]["error_m"][0].as_f64().unwrap() + WRONG_M).abs() < 1e-3, "{found}");
    assert_eq!(points[0]["wrong_marks"], serde_json::json!([image]), "{found}");
    assert!(difference(&read(dir, "b"), &there) < 1e-5);
}

#[test]
fn control_points_that_do_not_fit_a_model_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let (model, transform) = (scene(), similarity());
    write(dir, "a", &model);
    let adjust = "adjust {}/a --control-points {}/gcp.csv -o {}/b";
    let evaluate = "evaluate points {}/a {}/gcp.csv";
    let right = control_points_csv(&model, &|_, xyz| transform * xyz);
    fs::write(dir.join("gcp.csv"), right.replace("left/", "right/")).unwrap();
    let parts = ["gcp.csv", "as right/0 a.png, is one of its 8 images"];
    tiepoint_in(dir, adjust).failed(1, &parts);
    tiepoint_in(dir, evaluate).failed(1, &parts);
    let shuffled = |k: usize, xyz: Vector3<f64>| transform * xyz.map(|v| v * (1.0 + k as f64));
    fs::write(dir.join("gcp.csv"), control_points_csv(&model, &shuffled)).unwrap();
    tiepoint_in(dir, adjust).failed(1, &["from their places in the model"]);
    assert!(!dir.join("b").exists());
    // A place on the earth, and a model that is nowhere.
    let header = "point,lat,lon,alt,image,px,py\n";
    fs::write(dir.join("gcp.csv"), format!("{header}p,48,11,500,left/0 a.png,1,2\n")).unwrap();
    tiepoint_in(dir, evaluate).failed(1, &["not in a frame on the earth", "model align"]);
    tiepoint_in(dir, adjust).failed(1, &["0 of 1 control points are usable"]);
    fs::write(dir.join("bal.txt"), "1 0 0\n0 0 0 0 0 0 1 0 0\n").unwrap();
    let bal = "adjust {}/bal.txt --control-points {}/gcp.csv";
    tiepoint_in(dir, bal).failed(1, &["images of a BAL problem have no names"]);
}

#[test]
fn alignment_to_a_model_by_common_keypoints() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let (model, transform) = (scene(), similarity());
    write(dir, "a", &model);
    // Two common images, which are on a line.
    let mut reference = part(&model, |index| index >= 6);
    reference.transform(&transform);
    write(dir, "reference", &reference);
    let found = tiepoint_in(dir, "model align {}/a --to {}/reference -o {}/b --json").done().json();
    assert_eq!(found["alignment"]["common_images"], 2, "{found}");
    let mut expected = model.clone();
    expected.transform(&transform);
    assert!(difference(&read(dir, "b"), &expected) < 1e-6, "{found}");

    let mut renamed = Reconstruction::default();
    let camera = renamed.add_camera(*model.camera_of(ImageId(0)));
    let image = renamed.add_image(Image::new("other.png", camera, Vec::new()));
    renamed.register(image, Rigid3::identity());
    write(dir, "other", &renamed);
    tiepoint_in(dir, "model align {}/a --to {}/other -o {}/c")
        .failed(1, &["cannot align", "other", "no image has a pose in both"]);
    assert!(!dir.join("c").exists());
    for (arguments, part) in [
        ("model align {}/a -o {}/c", "--to"),
        ("model align {}/a --positions {}/p.txt -o {}/c", "--max-error"),
        ("model align {}/a --to {}/other --max-error-px 0 -o {}/c", "above zero"),
    ] {
        tiepoint_in(dir, arguments).failed(2, &[part]);
    }
}

#[test]
fn crop_to_a_box_and_to_quantiles() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let model = scene();
    write(dir, "a", &model);
    tiepoint_in(dir, "model crop {}/a --box -9,-9,0,-4,9,99 -o {}/b").done();
    let cropped = read(dir, "b");
    let inside = model.tracks().filter(|(_, track)| track.xyz.x <= -4.0).count();
    assert_eq!(cropped.num_tracks(), inside);
    assert!(inside > 0 && cropped.num_registered() < NUM_IMAGES);
    assert!(cropped.registered().all(|(_, image, _)| image.num_points() > 0));
    tiepoint_in(dir, "model crop {}/a --quantiles 0,1 -o {}/c").done();
    assert_eq!(read(dir, "c").num_tracks(), model.num_tracks());
    tiepoint_in(dir, "model crop {}/a --box 50,50,50,60,60,60 -o {}/d")
        .failed(1, &["no point of", "model info"]);
    for (option, part) in [
        ("--box 1,2,3", "six numbers"),
        ("--box 1,0,0,0,1,1", "x1 <= x2"),
        ("--box 0,0,0,inf,1,1", "six numbers"),
        ("--quantiles 0.9,0.1", "q1 <= q2"),
        ("", "--quantiles"),
    ] {
        tiepoint_in(dir, &format!("model crop {{}}/a {option} -o {{}}/d")).failed(2, &[part]);
    }
}

#[test]
fn parts_become_one_model_again() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let model = scene();
    write(dir, "a", &part(&model, |index| index < 4));
    let mut last = part(&model, |index| index >= 5);
    last.transform(&similarity());
    write(dir, "last", &last);
    let mut middle = part(&model, |index| (3..6).contains(&index));
    middle.transform(&similarity().inverse());
    write(dir, "middle", &middle);
    // `last` has nothing in common with `a`, and fits after `middle`.
    let merged: Value =
        tiepoint_in(dir, "model merge {}/a {}/last {}/middle -o {}/all --json").done().json();
    assert_eq!(merged["images"], NUM_IMAGES, "{merged}");
    assert_eq!(merged["merged"].as_array().unwrap().len(), 2);
    let all = read(dir, "all");
    assert!(difference(&all, &model) < 1e-6, "{merged}");
    assert_eq!(all.num_cameras(), 1, "common images have one camera");
    assert_eq!(all.num_tracks(), model.num_tracks());
    assert_eq!(all.num_observations(), model.num_observations());
    assert!(all.mean_reprojection_error_px() < 1e-4);

    tiepoint_in(dir, "model merge {}/a {}/last -o {}/none")
        .failed(1, &["cannot align", "last", "no image has a pose in both"]);
    tiepoint_in(dir, "model merge {}/a {}/middle -o {}/middle").failed(1, &["middle"]);
    tiepoint_in(dir, "model merge {}/a -o {}/none").failed(2, &["2"]);
    assert!(!dir.join("none").exists());
}

#[test]
fn a_trajectory_of_lines_has_no_gap() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let mut model = scene();
    write_model(&dir.join("whole"), &model, Format::Text).unwrap();
    tiepoint_in(dir, "export {}/whole --to kitti -o {}/whole.txt").done();
    assert_eq!(fs::read_to_string(dir.join("whole.txt")).unwrap().lines().count(), NUM_IMAGES);
    for image in [3, 4] {
        model.deregister(ImageId(image));
    }
    write_model(&dir.join("gap"), &model, Format::Text).unwrap();
    let parts = ["has no poses of frames 3 to 4", "export to tum"];
    tiepoint_in(dir, "export {}/gap --to kitti -o {}/gap.txt").failed(1, &parts);
    assert!(!dir.join("gap.txt").exists());
}
