//! Whether the images contradict a calibration.
//!
//! A lens model leaves a smooth static field of displacements, 0.1 to 0.2 px on KITTI (Krešo and
//! Šegvić 2015). Intrinsics that are refined fit a part of it. On a straight drive they then move
//! by ten pixels for a gain of 1 % in the reprojection error, and the trajectory becomes worse. So
//! two hypotheses are compared by how likely they make the intrinsics that fit best without a
//! field:
//!
//! - The calibration is exact, and the lens has a field.
//! - Each parameter is off by its standard deviation, and the lens has a field.
//!
//! The field is a bicubic spline whose coefficients have independent normal distributions of one
//! standard deviation τ. τ is estimated from the field that residuals show after a refinement of
//! the intrinsics ([`RandomEffects`]).

use std::collections::BTreeMap;

use tiepoint_ba::factors::{FieldReprojection, LensField, Prior};
use tiepoint_ba::{AnyKey, EliminationOrder, Factor, Key, Problem, RandomEffects};
use tiepoint_geometry::nalgebra::{DMatrix, DVector, SVector, Vector3};
use tiepoint_geometry::{CameraModel, Loss, Manifold, Rigid3, with_camera_model};
use tiepoint_scene::{CameraId, Image, ImageId, IntrinsicsPrior, PointId, Reconstruction};

use crate::Error;
use crate::gauge::fix_gauge;
use crate::intrinsics::{fixed_columns, intrinsics_prior};
use crate::noise::{FitNoise, keypoint_sigma_px};
use crate::options::{AdjustOptions, RefineIntrinsics, Scope};
use crate::selection::select_points;
use crate::solve::{adjust, keep_going};

/// Standard deviations of the priors that keep the normal equations regular where images determine
/// nothing: of the intrinsics in those of the calibration, and of the field's coefficients in
/// pixels. They are beyond every value that occurs.
const WIDE_DEVIATIONS: f64 = 100.0;
const WIDE_FIELD_PX: f64 = 10.0;
/// Calibrated cameras of fewer images tell too little.
const MIN_IMAGES: usize = 3;
/// Cameras that are compared at most, those with the most images: the cost grows with the cube.
const MAX_CAMERAS: usize = 8;
/// Images with fewer points take no part. Three determine a pose.
const MIN_POINTS: usize = 10;
/// τ is estimated from the best determined modes of the fields, so many for each camera: twice the
/// parameters of an OPENCV camera. Modes that images hardly determine show other errors than the
/// lens's. Chosen on KITTI 01 and 04, two photo sets and eight rendered drives with a field of 0.15
/// px: with 7, exact intrinsics are contradicted on most of them (factors of 4 to 70), with 28,
/// focal lengths that are 1 % off are kept on all drives, and KITTI 04's calibration.
const MODES_PER_CAMERA: usize = 14;

/// What images say of calibrations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibrationEvidence {
    /// Logarithm of the Bayes factor for intrinsics that are off by the standard deviations of
    /// their calibrations, against exact ones. `None` if no camera has a calibration that is
    /// refined and enough images.
    pub log_bayes_factor: Option<f64>,
    /// The cameras that it is of.
    pub cameras: Vec<CameraId>,
}

/// Compares exact calibrations with wrong ones. The model was refined with the calibrations as
/// priors. Poses are free, whatever rigs or terms say of them; cameras that are not compared are
/// constant.
///
/// # Errors
///
/// If a variable is undetermined, or there is nothing to adjust.
pub fn calibration_evidence(
    model: &Reconstruction,
    options: &AdjustOptions,
) -> Result<CalibrationEvidence, Error> {
    let refine = options.refine_calibrated.unwrap_or(options.refine);
    let cameras = calibrated_cameras(model, refine);
    if cameras.is_empty() {
        return Ok(CalibrationEvidence::default());
    }
    let noise = FitNoise::of(model, &options.loss);
    let mut model = model.clone();
    model.frames.clear();
    leave_out_weak_images(&mut model);
    let fit = AdjustOptions {
        refine: RefineIntrinsics::NONE,
        refine_calibrated: Some(RefineIntrinsics::NONE),
        select_tracks: true,
        loss: options.loss,
        noise: options.noise,
        ..AdjustOptions::default()
    };
    // Now the scores of the poses and points are zero.
    adjust(&mut model, &Scope::Global, &fit, &mut [], &mut keep_going)?;
    let effects = random_effects(&model, &cameras, refine, options.loss, &noise)?;
    let modes = MODES_PER_CAMERA * cameras.len();
    let log_bayes_factor = effects.and_then(|effects| effects.log_bayes_factor(modes));
    Ok(CalibrationEvidence { log_bayes_factor, cameras })
}

