use tiepoint_ba::{Key, Problem};
use tiepoint_geometry::nalgebra::{Vector1, Vector2};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use crate::Error;
use crate::options::Scope;
use crate::variables::Variables;

/// An addition to the reprojection errors of an adjustment, with its own variables and factors,
/// such as rig constraints or rolling shutters.
///
/// [`crate::adjust`] adds a term for the frames of a model, which composes the poses of their
/// images.
///
/// The methods are called in the order below, each on all terms before the next one.
pub trait Term {
    /// Returns the images among `posed` (sorted by id) whose pose is not a variable. [`Term::add`]
    /// composes it of other variables with [`Variables::compose_pose`].
    fn composed_images(&mut self, posed: &[ImageId]) -> Vec<ImageId> {
        let _ = posed;
        Vec::new()
    }

    /// Adds variables and factors. Poses are variables already, intrinsics are not.
    ///
    /// # Errors
    ///
    /// If the optimiser rejects one of them; [`Error::Term`] for errors of the term.
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error>;

    /// Adds variables and factors of one camera, before its intrinsics and observations.
    ///
    /// # Errors
    ///
    /// If the optimiser rejects one of them.
    fn add_to_camera(
        &mut self,
        context: &TermContext,
        camera: CameraId,
        variables: &mut Variables,
    ) -> Result<(), Error> {
        let _ = (context, camera, variables);
        Ok(())
    }

    /// Returns a scalar variable that shifts the keypoints of an image, and a shift per keypoint.
    /// The corrected keypoint is `pixel` − `shift` · variable; for a rolling shutter this is the
    /// keypoint of a global shutter. Images with composed poses are not asked.
    fn shifts_of(
        &self,
        camera: CameraId,
        image: ImageId,
    ) -> Option<(Key<Vector1<f64>>, &[Shifted])> {
        let _ = (camera, image);
        None
    }

    /// Reads its variables from the solved problem.
    fn read(&mut self, problem: &Problem) {
        let _ = problem;
    }
}

/// Input of a term.
#[derive(Clone, Copy)]
pub struct TermContext<'a> {
    /// The model before the adjustment.
    pub model: &'a Reconstruction,
    /// The scope of the adjustment.
    pub scope: &'a Scope<'a>,
    /// [`crate::AdjustOptions::noise`]: standard deviations of priors are divided by it.
    pub noise: f64,
}

/// A detected keypoint, and its shift per unit of a scalar variable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shifted {
    /// Detected position in pixels.
    pub pixel: Vector2<f64>,
    /// Shift in pixels per unit of the variable.
    pub shift: Vector2<f64>,
}
