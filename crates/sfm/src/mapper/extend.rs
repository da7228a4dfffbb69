//! Mapping that goes on from a model.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_geometry::nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tiepoint_geometry::{Rigid3, Sim3};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use super::growth::Mapper;
use super::incremental::{map_rest, prepared};
use crate::Error;
use crate::event::Event;
use crate::mapped_model::MappedModel;
use crate::options::MapperOptions;
use crate::rigs::Descriptors;
use crate::tracks::{filter_all_points, update_tracks};

/// The model that mapping goes on from.
#[derive(Clone, Copy, Debug)]
pub struct Existing<'a> {
    /// Registered images and points; all images to map, registered or not.
    pub model: &'a Reconstruction,
    /// Whether the poses of its registered images are constant. Then no stage after growth but the
    /// refinement runs.
    pub constant_poses: bool,
}

/// Registers further images onto a model. Its tracks are completed by the correspondences of the
/// graph, new points are triangulated with its poses, and the images without a pose are registered
/// one after another. Images that are not connected to it give further models, as in
/// [`crate::map`]; the extended model comes first.
///
/// The gauge of the model is kept. Poses that are not constant are refined with all others; the
/// refined model is then moved by the similarity that brings the poses of the existing images
/// closest to where they were.
///
/// # Errors
///
/// [`Error::NothingToExtend`] if the images of the model have no points in common after
/// triangulation; else as [`crate::map`].
pub fn extend(
    graph: &CorrespondenceGraph,
    existing: &Existing,
    descriptors: &mut Descriptors,
    options: &MapperOptions,
    watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
) -> Result<Vec<MappedModel>, Error> {
    options.validate()?;
    let mut start = existing.model.clone();
    (start.rigs, start.frames) = (Vec::new(), Vec::new());
    let poses: Vec<(ImageId, Rigid3)> =
        start.registered().map(|(id, _, pose)| (id, *pose)).collect();
    let registered: BTreeSet<ImageId> = poses.iter().map(|(id, _)| *id).collect();
    let input = prepared(graph, &start, options);
    for (id, camera) in input.scene.cameras() {
        *start.camera_mut(id) = *camera;
    }
    let mut mapper = Mapper::new(graph, &start, options);
    mapper.focal_priors = &input.focal_priors;
    mapper.constant_poses = existing.constant_poses.then_some(&registered);
    mapper.existing_poses = &poses;
    update_tracks(graph, &mut mapper.solution.model, &options.tracks);
    filter_all_points(&mut mapper.solution.model, &options.filter);
    if mapper.solution.model.num_tracks() == 0 {
        return Err(Error::NothingToExtend { images: poses.len() });
    }
    mapper.grow(watch)?;
    let extended = mapper.run_stages(None, descriptors, watch)?;
    map_rest(graph, &input, vec![extended], descriptors, options, watch)
}

impl Mapper<'_> {
    /// Moves the model such that the existing images are closest to their first poses.
    pub(super) fn restore_gauge(&mut self) {
        if self.constant_poses.is_some() {
            return;
        }
        let model = &self.solution.model;
        let pairs: Vec<(Rigid3, Rigid3)> = self
            .existing_poses
            .iter()
            .filter_map(|(id, before)| Some((*model.image(*id).cam_from_world()?, *before)))
            .collect();
        if let Some(similarity) = similarity_of_poses(&pairs) {
            self.solution.model.transform(&similarity);
        }
    }
}

/// The similarity b_from_a of poses `cam_from_a` and `cam_from_b` of the same cameras: the mean
/// rotation (chordal L2 mean, Hartley et al. 2013, section 5.3), and scale and translation by least
/// squares over the centres. `None` without two different centres.
fn similarity_of_poses(pairs: &[(Rigid3, Rigid3)]) -> Option<Sim3> {
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
    use tiepoint_synth::MatchOptions;

    use super::*;
    use crate::RefineIntrinsics;
    use crate::mapper::test_scene::scene;

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

    /// The first images with their true poses, the others without.
    #[test]
    fn further_images_are_registered_in_the_frame_of_the_model() {
        const KNOWN: usize = 4;
        let scene = scene();
        let graph = scene.graph(&MatchOptions::default());
        let truth = scene.truth();
        let mut start = scene.without_poses();
        for (id, _, pose) in truth.registered().take(KNOWN) {
            start.register(id, *pose);
        }
        let options = MapperOptions { refine: RefineIntrinsics::NONE, ..MapperOptions::default() };
        for constant_poses in [true, false] {
            let existing = Existing { model: &start, constant_poses };
            let watch = &mut |_: &_| ControlFlow::Continue(());
            let found =
                extend(&graph, &existing, &mut |_| Default::default(), &options, watch).unwrap();
            let found = &found[0].reconstruction;
            assert_eq!(found.num_registered(), truth.num_registered());
            for (id, _, pose) in truth.registered() {
                let there = found.image(id).cam_from_world().unwrap();
                if constant_poses && id.index() < KNOWN {
                    assert_eq!(there, pose, "a constant pose keeps its bits");
                }
                // In metres; the keypoints have noise.
                assert!((there.origin_in_a() - pose.origin_in_a()).norm() < 0.05, "{id:?}");
            }
        }
        // All poses are known and constant: only points are new.
        let mut truth_without_points = scene.without_poses();
        for (id, _, pose) in truth.registered() {
            truth_without_points.register(id, *pose);
        }
        let existing = Existing { model: &truth_without_points, constant_poses: true };
        let watch = &mut |_: &_| ControlFlow::Continue(());
        let found =
            extend(&graph, &existing, &mut |_| Default::default(), &options, watch).unwrap();
        assert!(found[0].reconstruction.num_tracks() > 100);
        let nothing = CorrespondenceGraph::new(
            &start.images().map(|(_, image)| image.keypoints.len()).collect::<Vec<_>>(),
            [],
        );
        let found = extend(&nothing, &existing, &mut |_| Default::default(), &options, watch);
        assert!(matches!(found, Err(Error::NothingToExtend { .. })));
    }
}
