//! Random consistent reconstructions for round trips.
#![allow(dead_code)] // each test binary uses a part

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
use tiepoint_scene::{
    Camera, CameraId, Frame, Image, ImageId, Keypoint, Observation, Reconstruction, Rig, RigId,
    RigSensor, Track,
};

/// Whether the model has a rig of several cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RigKind {
    SingleCameras,
    SeveralCameras,
}

pub(crate) fn vector(rng: &mut Rng, scale: f64) -> Vector3<f64> {
    Vector3::new(rng.normal(), rng.normal(), rng.normal()) * scale
}

pub(crate) fn pose(rng: &mut Rng) -> Rigid3 {
    Rigid3::from_axis_angle(vector(rng, 1.0), vector(rng, 10.0))
}

/// A model with random geometry and consistent observations. The poses of images in frames are
/// cam_from_rig · rig_from_world.
pub(crate) fn random_model(seed: u64, rig_kind: RigKind) -> Reconstruction {
    let mut rng = Rng::stream(seed, &[]);
    let mut model = Reconstruction::default();
    let cameras = 3 + rng.below(2);
    for _ in 0..cameras {
        let kind = CameraModelKind::ALL[rng.below(CameraModelKind::ALL.len())];
        let mut intrinsics = Intrinsics::centred(kind, 500.0 + rng.uniform(), 640, 480);
        for param in intrinsics.params_mut() {
            *param += 1e-3 * rng.normal();
        }
        model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: false });
    }
    let num_frames = 1 + rng.below(4);
    // The last camera is never in the rig.
    let num_rig_cameras = match rig_kind {
        RigKind::SingleCameras => 0,
        RigKind::SeveralCameras => cameras - 1,
    };
    if num_rig_cameras > 0 {
        let sensors = (0..num_rig_cameras).map(|camera| RigSensor {
            camera: CameraId::from_index(camera),
            cam_from_rig: Some(if camera == 0 { Rigid3::identity() } else { pose(&mut rng) }),
        });
        model.rigs.push(Rig { sensors: sensors.collect() });
    }
    for frame_index in 0..num_frames {
        let rig_from_world = pose(&mut rng);
        let mut members = Vec::new();
        for camera in 0..cameras {
            let keypoints = (0..rng.below(8)).map(|_| Keypoint {
                pixel: Vector2::new(640.0 * rng.uniform(), 480.0 * rng.uniform()),
                scale_px: 1.0,
            });
            let name = format!("{camera} é/{frame_index:06}.png");
            let image = Image::new(name, CameraId::from_index(camera), keypoints.collect());
            let id = model.add_image(image);
            if camera < num_rig_cameras {
                let sensor = model.rigs[0].sensors[camera];
                model.register(id, sensor.cam_from_rig.expect("set above") * rig_from_world);
                members.push(id);
            } else {
                model.register(id, pose(&mut rng));
            }
        }
        if !members.is_empty() {
            model.frames.push(Frame { rig: RigId(0), rig_from_world, images: members });
        }
    }
    let counts: Vec<usize> = model.images().map(|(_, image)| image.keypoints.len()).collect();
    for keypoint in 0..8 {
        let seen =
            (0..counts.len()).filter(|index| counts[*index] > keypoint && rng.uniform() < 0.7);
        let observations: Vec<_> = seen
            .map(|index| Observation {
                image: ImageId::from_index(index),
                keypoint: keypoint as u32,
            })
            .collect();
        if !observations.is_empty() {
            let color = [rng.below(256) as u8, rng.below(256) as u8, 7];
            model.add_track(Track { color, ..Track::new(vector(&mut rng, 5.0), observations) });
        }
    }
    model.validate().expect("made to be valid");
    model
}
