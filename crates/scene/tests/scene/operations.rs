//! Every sequence of operations leaves a valid model: keypoints and tracks are consistent, and
//! images are in the frames that their poses are composed of.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Sim3};
use tiepoint_scene::{
    Camera, CameraId, Frame, Image, ImageId, Keypoint, Observation, PointId, Reconstruction, Rig,
    RigId, RigSensor, Track,
};

const FRAMES: u32 = 3;
/// Left and right images of each frame, and two of a camera that is on no rig.
const IMAGES: u32 = 2 * FRAMES + 2;
const KEYPOINTS: u32 = 5;

#[derive(Clone, Debug)]
enum Operation {
    Register(ImageId, Vector3<f64>),
    Deregister(ImageId),
    AddTrack(Vec<Observation>),
    DeleteTrack(PointId),
    AddObservation(PointId, Observation),
    RemoveObservation(Observation),
    Merge(PointId, PointId),
    Transform(f64, Vector3<f64>),
}

fn operation() -> impl Strategy<Value = Operation> {
    let image = (0..IMAGES).prop_map(ImageId);
    let observation = (0..IMAGES, 0..KEYPOINTS)
        .prop_map(|(image, keypoint)| Observation { image: ImageId(image), keypoint });
    // The range includes ids of points that do not exist.
    let point = (0..12u32).prop_map(PointId);
    let vector = [-1.0..1.0, -1.0..1.0, -1.0..1.0].prop_map(Vector3::from);
    prop_oneof![
        2 => (image.clone(), vector.clone()).prop_map(|(image, v)| Operation::Register(image, v)),
        1 => image.prop_map(Operation::Deregister),
        4 => prop::collection::vec(observation.clone(), 0..6).prop_map(Operation::AddTrack),
        1 => point.clone().prop_map(Operation::DeleteTrack),
        4 => (point.clone(), observation.clone())
            .prop_map(|(p, o)| Operation::AddObservation(p, o)),
        2 => observation.prop_map(Operation::RemoveObservation),
        2 => (point.clone(), point).prop_map(|(one, other)| Operation::Merge(one, other)),
        1 => (0.5..2.0, vector).prop_map(|(scale, v)| Operation::Transform(scale, v)),
    ]
}

/// The images of the rig are registered and in frames. The last two images are not registered.
fn model() -> Reconstruction {
    let mut model = Reconstruction::default();
    let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
    let cameras = [0; 3].map(|_| {
        model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: false })
    });
    let add = |model: &mut Reconstruction, camera: CameraId| {
        let keypoint = Keypoint { pixel: Vector2::new(320.0, 240.0), scale_px: 2.0 };
        model.add_image(Image::new("", camera, vec![keypoint; KEYPOINTS as usize]))
    };
    let cam_from_rig =
        Rigid3::from_axis_angle(Vector3::new(0.0, 0.1, 0.0), Vector3::new(-0.5, 0.0, 0.0));
    model.rigs.push(Rig {
        sensors: vec![
            RigSensor { camera: cameras[0], cam_from_rig: Some(Rigid3::identity()) },
            RigSensor { camera: cameras[1], cam_from_rig: Some(cam_from_rig) },
        ],
    });
    for frame in 0..FRAMES {
        let rig_from_world =
            Rigid3::new(Default::default(), Vector3::new(0.0, 0.0, -f64::from(frame)));
        let images = vec![add(&mut model, cameras[0]), add(&mut model, cameras[1])];
        model.register(images[0], rig_from_world);
        model.register(images[1], cam_from_rig * rig_from_world);
        model.frames.push(Frame { rig: RigId(0), rig_from_world, images });
    }
    add(&mut model, cameras[2]);
    add(&mut model, cameras[2]);
    model
}

