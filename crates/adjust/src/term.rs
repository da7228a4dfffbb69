use tiepoint_ba::{Key, Problem};
use tiepoint_geometry::nalgebra::{Matrix3, Vector1, Vector2, Vector3};
use tiepoint_geometry::solvers::umeyama;
use tiepoint_geometry::{Loss, Sim3};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use crate::Error;
use crate::options::Scope;
use crate::variables::Variables;

/// An addition to the reprojection errors of an adjustment, with its own variables and factors,
/// such as rig constraints or rolling shutters.
///
/// A term is used for many adjustments: of a part of the images while a model grows
/// ([`Scope::Local`]), of all of them, and of models that are discarded later. What it adds depends
/// on the variables that it finds. [`crate::adjust`] puts a term for the frames of the model before
/// the given ones; it composes the poses of their images.
///
/// An adjustment calls [`Term::composed_images`] and the methods below it in this order, each on
/// all terms before the next one.
pub trait Term {
    /// Returns how the measurements of the term lie to the frame of a model. The default is for
    /// measurements that hold in any frame, such as the equality of two relative poses.
    ///
    /// A mapper asks before it adjusts a whole model, and moves the model into the frame of the
    /// terms. Until a term knows it, the mapper asks before each adjustment which terms wait.
    /// [`crate::adjust`] does not ask.
    fn frame(&self, model: &Reconstruction) -> TermFrame {
        let _ = model;
        TermFrame::Any
    }

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

    /// Returns the observations in an image of landmarks that the term added, such as marks of
    /// control points by hand.
    fn marks_of(&self, image: ImageId) -> &[Mark] {
        let _ = image;
        &[]
    }

    /// Reads its variables from the solved problem.
    fn read(&mut self, problem: &Problem) {
        let _ = problem;
    }
}

/// The frame of a term's measurements: the world frame of a model that fits them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TermFrame {
    /// The measurements hold in any frame.
    Any,
    /// The model does not determine the similarity: it has too few images, or they lie on a line.
    /// The term takes no part until it does.
    Undetermined,
    /// The similarity `term_from_model`.
    TermFromModel(Sim3),
}

/// Minimum spread of points across a line, in their standard deviations along an axis. It gives the
/// rotation about the line to a fraction of a radian, which adjustments then refine.
const MIN_SPREAD: f64 = 3.0;

impl TermFrame {
    /// The frame of measured points, such as the centres of cameras: the similarity that brings
    /// `in_model[i]` nearest to `measured[i]`. It is undetermined as long as the measured points
    /// lie on a line, up to three times their standard deviation `sigma` along an axis.
    pub fn of_points(in_model: &[Vector3<f64>], measured: &[Vector3<f64>], sigma: f64) -> Self {
        let count = measured.len() as f64;
        let mean = measured.iter().sum::<Vector3<f64>>() / count;
        let square = |point: &Vector3<f64>| (point - mean) * (point - mean).transpose();
        let variances = measured.iter().map(square).sum::<Matrix3<f64>>().symmetric_eigenvalues();
        let across = variances.sum() - variances.max() - variances.min();
        if across <= MIN_SPREAD.powi(2) * sigma.powi(2) * count {
            return Self::Undetermined;
        }
        umeyama(in_model, measured, true).map_or(Self::Undetermined, Self::TermFromModel)
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

/// An observation of a landmark of a term.
#[derive(Clone, Copy, Debug)]
pub struct Mark {
    /// The landmark.
    pub point: Key<Vector3<f64>>,
    /// Where it is in the image, in pixels.
    pub pixel: Vector2<f64>,
    /// Standard deviation of each coordinate in pixels, divided by [`TermContext::noise`].
    pub sigma_px: f64,
    /// The loss of the reprojection error.
    pub loss: Loss,
}
