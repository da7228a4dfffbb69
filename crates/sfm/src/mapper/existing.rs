//! The model that mapping goes on from.

use std::collections::BTreeSet;

use tiepoint_geometry::nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tiepoint_geometry::{Rigid3, Sim3};
use tiepoint_scene::{ImageId, Reconstruction};

/// What becomes of the poses of the model that mapping goes on from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExistingPoses {
    /// They are refined with all others.
    Refined,
    /// They are constant. Then no stage after growth but the refinement runs.
    Constant,
}

/// The poses of the model that mapping goes on from.
pub(super) struct Existing {
    poses: Vec<(ImageId, Rigid3)>,
    constant: Option<BTreeSet<ImageId>>,
}

impl Existing {
    pub(super) fn new(model: &Reconstruction, poses: ExistingPoses) -> Self {
        let is_constant = poses == ExistingPoses::Constant;
        let poses: Vec<(ImageId, Rigid3)> =
            model.registered().map(|(id, _, pose)| (id, *pose)).collect();
        let constant = is_constant.then(|| poses.iter().map(|(id, _)| *id).collect());
        Self { poses, constant }
    }

    pub(super) fn num_images(&self) -> usize {
        self.poses.len()
    }

    /// The images, if their poses are constant.
    pub(super) fn constant_poses(&self) -> Option<&BTreeSet<ImageId>> {
        self.constant.as_ref()
    }

    /// The similarity `existing_from_model` that moves the images of a model closest to their first
    /// poses.
    pub(super) fn existing_from_model(&self, model: &Reconstruction) -> Option<Sim3> {
        let pair =
            |(id, before): &(ImageId, Rigid3)| Some((*model.image(*id).cam_from_world()?, *before));
        similarity_of_poses(&self.poses.iter().filter_map(pair).collect::<Vec<_>>())
    }
}

/// The similarity b_from_a of poses `cam_from_a` and `cam_from_b` of the same cameras: the mean
/// rotation (chordal L2 mean, Hartley et al. 2013, section 5.3), and scale and translation by least
/// squares over the centres. `None` without two different centres.
pub(super) fn similarity_of_poses(pairs: &[(Rigid3, Rigid3)]) -> Option<Sim3> {
    let mut sum = Matrix3::zeros();
    for (cam_from_a, cam_from_b) in pairs {
        sum += (cam_from_b.rotation.inverse() * cam_from_a.rotation).to_rotation_matrix().matrix();
    }
    let rotation = UnitQuaternion::from_matrix(&sum);
    let count = pairs.len() as f64;
    let mean = |centre: &dyn Fn(&(Rigid3, Rigid3)) -> Vector3<f64>| {
        pairs.iter().map(centre).sum::<Vector3<f64>>() / count
    };
    let mean_a = mean(&|(cam_from_a, _)| rotation * cam_from_a.origin_in_a());
    let mean_b = mean(&|(_, cam_from_b)| cam_from_b.origin_in_a());
    let (mut product, mut square) = (0.0, 0.0);
    for (cam_from_a, cam_from_b) in pairs {
        let a = rotation * cam_from_a.origin_in_a() - mean_a;
        product += a.dot(&(cam_from_b.origin_in_a() - mean_b));
        square += a.norm_squared();
    }
    let scale = product / square;
    (scale.is_finite() && scale > 0.0).then(|| Sim3 {
        scale,
        rotation,
        translation: mean_b - mean_a * scale,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn similarity_of_exact_poses_is_exact() {
        let b_from_a = Sim3 {
            scale: 2.5,
            rotation: UnitQuaternion::from_euler_angles(0.3, -1.0, 2.0),
            translation: Vector3::new(3.0, -4.0, 5.0),
        };
        // Two cameras; their centres do not determine the rotation.
        let pairs = [Vector3::new(0.1, 0.2, 0.3), Vector3::new(2.0, 0.0, 1.0)].map(|axis| {
            let cam_from_a = Rigid3::from_axis_angle(axis, Vector3::new(1.0, axis.x, axis.y));
            (cam_from_a, b_from_a.transform_pose(&cam_from_a))
        });
        let found = similarity_of_poses(&pairs).unwrap();
        assert!((found.scale - b_from_a.scale).abs() < 1e-12, "{found:?}");
        assert!(found.rotation.angle_to(&b_from_a.rotation) < 1e-9);
        assert!((found.translation - b_from_a.translation).norm() < 1e-12);
        assert_eq!(similarity_of_poses(&pairs[..1]), None);
    }
}
