//! Rigid adjustment of a finished model: each camera beside the reference camera gets one relative
//! pose.
//!
//! The poses of these cameras are composed of the reference camera's pose and the extrinsics.
//! Extrinsics, intrinsics and points are adjusted.

use tiepoint_adjust::AdjustOptions;
use tiepoint_ba::Summary;
use tiepoint_geometry::Rigid3;
use tiepoint_scene::{CameraId, Reconstruction};

use super::extrinsics::{RigConstraint, RigExtrinsics};
use super::extrinsics_term::adjust_with_extrinsics;
use super::frames::add_frames;
use super::pairs::RigPair;
use super::sensor_pair::{ReferencePose, ReferencedImage, SensorPair};
use crate::Error;
use crate::tracks::{FilterOptions, filter_all_points};

/// A camera with a rigid constraint.
#[derive(Clone, Debug, PartialEq)]
pub struct RigidCamera {
    /// The reference camera.
    pub reference: CameraId,
    /// The other camera.
    pub other: CameraId,
    /// Extrinsics: initial value, and estimate after the adjustment.
    pub cam_from_rig: Rigid3,
    /// Pairs of one instant. Other images of the camera stay free.
    pub pairs: Vec<RigPair>,
}

/// Adds rigid constraints, adjusts the model, removes observations with large errors, and stores
/// the pairs as frames of a rig. The model's earlier rigs and frames are replaced.
///
/// # Errors
///
/// Fails if an adjustment fails.
pub fn constrain_rigidly(
    model: &mut Reconstruction,
    cameras: &mut [RigidCamera],
    options: &AdjustOptions,
    filter: &FilterOptions,
) -> Result<Summary, Error> {
    model.frames.clear();
    model.rigs.clear();
    let mut all_extrinsics: Vec<RigExtrinsics> =
        cameras.iter().map(RigidCamera::extrinsics).collect();
    for extrinsics in &all_extrinsics {
        extrinsics.register_images(model, &extrinsics.cam_from_rig);
    }
    adjust_with_extrinsics(model, options, &mut all_extrinsics, &mut [])?;
    filter_all_points(model, filter);
    let summary = adjust_with_extrinsics(model, options, &mut all_extrinsics, &mut [])?;
    add_frames(model, &all_extrinsics);
    for (camera, extrinsics) in cameras.iter_mut().zip(&all_extrinsics) {
        camera.cam_from_rig = extrinsics.cam_from_rig;
    }
    Ok(summary)
}

impl RigidCamera {
    /// The extrinsics as a rigid constraint of a synchronised sensor pair.
    fn extrinsics(&self) -> RigExtrinsics {
        let referenced = |pair: &RigPair| ReferencedImage {
            image: pair.other,
            reference: ReferencePose::Synchronous(pair.reference),
        };
        RigExtrinsics {
            sensor_pair: SensorPair::synchronised(self.reference, self.other),
            referenced_images: self.pairs.iter().map(referenced).collect(),
            cam_from_rig: self.cam_from_rig,
            constraint: RigConstraint::Rigid,
            split_images: Vec::new(),
        }
    }
}
