//! Bundle adjustment of a reconstruction: into a least-squares problem, and back.
//!
//! E = ½ Σ ρ(|x − π(k, R X + t)|² / σ²), σ growing with the keypoint's scale ([`crate::keypoint_sigma_px`]). The gauge is held by
//! leaving columns out: the pose of one image and, of a second image's tangent, the coordinate in which its centre moves most with the
//! scale. Links between the relative poses of cameras that ride together are further terms. Points that are held out do not take
//! part, nor do those that are not needed; afterwards each is moved to where the adjusted poses see it.

mod mountings;
mod shutters;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

use rayon::prelude::*;
use tiepoint_ba::factors::{Prior, Reprojection, RigReprojection, ShiftedReprojection};
use tiepoint_ba::{IterationRecord, Key, Options, Order, Problem, Solver, SpanningTree, Summary};
use tiepoint_geometry::nalgebra::{SVector, Vector1, Vector3};
use tiepoint_geometry::{CameraModelKind, Loss, Rigid3, with_camera_model};
use tiepoint_rig::{Baseline, Clock};
use tiepoint_scene::{Camera, CameraId, ImageId, ImagePair, PointId, Reconstruction};

use crate::focal::FocalPrior;
use crate::mounting::Mounting;
use crate::rig_pairs::BaselineLink;
use crate::sigma::relative_noise;
use crate::spread::spread_points;
use crate::{Error, keypoint_sigma_px, triangulation};
pub use mountings::MountingCovariance;
pub(crate) use mountings::mounting_covariances;
use mountings::rigid_pairs;
pub(crate) use shutters::{Shifted, Shutters, adjust_readouts, with_deviations};

/// Standard deviation of the ratio of two focal lengths. Ten times as much is enough for a million keypoints.
const FOCAL_RATIO_SIGMA: f64 = 1e-6;

/// Which intrinsics an adjustment may move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineIntrinsics {
    /// Focal lengths, in the ratio that they have: the pixels of cameras are square. From a street, which leaves itself as it is when heights
    /// grow and no camera rolls, keypoints that are a twentieth of a pixel off tell another one, by a thousandth.
    pub focal: bool,
    /// The principal point, held near the middle of the image by a prior.
    pub principal_point: bool,
    /// Distortion.
    pub distortion: bool,
}

impl RefineIntrinsics {
    /// Nothing: the calibration is known.
    pub const NONE: Self = Self { focal: false, principal_point: false, distortion: false };
    /// Focal length and distortion, the principal point staying where it is.
    pub const FOCAL_AND_DISTORTION: Self = Self { focal: true, principal_point: false, distortion: true };
    /// Everything.
    pub const ALL: Self = Self { focal: true, principal_point: true, distortion: true };
}

/// How to adjust.
#[derive(Clone, Copy, Debug)]
pub struct AdjustOptions<'a> {
    /// What may move of the cameras.
    pub refine: RefineIntrinsics,
    /// Whether points that are enough to place the images take part alone: those seen most often, all over every image.
    pub spread: bool,
    /// Of the weighted residual.
    pub loss: Loss,
    /// Standard deviation of the principal point's prior, as a share of the image's larger side.
    pub principal_point_sigma: f64,
    /// Standard deviation of the prior on each distortion coefficient, around 0.
    pub distortion_sigma: f64,
    /// Standard deviation of the keypoints, as a multiple of [`crate::keypoint_sigma_px`], against which the priors are weighed.
    pub noise: f64,
    /// What is believed of the focal lengths; of cameras that are not listed, nothing.
    pub focal_priors: &'a [FocalPrior],
    /// Where cameras ride together: relative poses that should be equal.
    pub links: &'a [BaselineLink],
    /// The images that hold place, orientation and size of the world: the first one's pose, and one coordinate in which the second one's
    /// centre moves. By default the first and the one farthest from it.
    pub gauge: Option<ImagePair>,
    /// Steps at most.
    pub max_iterations: usize,
    /// Stop when a step lowers the cost by less than this share.
    pub function_tolerance: f64,
}

impl Default for AdjustOptions<'_> {
    fn default() -> Self {
        Self {
            refine: RefineIntrinsics::FOCAL_AND_DISTORTION,
            spread: false,
            loss: Loss::SoftL1(4.0),
            principal_point_sigma: 0.01,
            distortion_sigma: 0.2,
            noise: 1.0,
            focal_priors: &[],
            links: &[],
            gauge: None,
            max_iterations: 50,
            function_tolerance: 1e-6,
        }
    }
}

