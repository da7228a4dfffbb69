//! Mountings in an adjustment: as variables with their clocks, as terms or as rigid poses, and how well they are determined.

use std::collections::BTreeMap;

use tiepoint_ba::factors::Prior;
use tiepoint_ba::{AnyKey, Key, Order};
use tiepoint_geometry::nalgebra::{Matrix3, SMatrix, Vector3};
use tiepoint_geometry::{Loss, Rigid3, so3};
use tiepoint_rig::{Clock, Mounted, MountedInTime};
use tiepoint_scene::{ImageId, PointId, Reconstruction, Track};

use super::{AdjustOptions, Bundle, Scope};
use crate::Error;
use crate::companion::{Left, Timing};
use crate::mounting::{Hold, Mounting};
use crate::sigma::noise_of_fit;

/// What is believed of a clock's offset beside what was found by motion, and of its drift (quartz: tens of parts per million).
const CLOCK_SIGMA_S: f64 = 1.0;
const DRIFT_SIGMA: f64 = 5e-5;

/// What is believed of the rotation of a mounting between cameras that see nothing in common; of the centre it is the unit.
const UNSEEN_SIGMA_RAD: f64 = 1.0;
/// How firmly a place that the motion does not tell stays at zero, as a share of what is believed of it.
const BLIND_SIGMA: f64 = 1e-3;

/// The covariance of each mounting's calibration and clock, zero where they do not move; `None`
/// where something is not determined. The noise of the keypoints is what the model and the loss leave; σ of the mountings and of the times
/// of images are what they say, widened by how what is left between the cameras goes on from moment to moment.
pub(crate) fn mounting_covariances(
    model: &Reconstruction,
    options: &AdjustOptions,
    mountings: &[Mounting],
) -> Result<Vec<Option<MountingCovariance>>, Error> {
    let model = &without_points_at_infinity(model);
    let noise = noise_of_fit(model, &options.loss);
    let options = &AdjustOptions { noise, spread: false, ..*options };
    let scaled: Vec<Mounting> =
        mountings.iter().map(|mounting| mounting.as_if_independent(model).scaled(1.0 / noise)).collect();
    let bundle = Bundle::new(model, &Scope::Global, options, &scaled, None)?;
    let of = |(mount, clock): &(Key<Rigid3>, Option<Key<Clock>>)| {
        let mut keys: Vec<AnyKey> = vec![(*mount).into()];
        keys.extend(clock.map(AnyKey::from));
        let found = bundle.problem.covariance(&keys).ok()?;
        let size = found.matrix().nrows();
        let mut of_tangent = MountingCovariance::zeros();
        of_tangent.view_mut((0, 0), (size, size)).copy_from(&(found.matrix() * (noise * noise)));
        let change = d_numbers(&bundle.problem.get(*mount));
        Some(change * of_tangent * change.transpose())
    };
    Ok(bundle.mountings.iter().map(of).collect())
}

/// A point whose depth its rays tell this much worse than its direction (as a ratio of information) is at infinity: the undamped system
/// is singular for it.
const MIN_DEPTH_INFORMATION: f64 = 1e-8;

/// With such points set aside; they move nothing but rotations, which all others move too.
pub(super) fn without_points_at_infinity(model: &Reconstruction) -> Reconstruction {
    let is_far = |track: &Track| {
        let mut information = Matrix3::zeros();
        for pose in track.observations.iter().filter_map(|o| model.image(o.image).cam_from_world()) {
            let ray = track.xyz - pose.origin_in_a();
            let direction = ray.normalize();
            information += (Matrix3::identity() - direction * direction.transpose()) / ray.norm_squared();
        }
        let eigenvalues = information.symmetric_eigenvalues();
        // Not a number is nowhere.
        let is_near = eigenvalues.min() > MIN_DEPTH_INFORMATION * eigenvalues.max();
        !is_near
    };
    let far: Vec<PointId> =
        model.tracks().filter(|(_, track)| is_far(track)).map(|(point, _)| point).collect();
    let mut near = model.clone();
    for point in far {
        if let Some(track) = near.track_mut(point) {
            track.is_held_out = true;
        }
    }
    near
}

/// How the numbers of a mounting (rotation, translation) and of a clock follow the tangents: a translation t moves by τ − [t]ₓ δ.
fn d_numbers(right_from_left: &Rigid3) -> MountingCovariance {
    let mut change = MountingCovariance::identity();
    change.fixed_view_mut::<3, 3>(3, 0).copy_from(&-so3::hat(&right_from_left.translation));
    change
}

/// Rotation (radians, R ← Exp(δ) R), translation (units of the model), offset (seconds), drift.
pub type MountingCovariance = SMatrix<f64, 8, 8>;

