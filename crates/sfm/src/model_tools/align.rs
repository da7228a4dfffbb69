//! The similarity between two models that have images in common.
//!
//! A keypoint of a common image that observes a point in both models is a common observation. Each
//! common image gives a hypothesis: the camera is the same in both models, and the median ratio of
//! the distances of its common points is the scale. One image is therefore enough, and images may
//! lie on a line. The hypothesis with the least truncated squared transfer error (MSAC) is refined
//! over its inliers: each point is transferred to the other model and projected into the image
//! there.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tiepoint_ba::factor::{Linear, Refs};
use tiepoint_ba::{EliminationOrder, Factor, Options, Problem, Solver};
use tiepoint_geometry::nalgebra::{Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::{CameraModel, Intrinsics, Loss, Rigid3, Sim3, so3, with_camera_model};
use tiepoint_scene::{ImageId, PointId, Reconstruction};

use crate::Error;

/// Maximum number of hypotheses, evenly spread over the common images.
const MAX_HYPOTHESES: usize = 200;
/// Maximum number of common observations that score and refine, evenly spread. The similarity has
/// seven degrees of freedom.
const MAX_OBSERVATIONS: usize = 20_000;
/// Rounds of refinement: the inliers change with the similarity.
const NUM_ROUNDS: usize = 3;
/// Minimum number of inliers, as for verified pairs.
const MIN_INLIERS: usize = 15;
/// Minimum share of inliers: the default of COLMAP's alignment by reprojections. Two models of one
/// scene with different calibrations had up to a fifth.
const MIN_INLIER_RATIO: f64 = 0.3;

/// How two models fit together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelAlignment {
    /// The similarity from the model to the reference; `None` if too few common observations fit
    /// any.
    pub reference_from_model: Option<Sim3>,
    /// Number of images with a pose in both models.
    pub num_common_images: usize,
    /// Number of common observations: keypoints of common images that observe a point in both.
    pub num_common_observations: usize,
    /// Number of those whose transfer errors in both models are below the threshold, among the
    /// `num_compared` that were compared.
    pub num_inliers: usize,
    /// Number of common observations that were compared.
    pub num_compared: usize,
}

/// The images with a pose in both models, by name, in order of the model's ids: of the model and of
/// the reference.
pub(super) fn common_images(
    model: &Reconstruction,
    reference: &Reconstruction,
) -> Vec<(ImageId, ImageId)> {
    let by_name: BTreeMap<&str, ImageId> =
        reference.registered().map(|(id, image, _)| (image.name.as_str(), id)).collect();
    model
        .registered()
        .filter_map(|(id, image, _)| Some((id, *by_name.get(image.name.as_str())?)))
        .collect()
}

/// Whether two images of one name have the same keypoints. Positions may differ: mapping moves
/// those of a rolling shutter.
pub(super) fn have_same_keypoints(
    model: &Reconstruction,
    reference: &Reconstruction,
    (a, b): (ImageId, ImageId),
) -> bool {
    model.image(a).keypoints.len() == reference.image(b).keypoints.len()
}

/// A common image: its poses and intrinsics in the model and in the reference.
struct CommonImage {
    poses: [Rigid3; 2],
    intrinsics: [Intrinsics; 2],
    observations: Vec<CommonObservation>,
}

/// The keypoint in both models, and the point that it observes in each.
struct CommonObservation {
    pixels: [Vector2<f64>; 2],
    points: [Vector3<f64>; 2],
}

impl CommonImage {
    fn new(models: [&Reconstruction; 2], ids: [ImageId; 2]) -> Option<Self> {
        let [a, b] = [0, 1].map(|k| models[k].image(ids[k]));
        let xyz = |k: usize, point: PointId| models[k].track(point).map(|track| track.xyz);
        let observation = |(keypoint, (p, q)): (usize, (&Option<PointId>, &Option<PointId>))| {
            Some(CommonObservation {
                pixels: [a.keypoints[keypoint].pixel, b.keypoints[keypoint].pixel],
                points: [xyz(0, (*p)?)?, xyz(1, (*q)?)?],
            })
        };
        let observations = a.points().iter().zip(b.points()).enumerate().filter_map(observation);
        Some(Self {
            poses: [*a.cam_from_world()?, *b.cam_from_world()?],
            intrinsics: [0, 1].map(|k| models[k].camera_of(ids[k]).intrinsics),
            observations: observations.collect(),
        })
    }

