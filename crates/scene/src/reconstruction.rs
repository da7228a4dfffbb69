//! The owner of cameras, images and tracks. All changes go through methods that keep keypoints and
//! tracks consistent with each other. [`Reconstruction::validate`] checks all invariants.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{Rigid3, Sim3};

use crate::rig::is_same_pose;
use crate::{
    Camera, CameraId, Frame, Georeference, Image, ImageId, IntrinsicsPrior, Observation,
    OriginalIds, PointId, Rig, Track,
};

/// A model: cameras, images with poses, points with tracks; rigs and frames for rigidly connected
/// images.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reconstruction {
    cameras: Vec<Camera>,
    images: Vec<Image>,
    /// `None` for deleted points, so that ids stay valid.
    tracks: Vec<Option<Track>>,
    /// Rigs of more than one camera. A camera is on at most one rig.
    pub rigs: Vec<Rig>,
    /// Frames of the rigs. An image is in at most one frame; an image in no frame has an
    /// independent pose.
    pub frames: Vec<Frame>,
    /// Cameras with known intrinsics, which adjustments keep.
    pub calibrated: BTreeSet<CameraId>,
    /// Cameras with a calibration, which adjustments refine within its standard deviations.
    pub intrinsics_priors: BTreeMap<CameraId, IntrinsicsPrior>,
    /// Pairs of cameras of one lens whose images have portrait and landscape format: the fx of the
    /// one is the fy of the other, and their radial distortion is equal. A camera may be in several
    /// pairs.
    pub portrait_landscape_pairs: Vec<[CameraId; 2]>,
    /// Ids in the files that the model was read from.
    pub original_ids: OriginalIds,
    /// Where the world frame is, if positions told: metric, z up.
    pub georeference: Option<Georeference>,
}

impl Reconstruction {
    /// Adds a camera.
    pub fn add_camera(&mut self, camera: Camera) -> CameraId {
        self.cameras.push(camera);
        CameraId::from_index(self.cameras.len() - 1)
    }

    /// Adds an image.
    pub fn add_image(&mut self, image: Image) -> ImageId {
        self.images.push(image);
        ImageId::from_index(self.images.len() - 1)
    }

    /// The camera with this id.
    pub fn camera(&self, id: CameraId) -> &Camera {
        &self.cameras[id.index()]
    }

    /// The camera with this id, for changes.
    pub fn camera_mut(&mut self, id: CameraId) -> &mut Camera {
        &mut self.cameras[id.index()]
    }

    /// Number of cameras.
    pub fn num_cameras(&self) -> usize {
        self.cameras.len()
    }

    /// All cameras, in order of their ids.
    pub fn cameras(&self) -> impl Iterator<Item = (CameraId, &Camera)> {
        self.cameras.iter().enumerate().map(|(index, camera)| (CameraId::from_index(index), camera))
    }

    /// The image with this id.
    pub fn image(&self, id: ImageId) -> &Image {
        &self.images[id.index()]
    }

    /// Number of images, registered or not.
    pub fn num_images(&self) -> usize {
        self.images.len()
    }

    /// All images, registered or not, in order of their ids.
    pub fn images(&self) -> impl Iterator<Item = (ImageId, &Image)> {
        self.images.iter().enumerate().map(|(index, image)| (ImageId::from_index(index), image))
    }

    /// Registered images with their poses (`cam_from_world`), in order of their ids.
    pub fn registered(&self) -> impl Iterator<Item = (ImageId, &Image, &Rigid3)> {
        self.images()
            .filter_map(|(id, image)| image.cam_from_world.as_ref().map(|pose| (id, image, pose)))
    }

    /// The cameras of the registered images.
    pub fn registered_cameras(&self) -> BTreeSet<CameraId> {
        self.registered().map(|(_, image, _)| image.camera).collect()
    }

    /// Number of registered images.
    pub fn num_registered(&self) -> usize {
        self.registered().count()
    }

    /// The camera of an image.
    pub fn camera_of(&self, image: ImageId) -> &Camera {
        self.camera(self.image(image).camera)
    }

    /// Sets the pose of an image. An image of a frame leaves it, unless the pose is the one
    /// composed of frame and rig.
    pub fn register(&mut self, image: ImageId, cam_from_world: Rigid3) {
        self.images[image.index()].cam_from_world = Some(cam_from_world);
        let camera = self.image(image).camera;
        let frame = self.frames.iter().find(|frame| frame.images.contains(&image));
        let is_of_frame = |frame: &Frame| {
            let of_frame = frame.cam_from_world(self.rigs.get(frame.rig.index())?, camera)?;
            Some(is_same_pose(&cam_from_world, &of_frame))
        };
        if frame.is_some_and(|frame| is_of_frame(frame) != Some(true)) {
            self.leave_frame(image);
        }
    }

