//! [`Reconstruction::validate`] reports each broken invariant and accepts COLMAP's models.
#![allow(clippy::unwrap_used)]

use tiepoint_geometry::nalgebra::{Quaternion, UnitQuaternion, Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
use tiepoint_scene::{
    Camera, CameraId, Frame, Image, ImageId, Keypoint, Observation, Reconstruction, Rig, RigId,
    RigSensor, Track,
};

const KEYPOINTS: usize = 3;

fn camera() -> Camera {
    let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
    Camera { intrinsics, width: 640, height: 480, has_focal_prior: false }
}

fn right_from_left() -> Rigid3 {
    Rigid3::from_axis_angle(Vector3::new(0.0, 0.1, 0.0), Vector3::new(-0.5, 0.0, 0.0))
}

fn rig_from_world(frame: u32) -> Rigid3 {
    Rigid3::from_axis_angle(Vector3::new(0.0, 0.0, 0.2), Vector3::new(0.0, 0.0, -f64::from(frame)))
}

/// Cameras 0 and 1 on a rig, camera 2 on none. Images 0 and 1 are frame 0, images 2 and 3 frame 1.
/// Image 4 is of camera 2. Image 5 of camera 0 is not registered. One track, in images 0, 1 and 4.
fn model() -> Reconstruction {
    let mut model = Reconstruction::default();
    let cameras = [0; 3].map(|_| model.add_camera(camera()));
    model.rigs.push(Rig {
        sensors: vec![
            RigSensor { camera: cameras[0], cam_from_rig: None },
            RigSensor { camera: cameras[1], cam_from_rig: Some(right_from_left()) },
        ],
    });
    let keypoint = Keypoint { pixel: Vector2::new(320.0, 240.0), scale_px: 2.0 };
    for (index, camera) in [0, 1, 0, 1, 2, 0].into_iter().enumerate() {
        model.add_image(Image::new(
            format!("{index}.jpg"),
            cameras[camera],
            vec![keypoint; KEYPOINTS],
        ));
    }
    for frame in 0..2 {
        let images = [ImageId(2 * frame), ImageId(2 * frame + 1)];
        model.register(images[0], rig_from_world(frame));
        model.register(images[1], right_from_left() * rig_from_world(frame));
        let rig_from_world = rig_from_world(frame);
        model.frames.push(Frame { rig: RigId(0), rig_from_world, images: images.to_vec() });
    }
    model.register(ImageId(4), Rigid3::identity());
    model.add_track(Track::new(
        Vector3::new(0.0, 0.0, 9.0),
        [0, 1, 4].map(|image| seen(image, 0)).to_vec(),
    ));
    model
}

fn seen(image: u32, keypoint: u32) -> Observation {
    Observation { image: ImageId(image), keypoint }
}

fn not_unit() -> Rigid3 {
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(1.0, 0.1, 0.0, 0.0));
    Rigid3::new(rotation, Vector3::zeros())
}

#[test]
fn a_valid_model_passes() {
    model().validate().unwrap();
    let mut model = model();
    // The reference sensor may have the identity instead of `None`, and a rig may have no frame.
    model.rigs[0].sensors[0].cam_from_rig = Some(Rigid3::identity());
    model.rigs.push(Rig { sensors: vec![RigSensor { camera: CameraId(2), cam_from_rig: None }] });
    model.validate().unwrap();
}

#[test]
fn each_broken_invariant_is_reported() {
    type Break = fn(&mut Reconstruction);
    let faults: [(&str, Break); 19] = [
        ("a focal length of camera 1 is -2, and not above zero", |model| {
            model.camera_mut(CameraId(1)).intrinsics.params_mut()[0] = -2.0;
        }),
        ("rig 1 has no camera", |model| model.rigs.push(Rig::default())),
        ("rig 0 has camera 7, but there are 3 cameras", |model| {
            model.rigs[0].sensors[1].camera = CameraId(7);
        }),
        ("camera 0 is on two rigs, or twice on one", |model| {
            let sensors = vec![RigSensor { camera: CameraId(0), cam_from_rig: None }];
            model.rigs.push(Rig { sensors });
        }),
        ("camera 0 is on two rigs, or twice on one", |model| {
            model.rigs[0].sensors.push(RigSensor { camera: CameraId(0), cam_from_rig: None });
        }),
        (
            "the first camera of rig 0 is its reference and has another pose than the \
            identity",
            |model| {
                model.rigs[0].sensors[0].cam_from_rig = Some(right_from_left());
            },
        ),
        ("the pose of camera 1 on rig 0 is not finite", |model| {
            model.rigs[0].sensors[1].cam_from_rig.as_mut().unwrap().translation.x = f64::NAN;
        }),
        ("the rotation of camera 1 on rig 0 is no unit quaternion", |model| {
            model.rigs[0].sensors[1].cam_from_rig = Some(not_unit());
        }),
        ("frame 1 is of rig 3, but there are 1 rigs", |model| {
            model.frames[1].rig = RigId(3);
        }),
        ("the pose of frame 0 is not finite", |model| {
            model.frames[0].rig_from_world.translation.y = f64::INFINITY;
        }),
        ("the rotation of frame 0 is no unit quaternion", |model| {
            model.frames[0].rig_from_world = not_unit();
        }),
        ("frame 0 holds image 9, but there are 6 images", |model| {
            model.frames[0].images.push(ImageId(9));
        }),
        ("frame 0 holds image 4, whose camera is not on its rig", |model| {
            model.frames[0].images.push(ImageId(4));
        }),
        ("image 1 is in two frames, or twice in one", |model| {
            model.frames[1].images = vec![ImageId(1)];
        }),
        ("frame 0 holds two images of camera 0", |model| {
            model.frames[0].images.push(ImageId(5));
        }),
        ("frame 1 holds image 5, which has no pose", |model| {
            model.frames[1].images = vec![ImageId(5)];
        }),
        ("the pose of image 2 is not the one that its frame and rig give it", |model| {
            model.frames[1].rig_from_world.translation.x += 1e-4;
        }),
        ("the pose of image 1 is not the one that its frame and rig give it", |model| {
            model.rigs[0].sensors[1].cam_from_rig = None;
        }),
        ("the rotation of image 4 is no unit quaternion", |model| {
            model.register(ImageId(4), not_unit());
        }),
    ];
    for (expected, fault) in faults {
        let mut model = model();
        fault(&mut model);
        let error = model.validate().expect_err(expected);
        assert_eq!(error.to_string(), expected);
    }
}

#[test]
fn a_pose_may_differ_from_its_frames_by_rounding() {
    let mut model = model();
    for frame in &mut model.frames {
        frame.rig_from_world.translation.x += 1e-9;
    }
    model.validate().unwrap();
}
