//! Lens fields of a finished model as random effects on its intrinsics.

use std::cmp::Reverse;

use tiepoint_ba::factors::LensField;
use tiepoint_ba::{AnyKey, RandomEffects};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{DMatrix, DVector};
use tiepoint_scene::{CameraId, Image, ImageId, IntrinsicsPrior, Reconstruction};

use crate::Error;
use crate::field_problem::{FieldCamera, FieldPriors, FieldProblem};
use crate::infinity::without_points_at_infinity;
use crate::intrinsics::fixed_columns;
use crate::noise::FitNoise;
use crate::options::{AdjustOptions, RefineIntrinsics, Scope};
use crate::solve::{adjust, keep_going};

/// Standard deviations of the priors that keep the normal equations regular where images determine
/// nothing: of the intrinsics in those of the expectation, and of the field's coefficients in
/// pixels. They are beyond every value that occurs.
const WIDE_DEVIATIONS: f64 = 100.0;
const WIDE_FIELD_PX: f64 = 10.0;
/// Images with fewer points take no part. Three determine a pose.
const MIN_POINTS: usize = 10;
/// The variance of the fields is estimated from their best determined modes, so many for each
/// camera: twice the parameters of an OPENCV camera. Modes that images hardly determine show other
/// errors than the lens's. Chosen on KITTI 01 and 04, two photo sets and eight rendered drives with
/// a field of 0.15 px: with 7, exact intrinsics are contradicted on most of them (factors of 4 to
/// 70), with 28, focal lengths that are 1 % off are kept on all drives, and KITTI 04's calibration.
const MODES_PER_CAMERA: usize = 14;

/// Cameras of fewer images tell too little of a field.
const MIN_IMAGES: usize = 3;
/// Cameras that have a field at most, those with the most images: the cost grows with the cube.
const MAX_CAMERAS: usize = 8;

/// Those of some cameras that may have lens fields: with enough registered images, and not too many
/// cameras. In order of their ids.
pub fn cameras_with_fields(
    model: &Reconstruction,
    cameras: impl IntoIterator<Item = CameraId>,
) -> Vec<CameraId> {
    let count = |id: CameraId| model.registered().filter(|(_, it, _)| it.camera == id).count();
    let counted = cameras.into_iter().map(|id| (count(id), id));
    let mut found: Vec<(usize, CameraId)> =
        counted.filter(|(count, _)| *count >= MIN_IMAGES).collect();
    found.sort_by_key(|(count, camera)| (Reverse(*count), *camera));
    found.truncate(MAX_CAMERAS);
    let mut cameras: Vec<CameraId> = found.into_iter().map(|(_, camera)| camera).collect();
    cameras.sort();
    cameras
}

/// The modes that tell of the fields of some cameras.
pub(crate) fn num_modes(num_cameras: usize) -> usize {
    MODES_PER_CAMERA * num_cameras
}

/// Adjusts poses and points to the intrinsics, so that the slopes of the cost with respect to them
/// are zero. Images with hardly any points and points that move to infinity make the system
/// singular: they are left out. Rigs are left out as well.
pub(crate) fn fit_poses(model: &mut Reconstruction, options: &AdjustOptions) -> Result<(), Error> {
    leave_out_weak_images(model);
    let fit = AdjustOptions {
        refine: RefineIntrinsics::NONE,
        refine_calibrated: Some(RefineIntrinsics::NONE),
        select_tracks: true,
        loss: options.loss,
        noise: options.noise,
        ..AdjustOptions::default()
    };
    adjust(model, &Scope::Global, &fit, &mut [], &mut keep_going)?;
    let num_fitted =
        |model: &Reconstruction| model.tracks().filter(|(_, track)| !track.is_held_out).count();
    let before = num_fitted(model);
    *model = without_points_at_infinity(model);
    if num_fitted(model) < before {
        adjust(model, &Scope::Global, &fit, &mut [], &mut keep_going)?;
    }
    Ok(())
}

/// Leaves rigs out, and images with hardly any points.
pub(crate) fn leave_out_weak_images(model: &mut Reconstruction) {
    model.frames.clear();
    let is_weak = |(_, image, _): &(ImageId, &Image, &Rigid3)| {
        image.points().iter().flatten().take(MIN_POINTS).count() < MIN_POINTS
    };
    let weak: Vec<ImageId> = model.registered().filter(is_weak).map(|(id, ..)| id).collect();
    weak.into_iter().for_each(|image| model.deregister(image));
}