    /// The similarity for which the camera is the same in both models; `None` without observations.
    fn hypothesis(&self) -> Option<Sim3> {
        let distance = |k: usize, xyz: &Vector3<f64>| (self.poses[k] * *xyz).norm();
        let mut ratios: Vec<f64> = self
            .observations
            .iter()
            .map(|o| distance(1, &o.points[1]) / distance(0, &o.points[0]))
            .filter(|ratio| ratio.is_normal())
            .collect();
        let scale = median(&mut ratios)?;
        let [cam_from_model, cam_from_reference] = self.poses;
        let reference_from_cam = cam_from_reference.inverse();
        Some(Sim3 {
            scale,
            rotation: reference_from_cam.rotation * cam_from_model.rotation,
            translation: reference_from_cam * (cam_from_model.translation * scale),
        })
    }

    /// The larger squared transfer error of an observation, in pixels².
    fn squared_error(&self, transform: [&Sim3; 2], observation: &CommonObservation) -> f64 {
        let error = |from: usize, to: usize| {
            let in_cam = self.poses[to] * (*transform[from] * observation.points[from]);
            let squared = self.intrinsics[to].squared_error_px2(&in_cam, &observation.pixels[to]);
            squared.unwrap_or(f64::INFINITY)
        };
        error(0, 1).max(error(1, 0))
    }
}

/// Transfer of a point of one model into an image of the other. Variable: the similarity
/// `reference_from_model`. Residual: projection − pixel. `is_inverse`: the point is of the
/// reference, and the image of the model.
struct Transfer<M: CameraModel> {
    params: M::Params,
    cam_from_world: Rigid3,
    point: Vector3<f64>,
    pixel: Vector2<f64>,
    is_inverse: bool,
}

impl<M: CameraModel> Factor<2> for Transfer<M> {
    type Vars = (Sim3,);

    fn linearize(&self, (similarity,): Refs<'_, Self::Vars>) -> Option<Linear<Self::Vars, 2>> {
        let rotation = similarity.rotation.to_rotation_matrix().into_inner();
        let mut d_moved = SMatrix::<f64, 3, 7>::zeros();
        let moved = if self.is_inverse {
            // y = Rᵀ(q − t)/s; dy = Rᵀ(−δ × q − τ)/s − λ y.
            let moved = similarity.inverse() * self.point;
            let turned = rotation.transpose() / similarity.scale;
            d_moved.fixed_columns_mut::<3>(0).copy_from(&(turned * so3::hat(&self.point)));
            d_moved.fixed_columns_mut::<3>(3).copy_from(&-turned);
            d_moved.set_column(6, &-moved);
            moved
        } else {
            // x = s R p + t; dx = δ × x + τ + λ (x − t).
            let moved = *similarity * self.point;
            d_moved.fixed_columns_mut::<3>(0).copy_from(&-so3::hat(&moved));
            d_moved.fixed_columns_mut::<3>(3).copy_from(&Matrix3::identity());
            d_moved.set_column(6, &(moved - similarity.translation));
            moved
        };
        let params = &self.params;
        let projection = M::project_with_jacobian(params, &(self.cam_from_world * moved))?;
        let d_point: Matrix2x3<f64> =
            projection.d_point * self.cam_from_world.rotation.to_rotation_matrix().into_inner();
        let residual = M::displacement(params, &projection.pixel, &self.pixel);
        Some((residual, (d_point * d_moved,)))
    }
}

