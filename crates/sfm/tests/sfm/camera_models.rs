//! Camera models of unknown lenses, on streets as features.

use tiepoint_geometry::CameraModelKind;
use tiepoint_scene::{CorrespondenceGraph, Reconstruction};
use tiepoint_sfm::{Mapper, MapperOptions};
use tiepoint_synth::{DriveOptions, Effects, FeatureScene, LensField, RouteKind};

use crate::lens::{LENS_FIELD_PX, begin_as_simple_radial, street_of};

/// Moments of two cameras.
const FRAMES: usize = 30;
const OBSERVATIONS_PER_FRAME: usize = 1000;

/// The first moments of a loop, without poses, and the matches. The cameras begin as SIMPLE_RADIAL.
pub(crate) fn street(
    frames: usize,
    has_action_lens: bool,
    lens_field_px: f64,
) -> (Reconstruction, CorrespondenceGraph, FeatureScene) {
    let effects = Effects { has_action_lens, ..Effects::default() };
    let route = RouteKind::Loop;
    let options = DriveOptions { rate_hz: 5.0, route, effects, ..DriveOptions::default() };
    let (_, scene, graph) = street_of(&options, frames, OBSERVATIONS_PER_FRAME * frames);
    let mut blank = scene.without_poses();
    if lens_field_px > 0.0 {
        LensField::displace_keypoints(&mut blank, lens_field_px, 1);
    }
    begin_as_simple_radial(&mut blank);
    (blank, graph, scene)
}

/// Relative error of the focal length on the axis. On rendered loops SIMPLE_RADIAL ends 20 % short
/// (docs/benchmarks/drives.md).
const MAX_FOCAL_ERROR: f64 = 0.05;

#[test]
fn an_action_lens_is_no_simple_one() {
    let (blank, graph, scene) = street(FRAMES, true, 0.0);
    for select_camera_models in [false, true] {
        let mapper = MapperOptions { select_camera_models, ..MapperOptions::default() };
        let models = Mapper::new(&graph, &blank).run(&mapper).expect("the scene is easy");
        let model = &models[0].reconstruction;
        for (id, camera) in model.cameras() {
            let kind = camera.intrinsics.kind();
            if !select_camera_models {
                assert_eq!(kind, CameraModelKind::SimpleRadial);
                continue;
            }
            assert_eq!(kind, CameraModelKind::OpencvFisheye);
            let true_focal_px = scene.truth().camera(id).intrinsics.mean_focal_px();
            let error = camera.intrinsics.mean_focal_px() / true_focal_px - 1.0;
            assert!(error.abs() < MAX_FOCAL_ERROR, "{error}");
            assert_eq!(model.num_registered(), 2 * FRAMES);
        }
    }
}

#[test]
fn lenses_that_are_simple_stay_so() {
    for lens_field_px in [0.0, LENS_FIELD_PX] {
        let (blank, graph, _) = street(FRAMES, false, lens_field_px);
        let mapper = MapperOptions { select_camera_models: true, ..MapperOptions::default() };
        let models = Mapper::new(&graph, &blank).run(&mapper).expect("the scene is easy");
        for (_, camera) in models[0].reconstruction.cameras() {
            assert_eq!(camera.intrinsics.kind(), CameraModelKind::SimpleRadial);
        }
    }
}
