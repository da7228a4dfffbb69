//! How well mountings are determined.

use tiepoint_ba::{AnyKey, Key};
use tiepoint_geometry::{Rigid3, so3};
use tiepoint_rig::Clock;
use tiepoint_scene::Reconstruction;

use super::extrinsics::{ExtrinsicsCovariance, RigExtrinsics};
use super::extrinsics_term::ExtrinsicsTerm;
use crate::Error;
use crate::adjust::{AdjustOptions, Scope, build};
use crate::noise::noise_of_fit;
use crate::tracks::without_points_at_infinity;

/// The covariance of each mounting's calibration and clock, zero where they do not move; `None`
/// where something is not determined. The noise of the keypoints is what the model and the loss
/// leave; σ of the mountings and of the times of images are what they say, widened by how what is
/// left between the cameras goes on from moment to moment.
pub(super) fn extrinsics_covariances(
    model: &Reconstruction,
    options: &AdjustOptions,
    all_extrinsics: &[RigExtrinsics],
) -> Result<Vec<Option<ExtrinsicsCovariance>>, Error> {
    let model = &without_points_at_infinity(model);
    let noise = noise_of_fit(model, &options.loss);
    let options = &AdjustOptions { noise, selects_points: false, ..*options };
    let mut scaled: Vec<RigExtrinsics> = all_extrinsics
        .iter()
        .map(|extrinsics| extrinsics.as_if_independent(model).scaled(1.0 / noise))
        .collect();
    let mut term = ExtrinsicsTerm::new(&mut scaled);
    let variables = build(model, &Scope::Global, options, &mut [&mut term])?;
    let problem = variables.problem();
    let of = |(mount, clock): &(Key<Rigid3>, Option<Key<Clock>>)| {
        let mut keys: Vec<AnyKey> = vec![(*mount).into()];
        keys.extend(clock.map(AnyKey::from));
        let found = problem.covariance(&keys).ok()?;
        let size = found.matrix().nrows();
        let mut of_tangent = ExtrinsicsCovariance::zeros();
        of_tangent.view_mut((0, 0), (size, size)).copy_from(&(found.matrix() * (noise * noise)));
        let change = d_numbers(&problem.get(*mount));
        Some(change * of_tangent * change.transpose())
    };
    Ok(term.keys.iter().map(of).collect())
}

/// How the numbers of a mounting (rotation, translation) and of a clock follow the tangents: a
/// translation t moves by τ − [t]ₓ δ.
fn d_numbers(right_from_left: &Rigid3) -> ExtrinsicsCovariance {
    let mut change = ExtrinsicsCovariance::identity();
    change.fixed_view_mut::<3, 3>(3, 0).copy_from(&-so3::hat(&right_from_left.translation));
    change
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_geometry::nalgebra::{SVector, Vector3};
    use tiepoint_geometry::testing::jacobian_law;

    /// Of the five-point rule, on a turn of a radian.
    const STEP: f64 = 1e-3;

    /// What is said to be the covariance of the translation is that of the number in the file.
    #[test]
    fn the_numbers_of_a_mounting_follow_its_tangent() {
        let mount =
            Rigid3::from_axis_angle(Vector3::new(0.3, -2.0, 0.4), Vector3::new(-0.5, 0.2, 3.0));
        let numbers = |moved: &Rigid3| {
            let turn = so3::log(&(moved.rotation * mount.rotation.inverse()));
            let shift = moved.translation - mount.translation;
            Some(SVector::<f64, 6>::from_iterator(turn.iter().chain(shift.iter()).copied()))
        };
        let found = d_numbers(&mount).fixed_view::<6, 6>(0, 0).into_owned();
        assert_eq!(jacobian_law(&mount, &found, STEP, numbers), Ok(()));
        // The clock's numbers are its tangent.
        assert_eq!(
            d_numbers(&mount).fixed_view::<2, 8>(6, 0),
            ExtrinsicsCovariance::identity().fixed_view::<2, 8>(6, 0)
        );
    }
}
