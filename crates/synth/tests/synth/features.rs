//! Feature-level scenes are consistent with the street.

use tiepoint_scene::{ImageId, Reconstruction, TwoViewKind};
use tiepoint_synth::{
    Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions, Mount, PairMatches,
    ViewDirection,
};

const OBSERVATIONS: usize = 30_000;

fn drive(direction: ViewDirection) -> Drive {
    let mounts = Mount::stereo(direction, 0.5).to_vec();
    let options =
        DriveOptions { mounts, rate_hz: 3.0, width: 2000, height: 1500, ..DriveOptions::default() };
    Drive::new(&options).expect("the options are valid")
}

fn scene(drive: &Drive, options: &FeatureOptions) -> FeatureScene {
    FeatureScene::new(drive, options).expect("the options are valid")
}

fn sees_same_point(truth: &Reconstruction, made: &PairMatches, index: usize) -> bool {
    let m = made.matches[index];
    let [a, b] =
        [(made.pair.a, m.a), (made.pair.b, m.b)].map(|(image, k)| truth.image(image).point_of(k));
    a.is_some() && a == b
}

#[test]
fn tracks_lie_on_visible_surfaces() {
    let drive = drive(ViewDirection::FrontRight);
    let exact = scene(
        &drive,
        &FeatureOptions { noise_px: 0.0, observations: OBSERVATIONS, ..Default::default() },
    );
    let truth = exact.truth();
    truth.validate().unwrap();
    assert!((truth.num_observations() as f64 / OBSERVATIONS as f64 - 1.0).abs() < 0.1);
    assert_eq!(
        truth.num_registered(),
        drive.cameras().iter().map(|c| c.exposures.len()).sum::<usize>()
    );
    // Projection in double precision.
    assert!(truth.mean_reprojection_error_px() < 1e-9, "{}", truth.mean_reprojection_error_px());
    let exposures = drive.cameras().iter().enumerate();
    let exposures: Vec<(usize, f64)> = exposures
        .flat_map(|(c, camera)| camera.exposures.iter().map(move |e| (c, e.time_s)))
        .collect();
    for (_, track) in truth.tracks().step_by(7) {
        for observation in &track.observations {
            let (camera, time_s) = exposures[observation.image.index()];
            let pixel =
                truth.image(observation.image).keypoints[observation.keypoint as usize].pixel;
            let seen = drive.surface_at(camera, time_s, &pixel).expect("something");
            // The tolerance of the occlusion test: 2 ‰ of at most 60 m.
            let apart = (seen.point_in_world - track.xyz).norm();
            assert!(
                apart < 0.13 || seen.distance > (track.xyz - seen.point_in_world).norm(),
                "{apart} m"
            );
            assert!(apart < 0.5, "{apart} m");
        }
    }
}

#[test]
fn keypoint_noise_has_its_standard_deviation() {
    let options =
        FeatureOptions { noise_px: 0.8, observations: OBSERVATIONS, ..Default::default() };
    let truth = scene(&drive(ViewDirection::Right), &options);
    let truth = truth.truth();
    let (mut sum, mut count) = (0.0, 0);
    for (point, track) in truth.tracks() {
        for (index, observation) in track.observations.iter().enumerate() {
            let keypoint = truth.image(observation.image).keypoints[observation.keypoint as usize];
            let error =
                truth.reprojection_error_px(point, index).expect("the truth sees its points");
            sum += error * error / (2.0 * f64::from(keypoint.scale_px) / 2.0);
            count += 1;
        }
    }
    // 60,000 components: the standard deviation is known to 0.3 %.
    let deviation = (sum / f64::from(count)).sqrt();
    assert!((deviation / options.noise_px - 1.0).abs() < 0.02, "{deviation}");
}