/// Where the loss of a finished model departs from the square, in standard deviations of its keypoints: 95 % as efficient as the square on
/// Gaussian noise (Holland and Welsch 1977).
const CAUCHY_SIGMAS: f64 = 2.385;
/// No keypoint is more precise, in standard deviations of [`crate::keypoint_sigma_px`]: where synthetic ones are, rounding is no outlier.
const MIN_NOISE: f64 = 0.05;

impl AdjustOptions<'_> {
    /// With priors and loss weighed against the noise that a finished model leaves ([`AdjustOptions::noise`]): precise keypoints decide alone, and
    /// one that is off by much more than most counts little. Noise beyond what was expected is the model's own, and gives the priors no more weight.
    pub fn weighed_against(self, model: &Reconstruction) -> Self {
        self.with_noise(relative_noise(model))
    }

    pub(crate) fn with_noise(self, noise: f64) -> Self {
        Self { noise: noise.min(1.0), loss: Loss::Cauchy(CAUCHY_SIGMAS * noise.max(MIN_NOISE)), ..self }
    }
}

/// Which images and points an adjustment moves.
#[derive(Clone, Debug)]
pub enum Scope<'a> {
    /// Everything that is registered.
    Global,
    /// These images and the points that they see; the other images that see those points hold them in place.
    Local(&'a BTreeSet<ImageId>),
}

impl Scope<'_> {
    fn moves(&self, image: ImageId) -> bool {
        match self {
            Self::Global => true,
            Self::Local(images) => images.contains(&image),
        }
    }

    /// The points that the images see, held out or not, in order.
    fn points(&self, model: &Reconstruction) -> Vec<PointId> {
        match self {
            Self::Global => model.tracks().map(|(point, _)| point).collect(),
            Self::Local(images) => model.points_seen_by(*images),
        }
    }
}

/// Adjusts; the model is changed to where the optimiser ended, whatever the reason.
pub fn adjust(
    model: &mut Reconstruction,
    scope: &Scope,
    options: &AdjustOptions,
    watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
) -> Result<Summary, Error> {
    adjust_mounted(model, scope, options, &mut [], watch)
}

/// Adjusts everything with cameras held to mountings, which are adjusted with it: calibration and clock.
pub(crate) fn adjust_mounted(
    model: &mut Reconstruction,
    scope: &Scope,
    options: &AdjustOptions,
    mountings: &mut [Mounting],
    watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
) -> Result<Summary, Error> {
    let mut bundle = Bundle::new(model, scope, options, mountings, None)?;
    let summary = bundle.solve(model, options, watch)?;
    for (mounting, (mount, clock)) in mountings.iter_mut().zip(&bundle.mountings) {
        mounting.right_from_left = bundle.problem.get(*mount);
        if let Some(clock) = clock {
            mounting.companion.clock = bundle.problem.get(*clock);
        }
    }
    retriangulate_others(model, scope, &bundle.points);
    Ok(summary)
}

/// For adjustments that nobody watches.
pub(crate) fn keep_going(_: &IterationRecord) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// A problem and which of its variables is what.
struct Bundle {
    problem: Problem,
    cameras: Vec<(CameraId, ReadCamera)>,
    poses: Vec<(ImageId, Key<Rigid3>)>,
    /// Images that are held rigidly to another: the mounting, and the other's pose.
    held: Vec<(ImageId, Key<Rigid3>, Key<Rigid3>)>,
    points: Vec<(PointId, Key<Vector3<f64>>)>,
    /// Calibration and clock of each mounting.
    mountings: Vec<(Key<Rigid3>, Option<Key<Clock>>)>,
    /// Where they are found: how long the shutter of a camera takes.
    readouts: BTreeMap<CameraId, Key<Vector1<f64>>>,
}

/// Where the pose of an image stands.
#[derive(Clone, Copy)]
enum Place {
    Own(Key<Rigid3>),
    /// Mounting and the other camera's pose.
    Held(Key<Rigid3>, Key<Rigid3>),
}

/// Reads the intrinsics of one camera out of the solved problem; its parameter block has a type of its own.
type ReadCamera = Box<dyn Fn(&Problem) -> Vec<f64>>;

