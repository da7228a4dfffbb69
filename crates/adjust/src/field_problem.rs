//! A model as a problem in which cameras have lens fields.

use std::collections::BTreeMap;

use tiepoint_ba::factors::{FieldReprojection, LensField, Prior};
use tiepoint_ba::{AnyKey, EliminationOrder, Factor, FactorKey, Key, Problem, SpanningTree};
use tiepoint_geometry::nalgebra::{SVector, Vector3};
use tiepoint_geometry::{CameraModel, Loss, Manifold, Rigid3, with_camera_model};
use tiepoint_scene::{CameraId, ImageId, IntrinsicsPrior, PointId, Reconstruction};

use crate::Error;
use crate::covariance::cluster_cell;
use crate::gauge::fix_gauge;
use crate::intrinsics::{fixed_columns, intrinsics_prior};
use crate::noise::keypoint_sigma_px;
use crate::options::{AdjustOptions, RefineIntrinsics};
use crate::selection::select_points;
use crate::variables::ReadCamera;

/// The images, selected points and cameras of a model without rigs and terms.
pub(crate) struct FieldProblem {
    pub(crate) problem: Problem,
    pub(crate) poses: BTreeMap<ImageId, Key<Rigid3>>,
    pub(crate) points: Vec<(PointId, Key<Vector3<f64>>)>,
    /// Those with free intrinsics and a field.
    pub(crate) cameras: Vec<FieldCamera>,
    /// The cluster of each reprojection error ([`cluster_cell`]).
    pub(crate) cells: Vec<(FactorKey, u32)>,
}

/// A camera with free intrinsics and a field.
pub(crate) struct FieldCamera {
    pub(crate) camera: CameraId,
    pub(crate) intrinsics: AnyKey,
    pub(crate) field: AnyKey,
    pub(crate) params: Vec<f64>,
    pub(crate) read: ReadCamera,
    /// Slopes of the reprojection errors' cost.
    pub(crate) slopes: (Vec<f64>, LensField),
}

/// What is free of a camera, and the priors on it.
#[derive(Clone, Copy)]
pub(crate) struct FieldPriors<'a> {
    pub(crate) refine: RefineIntrinsics,
    /// `None`: those of the options for a camera without a calibration.
    pub(crate) intrinsics: Option<&'a IntrinsicsPrior>,
    /// Standard deviation of the field's coefficients.
    pub(crate) field_px: f64,
    /// Noise and focal lengths of priors.
    pub(crate) options: &'a AdjustOptions<'a>,
}

impl FieldProblem {
    /// `priors` are those of cameras with free intrinsics and a field. All others have constant
    /// intrinsics and none.
    pub(crate) fn new<'a>(
        model: &Reconstruction,
        loss: Loss,
        priors: impl Fn(CameraId) -> Option<FieldPriors<'a>>,
    ) -> Result<Self, Error> {
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
        let points: Vec<(PointId, Key<Vector3<f64>>)> =
            select_points(model, trained.collect(), |_| true)
                .into_iter()
                .filter_map(|id| Some((id, problem.add_landmark(model.track(id)?.xyz))))
                .collect();
        let views: Vec<(Key<Rigid3>, Key<Vector3<f64>>)> = points
            .iter()
            .filter_map(|(id, key)| Some((model.track(*id)?, key)))
            .flat_map(|(track, point)| track.observations.iter().map(move |o| (o.image, *point)))
            .filter_map(|(image, point)| Some((*poses.get(&image)?, point)))
            .collect();
        let tree = SpanningTree::new(&problem, &views)?;
        problem.set_retraction(tree);
        let mut found = Self { problem, poses, points, cameras: Vec::new(), cells: Vec::new() };
        for (id, camera) in model.cameras() {
            with_camera_model!(&camera.intrinsics, M, params => {
                found.add_camera::<M, _>(model, id, *params, priors(id), loss)?;
            });
        }
        Ok(found)
    }

    /// Adds a camera and its observations.
    fn add_camera<M: CameraModel<Params = SVector<f64, N>>, const N: usize>(
        &mut self,
        model: &Reconstruction,
        id: CameraId,
        params: SVector<f64, N>,
        priors: Option<FieldPriors>,
        loss: Loss,
    ) -> Result<(), Error> {
        let key = self.problem.add_parameter(params, EliminationOrder::Last);
        let field = self.problem.add_parameter(LensField::zeros(), EliminationOrder::Last);
        let mut slopes = (SVector::<f64, N>::zeros(), LensField::zeros());
        let camera = model.camera(id);
        for &(point, landmark) in &self.points {
            let Some(track) = model.track(point) else { continue };
            for observation in &track.observations {
                let image = model.image(observation.image);
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
                let factor = self.problem.add((key, pose, field, landmark), factor, loss)?;
                self.cells.push((factor, cluster_cell(model, image.camera, &keypoint.pixel)));
            }
        }
        let Some(FieldPriors { refine, intrinsics, field_px, options }) = priors else {
            self.problem.fix(key);
            self.problem.fix(field);
            return Ok(());
        };
        self.problem.fix_dofs(key, &fixed_columns(camera.intrinsics.kind(), refine))?;
        let prior = intrinsics_prior(&params, id, camera, intrinsics, refine, options)?;
        self.problem.add(key, prior, Loss::Trivial)?;
        let sigmas = [field_px / options.noise; LensField::DOF];
        self.problem.add(field, Prior::new(LensField::zeros(), &sigmas)?, Loss::Trivial)?;
        self.cameras.push(FieldCamera {
            camera: id,
            intrinsics: key.into(),
            field: field.into(),
            params: params.as_slice().to_vec(),
            read: Box::new(move |problem| problem.get(key).as_slice().to_vec()),
            slopes: (slopes.0.as_slice().to_vec(), slopes.1),
        });
        Ok(())
    }
}
