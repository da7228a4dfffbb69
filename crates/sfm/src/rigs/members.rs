//! Which moments take part in a mounting: those near to it, those whose own matches agree with it,
//! and rows of images that stand elsewhere together without a word from their own matches.

use tiepoint_geometry::Rigid3;
use tiepoint_rig::{Clock, RelativePose, robust_average};
use tiepoint_scene::{ImagePair, Reconstruction};

use super::context::Context;
use super::extrinsics::{
    Closed, RigConstraint, RigExtrinsics, deviation, relative_poses, spread_of,
};
use super::rig_sensor::{ClockState, ReferencedImage, RigSensor};
use crate::two_view::relative_pose;

/// A pair this far from the mounting, in standard deviations of the spread, is looked at more
/// closely; no less than this in baselines and radians, though.
const GATE: f64 = 5.0;
const GATE_FLOOR: (f64, f64) = (0.2, 0.035);
/// A pair's own two-view geometry agrees with the mounting when their rotations and directions of
/// translation differ by less (1° and 5°, and what a pair of neighbours leaves uncertain).
const MAX_OWN_ROTATION_RAD: f64 = 0.026;
const MAX_OWN_DIRECTION_RAD: f64 = 0.175;
/// Fewer matches tell no two-view geometry.
const MIN_OWN_MATCHES: usize = 30;
/// So many images in a row without matches with their partners that stand elsewhere together are a
/// split of the model; fewer are images of something else.
const MIN_SPLIT_ROW: usize = 3;
/// They stand together when neighbours are apart by less than this share of their distance from
/// where they should be.
const TOGETHER: f64 = 0.5;

