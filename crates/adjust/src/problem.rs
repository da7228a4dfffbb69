//! Construction of the least-squares problem of a reconstruction.
//!
//! E = ½ Σ ρ(|x − π(k, R X + t)|² / σ²), where σ grows with the keypoint's scale
//! ([`crate::keypoint_sigma_px`]), plus priors on the intrinsics and the factors of [`Term`]s. The
//! gauge is fixed by leaving columns out ([`Gauge`]). Held-out points take no part; with point
//! selection, neither do points that were not selected.

use std::collections::BTreeSet;

use tiepoint_ba::factors::{Reprojection, RigReprojection, ShiftedReprojection};
use tiepoint_ba::{EliminationOrder, FactorKey, Key, Problem, SpanningTree};
use tiepoint_geometry::nalgebra::{Vector1, Vector2, Vector3};
use tiepoint_geometry::{CameraModel, Loss, Rigid3, with_camera_model};
use tiepoint_scene::{CameraId, ImageId, IntrinsicsPrior, Keypoint, Reconstruction};

use crate::Error;
use crate::gauge::{Gauge, fix_gauge};
use crate::intrinsics::{fixed_columns, intrinsics_prior};
use crate::noise::keypoint_sigma_px;
use crate::options::{AdjustOptions, RefineIntrinsics, Scope};
use crate::portrait_landscape::{CameraKey, add_portrait_landscape};
use crate::selection::select_points;
use crate::term::{Shifted, Term, TermContext};
use crate::variables::{ComposedPose, ObservationFactor, Variables};

/// For each image: its keypoints that observe a point of the problem.
type Observations = Vec<Vec<(u32, Key<Vector3<f64>>)>>;

/// Builds the problem of a model.
///
/// # Errors
///
/// [`Error::NothingToAdjust`] if fewer than two registered images observe a point.
pub fn build_problem(
    model: &Reconstruction,
    scope: &Scope,
    options: &AdjustOptions,
    terms: &mut [&mut dyn Term],
) -> Result<Variables, Error> {
    let mut variables = Variables::new();
    let context = TermContext { model, scope, noise: options.noise };
    let observations = add_points(&mut variables, &context, options);
    let is_posed = |id: &ImageId| !observations[id.index()].is_empty();
    let posed: Vec<ImageId> = model.registered().map(|(id, ..)| id).filter(is_posed).collect();
    let num_observations = observations.iter().map(Vec::len).sum();
    if posed.len() < 2 || num_observations == 0 {
        return Err(Error::NothingToAdjust {
            images: posed.len(),
            points: variables.points.len(),
            observations: num_observations,
        });
    }
    let composed: BTreeSet<ImageId> =
        terms.iter_mut().flat_map(|term| term.composed_images(&posed)).collect();
    add_poses(&mut variables, &context, options, &posed, &composed);
    for term in terms.iter_mut() {
        term.add(&context, &mut variables)?;
    }
    let found: BTreeSet<ImageId> = variables.composed.iter().map(|(image, _)| *image).collect();
    if found.len() < variables.composed.len() || found != composed {
        return Err(Error::ComposedPoses);
    }
    fix_problem_gauge(&mut variables, &context, options)?;
    set_tree_retraction(&mut variables, &observations)?;
    let mut keys = Vec::new();
    for (camera, _) in model.cameras() {
        keys.extend(add_camera(&mut variables, &context, options, terms, &observations, camera)?);
    }
    add_portrait_landscape(variables.problem_mut(), model, &keys)?;
    Ok(variables)
}

/// Adds the points of the scope as landmarks, without held-out and unselected ones.
fn add_points(
    variables: &mut Variables,
    context: &TermContext,
    options: &AdjustOptions,
) -> Observations {
    let TermContext { model, scope, .. } = *context;
    let mut observations = vec![Vec::new(); model.images().count()];
    let mut points = scope.points(model);
    points.retain(|point| model.track(*point).is_some_and(|track| !track.is_held_out));
    if options.select_tracks {
        points = select_points(model, points, |image| scope.is_variable(image));
    }
    for point in points {
        let Some(track) = model.track(point) else { continue };
        let key = variables.problem_mut().add_landmark(track.xyz);
        variables.points.push((point, key));
        for observation in &track.observations {
            observations[observation.image.index()].push((observation.keypoint, key));
        }
    }
    observations
}

