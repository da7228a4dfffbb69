//! Gating: selects the images that are constrained to the rig extrinsics.
//!
//! Three groups are selected: images whose relative pose is near to the extrinsics; images whose
//! two-view geometry agrees with the extrinsics; runs of consecutive images without matches across
//! cameras that are displaced together (a split of the model).

use tiepoint_geometry::Rigid3;
use tiepoint_rig::{Clock, RelativePose, robust_average};
use tiepoint_scene::{ImagePair, Reconstruction};

use super::context::Context;
use super::extrinsics::{
    RigConstraint, RigExtrinsics, SplitImage, deviation, relative_poses, robust_sigmas,
};
use super::sensor_pair::{ClockState, ReferencedImage, SensorPair};
use crate::two_view::relative_pose;

/// Gate in robust standard deviations of the relative poses. The floor is in baselines and radians.
const GATE: f64 = 5.0;
const GATE_FLOOR: (f64, f64) = (0.2, 0.035);
/// Maximum differences between the two-view geometry of a pair and the extrinsics: rotation, and
/// direction of translation. They are 1° and 5° plus the uncertainty of the two-view geometry of
/// neighbouring images.
const MAX_TWO_VIEW_ROTATION_RAD: f64 = 0.026;
const MAX_TWO_VIEW_DIRECTION_RAD: f64 = 0.175;
/// Minimum number of matches for the check against the two-view geometry.
const MIN_TWO_VIEW_MATCHES: usize = 30;
/// Minimum length of a run of images without matches across cameras that counts as a split. Shorter
/// runs are treated as wrongly registered images.
const MIN_SPLIT_RUN: usize = 3;
/// Two consecutive images of a run are displaced together when their relative poses differ by less
/// than this fraction of their deviation from the extrinsics.
const MAX_MUTUAL_RATIO: f64 = 0.5;

