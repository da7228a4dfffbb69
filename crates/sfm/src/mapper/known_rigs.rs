//! Rigs with known extrinsics in a model: its scale, and the registration of whole frames.
//!
//! The initial pair has an arbitrary scale, and the cameras of a rig a known one. Images are
//! registered alone until two images of a frame are. Their relative pose gives the scale. From then
//! on, the model has the rigs and frames; frames are registered as a whole, and bundle adjustment
//! keeps them rigid.

use tiepoint_geometry::numeric::median;
use tiepoint_geometry::{Rigid3, Sim3};
use tiepoint_scene::rig::KnownFrame;
use tiepoint_scene::{Frame, ImageId, KnownRigs, Reconstruction, Rig};

use super::growth::Growth;
use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use crate::Error;
use crate::event::Watch;

/// Maximum angle between known and estimated rotations and between known and estimated directions
/// of two images of a frame (20°). A random direction is within it with a probability of 3 %, a
/// random rotation with 0.05 %; known extrinsics are off by far less.
const MAX_ANGLE_RAD: f64 = 0.35;

impl Growth<'_> {
    /// Gives the model the scale, the rigs and the frames of the known rigs, as soon as the
    /// registered images determine the scale. Frames with a registered image are registered.
    pub(super) fn start_frames(&mut self, watch: &mut Watch) -> Result<(), Error> {
        let Some(known) = self.refiner.input.known_rigs else { return Ok(()) };
        if !self.model().rigs.is_empty() {
            return Ok(());
        }
        let Some(units_per_metre) = self.units_of_rigs(known) else { return Ok(()) };
        let model = &mut self.refiner.solution.model;
        model.transform(&Sim3 { scale: 1.0 / units_per_metre, ..Sim3::identity() });
        model.rigs.clone_from(&known.rigs);
        let mut added = Vec::new();
        for frame in self.next_best_view.frames().iter() {
            let is_registered = |image: &&ImageId| model.image(**image).cam_from_world().is_some();
            // The image with the most points has the most certain pose.
            let most = frame.images.iter().filter(is_registered).max_by_key(|image| {
                (model.image(**image).num_points(), std::cmp::Reverse(**image))
            });
            let Some(&most) = most else { continue };
            added.extend(frame.images.iter().filter(|image| !is_registered(image)).copied());
            compose_frame(model, frame, most);
        }
        added.iter().for_each(|image| self.triangulate(*image));
        self.refiner.refine_globally(&RefinementSchedule::GROWING, watch)?;
        added.into_iter().try_for_each(|image| self.report(image, watch))
    }

    /// Length of the rigs' unit in units of the model: the median over the pairs of registered
    /// images of a frame; `None` without one that agrees with the known relative pose. Rigs whose
    /// cameras have one centre fit any scale.
    fn units_of_rigs(&self, known: &KnownRigs) -> Option<f64> {
        let model = self.model();
        let frames = self.next_best_view.frames();
        let mut has_baseline = false;
        let mut ratios = Vec::new();
        for frame in frames.iter() {
            let known_pose = |image: &ImageId| known.cam_from_rig(model, frame, *image);
            for (index, one) in frame.images.iter().enumerate() {
                for other in &frame.images[index + 1..] {
                    let (Some(a), Some(b)) = (known_pose(one), known_pose(other)) else { continue };
                    let b_from_a = b * a.inverse();
                    let distance = b_from_a.translation.norm();
                    if distance <= f64::EPSILON * a.translation.norm() {
                        continue;
                    }
                    has_baseline = true;
                    let pose = |image: &ImageId| model.image(*image).cam_from_world();
                    let (Some(a), Some(b)) = (pose(one), pose(other)) else { continue };
                    ratios.extend(ratio(&(*b * a.inverse()), &b_from_a));
                }
            }
        }
        if has_baseline { median(&mut ratios) } else { Some(1.0) }
    }
}

/// Registers the images of a frame at the poses that one of them and the rig give.
fn compose_frame(model: &mut Reconstruction, frame: &KnownFrame, image: ImageId) {
    let Some(rig) = model.rigs.get(frame.rig.index()).cloned() else { return };
    let cam_from_rig =
        |image: ImageId, model: &Reconstruction| rig.cam_from_rig(model.image(image).camera);
    let Some(of_image) = cam_from_rig(image, model) else { return };
    let Some(&cam_from_world) = model.image(image).cam_from_world() else { return };
    let rig_from_world = of_image.inverse() * cam_from_world;
    for &other in &frame.images {
        if let Some(of_other) = cam_from_rig(other, model) {
            model.register(other, of_other * rig_from_world);
        }
    }
    model.frames.push(Frame { rig: frame.rig, rig_from_world, images: frame.images.clone() });
}

/// Composes the poses of all frames again after their images were moved one by one. The first image
/// of each frame keeps its pose.
pub(super) fn restore_frames(model: &mut Reconstruction, frames: Vec<Frame>) {
    for Frame { rig, images, .. } in frames {
        let Some(&first) = images.first() else { continue };
        compose_frame(model, &KnownFrame { rig, images }, first);
    }
}

impl Refiner<'_> {
    /// Ends the work on known rigs: the scale of the model becomes theirs.
    ///
    /// # Errors
    ///
    /// [`Error::NoKnownFrame`] if the model has no frame.
    pub(super) fn finish_known_rigs(&mut self) -> Result<(), Error> {
        if self.solution.model.frames.is_empty() {
            return Err(Error::NoKnownFrame);
        }
        self.restore_scale();
        Ok(())
    }

    /// Scales a model with refined extrinsics so that the root mean square distance of the cameras
    /// from their reference camera is the known one: bundle adjustment leaves the scale open,
    /// unless the model is in the frame of terms.
    fn restore_scale(&mut self) {
        let known = self.input.known_rigs.filter(|known| known.refine_extrinsics);
        let Some(known) = known.filter(|_| !self.solution.is_in_frame_of_terms) else { return };
        let model = &mut self.solution.model;
        let squared = |rigs: &[Rig]| -> f64 {
            let sensors = rigs.iter().flat_map(|rig| rig.sensors.iter().skip(1));
            let poses = sensors.filter_map(|sensor| sensor.cam_from_rig);
            poses.map(|pose| pose.translation.norm_squared()).sum()
        };
        let scale = (squared(&known.rigs) / squared(&model.rigs)).sqrt();
        if scale.is_finite() && scale > 0.0 {
            model.transform(&Sim3 { scale, ..Sim3::identity() });
        }
    }
}

/// Length of an estimated translation over that of a known one, as far as it goes the same way;
/// `None` if the poses do not agree.
fn ratio(estimated: &Rigid3, known: &Rigid3) -> Option<f64> {
    let is_near = estimated.rotation.angle_to(&known.rotation) < MAX_ANGLE_RAD
        && estimated.translation.angle(&known.translation) < MAX_ANGLE_RAD;
    let ratio = estimated.translation.dot(&known.translation) / known.translation.norm_squared();
    (is_near && ratio.is_finite() && ratio > 0.0).then_some(ratio)
}
