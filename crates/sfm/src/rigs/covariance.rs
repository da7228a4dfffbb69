//! Covariance of the rig extrinsics and clocks.

use tiepoint_adjust::{
    AdjustOptions, FitNoise, Scope, Term, build_problem, covariance_of_fit,
    without_points_at_infinity,
};
use tiepoint_ba::{AnyKey, Key};
use tiepoint_geometry::{Rigid3, so3};
use tiepoint_rig::Clock;
use tiepoint_scene::Reconstruction;

use super::extrinsics::{ExtrinsicsCovariance, RigExtrinsics};
use super::extrinsics_term::ExtrinsicsTerm;
use crate::Error;
use crate::terms::with_terms;

/// Returns the covariance of each camera's extrinsics and clock; `None` if the information matrix
/// is singular. Entries of constant parameters are zero. The residuals of keypoints may be
/// correlated ([`covariance_of_fit`]). Those of a soft constraint are too small to state the
/// uncertainty of the mount, so their standard deviations count, increased by the autocorrelation
/// of the residuals.
pub(super) fn extrinsics_covariances(
    model: &Reconstruction,
    options: &AdjustOptions,
    all_extrinsics: &[RigExtrinsics],
    terms: &mut [&mut dyn Term],
) -> Result<Vec<Option<ExtrinsicsCovariance>>, Error> {
    let model = &without_points_at_infinity(model);
    let noise = FitNoise::of(model, &options.loss);
    let options = &AdjustOptions { noise: noise.sigma, select_tracks: false, ..*options };
    let mut scaled: Vec<RigExtrinsics> = all_extrinsics
        .iter()
        .map(|extrinsics| extrinsics.with_autocorrelation(model).scaled(1.0 / noise.sigma))
        .collect();
    let mut term = ExtrinsicsTerm::new(&mut scaled);
    let terms = &mut with_terms(&mut term, terms);
    let variables = build_problem(model, &Scope::Global, options, terms)?;
    let of = |(extrinsics, clock): &(Key<Rigid3>, Option<Key<Clock>>)| {
        let mut keys: Vec<AnyKey> = vec![(*extrinsics).into()];
        keys.extend(clock.map(AnyKey::from));
        let found = covariance_of_fit(model, &variables, &noise, &keys).ok()?;
        let size = found.nrows();
        let mut of_tangent = ExtrinsicsCovariance::zeros();
        of_tangent.view_mut((0, 0), (size, size)).copy_from(&found);
        let jacobian = parameters_by_tangent(&variables.problem().get(*extrinsics));
        Some(jacobian * of_tangent * jacobian.transpose())
    };
    Ok(term.keys.iter().map(of).collect())
}

/// Jacobian of (rotation, translation, clock) by the tangent vectors: a translation t changes by τ
/// − [t]ₓ δ.
fn parameters_by_tangent(cam_from_rig: &Rigid3) -> ExtrinsicsCovariance {
    let mut jacobian = ExtrinsicsCovariance::identity();
    jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&-so3::hat(&cam_from_rig.translation));
    jacobian
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_geometry::nalgebra::{SVector, Vector3};
    use tiepoint_geometry::testing::jacobian_law;

    /// Step of the five-point rule, for a rotation of the order of a radian.
    const STEP: f64 = 1e-3;

    /// The covariance of the translation refers to the translation as it is stored.
    #[test]
    fn the_jacobian_of_the_parameters_is_numeric() {
        let extrinsics =
            Rigid3::from_axis_angle(Vector3::new(0.3, -2.0, 0.4), Vector3::new(-0.5, 0.2, 3.0));
        let numbers = |moved: &Rigid3| {
            let turn = so3::log(&(moved.rotation * extrinsics.rotation.inverse()));
            let shift = moved.translation - extrinsics.translation;
            Some(SVector::<f64, 6>::from_iterator(turn.iter().chain(shift.iter()).copied()))
        };
        let found = parameters_by_tangent(&extrinsics).fixed_view::<6, 6>(0, 0).into_owned();
        assert_eq!(jacobian_law(&extrinsics, &found, STEP, numbers), Ok(()));
        // The clock's parameters are their own tangent.
        assert_eq!(
            parameters_by_tangent(&extrinsics).fixed_view::<2, 8>(6, 0),
            ExtrinsicsCovariance::identity().fixed_view::<2, 8>(6, 0)
        );
    }
}
