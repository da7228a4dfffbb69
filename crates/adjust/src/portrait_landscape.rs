//! Two cameras that are one lens in portrait and landscape format: their images are rotated by 90°
//! against each other, because the program that wrote them rotated the pixels upright.
//!
//! Turning an image exchanges the focal lengths and keeps the coefficients of the radial
//! distortion. The cameras share these ([`crate::shared_lens`]). The principal point and the other
//! distortion parameters stay separate: they depend on the sense of the rotation, which is unknown.

use std::any::Any;

use tiepoint_ba::{Key, Problem};
use tiepoint_geometry::{Loss, with_camera_model};
use tiepoint_scene::{CameraId, Reconstruction};

use crate::Error;
use crate::shared_lens::{shared_lens, shared_params};

/// The key of a camera's parameters. Its type depends on the camera model.
pub(crate) type CameraKey = (CameraId, Box<dyn Any>);

/// Adds the factors of the cameras of a pair that are both in the problem.
pub(crate) fn add_portrait_landscape(
    problem: &mut Problem,
    model: &Reconstruction,
    keys: &[CameraKey],
) -> Result<(), Error> {
    let key_of = |camera: CameraId| keys.iter().find(|(id, _)| *id == camera).map(|(_, key)| key);
    for &[one, other] in &model.portrait_landscape_pairs {
        let (Some(key1), Some(key2)) = (key_of(one), key_of(other)) else { continue };
        let intrinsics = &model.camera(one).intrinsics;
        let is_fixed = |camera| model.calibrated.contains(&camera);
        if intrinsics.kind() != model.camera(other).intrinsics.kind()
            || is_fixed(one)
            || is_fixed(other)
        {
            continue;
        }
        with_camera_model!(intrinsics, M, params => {
            type Params<M> = <M as tiepoint_geometry::CameraModel>::Params;
            if let (Some(key1), Some(key2)) = (
                key1.downcast_ref::<Key<Params<M>>>(),
                key2.downcast_ref::<Key<Params<M>>>(),
            ) {
                let factor = shared_lens(intrinsics, params);
                problem.add((*key1, *key2), factor, Loss::Trivial)?;
            }
        });
    }
    Ok(())
}

/// Copies the shared parameters to cameras that no registered image has yet, so that their first
/// image is registered with the lens as it is known.
pub(crate) fn copy_to_unused(model: &mut Reconstruction) {
    let is_used = |model: &Reconstruction, camera: CameraId| {
        model.registered().any(|(_, image, _)| image.camera == camera)
    };
    for [one, other] in model.portrait_landscape_pairs.clone() {
        let (from, to) = match (is_used(model, one), is_used(model, other)) {
            (true, false) => (one, other),
            (false, true) => (other, one),
            _ => continue,
        };
        let source = model.camera(from).intrinsics;
        let is_same_kind = source.kind() == model.camera(to).intrinsics.kind();
        if !is_same_kind || model.calibrated.contains(&to) {
            continue;
        }
        for (i, j) in shared_params(source.kind()) {
            model.camera_mut(to).intrinsics.params_mut()[j] = source.params()[i];
        }
    }
}