    /// Removes an image from its frame, and the frame if it becomes empty.
    fn leave_frame(&mut self, image: ImageId) {
        for frame in &mut self.frames {
            frame.images.retain(|other| *other != image);
        }
        self.frames.retain(|frame| !frame.images.is_empty());
    }

    /// Sets the positions of an image's keypoints, in pixels.
    pub fn move_keypoints(&mut self, image: ImageId, pixels: &[Vector2<f64>]) {
        let keypoints = Arc::make_mut(&mut self.images[image.index()].keypoints);
        for (keypoint, pixel) in keypoints.iter_mut().zip(pixels) {
            keypoint.pixel = *pixel;
        }
    }

    /// Sets the time of an image on its camera's clock, in seconds.
    pub fn set_time(&mut self, image: ImageId, time_s: Option<f64>) {
        self.images[image.index()].time_s = time_s;
    }

    /// Sets the stream of an image.
    pub fn set_stream(&mut self, image: ImageId, stream: Arc<str>) {
        self.images[image.index()].stream = stream;
    }

    /// Removes the pose of an image and its observations. Tracks with fewer than two remaining
    /// observations are deleted. An image of a frame leaves it.
    pub fn deregister(&mut self, image: ImageId) {
        for keypoint in 0..self.image(image).points.len() as u32 {
            self.remove_observation(Observation { image, keypoint });
        }
        self.images[image.index()].cam_from_world = None;
        self.leave_frame(image);
    }

    /// Copies a camera, and whether it is calibrated, from a model of the same cameras.
    pub fn copy_camera(&mut self, other: &Self, camera: CameraId) {
        *self.camera_mut(camera) = *other.camera(camera);
        match other.calibrated.contains(&camera) {
            true => self.calibrated.insert(camera),
            false => self.calibrated.remove(&camera),
        };
    }

    /// Adds a track. Its observations must be in registered images, of keypoints without a point,
    /// each once.
    pub fn add_track(&mut self, track: Track) -> PointId {
        let id = PointId::from_index(self.tracks.len());
        for observation in &track.observations {
            let slot =
                &mut self.images[observation.image.index()].points[observation.keypoint as usize];
            debug_assert!(slot.is_none(), "{observation:?} already sees {slot:?}");
            *slot = Some(id);
        }
        self.tracks.push(Some(track));
        id
    }

    /// The track of a point; `None` if it was deleted.
    pub fn track(&self, id: PointId) -> Option<&Track> {
        self.tracks.get(id.index()).and_then(Option::as_ref)
    }

    /// A track, for changes of position, colour and hold-out flag. Observations are changed through
    /// the other methods.
    pub fn track_mut(&mut self, id: PointId) -> Option<&mut Track> {
        self.tracks.get_mut(id.index()).and_then(Option::as_mut)
    }

    /// All tracks, in order of their ids.
    pub fn tracks(&self) -> impl Iterator<Item = (PointId, &Track)> {
        self.tracks.iter().enumerate().filter_map(|(index, track)| {
            track.as_ref().map(|track| (PointId::from_index(index), track))
        })
    }