/// Aligns a model to a reference by their common observations. `max_error_px` is the threshold of
/// the transfer error, in pixels.
///
/// # Errors
///
/// Those of the optimiser.
pub fn align_models(
    model: &Reconstruction,
    reference: &Reconstruction,
    max_error_px: f64,
) -> Result<ModelAlignment, Error> {
    let common = common_images(model, reference);
    let num_common_images = common.len();
    let mut images: Vec<CommonImage> = common
        .into_iter()
        .filter(|ids| have_same_keypoints(model, reference, *ids))
        .filter_map(|(a, b)| CommonImage::new([model, reference], [a, b]))
        .filter(|image| !image.observations.is_empty())
        .collect();
    let num_common_observations: usize = images.iter().map(|image| image.observations.len()).sum();
    let step = images.len().div_ceil(MAX_HYPOTHESES).max(1);
    let hypotheses: Vec<Sim3> =
        images.iter().step_by(step).filter_map(CommonImage::hypothesis).collect();
    let step = num_common_observations.div_ceil(MAX_OBSERVATIONS).max(1);
    let mut number = 0;
    for image in &mut images {
        image.observations.retain(|_| {
            number += 1;
            (number - 1) % step == 0
        });
    }
    let max_squared = max_error_px * max_error_px;
    let score = |similarity: &Sim3| -> f64 {
        let inverse = similarity.inverse();
        let squared = |image: &CommonImage| -> f64 {
            let errors = image.observations.iter();
            errors.map(|o| image.squared_error([similarity, &inverse], o).min(max_squared)).sum()
        };
        images.iter().map(squared).sum()
    };
    let scores: Vec<f64> = hypotheses.par_iter().map(score).collect();
    let best = scores.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
    let mut alignment = ModelAlignment {
        reference_from_model: None,
        num_common_images,
        num_common_observations,
        num_inliers: 0,
        num_compared: images.iter().map(|image| image.observations.len()).sum(),
    };
    let Some((best, _)) = best else { return Ok(alignment) };
    let mut similarity = hypotheses[best];
    for _ in 0..NUM_ROUNDS {
        let refined = refine(&images, &similarity, max_error_px)?;
        if score(&refined) >= score(&similarity) {
            break;
        }
        similarity = refined;
    }
    let inverse = similarity.inverse();
    alignment.num_inliers = images
        .iter()
        .flat_map(|image| image.observations.iter().map(move |o| (image, o)))
        .filter(|(image, o)| image.squared_error([&similarity, &inverse], o) < max_squared)
        .count();
    let required = (MIN_INLIER_RATIO * alignment.num_compared as f64).max(MIN_INLIERS as f64);
    alignment.reference_from_model =
        Some(similarity).filter(|_| alignment.num_inliers as f64 >= required);
    Ok(alignment)
}

/// The similarity with the least robust squared transfer errors of the inliers.
fn refine(images: &[CommonImage], start: &Sim3, max_error_px: f64) -> Result<Sim3, Error> {
    let inverse = start.inverse();
    let mut problem = Problem::new();
    let key = problem.add_parameter(*start, EliminationOrder::Last);
    for image in images {
        for o in &image.observations {
            if image.squared_error([start, &inverse], o) >= max_error_px * max_error_px {
                continue;
            }
            for (from, to) in [(0, 1), (1, 0)] {
                with_camera_model!(&image.intrinsics[to], M, params => {
                    let factor = Transfer::<M> {
                        params: *params,
                        cam_from_world: image.poses[to],
                        point: o.points[from],
                        pixel: o.pixels[to],
                        is_inverse: to == 0,
                    };
                    problem.add(key, factor, Loss::Cauchy(1.0))?;
                });
            }
        }
    }
    if problem.num_residuals() == 0 {
        return Ok(*start);
    }
    Solver::new(&problem, &Options::default())?.solve(&mut problem)?;
    Ok(problem.get(key))
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::CameraModelKind;
    use tiepoint_geometry::nalgebra::SVector;
    use tiepoint_geometry::testing::jacobian_law;

    use super::*;

    #[test]
    fn jacobians_of_both_transfers_are_the_derivatives() {
        let similarity = Sim3 {
            scale: 1.7,
            rotation: so3::exp(&Vector3::new(0.3, -0.2, 0.5)),
            translation: Vector3::new(0.4, 1.0, -0.3),
        };
        let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, 2.0, 2, 2);
        let cam_from_world =
            Rigid3::from_axis_angle(Vector3::new(0.1, 0.2, -0.3), Vector3::new(0.5, 0.2, 9.0));
        for is_inverse in [false, true] {
            with_camera_model!(&intrinsics, M, params => {
                let factor = Transfer::<M> {
                    params: *params,
                    cam_from_world,
                    point: Vector3::new(1.0, -0.5, 0.7),
                    pixel: Vector2::new(0.3, 0.4),
                    is_inverse,
                };
                let (_, (analytic,)) = factor.linearize((&similarity,)).expect("in front");
                let residual = |s: &Sim3| -> Option<SVector<f64, 2>> {
                    factor.linearize((s,)).map(|(residual, _)| residual)
                };
                assert_eq!(jacobian_law(&similarity, &analytic, 1e-3, residual), Ok(()));
            });
        }
    }
}