impl Context<'_> {
    /// The mountings as the model has them now, with the moments that are to be held to them.
    /// Images of different instants are held softly at best, with the given standard deviations.
    pub(super) fn rig_extrinsics(
        &self,
        model: &Reconstruction,
        rig_sensors: &[RigSensor],
        constraint: RigConstraint,
        sigmas: (f64, f64),
        unmatched: Unmatched,
    ) -> Vec<RigExtrinsics> {
        let extrinsics = |rig_sensor: &RigSensor| -> Option<RigExtrinsics> {
            let RigSensor { clock, clock_state, assumed_baseline, .. } = *rig_sensor;
            // All referenced images of a rig sensor have poses.
            let referenced_images = rig_sensor.referenced_images(model);
            let poses = relative_poses(model, &referenced_images, &clock);
            let average = robust_average(&poses)?;
            let (spread_t, spread_r) = spread_of(&poses, &average, assumed_baseline);
            let gate = ((GATE * spread_t).max(GATE_FLOOR.0), (GATE * spread_r).max(GATE_FLOOR.1));
            let baseline = assumed_baseline.unwrap_or_else(|| average.translation.norm());
            let is_near = |pose: &RelativePose| {
                let (t, r) = deviation(pose, &average, baseline);
                t <= gate.0 && r <= gate.1
            };
            // Nearer to each other than either is to the mounting.
            let are_together = |a: &RelativePose, b: &RelativePose| {
                let (t, r) = deviation(a, b, baseline);
                let [far_a, far_b] = [a, b].map(|pose| deviation(pose, &average, baseline));
                t <= (TOGETHER * far_a.0.min(far_b.0)).max(gate.0)
                    && r <= (TOGETHER * far_a.1.min(far_b.1)).max(gate.1)
            };
            let verdict = |(referenced, pose): (&ReferencedImage, &RelativePose)| {
                let own = || self.own_geometry_agrees(model, referenced, &clock, &average);
                if is_near(pose) { Some(true) } else { own() }
            };
            let verdicts: Vec<Option<bool>> =
                referenced_images.iter().zip(&poses).map(verdict).collect();
            let splits = match unmatched {
                Unmatched::Rows => rows(&verdicts, |a, b| are_together(&poses[a], &poses[b])),
                Unmatched::None => Vec::new(),
            };
            let is_sound = |index: &usize| verdicts[*index] == Some(true) || splits.contains(index);
            let closed = splits
                .iter()
                .map(|&index| Closed::new(&referenced_images[index], &clock))
                .collect();
            let referenced_images: Vec<ReferencedImage> = (0..referenced_images.len())
                .filter(is_sound)
                .map(|index| referenced_images[index])
                .collect();
            let constraint = if clock_state == ClockState::Synchronised {
                constraint
            } else {
                RigConstraint::soft(sigmas)
            };
            let right_from_left = average.right_from_left();
            (referenced_images.len() >= 2).then_some(RigExtrinsics {
                rig_sensor: *rig_sensor,
                referenced_images,
                right_from_left,
                constraint,
                closed,
            })
        };
        rig_sensors.iter().filter_map(extrinsics).collect()
    }

    /// Whether the matches of an image with the first camera's nearest one alone agree with the
    /// mounting; `None` where there are none. What the first camera moved between that one and the
    /// moment itself is taken from the model.
    fn own_geometry_agrees(
        &self,
        model: &Reconstruction,
        referenced: &ReferencedImage,
        clock: &Clock,
        average: &RelativePose,
    ) -> Option<bool> {
        let near = referenced.nearest_left(clock);
        let key = ImagePair::new(near, referenced.right)?;
        let two_view = self.graph.pairs().get(&key)?;
        if two_view.matches.len() < MIN_OWN_MATCHES {
            return None;
        }
        let poses = || -> Option<(RelativePose, RelativePose)> {
            let b_from_a = relative_pose(model, &key, two_view)?;
            let right_from_near = if key.a == near { b_from_a } else { b_from_a.inverse() };
            let near_from_world = model.image(near).cam_from_world()?;
            let left_from_near =
                referenced.left_from_world(model, clock)? * near_from_world.inverse();
            let expected = average.right_from_left() * left_from_near;
            let from_near = |pose: &Rigid3| RelativePose::between(&Rigid3::identity(), pose);
            Some((from_near(&right_from_near), from_near(&expected)))
        };
        Some(poses().is_some_and(|(own, expected)| {
            let (own_t, t) = (own.translation.normalize(), expected.translation.normalize());
            let (_, rotation) = own.distance_and_angle(&expected);
            rotation < MAX_OWN_ROTATION_RAD
                && own_t.cross(&t).norm() < MAX_OWN_DIRECTION_RAD
                && own_t.dot(&t) > 0.0
        }))
    }
}

/// Which of the moments far from the mounting take part without a word from their own matches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unmatched {
    /// Those in a row.
    Rows,
    None,
}

/// The indices of moments without a verdict that stand in rows of at least [`MIN_SPLIT_ROW`], each
/// near to the one before.
fn rows(verdicts: &[Option<bool>], is_near: impl Fn(usize, usize) -> bool) -> Vec<usize> {
    let mut rows: Vec<Vec<usize>> = Vec::new();
    for index in (0..verdicts.len()).filter(|&index| verdicts[index].is_none()) {
        match rows.last_mut() {
            Some(row)
                if row.last().is_some_and(|&last| last + 1 == index && is_near(last, index)) =>
            {
                row.push(index)
            }
            _ => rows.push(vec![index]),
        }
    }
    rows.into_iter().filter(|row| row.len() >= MIN_SPLIT_ROW).flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_rows_of_unmatched_images_that_stand_together_are_splits() {
        let (near, unmatched, wrong) = (Some(true), None, Some(false));
        let verdicts = [
            unmatched, unmatched, unmatched, near, unmatched, unmatched, wrong, unmatched,
            unmatched, unmatched,
        ];
        assert_eq!(rows(&verdicts, |_, _| true), [0, 1, 2, 7, 8, 9]);
        // The last three stand apart from each other: other pictures.
        assert_eq!(rows(&verdicts, |_, index| index < 5), [0, 1, 2]);
        assert_eq!(rows(&[], |_, _| true), [0; 0]);
    }
}
