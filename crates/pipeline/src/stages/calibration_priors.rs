//! Calibrations as priors of bundle adjustment.
//!
//! A calibration is not exact: its lens has changed since, or its lens model leaves a part of the
//! image out. Rectified images are an example: the calibration says that they have no distortion,
//! and what the rectification left is a tenth of a pixel or two, the same in all images.

use std::collections::BTreeMap;

use tiepoint_sfm::geometry::Intrinsics;
use tiepoint_sfm::scene::{CameraId, IntrinsicsPrior, Reconstruction};

/// The intrinsics of calibrated cameras.
pub(crate) fn calibrations_of(scene: &Reconstruction) -> BTreeMap<CameraId, Intrinsics> {
    scene.calibrated.iter().map(|&id| (id, scene.camera(id).intrinsics)).collect()
}

/// Gives cameras a prior at their calibrations. Where distortion is refined, models without
/// distortion become those of the same projection with distortion.
pub(crate) fn set_calibration_priors(
    scene: &mut Reconstruction,
    calibrations: &BTreeMap<CameraId, Intrinsics>,
    refines_distortion: bool,
    sigma_px: f64,
) {
    for (&id, calibration) in calibrations {
        let camera = scene.camera_mut(id);
        let mut mean = *calibration;
        if refines_distortion {
            mean = mean.with_distortion();
            camera.intrinsics = camera.intrinsics.with_distortion();
        }
        let prior = IntrinsicsPrior::new(mean, camera.width, camera.height, sigma_px);
        scene.intrinsics_priors.insert(id, prior);
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_sfm::geometry::CameraModelKind;
    use tiepoint_sfm::scene::Camera;

    use super::*;

    fn scene() -> Reconstruction {
        let mut scene = Reconstruction::default();
        for kind in [CameraModelKind::Pinhole, CameraModelKind::SimpleRadial] {
            let intrinsics = Intrinsics::centred(kind, 500.0, 640, 480);
            scene.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        }
        scene.calibrated = [CameraId(0), CameraId(1)].into();
        scene
    }

    #[test]
    fn a_pinhole_gets_distortion_where_it_is_refined() {
        for (refines, kind) in [(true, CameraModelKind::Opencv), (false, CameraModelKind::Pinhole)]
        {
            let mut scene = scene();
            let calibrations = calibrations_of(&scene);
            set_calibration_priors(&mut scene, &calibrations, refines, 1.0);
            let kinds = [kind, CameraModelKind::SimpleRadial];
            for (id, kind) in [CameraId(0), CameraId(1)].into_iter().zip(kinds) {
                let intrinsics = scene.camera(id).intrinsics;
                assert_eq!(intrinsics.kind(), kind);
                assert_eq!(scene.intrinsics_priors[&id].mean, intrinsics);
                assert_eq!(intrinsics.focal_lengths_px(), [500.0; 2]);
            }
        }
    }
}