impl Bundle {
    fn new(
        model: &Reconstruction,
        scope: &Scope,
        options: &AdjustOptions,
        mountings: &[Mounting],
        shutters: Option<&Shutters>,
    ) -> Result<Self, Error> {
        let moves = |image: ImageId| scope.moves(image);
        let mut bundle = Self {
            problem: Problem::new(),
            cameras: Vec::new(),
            poses: Vec::new(),
            held: Vec::new(),
            points: Vec::new(),
            mountings: Vec::new(),
            readouts: BTreeMap::new(),
        };
        let mut observations_of_image: Vec<Vec<(u32, Key<Vector3<f64>>)>> =
            vec![Vec::new(); model.images().count()];
        let mut num_observations = 0;
        let mut points = scope.points(model);
        points.retain(|point| model.track(*point).is_some_and(|track| !track.is_held_out));
        if options.spread {
            points = spread_points(model, points, moves);
        }
        for point in points {
            let Some(track) = model.track(point) else { continue };
            let key = bundle.problem.eliminate(track.xyz);
            bundle.points.push((point, key));
            num_observations += track.observations.len();
            for observation in &track.observations {
                observations_of_image[observation.image.index()].push((observation.keypoint, key));
            }
        }
        let posed: Vec<ImageId> = model
            .registered()
            .map(|(id, ..)| id)
            .filter(|id| !observations_of_image[id.index()].is_empty())
            .collect();
        if posed.len() < 2 || num_observations == 0 {
            return Err(Error::NothingToAdjust {
                images: posed.len(),
                points: bundle.points.len(),
                observations: num_observations,
            });
        }
        let rigid = rigid_pairs(mountings, &posed);
        for (order, &image) in posed.iter().enumerate() {
            if rigid.contains_key(&image) {
                continue;
            }
            let Some(pose) = model.image(image).cam_from_world() else { continue };
            let key = bundle.problem.keep(*pose, Order::At(order as u32));
            if !moves(image) {
                bundle.problem.fix(key);
            }
            bundle.poses.push((image, key));
        }
        bundle.hold_gauge(model, options.gauge, &moves)?;
        bundle.add_links(model, options.links, &moves)?;
        bundle.add_mountings(model, mountings, &rigid, options.noise)?;
        let own = bundle.poses.iter().copied();
        let lefts = bundle.held.iter().map(|(image, _, left)| (*image, *left));
        let sights: Vec<_> = own
            .chain(lefts)
            .flat_map(|(image, pose)| {
                observations_of_image[image.index()].iter().map(move |(_, point)| (pose, *point))
            })
            .collect();
        let tree = SpanningTree::new(&bundle.problem, &sights)?;
        bundle.problem.set_retraction(tree);
        for (id, camera) in model.cameras() {
            let own = bundle.poses.iter().map(|(image, key)| (*image, Place::Own(*key)));
            let held = bundle.held.iter().map(|(image, mount, left)| (*image, Place::Held(*mount, *left)));
            let images: Vec<(ImageId, Place)> =
                own.chain(held).filter(|(image, _)| model.image(*image).camera == id).collect();
            if images.is_empty() {
                continue;
            }
            // A local adjustment sees too little of a camera that has images elsewhere.
            let sees_all =
                model.registered().filter(|(_, image, _)| image.camera == id).all(|(image, ..)| moves(image));
            let refine = if sees_all { options.refine } else { RefineIntrinsics::NONE };
            let shutter = match shutters {
                Some(shutters) => bundle
                    .add_readout(id, shutters, options.noise)?
                    .map(|readout| (readout, shutters.keypoints)),
                None => None,
            };
            with_camera_model!(&camera.intrinsics, M, params => {
                let key = bundle.problem.keep(*params, Order::Shared);
                let kind = camera.intrinsics.kind();
                let columns = fixed_columns(kind, refine);
                if columns.len() == kind.num_params() {
                    bundle.problem.fix(key);
                } else {
                    bundle.problem.fix_tangent(key, &columns)?;
                    bundle.problem.add(key, intrinsics_prior(params, id, camera, options)?, Loss::Trivial)?;
                }
                for (image, place) in &images {
                    let shifted = shutter
                        .and_then(|(readout, keypoints)| Some((readout, keypoints.get(image)?)));
                    let keypoints = &model.image(*image).keypoints;
                    for &(keypoint, point) in &observations_of_image[image.index()] {
                        let (index, keypoint) = (keypoint as usize, &keypoints[keypoint as usize]);
                        let (pixel, sigma_px) = (keypoint.pixel, keypoint_sigma_px(keypoint.scale_px));
                        match (*place, shifted) {
                            (Place::Own(pose), Some((readout, shifted))) => {
                                let Shifted { pixel, shift } = shifted[index];
                                let unshifted = Reprojection::<M>::new(pixel, sigma_px);
                                let factor = ShiftedReprojection { unshifted, shift };
                                bundle.problem.add((key, pose, readout, point), factor, options.loss)?;
                            }
                            (Place::Own(pose), None) => {
                                let factor = Reprojection::<M>::new(pixel, sigma_px);
                                bundle.problem.add((key, pose, point), factor, options.loss)?;
                            }
                            (Place::Held(mount, left), _) => {
                                let factor = RigReprojection::<M>::new(pixel, sigma_px);
                                bundle.problem.add((key, mount, left, point), factor, options.loss)?;
                            }
                        }
                    }
                }
                bundle.cameras.push((id, Box::new(move |problem| problem.get(key).as_slice().to_vec())));
            });
        }
        Ok(bundle)
    }