/// Adds the poses that are not composed. Poses outside the scope are constant.
fn add_poses(
    variables: &mut Variables,
    context: &TermContext,
    options: &AdjustOptions,
    posed: &[ImageId],
    composed: &BTreeSet<ImageId>,
) {
    for (order, &image) in posed.iter().enumerate().filter(|(_, image)| !composed.contains(image)) {
        let Some(pose) = context.model.image(image).cam_from_world() else { continue };
        let key = variables.problem_mut().add_parameter(*pose, EliminationOrder::At(order as u32));
        if !options.is_variable(context.scope, image) {
            variables.problem_mut().fix(key);
        }
        variables.poses.push((image, key));
    }
}

/// Fixes the gauge on the poses of images and frames, unless terms do.
fn fix_problem_gauge(
    variables: &mut Variables,
    context: &TermContext,
    options: &AdjustOptions,
) -> Result<(), Error> {
    let index_of = |wanted| variables.poses.iter().position(|(image, _)| *image == wanted);
    let pair = match options.gauge {
        Gauge::FixedByTerms => return Ok(()),
        Gauge::Pair(pair) => index_of(pair.a).zip(index_of(pair.b)).map(|(a, b)| [a, b]),
        Gauge::FirstAndFarthest => None,
    };
    let is_fixed = |image: ImageId| !options.is_variable(context.scope, image);
    let of_images = variables.poses.iter().map(|(image, key)| (*key, is_fixed(*image)));
    let (keys, fixed): (Vec<Key<Rigid3>>, Vec<bool>) =
        of_images.chain(variables.rig_poses.iter().copied()).unzip();
    if options.constant_rigs && variables.have_baseline() {
        // The rigs determine the scale.
        if !fixed.contains(&true)
            && let Some(first) = keys.first()
        {
            variables.problem_mut().fix(*first);
        }
        return Ok(());
    }
    fix_gauge(variables.problem_mut(), &keys, &fixed, pair)?;
    if let (1, Some((_, composed))) = (keys.len(), variables.composed.first()) {
        // A single frame of a rig: the baseline of two of its cameras fixes the scale.
        let cam_from_rig = composed.cam_from_rig;
        let place = variables.problem().get(cam_from_rig).translation;
        variables.problem_mut().fix_dofs(cam_from_rig, &[3 + place.iamax()])?;
    }
    Ok(())
}

/// Sets a retraction that moves each pose relative to others that observe the same points
/// ([`SpanningTree`]).
fn set_tree_retraction(
    variables: &mut Variables,
    observations: &Observations,
) -> Result<(), Error> {
    let own = variables.poses.iter().copied();
    let composed = variables.composed.iter().map(|(image, pose)| (*image, pose.rig_from_world));
    let views: Vec<(Key<Rigid3>, Key<Vector3<f64>>)> = own
        .chain(composed)
        .flat_map(|(image, pose)| {
            observations[image.index()].iter().map(move |(_, point)| (pose, *point))
        })
        .collect();
    let tree = SpanningTree::new(variables.problem(), &views)?;
    variables.problem_mut().set_retraction(tree);
    Ok(())
}

/// Representation of an image's pose.
#[derive(Clone, Copy)]
enum Pose {
    Variable(Key<Rigid3>),
    Composed(ComposedPose),
}

impl Pose {
    /// Adds the reprojection error of a point. `observed`: the pixel and its standard deviation.
    fn observe<M: CameraModel>(
        self,
        problem: &mut Problem,
        params: Key<M::Params>,
        point: Key<Vector3<f64>>,
        observed: (Vector2<f64>, f64),
        loss: Loss,
    ) -> Result<FactorKey, Error> {
        let (pixel, sigma_px) = observed;
        Ok(match self {
            Self::Variable(pose) => {
                let factor = Reprojection::<M>::new(pixel, sigma_px);
                problem.add((params, pose, point), factor, loss)?
            }
            Self::Composed(ComposedPose { cam_from_rig, rig_from_world }) => {
                let factor = RigReprojection::<M>::new(pixel, sigma_px);
                problem.add((params, cam_from_rig, rig_from_world, point), factor, loss)?
            }
        })
    }
}

