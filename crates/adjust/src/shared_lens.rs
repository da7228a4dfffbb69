//! The factor between two cameras that are one lens in portrait and landscape format. Its test
//! includes this file, since it is no part of the interface.

use tiepoint_ba::Factor;
use tiepoint_ba::factor::Linear;
use tiepoint_geometry::nalgebra::{SMatrix, SVector};
use tiepoint_geometry::{CameraModelKind, Intrinsics};

/// Standard deviation of the relation: relative for focal lengths, absolute for coefficients. A
/// value ten times as large suffices for a million keypoints, as for the ratio of focal lengths.
const SIGMA: f64 = 1e-6;

/// A parameter that the two cameras share: its index in the one and in the other camera.
pub(crate) type SharedParam = (usize, usize);

/// The shared parameters of a camera model.
pub(crate) fn shared_params(kind: CameraModelKind) -> Vec<SharedParam> {
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
pub(crate) struct SharedLens<const N: usize> {
    shared: Vec<SharedParam>,
    /// Reciprocal standard deviation of each parameter of the second camera.
    pub(crate) weights: SVector<f64, N>,
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

/// The factor at these intrinsics.
pub(crate) fn shared_lens<const N: usize>(
    intrinsics: &Intrinsics,
    params: &SVector<f64, N>,
) -> SharedLens<N> {
    let kind = intrinsics.kind();
    let sigma = |index: usize| {
        if kind.focal_indices().contains(&index) { SIGMA * params[index] } else { SIGMA }
    };
    let weights = SVector::from_fn(|index, _| 1.0 / sigma(index));
    SharedLens { shared: shared_params(kind), weights }
}
