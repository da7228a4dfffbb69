use tiepoint_ba::{Key, Problem};
use tiepoint_geometry::nalgebra::{Vector1, Vector2};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::options::Scope;
use super::variables::Variables;
use crate::Error;

/// What an adjustment has beside the reprojection errors: variables and factors of its own, as of
/// cameras on a rig or of a rolling shutter.
///
/// [`super::adjust`] adds one itself for the frames that a model has, which composes the poses of
/// their images.
///
/// The methods are called in the order in which they stand here, each of them on all terms before
/// the next one.
pub trait Term {
    /// The images among `posed` (in order of their ids) whose pose is no variable of its own:
    /// [`Term::add`] composes it of others, by [`Variables::compose_pose`].
    fn composed_images(&mut self, posed: &[ImageId]) -> Vec<ImageId> {
        let _ = posed;
        Vec::new()
    }

    /// Adds variables and factors; the poses are variables already, intrinsics are not.
    ///
    /// # Errors
    ///
    /// Where the optimiser refuses one of them; [`Error::Term`] for a reason of its own.
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error>;

    /// Adds what concerns one camera, before its intrinsics and its observations.
    ///
    /// # Errors
    ///
    /// Where the optimiser refuses it.
    fn add_to_camera(
        &mut self,
        context: &TermContext,
        camera: CameraId,
        variables: &mut Variables,
    ) -> Result<(), Error> {
        let _ = (context, camera, variables);
        Ok(())
    }

    /// A variable that shifts the keypoints of an image in proportion, and how far each: keypoint −
    /// shift · variable is what a camera that sees all rows at once would have detected. There is
    /// one for each keypoint of the image. Images whose pose is composed are not asked.
    fn shifts_of(
        &self,
        camera: CameraId,
        image: ImageId,
    ) -> Option<(Key<Vector1<f64>>, &[Shifted])> {
        let _ = (camera, image);
        None
    }

    /// Takes its variables out of the solved problem.
    fn read(&mut self, problem: &Problem) {
        let _ = problem;
    }
}

/// What a term may look at.
#[derive(Clone, Copy)]
pub struct TermContext<'a> {
    /// The model as it is before the adjustment.
    pub model: &'a Reconstruction,
    /// What moves.
    pub scope: &'a Scope<'a>,
    /// [`super::AdjustOptions::noise`]: standard deviations of priors are divided by it.
    pub noise: f64,
}

/// Where a keypoint was detected, and how far a unit of a variable shifted it, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shifted {
    /// In pixels.
    pub pixel: Vector2<f64>,
    /// In pixels for each unit of the variable.
    pub shift: Vector2<f64>,
}
