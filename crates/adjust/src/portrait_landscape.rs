//! Two cameras that are one lens in portrait and landscape format: their images are rotated by 90°
//! against each other, because the program that wrote them rotated the pixels upright.
//!
//! Turning an image exchanges the focal lengths and keeps the coefficients of the radial
//! distortion. The cameras share these up to [`SIGMA`]. The principal point and the other
//! distortion parameters stay separate: they depend on the sense of the rotation, which is unknown.

use std::any::Any;

use tiepoint_ba::{Factor, Key, Linear, Problem};
use tiepoint_geometry::nalgebra::{SMatrix, SVector};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Loss, with_camera_model};
use tiepoint_scene::{CameraId, Reconstruction};

use crate::Error;

/// Standard deviation of the relation: relative for focal lengths, absolute for coefficients. A
/// value ten times as large suffices for a million keypoints, as for the ratio of focal lengths.
const SIGMA: f64 = 1e-6;

/// A parameter that the two cameras share: its index in the one and in the other camera.
type SharedParam = (usize, usize);

/// The shared parameters of a camera model.
fn shared_params(kind: CameraModelKind) -> Vec<SharedParam> {
    let focal = match *kind.focal_indices() {
        [x, y] => vec![(x, y), (y, x)],
        ref single => single.iter().map(|&index| (index, index)).collect(),
    };
    // Radial coefficients are k, k1, k2, …, omega of FOV, alpha and beta of EUCM.
    let is_radial = |name: &str| {
        ["omega", "alpha", "beta"].contains(&name)
            || name.strip_prefix('k').is_some_and(|n| n.bytes().all(|b| b.is_ascii_digit()))
    };
    let radial = kind.param_names().iter().enumerate().filter(|(_, name)| is_radial(name));
    focal.into_iter().chain(radial.map(|(index, _)| (index, index))).collect()
}

/// Residual of the parameters that the two cameras share.
struct SharedLens<const N: usize> {
    shared: Vec<SharedParam>,
    /// Reciprocal standard deviation of each parameter of the second camera.
    weights: SVector<f64, N>,
}

impl<const N: usize> Factor<N> for SharedLens<N> {
    type Vars = (SVector<f64, N>, SVector<f64, N>);

    fn linearize(
        &self,
        (one, other): (&SVector<f64, N>, &SVector<f64, N>),
    ) -> Option<Linear<Self::Vars, N>> {
        let mut residual = SVector::<f64, N>::zeros();
        let mut by_one = SMatrix::<f64, N, N>::zeros();
        let mut by_other = SMatrix::<f64, N, N>::zeros();
        for &(i, j) in &self.shared {
            let weight = self.weights[j];
            residual[j] = weight * (other[j] - one[i]);
            (by_one[(j, i)], by_other[(j, j)]) = (-weight, weight);
        }
        Some((residual, (by_one, by_other)))
    }
}

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

/// The factor at these intrinsics.
fn shared_lens<const N: usize>(intrinsics: &Intrinsics, params: &SVector<f64, N>) -> SharedLens<N> {
    let kind = intrinsics.kind();
    let sigma = |index: usize| {
        if kind.focal_indices().contains(&index) { SIGMA * params[index] } else { SIGMA }
    };
    let weights = SVector::from_fn(|index, _| 1.0 / sigma(index));
    SharedLens { shared: shared_params(kind), weights }
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
