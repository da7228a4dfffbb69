//! A drive, and its true model.

use tiepoint_pipeline::eval::geometry::nalgebra::Vector2;
use tiepoint_pipeline::sfm::scene::{Image, ImageId, Keypoint, Observation, Reconstruction, Track};
use tiepoint_synth::{Drive, DriveOptions};

/// Rounding of projection and ray casting at distances up to 100 m.
pub(crate) const TOLERANCE_M: f64 = 1e-5;

pub(crate) fn drive(effects: &str) -> Drive {
    let options = DriveOptions {
        effects: effects.parse().unwrap(),
        length_m: 160.0,
        ..DriveOptions::default()
    };
    let mut drive = Drive::new(&options).unwrap();
    drive.keep_first(30);
    drive
}

/// The true model with the surface points at a grid of pixels of the left camera that the right
/// camera sees as well.
pub(crate) fn truth_with_points(drive: &Drive) -> Reconstruction {
    let bare = drive.truth();
    let mut keypoints: Vec<Vec<Keypoint>> = bare.images().map(|_| Vec::new()).collect();
    let mut tracks = Vec::new();
    let frames = drive.cameras()[0].exposures.len().min(drive.cameras()[1].exposures.len());
    for frame in 0..frames {
        for cell in 0..80u32 {
            let pixel = Vector2::new(
                f64::from(cell % 10) * 60.0 + 40.0,
                f64::from(cell / 10) * 50.0 + 60.0,
            );
            let times = [0, 1].map(|camera| drive.cameras()[camera].exposures[frame].time_s);
            let Some(seen) = drive.surface_at(0, times[0], &pixel).filter(|seen| !seen.is_moving)
            else {
                continue;
            };
            let Some(other) = drive.project(1, times[1], &seen.point_in_world) else { continue };
            let is_same = drive.surface_at(1, times[1], &other).is_some_and(|back| {
                (back.point_in_world - seen.point_in_world).norm() < TOLERANCE_M
            });
            if !is_same {
                continue;
            }
            let images = [frame, drive.cameras()[0].exposures.len() + frame];
            let observe = |(image, pixel): (usize, Vector2<f64>)| {
                keypoints[image].push(Keypoint { pixel, scale_px: 1.0 });
                let keypoint = keypoints[image].len() as u32 - 1;
                Observation { image: ImageId(image as u32), keypoint }
            };
            let observations = images.into_iter().zip([pixel, other]).map(observe).collect();
            tracks.push((seen.point_in_world, observations));
        }
    }
    let mut model = Reconstruction::default();
    for (_, camera) in bare.cameras() {
        model.add_camera(*camera);
    }
    for ((_, image), keypoints) in bare.images().zip(keypoints) {
        let id = model.add_image(Image::new(image.name.clone(), image.camera, keypoints));
        model.set_time(id, image.time_s);
        model.register(id, *image.cam_from_world().unwrap());
    }
    for (xyz, observations) in tracks {
        model.add_track(Track::new(xyz, observations));
    }
    model.validate().unwrap();
    model
}