    /// Holds what the images cannot see: place, orientation and size of the world. Nothing to do where two images are held already.
    fn hold_gauge(
        &mut self,
        model: &Reconstruction,
        gauge: Option<ImagePair>,
        moves: &dyn Fn(ImageId) -> bool,
    ) -> Result<(), Error> {
        let held = self.poses.iter().filter(|(image, _)| !moves(*image)).count();
        if held >= 2 {
            return Ok(());
        }
        let index_of = |wanted: ImageId| self.poses.iter().position(|(image, _)| *image == wanted);
        let wished =
            gauge.filter(|_| held == 0).and_then(|pair| Some((index_of(pair.a)?, index_of(pair.b)?)));
        let first = wished.map(|(first, _)| first);
        let first = first.or_else(|| self.poses.iter().position(|(image, _)| held == 0 || !moves(*image)));
        let (first_image, first_key) = self.poses[first.unwrap_or(0)];
        self.problem.fix(first_key);
        let Some(first_pose) = model.image(first_image).cam_from_world() else { return Ok(()) };
        let first_centre = first_pose.origin_in_a();
        // Scaling the world about the first camera by 1 + ε moves the centre of another by ε (c − c₁), which in its frame is
        // τ = −ε R (c − c₁).
        let direction = |&(image, key): &(ImageId, Key<Rigid3>)| {
            let pose = model.image(image).cam_from_world()?;
            Some((key, pose.rotation * (pose.origin_in_a() - first_centre)))
        };
        let second = match wished {
            Some((_, second)) => direction(&self.poses[second]),
            None => self
                .poses
                .iter()
                .filter_map(direction)
                .max_by(|a, b| a.1.norm_squared().total_cmp(&b.1.norm_squared())),
        };
        if let Some((key, direction)) = second {
            self.problem.fix_tangent(key, &[3 + direction.iamax()])?;
        }
        Ok(())
    }

    /// Adds the links of which some image moves. Images that are in no other term hold still.
    fn add_links(
        &mut self,
        model: &Reconstruction,
        links: &[BaselineLink],
        moves: &dyn Fn(ImageId) -> bool,
    ) -> Result<(), Error> {
        if links.is_empty() {
            return Ok(());
        }
        let mut keys: BTreeMap<ImageId, Key<Rigid3>> = self.poses.iter().copied().collect();
        for link in links {
            let images = link.images();
            if !images.iter().any(|image| moves(*image) && keys.contains_key(image)) {
                continue;
            }
            let key_of = |image: ImageId| -> Option<Key<Rigid3>> {
                if let Some(&key) = keys.get(&image) {
                    return Some(key);
                }
                let key = self.problem.keep(*model.image(image).cam_from_world()?, Order::At(image.0));
                self.problem.fix(key);
                keys.insert(image, key);
                Some(key)
            };
            let [a, b, c, d] = images.map(key_of);
            let (Some(a), Some(b), Some(c), Some(d)) = (a, b, c, d) else { continue };
            self.problem.add((a, b, c, d), Baseline::with_weight(link.weight, link.near), Loss::Trivial)?;
        }
        Ok(())
    }