/// Adds the intrinsics of a camera and the observations of its images. Returns the key of the
/// intrinsics; `None` for a camera without images in the problem.
fn add_camera(
    variables: &mut Variables,
    context: &TermContext,
    options: &AdjustOptions,
    terms: &mut [&mut dyn Term],
    observations: &Observations,
    camera: CameraId,
) -> Result<Option<CameraKey>, Error> {
    let model = context.model;
    let own = variables.poses.iter().map(|(image, key)| (*image, Pose::Variable(*key)));
    let composed = variables.composed.iter().map(|(image, pose)| (*image, Pose::Composed(*pose)));
    let is_of_camera = |(image, _): &(ImageId, Pose)| model.image(*image).camera == camera;
    let images: Vec<(ImageId, Pose)> = own.chain(composed).filter(is_of_camera).collect();
    if images.is_empty() {
        return Ok(None);
    }
    for term in terms.iter_mut() {
        term.add_to_camera(context, camera, variables)?;
    }
    let camera_of_images = model.camera(camera);
    let is_of_kind =
        |prior: &&IntrinsicsPrior| prior.mean.kind() == camera_of_images.intrinsics.kind();
    let calibration = model.intrinsics_priors.get(&camera).filter(is_of_kind);
    let refine = intrinsics_to_refine(context, options, camera, calibration.is_some());
    let mut factors = Vec::new();
    let key: CameraKey = with_camera_model!(&camera_of_images.intrinsics, M, params => {
        let kind = camera_of_images.intrinsics.kind();
        let columns = fixed_columns(kind, refine);
        let problem = variables.problem_mut();
        let key = problem.add_parameter(*params, EliminationOrder::Last);
        if columns.len() == kind.num_params() {
            problem.fix(key);
        } else {
            problem.fix_dofs(key, &columns)?;
            let prior =
                intrinsics_prior(params, camera, camera_of_images, calibration, refine, options)?;
            problem.add(key, prior, Loss::Trivial)?;
        }
        for (image, pose) in &images {
            let shifts = terms.iter().find_map(|term| term.shifts_of(camera, *image));
            let observations_of_image = ImageObservations {
                image: *image,
                keypoints: &model.image(*image).keypoints,
                observed: &observations[image.index()],
                pose: *pose,
                shifts,
            };
            observations_of_image.add::<M>(problem, key, options.loss, &mut factors)?;
            for mark in terms.iter().flat_map(|term| term.marks_of(*image)) {
                let observed = (mark.pixel, mark.sigma_px);
                pose.observe::<M>(problem, key, mark.point, observed, mark.loss)?;
            }
        }
        let read = move |problem: &Problem| problem.get(key).as_slice().to_vec();
        variables.cameras.push((camera, key.into(), Box::new(read)));
        (camera, Box::new(key))
    });
    variables.observations.extend(factors);
    Ok(Some(key))
}

/// What is refined of a camera. The images of a local adjustment determine the intrinsics too
/// weakly if the camera has other images.
fn intrinsics_to_refine(
    context: &TermContext,
    options: &AdjustOptions,
    camera: CameraId,
    is_calibrated: bool,
) -> RefineIntrinsics {
    let model = context.model;
    let mut all = model.registered().filter(|(_, image, _)| image.camera == camera);
    let has_all_images = all.all(|(id, ..)| context.scope.is_variable(id));
    match options.refine_calibrated {
        _ if model.calibrated.contains(&camera) || !has_all_images => RefineIntrinsics::NONE,
        Some(refine) if is_calibrated => refine,
        _ => options.refine,
    }
}

/// The observations of an image.
struct ImageObservations<'a> {
    image: ImageId,
    keypoints: &'a [Keypoint],
    observed: &'a [(u32, Key<Vector3<f64>>)],
    pose: Pose,
    shifts: Option<(Key<Vector1<f64>>, &'a [Shifted])>,
}

impl ImageObservations<'_> {
    /// Adds a reprojection factor for each observed point, and lists it in `factors`.
    fn add<M: CameraModel>(
        &self,
        problem: &mut Problem,
        params: Key<M::Params>,
        loss: Loss,
        factors: &mut Vec<ObservationFactor>,
    ) -> Result<(), Error> {
        for &(index, point) in self.observed {
            let keypoint = &self.keypoints[index as usize];
            let (pixel, sigma_px) = (keypoint.pixel, keypoint_sigma_px(keypoint.scale_px));
            let factor = match (self.pose, self.shifts) {
                (Pose::Variable(pose), Some((shift_scale, shifts))) => {
                    let Shifted { pixel, shift } = shifts[index as usize];
                    let unshifted = Reprojection::<M>::new(pixel, sigma_px);
                    let factor = ShiftedReprojection { unshifted, shift };
                    problem.add((params, pose, shift_scale, point), factor, loss)?
                }
                (pose, _) => pose.observe::<M>(problem, params, point, (pixel, sigma_px), loss)?,
            };
            factors.push(ObservationFactor { factor, image: self.image, keypoint: index });
        }
        Ok(())
    }
}
