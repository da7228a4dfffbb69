//! The dense cloud of a model beside the laser scan.

use std::path::Path;

use serde::{Deserialize, Serialize};
use tiepoint_pipeline::eval::geometry::Sim3;
use tiepoint_pipeline::eval::geometry::nalgebra::Vector3;
use tiepoint_pipeline::eval::{Alignment, Cloud};
use tiepoint_pipeline::evaluation::{read_cloud, register_cloud};
use tiepoint_pipeline::stages::{DenseOptions, dense};
use tiepoint_pipeline::{Error, Workspace};
use tiepoint_report::{CameraError, CloudError};

use super::distance::Distance;
use crate::Progress;
use crate::drive_evaluation::MAX_CLOUD_RANGE_M;

/// The fused cloud in a workspace.
const CLOUD: &str = "dense/fused.ply";
/// Errors of a dense cloud.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct DenseCloud {
    /// Number of points that were compared.
    pub(crate) points: usize,
    /// Distances to the scan.
    pub(crate) distance: Distance,
    /// Length of the drive up to an image of the first camera, and the mean distance of the points
    /// that its true centre is nearest to, in metres.
    pub(crate) along: Vec<[f64; 2]>,
}

/// How a dense cloud is compared with the scan.
pub(crate) struct Comparison<'a> {
    /// The points of the scan.
    pub(crate) scan: &'a Cloud,
    pub(crate) world_from_model: Sim3,
    /// True and estimated centres of the images. Points far from the centres are left out.
    pub(crate) cameras: &'a [CameraError],
    /// Whether the poses of the workspace are the true ones.
    pub(crate) has_true_poses: bool,
    /// Whether a point in the world frame is compared.
    pub(crate) is_compared: &'a dyn Fn(&Vector3<f64>) -> bool,
}

/// Makes the dense cloud of a workspace, unless it is there, and compares it with the scan; `None`
/// if no depth can be estimated or no point is near the scan.
///
/// # Errors
///
/// The stage fails, or its cloud cannot be read.
pub(crate) fn evaluate_dense(
    workspace: &Path,
    comparison: &Comparison,
    progress: &mut dyn Progress,
) -> Result<Option<DenseCloud>, Error> {
    let mut opened = Workspace::open(workspace)?;
    let options = DenseOptions::default();
    match dense(&mut opened, &options, None, &mut |event| progress.watch(event)) {
        Err(Error::NothingDense { .. }) => return Ok(None),
        done => done?,
    }
    Ok(comparison.evaluate(&read_cloud(&workspace.join(CLOUD))?))
}

impl Comparison<'_> {
    fn evaluate(&self, cloud: &[Vector3<f64>]) -> Option<DenseCloud> {
        let is_near = |point: &Vector3<f64>| {
            let centre = |camera: &CameraError| {
                if self.has_true_poses { camera.true_centre } else { camera.estimated_centre }
            };
            self.cameras.iter().any(|camera| (centre(camera) - point).norm() < MAX_CLOUD_RANGE_M)
        };
        let points = cloud.iter().map(|point| self.world_from_model * *point);
        let points: Vec<Vector3<f64>> =
            points.filter(|point| is_near(point) && (self.is_compared)(point)).collect();
        let alignment = if self.has_true_poses { Alignment::None } else { Alignment::Rigid };
        let cloud = register_cloud(&points, self.scan, &Sim3::identity(), alignment)?;
        let along = self.along(&cloud.registered, &cloud.distances)?;
        Some(DenseCloud { points: cloud.points, distance: Distance::from(&cloud), along })
    }

    /// The mean distance of the points that each image of the first camera is nearest to.
    fn along(&self, points: &[Vector3<f64>], distances: &[f64]) -> Option<Vec<[f64; 2]>> {
        let first = self.cameras.iter().map(|camera| camera.camera).min()?;
        let centres = self.cameras.iter().filter(|camera| camera.camera == first);
        let centres: Vec<Vector3<f64>> = centres.map(|camera| camera.true_centre).collect();
        let mut sums = vec![(0.0, 0_usize); centres.len()];
        for (point, distance) in points.iter().zip(distances) {
            let to = |index: usize| (centres[index] - point).norm_squared();
            let nearest =
                (0..centres.len()).min_by(|one, other| to(*one).total_cmp(&to(*other)))?;
            sums[nearest].0 += distance;
            sums[nearest].1 += 1;
        }
        let mut path_length_m = 0.0;
        let mut along = Vec::new();
        for (index, (sum, count)) in sums.into_iter().enumerate() {
            if index > 0 {
                path_length_m += (centres[index] - centres[index - 1]).norm();
            }
            if count > 0 {
                along.push([path_length_m, sum / count as f64]);
            }
        }
        Some(along)
    }
}

impl DenseCloud {
    /// For the plot of the page.
    pub(crate) fn errors(&self) -> Vec<CloudError> {
        let error = |&[path_length_m, mean_m]: &[f64; 2]| CloudError { path_length_m, mean_m };
        self.along.iter().map(error).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall 5 m beside a drive of 20 m, and a cloud of it that is 0.1 m off in its second half.
    #[test]
    fn errors_are_where_they_are_made() {
        let wall = |off: &dyn Fn(f64) -> f64| -> Vec<Vector3<f64>> {
            let place = |index: usize| {
                let (x, z) = ((index % 400) as f64 * 0.05, (index / 400) as f64 * 0.05);
                Vector3::new(x, 5.0 + off(x), z)
            };
            (0..400 * 60).map(place).collect()
        };
        let scan = Cloud::new(wall(&|_| 0.0)).unwrap();
        let cameras: Vec<CameraError> = (0..=20)
            .map(|x| {
                let centre = Vector3::new(f64::from(x), 0.0, 1.5);
                CameraError { camera: 0, estimated_centre: centre, true_centre: centre }
            })
            .collect();
        let comparison = Comparison {
            scan: &scan,
            world_from_model: Sim3::identity(),
            cameras: &cameras,
            has_true_poses: true,
            is_compared: &|_| true,
        };
        let cloud = wall(&|x| if x < 10.0 { 0.0 } else { 0.1 });
        let found = comparison.evaluate(&cloud).unwrap();
        assert_eq!(found.points, cloud.len());
        assert!((found.distance.mean_m - 0.05).abs() < 1e-9, "{found:?}");
        assert_eq!(found.along.len(), 21);
        for [path_length_m, mean_m] in &found.along {
            let expected = if *path_length_m < 10.0 { 0.0..1e-9 } else { 0.04..0.1 + 1e-9 };
            assert!(expected.contains(mean_m), "{path_length_m} {mean_m}");
        }
    }
}
