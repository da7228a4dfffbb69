//! The evidence that a pose needs.

use std::collections::BTreeSet;

use tiepoint_geometry::Rigid3;
use tiepoint_scene::{
    CorrespondenceGraph, ImageId, ImagePair, Observation, PointId, Reconstruction,
};

use super::options::RegisterOptions;
use super::significance::{chance_of_agreement, is_significant};
use crate::two_view::{Agreement, agreement};

/// The evidence that a pose needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Evidence {
    /// [`RegisterOptions::min_num_inliers`].
    Usual,
    /// Half as many, which chance does not explain ([`super::significance`]), and verified pairs
    /// that agree. An image with fewer points would be filtered out again.
    Significant,
}

impl Evidence {
    /// The minimum number of inliers.
    pub(super) fn min_num_inliers(self, options: &RegisterOptions) -> usize {
        match self {
            Self::Usual => options.min_num_inliers,
            Self::Significant => options.min_num_inliers / 2,
        }
    }

    /// Whether the inliers among the candidates suffice for the poses of images.
    pub(super) fn suffices(
        self,
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        poses: &[(ImageId, Rigid3)],
        [candidates, inliers]: [&[(Observation, PointId)]; 2],
        options: &RegisterOptions,
    ) -> bool {
        let RegisterOptions { max_error_px, min_inlier_ratio, .. } = *options;
        inliers.len() as f64 >= min_inlier_ratio * candidates.len() as f64
            && (self == Self::Usual
                || are_significant(model, candidates, inliers, max_error_px)
                    && pairs_agree(graph, model, poses, max_error_px))
    }
}

/// Whether chance does not explain the inliers. Keypoints in one cell of the size of the threshold
/// agree with the same poses, so that they count once.
fn are_significant(
    model: &Reconstruction,
    candidates: &[(Observation, PointId)],
    inliers: &[(Observation, PointId)],
    max_error_px: f64,
) -> bool {
    let num_cells = |observations: &[(Observation, PointId)]| {
        let cell = |(Observation { image, keypoint }, _): &(Observation, PointId)| {
            let pixel = model.image(*image).keypoints[*keypoint as usize].pixel / max_error_px;
            (*image, pixel.x.floor() as i64, pixel.y.floor() as i64)
        };
        observations.iter().map(cell).collect::<BTreeSet<_>>().len()
    };
    let chance = |(observation, _): &(Observation, PointId)| {
        chance_of_agreement(model.camera_of(observation.image), max_error_px)
    };
    let chance = candidates.iter().map(chance).fold(0.0, f64::max);
    is_significant(num_cells(candidates), num_cells(inliers), chance)
}

/// Whether the matches of the verified pairs with registered images agree with poses: also those
/// without a point, which had no part in the estimation.
fn pairs_agree(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    poses: &[(ImageId, Rigid3)],
    max_error_px: f64,
) -> bool {
    let mut sum = Agreement::default();
    for (image, pose) in poses {
        for &other in graph.neighbours(*image) {
            let Some(pair) = ImagePair::new(*image, other) else { continue };
            let Some(other_pose) = model.image(other).cam_from_world() else { continue };
            let both = if pair.a == *image { [pose, other_pose] } else { [other_pose, pose] };
            sum.add(agreement(graph, model, pair, both, max_error_px));
        }
    }
    sum.is_majority()
}