impl Bundle {
    /// Adds the mountings as variables, soft ones with a term for each moment; what is believed of them is weighed against the noise.
    pub(super) fn add_mountings(
        &mut self,
        model: &Reconstruction,
        mountings: &[Mounting],
        rigid: &BTreeMap<ImageId, (usize, ImageId)>,
        noise: f64,
    ) -> Result<(), Error> {
        if mountings.is_empty() {
            return Ok(());
        }
        let keys: BTreeMap<ImageId, Key<Rigid3>> = self.poses.iter().copied().collect();
        let key = |image: &ImageId| keys.get(image).copied();
        for (index, mounting) in mountings.iter().enumerate() {
            let mount = self.problem.keep(mounting.right_from_left, Order::Shared);
            let moves = mounting.moments.iter().any(|m| matches!(m.left, Left::Between { .. }));
            let clock = moves.then(|| self.problem.keep(mounting.companion.clock, Order::Shared));
            if let Some(clock) = clock {
                match mounting.companion.timing {
                    Timing::Free => {
                        let sigmas = [CLOCK_SIGMA_S, DRIFT_SIGMA].map(|sigma| sigma / noise);
                        let stamps = Clock { drift: 0.0, ..mounting.companion.clock };
                        self.problem.add(clock, Prior::new(stamps, &sigmas)?, Loss::Trivial)?;
                    }
                    Timing::Together | Timing::NotObservable => self.problem.fix(clock),
                }
            }
            if let Some(unit) = mounting.companion.unit {
                self.problem.add(mount, belief(mounting, unit, noise)?, Loss::Trivial)?;
            }
            self.mountings.push((mount, clock));
            for moment in &mounting.moments {
                let right = key(&moment.right);
                match (mounting.hold, moment.left, clock) {
                    (Hold::Rigid, Left::At(left), _) => {
                        if let (Some(left), Some(&(by, _))) = (key(&left), rigid.get(&moment.right))
                            && by == index
                        {
                            self.held.push((moment.right, mount, left));
                        }
                    }
                    (Hold::Soft { sigma_translation, sigma_rotation_rad }, Left::At(left), _) => {
                        let (Some(left), Some(right)) = (key(&left), right) else { continue };
                        let factor =
                            Mounted { sigma_translation, sigma_rotation_rad, unit: mounting.companion.unit };
                        self.problem.add((left, right, mount), factor, Loss::Trivial)?;
                    }
                    (
                        Hold::Soft { sigma_translation, sigma_rotation_rad },
                        Left::Between { images, times_s, right_time_s, .. },
                        Some(clock),
                    ) => {
                        let [a, b, c, d] = images.each_ref().map(key);
                        let (Some(a), Some(b), Some(c), Some(d), Some(right)) = (a, b, c, d, right) else {
                            continue;
                        };
                        let mounted =
                            Mounted { sigma_translation, sigma_rotation_rad, unit: mounting.companion.unit };
                        let Some(left) = moment.left_from_world(model, &mounting.companion.clock) else {
                            continue;
                        };
                        let whitening = moment.whitening(&mounted, &left, &mounting.right_from_left);
                        let factor =
                            MountedInTime { mounted, left_times_s: times_s, right_time_s, whitening };
                        self.problem.add((a, b, c, d, right, mount, clock), factor, Loss::Trivial)?;
                    }
                    // Images of different instants are never rigid.
                    (_, Left::Between { .. }, _) => {}
                }
            }
        }
        Ok(())
    }
}

/// What is believed of a camera that sees nothing in common with the first one: its rotation is as it comes, its centre near the other's, and at zero
/// where the motion does not tell it.
fn belief(mounting: &Mounting, unit: f64, noise: f64) -> Result<Prior<Rigid3, 6>, Error> {
    let sigmas: [f64; 6] = std::array::from_fn(|k| if k < 3 { UNSEEN_SIGMA_RAD } else { unit } / noise);
    let rotation = mounting.right_from_left.rotation;
    let mut prior = Prior::new(Rigid3::new(rotation, Vector3::zeros()), &sigmas)?;
    if let Some(blind) = mounting.companion.blind {
        let along = rotation * blind;
        let firmer = Matrix3::identity() + along * along.transpose() * (1.0 / BLIND_SIGMA - 1.0);
        let of_place = prior.sqrt_information.fixed_view::<3, 3>(3, 3) * firmer;
        prior.sqrt_information.fixed_view_mut::<3, 3>(3, 3).copy_from(&of_place);
    }
    Ok(prior)
}

/// Images that take their pose from another's: by which mounting, and whose.
pub(super) fn rigid_pairs(mountings: &[Mounting], posed: &[ImageId]) -> BTreeMap<ImageId, (usize, ImageId)> {
    let mut rigid = BTreeMap::new();
    for (index, mounting) in mountings.iter().enumerate().filter(|(_, m)| m.hold == Hold::Rigid) {
        for moment in &mounting.moments {
            let Left::At(left) = moment.left else { continue };
            if posed.binary_search(&left).is_ok() && posed.binary_search(&moment.right).is_ok() {
                rigid.insert(moment.right, (index, left));
            }
        }
    }
    rigid
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
        let mount = Rigid3::from_axis_angle(Vector3::new(0.3, -2.0, 0.4), Vector3::new(-0.5, 0.2, 3.0));
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
            MountingCovariance::identity().fixed_view::<2, 8>(6, 0)
        );
    }
}