/// Images with hardly any points do not determine their poses, and make the system singular.
fn leave_out_weak_images(model: &mut Reconstruction) {
    let is_weak = |(_, image, _): &(ImageId, &Image, &Rigid3)| {
        image.points().iter().flatten().take(MIN_POINTS).count() < MIN_POINTS
    };
    let weak: Vec<ImageId> = model.registered().filter(is_weak).map(|(id, ..)| id).collect();
    weak.into_iter().for_each(|image| model.deregister(image));
}

/// Cameras whose calibrations are tested, in order of their ids.
fn calibrated_cameras(model: &Reconstruction, refine: RefineIntrinsics) -> Vec<CameraId> {
    let mut found: Vec<(usize, CameraId)> = model
        .intrinsics_priors
        .iter()
        .filter(|(camera, prior)| {
            let kind = model.camera(**camera).intrinsics.kind();
            !model.calibrated.contains(camera)
                && prior.mean.kind() == kind
                && fixed_columns(kind, refine).len() < kind.num_params()
        })
        .map(|(camera, _)| {
            (model.registered().filter(|(_, image, _)| image.camera == *camera).count(), *camera)
        })
        .filter(|(count, _)| *count >= MIN_IMAGES)
        .collect();
    found.sort_by_key(|(count, camera)| (std::cmp::Reverse(*count), *camera));
    found.truncate(MAX_CAMERAS);
    let mut cameras: Vec<CameraId> = found.into_iter().map(|(_, camera)| camera).collect();
    cameras.sort();
    cameras
}

/// The normal equations of the intrinsics and of the fields' coefficients, for residuals of unit
/// variance. `None` if the covariance is singular to rounding.
fn random_effects(
    model: &Reconstruction,
    cameras: &[CameraId],
    refine: RefineIntrinsics,
    loss: Loss,
    noise: &FitNoise,
) -> Result<Option<RandomEffects>, Error> {
    let mut scene = Scene::new(model)?;
    let mut found = Vec::new();
    for (id, camera) in model.cameras() {
        let refined = cameras.contains(&id).then_some(refine);
        with_camera_model!(&camera.intrinsics, M, params => {
            found.extend(scene.add_camera::<M, _>(id, *params, refined, loss)?);
        });
    }
    let keys: Vec<AnyKey> = found.iter().flat_map(|it| [it.intrinsics, it.field]).collect();
    let covariance = scene.problem.covariance(&keys)?;
    // Rows of the covariance with their units, and slopes.
    let (mut of_intrinsics, mut of_fields, mut first) = (Vec::new(), Vec::new(), 0);
    for camera in &found {
        let rows = camera.parameters.iter().map(|it| (first + it.index, it.sigma, it.slope));
        of_intrinsics.extend(rows);
        first += camera.num_params;
        of_fields
            .extend((first..).zip(&camera.field_slopes).map(|(row, slope)| (row, 1.0, *slope)));
        first += camera.field_slopes.len();
    }
    let moved: Vec<f64> =
        found.iter().flat_map(|camera| &camera.parameters).map(|it| it.moved).collect();
    let rows: Vec<(usize, f64, f64)> = of_intrinsics.into_iter().chain(of_fields).collect();
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
        let ((row, unit, _), (column, other, _)) = (rows[i], rows[j]);
        covariance.matrix()[(row, column)] * noise.sigma.powi(2) / (unit * other)
    });
    // The information counts the weights of the loss, and slopes its derivatives.
    let scale = noise.curvature_excess / noise.sigma.powi(2);
    let slopes = rows.iter().map(|(_, _, slope)| slope * scale);
    Ok(covariance.cholesky().map(|covariance| RandomEffects {
        moved: DVector::from_vec(moved),
        information: covariance.inverse(),
        slopes: DVector::from_iterator(rows.len(), slopes),
    }))
}

/// A model as a problem, camera by camera.
struct Scene<'a> {
    model: &'a Reconstruction,
    problem: Problem,
    poses: BTreeMap<ImageId, Key<Rigid3>>,
    points: Vec<(PointId, Key<Vector3<f64>>)>,
}

/// A camera whose calibration is tested.
struct TestedCamera {
    intrinsics: AnyKey,
    field: AnyKey,
    num_params: usize,
    /// The free ones.
    parameters: Vec<Parameter>,
    field_slopes: LensField,
}

/// A parameter of the intrinsics.
struct Parameter {
    index: usize,
    /// Standard deviation of the calibration, the unit of what follows.
    sigma: f64,
    /// Difference from the calibration.
    moved: f64,
    /// Slope of the cost.
    slope: f64,
}