/// The joint covariance of the intrinsics of some cameras, in standard deviations of `expected`,
/// and of the coefficients of their fields in pixels, for residuals of unit variance. Poses and
/// points are adjusted to the intrinsics, as by [`fit_poses`].
pub(crate) fn field_effects<'a>(
    model: &Reconstruction,
    expected: impl Fn(CameraId) -> Option<&'a IntrinsicsPrior>,
    refine: RefineIntrinsics,
    options: &AdjustOptions,
    noise: &FitNoise,
) -> Result<FieldEffects, Error> {
    let wide = |id| {
        let IntrinsicsPrior { mean, sigmas } = expected(id)?;
        let sigmas = sigmas.iter().map(|sigma| sigma * WIDE_DEVIATIONS).collect();
        Some(IntrinsicsPrior { mean: *mean, sigmas })
    };
    let wide: Vec<Option<IntrinsicsPrior>> = model.cameras().map(|(id, _)| wide(id)).collect();
    let regular = AdjustOptions::default();
    let scene = FieldProblem::new(model, options.loss, |id| {
        let intrinsics = Some(wide[id.index()].as_ref()?);
        Some(FieldPriors { refine, intrinsics, field_px: WIDE_FIELD_PX, options: &regular })
    })?;
    let keys: Vec<AnyKey> = scene.cameras.iter().flat_map(|it| [it.intrinsics, it.field]).collect();
    let covariance = scene.problem.covariance(&keys)?;
    // Rows of the covariance with their units, and slopes.
    let (mut of_intrinsics, mut of_fields, mut moved) = (Vec::new(), Vec::new(), Vec::new());
    let mut first = 0;
    for camera in &scene.cameras {
        let Some(prior) = expected(camera.camera) else { continue };
        let parameters = parameters(model, camera, prior, refine);
        of_intrinsics.extend(parameters.iter().map(|it| (first + it.index, it.sigma, it.slope)));
        moved.extend(parameters.iter().map(|it| (camera.camera, it.index, it.moved)));
        first += camera.params.len();
        let slopes: &LensField = &camera.slopes.1;
        of_fields.extend((first..).zip(slopes).map(|(row, slope)| (row, 1.0, *slope)));
        first += slopes.len();
    }
    let rows: Vec<(usize, f64, f64)> = of_intrinsics.into_iter().chain(of_fields).collect();
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
        let ((row, unit, _), (column, other, _)) = (rows[i], rows[j]);
        covariance.matrix()[(row, column)] * noise.sigma.powi(2) / (unit * other)
    });
    // The information counts the weights of the loss, and slopes its derivatives.
    let scale = noise.curvature_excess / noise.sigma.powi(2);
    let slopes = rows.iter().map(|(_, _, slope)| slope * scale).collect();
    Ok(FieldEffects { moved, covariance, slopes })
}

/// The joint covariance of intrinsics and fields.
pub(crate) struct FieldEffects {
    /// Camera, parameter, and its difference from the expectation. Fields follow.
    moved: Vec<(CameraId, usize, f64)>,
    covariance: DMatrix<f64>,
    /// Slopes of the cost.
    slopes: Vec<f64>,
}

impl FieldEffects {
    /// The normal equations of all intrinsics and the fields. `None` if the covariance is singular
    /// to rounding.
    pub(crate) fn all(&self) -> Option<RandomEffects> {
        self.of(|_, _| true)
    }

    /// The normal equations of some parameters and the fields, where the others are free. The cost
    /// has its minimum with respect to these.
    pub(crate) fn of(&self, is_kept: impl Fn(CameraId, usize) -> bool) -> Option<RandomEffects> {
        let kept: Vec<usize> = (0..self.slopes.len())
            .filter(|row| self.moved.get(*row).is_none_or(|(id, index, _)| is_kept(*id, *index)))
            .collect();
        let moved = kept.iter().filter_map(|row| Some(self.moved.get(*row)?.2));
        let covariance =
            DMatrix::from_fn(kept.len(), kept.len(), |i, j| self.covariance[(kept[i], kept[j])]);
        Some(RandomEffects {
            moved: DVector::from_vec(moved.collect()),
            information: covariance.cholesky()?.inverse(),
            slopes: DVector::from_iterator(kept.len(), kept.iter().map(|row| self.slopes[*row])),
        })
    }
}

/// A parameter of the intrinsics.
struct Parameter {
    index: usize,
    /// Standard deviation of the expectation, the unit of what follows.
    sigma: f64,
    /// Difference from the expectation.
    moved: f64,
    /// Slope of the cost.
    slope: f64,
}

/// The free parameters of a camera.
fn parameters(
    model: &Reconstruction,
    camera: &FieldCamera,
    expected: &IntrinsicsPrior,
    refine: RefineIntrinsics,
) -> Vec<Parameter> {
    let intrinsics = &model.camera(camera.camera).intrinsics;
    let kind = intrinsics.kind();
    let fixed = fixed_columns(kind, refine);
    let (params, slopes) = (&camera.params, &camera.slopes.0);
    let tied = match kind.focal_indices() {
        &[x, y] if !refine.aspect => Some((x, y, params[y] / params[x])),
        _ => None,
    };
    let deviations = expected.deviations(intrinsics);
    let is_free = |index: &usize| {
        !fixed.contains(index) && tied.is_none_or(|(_, follower, _)| *index != follower)
    };
    let parameter = |index: usize| {
        let of_follower = match tied {
            Some((x, y, ratio)) if x == index => ratio * slopes[y],
            _ => 0.0,
        };
        let sigma = expected.sigmas[index];
        let slope = (slopes[index] + of_follower) * sigma;
        Parameter { index, sigma, moved: deviations[index], slope }
    };
    (0..params.len()).filter(is_free).map(parameter).collect()
}