    /// Solves the problem and changes the model to where that ended.
    fn solve(
        &mut self,
        model: &mut Reconstruction,
        options: &AdjustOptions,
        watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
    ) -> Result<Summary, Error> {
        let options = Options {
            max_iterations: options.max_iterations,
            function_tolerance: options.function_tolerance,
            ..Options::default()
        };
        let summary = Solver::new(&self.problem, &options)?.solve(&mut self.problem, watch)?;
        self.write_back(model);
        Ok(summary)
    }

    fn write_back(&self, model: &mut Reconstruction) {
        for (camera, read) in &self.cameras {
            model.camera_mut(*camera).intrinsics.params_mut().copy_from_slice(&read(&self.problem));
        }
        for &(image, key) in &self.poses {
            model.register(image, self.problem.get(key));
        }
        for &(image, mount, left) in &self.held {
            model.register(image, self.problem.get(mount) * self.problem.get(left));
        }
        for &(point, key) in &self.points {
            if let Some(track) = model.track_mut(point) {
                track.xyz = self.problem.get(key);
            }
        }
    }
}

/// Indices of the parameters that stay. What a turn of the camera does as well is one of them: a hundredth of a pixel of systematic error would
/// turn the camera by a tenth of a degree.
fn fixed_columns(kind: CameraModelKind, refine: RefineIntrinsics) -> Vec<usize> {
    (0..kind.num_params())
        .filter(|index| {
            if kind.focal_indices().contains(index) {
                !refine.focal
            } else if kind.principal_point_indices().contains(index) {
                !refine.principal_point
            } else {
                !refine.distortion || kind.turn_indices().contains(index)
            }
        })
        .collect()
}

/// What is known of a camera before looking: the principal point is near the middle, distortion is small, the focal lengths keep their ratio,
/// and what the options say of the first one. In units of the keypoints' noise, as residuals are.
fn intrinsics_prior<const N: usize>(
    params: &SVector<f64, N>,
    id: CameraId,
    camera: &Camera,
    options: &AdjustOptions,
) -> Result<Prior<SVector<f64, N>, N>, tiepoint_ba::Error> {
    let kind = camera.intrinsics.kind();
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let focal = options.focal_priors.iter().find(|prior| prior.camera == id);
    let (mut mean, mut sigmas) = (*params, [options.distortion_sigma; N]);
    for index in 0..N {
        if kind.focal_indices().contains(&index) {
            mean[index] = focal.map_or(params[index], |prior| prior.mean_px);
            sigmas[index] = focal.map_or(f64::INFINITY, |prior| prior.sigma_px);
        } else if let Some(axis) = kind.principal_point_indices().iter().position(|&p| p == index) {
            mean[index] = [width / 2.0, height / 2.0][axis];
            sigmas[index] = options.principal_point_sigma * width.max(height);
        } else {
            mean[index] = 0.0;
        }
    }
    let mut prior = Prior::new(mean, &sigmas.map(|sigma| sigma / options.noise))?;
    if let &[x, y] = kind.focal_indices() {
        let (ratio, weight) = (params[y] / params[x], options.noise / (FOCAL_RATIO_SIGMA * params[y]));
        prior.mean[y] = ratio * prior.mean[x];
        prior.sqrt_information[(y, x)] = -ratio * weight;
        prior.sqrt_information[(y, y)] = weight;
    }
    Ok(prior)
}

/// Moves each point that took no part to where the poses see it now; those that did come in order.
fn retriangulate_others(
    model: &mut Reconstruction,
    scope: &Scope,
    adjusted: &[(PointId, Key<Vector3<f64>>)],
) {
    let took_no_part = |point: &PointId| adjusted.binary_search_by_key(point, |(other, _)| *other).is_err();
    let others: Vec<PointId> = scope.points(model).into_iter().filter(took_no_part).collect();
    let place = |point: &PointId| triangulation::seen_at(model, &model.track(*point)?.observations);
    let places: Vec<_> = others.par_iter().map(place).collect();
    for (point, place) in others.into_iter().zip(places) {
        if let (Some(xyz), Some(track)) = (place, model.track_mut(point)) {
            track.xyz = xyz;
        }
    }
}