    /// The points that the images observe, each once, in order of their ids.
    pub fn points_observed_by<'a>(
        &self,
        images: impl IntoIterator<Item = &'a ImageId>,
    ) -> Vec<PointId> {
        let seen = images.into_iter().flat_map(|image| self.image(*image).points.iter().flatten());
        let mut points: Vec<PointId> = seen.copied().collect();
        points.sort_unstable();
        points.dedup();
        points
    }

    /// Number of points.
    pub fn num_tracks(&self) -> usize {
        self.tracks.iter().flatten().count()
    }

    /// One more than the largest point id ever used: the length of a table indexed by point.
    pub fn point_id_bound(&self) -> usize {
        self.tracks.len()
    }

    /// Number of observations of all points.
    pub fn num_observations(&self) -> usize {
        self.tracks.iter().flatten().map(|track| track.observations.len()).sum()
    }

    /// Mean number of observations of a point.
    pub fn mean_track_length(&self) -> f64 {
        self.num_observations() as f64 / self.num_tracks().max(1) as f64
    }

    /// Adds an observation in a registered image to a point. Does nothing if the keypoint observes
    /// a point already, or if the point is deleted.
    pub fn add_observation(&mut self, point: PointId, observation: Observation) {
        let slot =
            &mut self.images[observation.image.index()].points[observation.keypoint as usize];
        if let (None, Some(Some(track))) = (*slot, self.tracks.get_mut(point.index())) {
            *slot = Some(point);
            track.observations.push(observation);
        }
    }

    /// Removes an observation. A track with fewer than two remaining observations is deleted.
    pub fn remove_observation(&mut self, observation: Observation) {
        let slot =
            &mut self.images[observation.image.index()].points[observation.keypoint as usize];
        let Some(point) = slot.take() else { return };
        if let Some(track) = self.tracks[point.index()].as_mut() {
            track.observations.retain(|o| *o != observation);
            if track.observations.len() < 2 {
                self.delete_track(point);
            }
        }
    }

    /// Deletes a point with its observations.
    pub fn delete_track(&mut self, point: PointId) {
        let Some(track) = self.tracks.get_mut(point.index()).and_then(Option::take) else { return };
        for observation in &track.observations {
            self.images[observation.image.index()].points[observation.keypoint as usize] = None;
        }
    }

    /// Replaces two points by one at `xyz` with the observations of both. `None` without changes if
    /// one of them is deleted.
    pub fn merge_tracks(
        &mut self,
        one: PointId,
        other: PointId,
        xyz: Vector3<f64>,
    ) -> Option<PointId> {
        if one == other || self.track(one).is_none() || self.track(other).is_none() {
            return None;
        }
        let mut merged = self.track(one)?.clone();
        merged.observations.extend(self.track(other)?.observations.iter().copied());
        merged.xyz = xyz;
        self.delete_track(one);
        self.delete_track(other);
        Some(self.add_track(merged))
    }

    /// Reprojection error of one observation of a point, in pixels; `None` if the point does not
    /// project.
    pub fn reprojection_error_px(&self, point: PointId, observation: usize) -> Option<f64> {
        let track = self.track(point)?;
        self.observation_error_px(track.observations.get(observation)?, &track.xyz)
    }

    /// Reprojection error of a point at `xyz` (world frame), in pixels; `None` if the image is not
    /// registered or the point does not project.
    pub fn observation_error_px(
        &self,
        observation: &Observation,
        xyz: &Vector3<f64>,
    ) -> Option<f64> {
        let image = self.image(observation.image);
        let point_in_cam = *image.cam_from_world()? * *xyz;
        let pixel = image.keypoints[observation.keypoint as usize].pixel;
        let intrinsics = &self.camera(image.camera).intrinsics;
        intrinsics.squared_error_px2(&point_in_cam, &pixel).map(f64::sqrt)
    }

    /// Mean reprojection error of a track's observations, in pixels.
    pub fn track_error_px(&self, track: &Track) -> f64 {
        let errors =
            track.observations.iter().filter_map(|o| self.observation_error_px(o, &track.xyz));
        let (sum, count) =
            errors.fold((0.0, 0usize), |(sum, count), error| (sum + error, count + 1));
        sum / count.max(1) as f64
    }

    /// Mean over the points of their mean reprojection errors, in pixels. COLMAP's mean
    /// reprojection error.
    pub fn mean_reprojection_error_px(&self) -> f64 {
        // The sum of no numbers is -0.
        let sum: f64 = self.tracks.iter().flatten().map(|track| self.track_error_px(track)).sum();
        (sum + 0.0) / self.num_tracks().max(1) as f64
    }

    /// Applies a similarity to poses, points and frames.
    pub fn transform(&mut self, new_from_old: &Sim3) {
        self.georeference = None;
        for pose in self.images.iter_mut().filter_map(|image| image.cam_from_world.as_mut()) {
            *pose = new_from_old.transform_pose(pose);
        }
        for track in self.tracks.iter_mut().flatten() {
            track.xyz = *new_from_old * track.xyz;
        }
        for frame in &mut self.frames {
            frame.rig_from_world = new_from_old.transform_pose(&frame.rig_from_world);
        }
        for sensor in self.rigs.iter_mut().flat_map(|rig| rig.sensors.iter_mut()) {
            if let Some(cam_from_rig) = &mut sensor.cam_from_rig {
                cam_from_rig.translation *= new_from_old.scale;
            }
        }
    }
}