impl Context<'_> {
    /// Estimates the extrinsics of each sensor pair from the current poses and gates its images.
    /// Sensor pairs that are not synchronised get a soft constraint with `sigmas`, whatever
    /// `constraint` is.
    pub(super) fn rig_extrinsics(
        &self,
        model: &Reconstruction,
        sensor_pairs: &[SensorPair],
        constraint: RigConstraint,
        sigmas: (f64, f64),
        unmatched: UnmatchedImages,
    ) -> Vec<RigExtrinsics> {
        let extrinsics = |sensor_pair: &SensorPair| -> Option<RigExtrinsics> {
            let SensorPair { clock, clock_state, assumed_baseline, .. } = *sensor_pair;
            // `referenced_images` returns only images with poses.
            let referenced_images = sensor_pair.referenced_images(model);
            let poses = relative_poses(model, &referenced_images, &clock);
            let average = robust_average(&poses)?;
            let (sigma_t, sigma_r) = robust_sigmas(&poses, &average, assumed_baseline);
            let gate = ((GATE * sigma_t).max(GATE_FLOOR.0), (GATE * sigma_r).max(GATE_FLOOR.1));
            let baseline = assumed_baseline.unwrap_or_else(|| average.translation.norm());
            let is_near = |pose: &RelativePose| {
                let (t, r) = deviation(pose, &average, baseline);
                t <= gate.0 && r <= gate.1
            };
            // The two relative poses are nearer to each other than either is to the extrinsics.
            let are_displaced_together = |a: &RelativePose, b: &RelativePose| {
                let (t, r) = deviation(a, b, baseline);
                let [far_a, far_b] = [a, b].map(|pose| deviation(pose, &average, baseline));
                t <= (MAX_MUTUAL_RATIO * far_a.0.min(far_b.0)).max(gate.0)
                    && r <= (MAX_MUTUAL_RATIO * far_a.1.min(far_b.1)).max(gate.1)
            };
            let agreement = |(referenced, pose): (&ReferencedImage, &RelativePose)| {
                let two_view =
                    || self.two_view_geometry_agrees(model, referenced, &clock, &average);
                if is_near(pose) { Some(true) } else { two_view() }
            };
            let agreements: Vec<Option<bool>> =
                referenced_images.iter().zip(&poses).map(agreement).collect();
            let splits = match unmatched {
                UnmatchedImages::ConstrainRuns => {
                    runs(&agreements, |a, b| are_displaced_together(&poses[a], &poses[b]))
                }
                UnmatchedImages::Exclude => Vec::new(),
            };
            let is_inlier =
                |index: &usize| agreements[*index] == Some(true) || splits.contains(index);
            let split_images = splits
                .iter()
                .map(|&index| SplitImage::new(&referenced_images[index], &clock))
                .collect();
            let referenced_images: Vec<ReferencedImage> = (0..referenced_images.len())
                .filter(is_inlier)
                .map(|index| referenced_images[index])
                .collect();
            let constraint = if clock_state == ClockState::Synchronised {
                constraint
            } else {
                RigConstraint::soft(sigmas)
            };
            let cam_from_rig = average.cam_from_rig();
            (referenced_images.len() >= 2).then_some(RigExtrinsics {
                sensor_pair: *sensor_pair,
                referenced_images,
                cam_from_rig,
                constraint,
                split_images,
            })
        };
        sensor_pairs.iter().filter_map(extrinsics).collect()
    }

    /// Returns whether the two-view geometry between an image and the nearest image of the
    /// reference camera agrees with the extrinsics; `None` with too few matches. The model gives
    /// the motion of the reference camera between its nearest image and the time of the other
    /// image.
    fn two_view_geometry_agrees(
        &self,
        model: &Reconstruction,
        referenced: &ReferencedImage,
        clock: &Clock,
        average: &RelativePose,
    ) -> Option<bool> {
        let near = referenced.nearest_reference(clock);
        let key = ImagePair::new(near, referenced.image)?;
        let two_view = self.graph.pairs().get(&key)?;
        if two_view.matches.len() < MIN_TWO_VIEW_MATCHES {
            return None;
        }
        let poses = || -> Option<(RelativePose, RelativePose)> {
            let b_from_a = relative_pose(model, &key, two_view)?;
            let cam_from_near = if key.a == near { b_from_a } else { b_from_a.inverse() };
            let near_from_world = model.image(near).cam_from_world()?;
            let rig_from_near =
                referenced.rig_from_world(model, clock)? * near_from_world.inverse();
            let expected = average.cam_from_rig() * rig_from_near;
            let from_near = |pose: &Rigid3| RelativePose::between(&Rigid3::identity(), pose);
            Some((from_near(&cam_from_near), from_near(&expected)))
        };
        Some(poses().is_some_and(|(own, expected)| {
            let (own_t, t) = (own.translation.normalize(), expected.translation.normalize());
            let (_, rotation) = own.distance_and_angle(&expected);
            rotation < MAX_TWO_VIEW_ROTATION_RAD
                && own_t.cross(&t).norm() < MAX_TWO_VIEW_DIRECTION_RAD
                && own_t.dot(&t) > 0.0
        }))
    }
}

/// Treatment of gated images that have no two-view geometry with the reference camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum UnmatchedImages {
    /// Runs that are displaced together are constrained.
    ConstrainRuns,
    /// They are not constrained.
    Exclude,
}

/// Returns the indices of images with `None` that are in runs of at least [`MIN_SPLIT_RUN`]
/// consecutive indices. `is_near` must hold for each pair of neighbours in a run.
fn runs(agreements: &[Option<bool>], is_near: impl Fn(usize, usize) -> bool) -> Vec<usize> {
    let mut runs: Vec<Vec<usize>> = Vec::new();
    for index in (0..agreements.len()).filter(|&index| agreements[index].is_none()) {
        match runs.last_mut() {
            Some(run)
                if run.last().is_some_and(|&last| last + 1 == index && is_near(last, index)) =>
            {
                run.push(index)
            }
            _ => runs.push(vec![index]),
        }
    }
    runs.into_iter().filter(|run| run.len() >= MIN_SPLIT_RUN).flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_rows_of_unmatched_images_that_stand_together_are_splits() {
        let (near, unmatched, wrong) = (Some(true), None, Some(false));
        let agreements = [
            unmatched, unmatched, unmatched, near, unmatched, unmatched, wrong, unmatched,
            unmatched, unmatched,
        ];
        assert_eq!(runs(&agreements, |_, _| true), [0, 1, 2, 7, 8, 9]);
        // The relative poses of the last three differ from each other.
        assert_eq!(runs(&agreements, |_, index| index < 5), [0, 1, 2]);
        assert_eq!(runs(&[], |_, _| true), [0; 0]);
    }
}
