//! Results of the rig calibration as bytes.

use super::extrinsics::RigConstraint;
use super::held_out::HeldOutChange;
use super::pairs::RigPair;
use super::sensor_pair::{ClockState, SensorPair};
use super::solution::{CalibratedCamera, CalibratedRig, ConstraintLimit, SplitRepair};
use crate::saved::saved;

saved! {
    struct CalibratedRig {
        constraint,
        cameras,
        bad_pairs,
        split,
        error_off_px,
        error_px,
        held_out_change,
        unconstrained,
        limit,
    }
}
saved! { struct HeldOutChange { relative, sd } }
saved! {
    struct CalibratedCamera {
        sensor_pair,
        cam_from_rig,
        covariance,
        constraint,
        num_referenced_images,
        statistics,
    }
}
saved! {
    struct SensorPair {
        reference,
        other,
        clock,
        clock_state,
        assumed_baseline,
        unobservable_direction,
    }
}
saved! { struct RigPair { reference, other } }
saved! { struct SplitRepair { num_images, num_rematched_pairs } }
saved! {
    enum RigConstraint { 0 = Soft { sigma_translation, sigma_rotation_rad }, 1 = Rigid }
}
saved! {
    enum ConstraintLimit {
        0 = HeldOutError { error_px },
        1 = Residuals,
        2 = FlexibleRotation,
        3 = Unsynchronised,
        4 = RigidIsWorse { error_px },
        5 = Smallest,
    }
}
saved! { enum ClockState { 0 = Synchronised, 1 = Estimated, 2 = Unobservable } }