fn apply(model: &mut Reconstruction, operation: &Operation) {
    let has_pose =
        |model: &Reconstruction, o: &Observation| model.image(o.image).cam_from_world().is_some();
    match operation {
        Operation::Register(image, v) => model.register(*image, Rigid3::from_axis_angle(*v, *v)),
        Operation::Deregister(image) => model.deregister(*image),
        Operation::AddTrack(observations) => {
            // Precondition of `add_track`: keypoints of registered images without a point, each
            // once.
            let mut free = observations.clone();
            free.sort_unstable();
            free.dedup();
            free.retain(|o| {
                has_pose(model, o) && model.image(o.image).point_of(o.keypoint).is_none()
            });
            model.add_track(Track::new(Vector3::z(), free));
        }
        Operation::DeleteTrack(point) => model.delete_track(*point),
        Operation::AddObservation(point, observation) => {
            if has_pose(model, observation) {
                model.add_observation(*point, *observation);
            }
        }
        Operation::RemoveObservation(observation) => model.remove_observation(*observation),
        Operation::Merge(one, other) => {
            let lengths =
                [one, other].map(|point| model.track(*point).map(|track| track.observations.len()));
            let merged = model.merge_tracks(*one, *other, Vector3::z());
            let both = lengths[0].zip(lengths[1]).filter(|_| one != other);
            assert_eq!(merged.is_some(), both.is_some());
            if let (Some(merged), Some((a, b))) = (merged, both) {
                assert!(model.track(*one).is_none() && model.track(*other).is_none());
                assert_eq!(model.track(merged).unwrap().observations.len(), a + b);
            }
        }
        Operation::Transform(scale, v) => {
            let Rigid3 { rotation, translation } = Rigid3::from_axis_angle(*v, *v);
            model.transform(&Sim3 { scale: *scale, rotation, translation });
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 256,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn every_operation_leaves_a_valid_model(
        operations in prop::collection::vec(operation(), 1..60),
    ) {
        let mut model = model();
        for operation in &operations {
            apply(&mut model, operation);
            if let Err(error) = model.validate() {
                prop_assert!(false, "{operation:?}: {error}");
            }
        }
        let seen: usize = model.images().map(|(_, image)| image.num_points()).sum();
        prop_assert_eq!(seen, model.num_observations());
        prop_assert_eq!(model.tracks().count(), model.num_tracks());
    }
}

/// The first image of each frame is of the left camera.
#[test]
fn an_image_with_a_new_pose_leaves_its_frame() {
    let (mut model, [left, right]) = (model(), [ImageId(0), ImageId(1)]);
    let pose = *model.image(right).cam_from_world().unwrap();
    model.register(right, pose);
    assert_eq!(model.frames[0].images, [left, right], "the same pose");
    model.register(right, Rigid3::identity());
    assert_eq!(model.frames[0].images, [left]);
    model.deregister(left);
    assert_eq!(model.frames.len(), FRAMES as usize - 1, "no frame is empty");
    assert_eq!(
        model.image(right).cam_from_world(),
        Some(&Rigid3::identity()),
        "the other image stays"
    );
    model.validate().unwrap();
}

#[test]
fn a_track_with_one_observation_is_deleted_and_deregistering_frees_keypoints() {
    let mut model = model();
    let seen = |image| Observation { image: ImageId(image), keypoint: 1 };
    let long = model.add_track(Track::new(Vector3::z(), vec![seen(0), seen(1), seen(2)]));
    model.remove_observation(seen(1));
    assert_eq!(model.track(long).unwrap().observations, [seen(0), seen(2)]);
    assert_eq!(model.image(ImageId(1)).point_of(1), None);
    model.add_observation(long, seen(1));
    let other = Observation { image: ImageId(1), keypoint: 2 };
    let short = model
        .add_track(Track::new(Vector3::z(), vec![other, Observation { keypoint: 2, ..seen(2) }]));
    model.add_observation(short, seen(0));
    assert_eq!(model.image(ImageId(0)).point_of(1), Some(long), "it sees a point already");
    model.deregister(ImageId(1));
    assert_eq!(model.track(long).unwrap().observations, [seen(0), seen(2)]);
    assert_eq!((model.track(short), model.num_tracks(), model.point_id_bound()), (None, 1, 2));
    assert_eq!(model.image(ImageId(2)).points()[1..3], [Some(long), None]);
    model.validate().unwrap();
}

#[test]
fn the_error_of_no_point_is_zero_without_a_sign() {
    let error = Reconstruction::default().mean_reprojection_error_px();
    assert_eq!(format!("{error:.4}"), "0.0000");
}