#[test]
fn outlier_ratio_and_verification_are_as_requested() {
    let options =
        FeatureOptions { observations: OBSERVATIONS, wrong_pairs: 3, ..Default::default() };
    let scene = scene(&drive(ViewDirection::Front), &options);
    let made = scene.matches(&MatchOptions { outlier_ratio: 0.25, ..MatchOptions::default() });
    assert!(made.is_sorted_by_key(|made| made.pair) && made.len() > 500, "{} pairs", made.len());
    let wrong_pairs: Vec<_> = scene.wrong_pairs().collect();
    assert_eq!(wrong_pairs.len(), 3);
    let (mut all, mut right, mut verified, mut verified_right) = (0, 0, 0, 0);
    for pair in made.iter().filter(|made| !wrong_pairs.contains(&made.pair)) {
        all += pair.matches.len();
        right +=
            (0..pair.matches.len()).filter(|&k| sees_same_point(scene.truth(), pair, k)).count();
        verified += pair.two_view.matches.len();
        let kept = PairMatches { matches: pair.two_view.matches.clone(), ..pair.clone() };
        verified_right +=
            (0..kept.matches.len()).filter(|&k| sees_same_point(scene.truth(), &kept, k)).count();
        assert!(pair.two_view.is_verified());
        let mut keypoints: Vec<u32> = pair.matches.iter().map(|m| m.a).collect();
        keypoints.dedup();
        assert_eq!(keypoints.len(), pair.matches.len(), "a keypoint was matched twice");
    }
    // Tens of thousands of matches; a few wrong ones are dropped because their keypoints are
    // matched.
    let share = 1.0 - f64::from(right as u32) / f64::from(all as u32);
    assert!((0.2..0.26).contains(&share), "{share} are wrong");
    assert_eq!(right, verified_right, "the verification loses nothing that is right");
    let slipped = 1.0 - verified_right as f64 / verified as f64;
    assert!(slipped < 0.02, "{slipped} of the verified are wrong");
    // The visually aliased pairs support their wrong geometry and have no common points.
    for pair in wrong_pairs {
        let index = made.binary_search_by_key(&pair, |made| made.pair).expect("it is listed");
        assert!(made[index].two_view.matches.len() >= 40);
        assert!((0..made[index].matches.len()).all(|k| !sees_same_point(
            scene.truth(),
            &made[index],
            k
        )));
        check_geometry(scene.truth(), &made[index]);
    }
    for pair in made.iter().step_by(50) {
        check_geometry(scene.truth(), pair);
    }
}

/// Checks that verified matches are near their epipolar lines.
fn check_geometry(truth: &Reconstruction, made: &PairMatches) {
    // Four standard deviations of the noise, which grows from 0.5 px at scale 2 to 1.4 px at scale
    // 16.
    const LIMIT_PX: f64 = 6.0;
    let (Some(f), Some(pose)) = (made.two_view.fundamental, made.two_view.cam2_from_cam1) else {
        assert_eq!(made.two_view.kind, TwoViewKind::Panoramic);
        return;
    };
    assert!((pose.translation.norm() - 1.0).abs() < 1e-9);
    for m in &made.two_view.matches {
        let pixel =
            |image: ImageId, k: u32| truth.image(image).keypoints[k as usize].pixel.push(1.0);
        let line = f * pixel(made.pair.a, m.a);
        let distance = line.dot(&pixel(made.pair.b, m.b)).abs() / line.xy().norm();
        assert!(distance < 3.0 * LIMIT_PX, "{distance} px");
    }
}

#[test]
fn input_of_a_mapper_has_neither_poses_nor_points() {
    let scene = scene(
        &drive(ViewDirection::Left),
        &FeatureOptions { observations: 5_000, ..Default::default() },
    );
    let blank = scene.without_poses();
    assert_eq!((blank.num_registered(), blank.num_tracks()), (0, 0));
    for ((_, image), (_, known)) in blank.images().zip(scene.truth().images()) {
        assert_eq!(
            (&image.name, image.time_s, &image.keypoints),
            (&known.name, known.time_s, &known.keypoints)
        );
        assert!(image.time_s.is_some());
    }
}

#[test]
fn scene_is_independent_of_the_number_of_threads() {
    let drive = drive(ViewDirection::Right);
    let options = FeatureOptions { observations: 5_000, wrong_pairs: 1, ..Default::default() };
    let make = || {
        let scene = scene(&drive, &options);
        (scene.matches(&MatchOptions::default()), scene.truth().clone())
    };
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(make)
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_eq!(one, on(5));
}
