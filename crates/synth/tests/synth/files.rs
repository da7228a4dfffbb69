//! The files that a drive writes.

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use tiepoint_synth::lens::Lens;
use tiepoint_synth::{Drive, DriveOptions, Effects, Mount, ViewDirection, image};

fn drive(effects: Effects) -> Drive {
    let mounts = Mount::stereo(ViewDirection::Right, 0.5).to_vec();
    let options =
        DriveOptions { mounts, width: 160, height: 120, effects, ..DriveOptions::default() };
    Drive::new(&options).expect("the options are valid")
}

#[test]
fn written_images_equal_rendered_images() {
    let folder = tempfile::tempdir().unwrap();
    for (effects, extension) in [(Effects::default(), "png"), (Effects::all(), "jpg")] {
        let drive = drive(effects);
        let (renderer, exposure) = (drive.renderer(1), &drive.cameras()[1].exposures[7]);
        drive.write_image(folder.path(), 1, exposure, &renderer).unwrap();
        assert_eq!(exposure.name, format!("right/000007.{extension}"));
        let back = image::open(folder.path().join(&exposure.name)).unwrap().to_rgb8();
        assert_eq!(back, drive.render(1, exposure, &renderer));
    }
}

#[test]
fn tables_hold_time_stamps_and_true_poses() {
    let folder = tempfile::tempdir().unwrap();
    let drive = drive(Effects::all());
    drive.write_tables(folder.path()).unwrap();
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let exposures: Vec<_> = drive
        .cameras()
        .iter()
        .enumerate()
        .flat_map(|(c, camera)| camera.exposures.iter().map(move |exposure| (c, exposure)))
        .collect();
    let stamps = read("timestamps.csv");
    let poses = read("truth/poses.csv");
    assert_eq!(stamps.lines().next(), Some("image,seconds"));
    assert_eq!(
        (stamps.lines().count(), poses.lines().count()),
        (exposures.len() + 1, exposures.len() + 1)
    );
    for ((stamp, pose), (camera, exposure)) in
        stamps.lines().zip(poses.lines()).skip(1).zip(exposures)
    {
        let (name, seconds) = stamp.split_once(',').unwrap();
        assert_eq!(name, exposure.name);
        // Times have six decimals.
        assert!((seconds.parse::<f64>().unwrap() - exposure.stamp_s).abs() < 1e-6);
        let (name, numbers) = pose.split_once(',').unwrap();
        let n: Vec<f64> = numbers.split(',').map(|number| number.parse().unwrap()).collect();
        let truth = drive.cam_from_world(camera, exposure.time_s);
        assert_eq!((name, n[0]), (exposure.name.as_str(), exposure.time_s));
        assert_eq!(
            UnitQuaternion::new_unchecked(Quaternion::new(n[1], n[2], n[3], n[4])),
            truth.rotation
        );
        assert_eq!(Vector3::new(n[5], n[6], n[7]), truth.translation);
    }
    assert_eq!(read("truth/left.tum").lines().count(), drive.cameras()[0].exposures.len());
    let offset = format!("right,clock_offset_s,{}", drive.cameras()[1].clock.offset_s);
    assert!(read("truth/cameras.csv").contains(&offset));
}

#[test]
fn the_lens_field_is_that_of_the_table() {
    let drive = drive("lens+lens-field".parse().unwrap());
    let camera = &drive.cameras()[1];
    let table = drive.cameras_csv();
    let rows = table.lines().filter_map(|line| line.strip_prefix("right,field_"));
    // The displacement of a pixel from its documented formula.
    let mut sum = Vector3::zeros();
    let pixel = Vector3::new(31.0, 77.5, 0.0);
    for row in rows {
        let (mode, value) = row.split_once(',').unwrap();
        let words: Vec<&str> = mode.split('_').collect();
        let waves: Vec<f64> = words[1..].iter().map(|word| word.parse().unwrap()).collect();
        let at = |k: usize, side: f64| (waves[k] * std::f64::consts::PI * pixel[k] / side).cos();
        let displacement = value.parse::<f64>().unwrap() * at(0, 160.0) * at(1, 120.0);
        sum[usize::from(words[0] == "y")] += displacement;
    }
    let Lens::WithField { lens, field } = &camera.lens else { panic!("no field") };
    assert!((field.at(&pixel.xy()) - sum.xy()).norm() < 1e-12);
    // 0.15 px over the image.
    assert!((0.01..0.6).contains(&sum.norm()), "{sum}");
    let ray = lens.unproject(&pixel.xy()).unwrap();
    assert!((camera.lens.project(&ray).unwrap() - (pixel + sum).xy()).norm() < 1e-9);
}

#[test]
fn rows_of_a_rolling_shutter_have_their_poses() {
    let global = drive(Effects::default());
    assert!(global.rows_csv().is_none());
    let drive = drive(Effects { readout_s: 0.02, ..Effects::default() });
    let rows = drive.rows_csv().unwrap();
    let exposure = &drive.cameras()[1].exposures[2];
    let of_image = rows.lines().filter_map(|line| line.strip_prefix(exposure.name.as_str()));
    let poses: Vec<(f64, Rigid3)> = of_image
        .map(|line| {
            let n: Vec<f64> = line[1..].split(',').map(|number| number.parse().unwrap()).collect();
            let q = UnitQuaternion::new_unchecked(Quaternion::new(n[1], n[2], n[3], n[4]));
            (n[0], Rigid3::new(q, Vector3::new(n[5], n[6], n[7])))
        })
        .collect();
    // The image has 120 rows, of which the middle is exposed at the time of the image.
    let steps = [0.5 / 120.0 - 0.5, 0.5 - 0.5 / 120.0];
    for ((y_px, pose), (height_px, step)) in poses.iter().zip([0.5, 119.5].into_iter().zip(steps)) {
        assert_eq!(*y_px, height_px);
        let expected = drive.cam_from_world(1, exposure.time_s + 0.02 * step);
        assert!((pose.translation - expected.translation).norm() < 1e-9);
        assert!(pose.rotation.angle_to(&expected.rotation) < 1e-9);
    }
    assert_eq!(poses.len(), 2);
    assert!((poses[0].1.origin_in_a() - poses[1].1.origin_in_a()).norm() > 0.01);
}

#[test]
fn unwritable_folder_is_an_error() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let error = drive(Effects::default()).write_tables(file.path()).unwrap_err();
    assert!(error.to_string().contains("timestamps.csv"), "{error}");
}