impl<'a> Scene<'a> {
    fn new(model: &'a Reconstruction) -> Result<Self, Error> {
        let mut problem = Problem::new();
        let poses: BTreeMap<ImageId, Key<Rigid3>> = (0..)
            .zip(model.registered())
            .map(|(at, (image, _, pose))| {
                (image, problem.add_parameter(*pose, EliminationOrder::At(at)))
            })
            .collect();
        let keys: Vec<Key<Rigid3>> = poses.values().copied().collect();
        fix_gauge(&mut problem, &keys, &vec![false; keys.len()], None)?;
        let trained = model.tracks().filter(|(_, track)| !track.is_held_out).map(|(id, _)| id);
        let points = select_points(model, trained.collect(), |_| true);
        let points = points
            .into_iter()
            .filter_map(|id| Some((id, problem.add_landmark(model.track(id)?.xyz))))
            .collect();
        Ok(Self { model, problem, poses, points })
    }

    /// Adds a camera and its observations: with constant intrinsics, or with free ones and a field.
    fn add_camera<M: CameraModel<Params = SVector<f64, N>>, const N: usize>(
        &mut self,
        id: CameraId,
        params: SVector<f64, N>,
        refined: Option<RefineIntrinsics>,
        loss: Loss,
    ) -> Result<Option<TestedCamera>, Error> {
        let key = self.problem.add_parameter(params, EliminationOrder::Last);
        let field = self.problem.add_parameter(LensField::zeros(), EliminationOrder::Last);
        let mut slopes = (SVector::<f64, N>::zeros(), LensField::zeros());
        let camera = self.model.camera(id);
        for &(point, landmark) in &self.points {
            let Some(track) = self.model.track(point) else { continue };
            for observation in &track.observations {
                let image = self.model.image(observation.image);
                let Some(&pose) = self.poses.get(&observation.image) else { continue };
                if image.camera != id {
                    continue;
                }
                let keypoint = &image.keypoints[observation.keypoint as usize];
                let sigma_px = keypoint_sigma_px(keypoint.scale_px);
                let size = [camera.width, camera.height];
                let factor = FieldReprojection::<M>::new(keypoint.pixel, sigma_px, size);
                let values = (&params, &self.problem.get(pose), &LensField::zeros(), &track.xyz);
                if let Some((residual, (d_params, _, d_field, _))) = factor.linearize(values) {
                    let [_, weight, _] = loss.evaluate(residual.norm_squared());
                    slopes.0 += d_params.transpose() * residual * weight;
                    slopes.1 += d_field.transpose() * residual * weight;
                }
                self.problem.add((key, pose, field, landmark), factor, loss)?;
            }
        }
        let calibration = self.model.intrinsics_priors.get(&id);
        let Some((refine, calibration)) = refined.zip(calibration) else {
            self.problem.fix(key);
            self.problem.fix(field);
            return Ok(None);
        };
        let kind = camera.intrinsics.kind();
        let fixed = fixed_columns(kind, refine);
        self.problem.fix_dofs(key, &fixed)?;
        let wide = IntrinsicsPrior {
            mean: calibration.mean,
            sigmas: calibration.sigmas.iter().map(|sigma| sigma * WIDE_DEVIATIONS).collect(),
        };
        let options = AdjustOptions::default();
        let prior = intrinsics_prior(&params, id, camera, Some(&wide), refine, &options)?;
        self.problem.add(key, prior, Loss::Trivial)?;
        let sigmas = [WIDE_FIELD_PX; LensField::DOF];
        self.problem.add(field, Prior::new(LensField::zeros(), &sigmas)?, Loss::Trivial)?;
        let tied = match kind.focal_indices() {
            &[x, y] if !refine.aspect => Some((x, y, params[y] / params[x])),
            _ => None,
        };
        let deviations = calibration.deviations(&camera.intrinsics);
        let is_free = |index: &usize| {
            !fixed.contains(index) && tied.is_none_or(|(_, follower, _)| *index != follower)
        };
        let parameter = |index: usize| {
            let of_follower = match tied {
                Some((x, y, ratio)) if x == index => ratio * slopes.0[y],
                _ => 0.0,
            };
            let sigma = calibration.sigmas[index];
            let slope = (slopes.0[index] + of_follower) * sigma;
            Parameter { index, sigma, moved: deviations[index], slope }
        };
        Ok(Some(TestedCamera {
            intrinsics: key.into(),
            field: field.into(),
            num_params: N,
            parameters: (0..N).filter(is_free).map(parameter).collect(),
            field_slopes: slopes.1,
        }))
    }
}
