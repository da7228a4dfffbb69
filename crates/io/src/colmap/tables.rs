//! The records of the files of a model, and their conversion to a reconstruction.

use std::collections::BTreeSet;
use std::path::Path;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::rig::is_same_pose;
use tiepoint_scene::{
    Camera, CameraId, Frame, Image, ImageId, Keypoint, Observation, OriginalIds, Reconstruction,
    Rig, RigId, RigSensor, Track,
};

use super::file_ids::NO_POINT;
use super::rig_tables::{FrameRow, RigRow};
use crate::text::excerpt::Excerpt;
use crate::{Error, Result};

/// Scale of a keypoint, in pixels, since the files hold none: all keypoints have equal weight.
pub(super) const UNKNOWN_SCALE_PX: f32 = 1.0;

pub(super) struct ImageRow {
    pub(super) id: u32,
    pub(super) cam_from_world: Rigid3,
    pub(super) camera: u32,
    pub(super) name: String,
    pub(super) keypoints: Vec<Keypoint>,
    /// Point id of each keypoint, or [`NO_POINT`].
    pub(super) points: Vec<u64>,
}

pub(super) struct PointRow {
    pub(super) id: u64,
    pub(super) xyz: Vector3<f64>,
    pub(super) color: [u8; 3],
    /// Image id and index of the keypoint.
    pub(super) track: Vec<(u32, u32)>,
}

#[derive(Default)]
pub(super) struct Tables {
    pub(super) cameras: Vec<(u32, Camera)>,
    pub(super) rigs: Vec<RigRow>,
    pub(super) frames: Vec<FrameRow>,
    pub(super) images: Vec<ImageRow>,
    pub(super) points: Vec<PointRow>,
}

/// Sorts rows by id and returns the ids; an error if an id occurs twice.
fn sort<T, I: Ord + Copy + std::fmt::Display>(
    dir: &Path,
    kind: &str,
    rows: &mut [T],
    id: impl Fn(&T) -> I,
) -> Result<Vec<I>> {
    rows.sort_by_key(&id);
    match rows.windows(2).find(|pair| id(&pair[0]) == id(&pair[1])) {
        Some(pair) => Err(Error::content(dir, format!("{kind} {} is listed twice", id(&pair[0])))),
        None => Ok(rows.iter().map(id).collect()),
    }
}

/// The index of an id in a sorted list; `referrer` names the record that refers to it, for the
/// error.
fn find<I: Ord + Copy + std::fmt::Display>(
    dir: &Path,
    kind: &str,
    ids: &[I],
    id: I,
    referrer: impl FnOnce() -> String,
) -> Result<usize> {
    ids.binary_search(&id).map_err(|_| {
        Error::content(dir, format!("{} names {kind} {id}, which does not exist", referrer()))
    })
}

impl Tables {
    pub(super) fn into_reconstruction(mut self, dir: &Path) -> Result<Reconstruction> {
        let mut model = Reconstruction::default();
        let cameras = sort(dir, "camera", &mut self.cameras, |row| row.0)?;
        for (_, camera) in self.cameras {
            model.add_camera(camera);
        }
        let images = sort(dir, "image", &mut self.images, |row| row.id)?;
        let mut names = BTreeSet::new();
        if let Some(row) = self.images.iter().find(|row| !names.insert(row.name.as_str())) {
            // Photos, times and other models are found by names.
            let name = Excerpt(&row.name);
            return Err(Error::content(dir, format!("two of its images have the name {name}")));
        }
        // Point ids of the keypoints of each image; set to `NO_POINT` when the track of the point
        // lists the keypoint.
        let mut point_ids = Vec::with_capacity(self.images.len());
        for row in self.images {
            let camera = find(dir, "camera", &cameras, row.camera, || {
                format!("image {}", Excerpt(&row.name))
            })?;
            let image =
                model.add_image(Image::new(row.name, CameraId::from_index(camera), row.keypoints));
            model.register(image, row.cam_from_world);
            point_ids.push(row.points);
        }
        add_rigs(dir, &mut model, self.rigs, self.frames, &cameras, &images)?;
        let points = sort(dir, "point", &mut self.points, |row| row.id)?;
        if points.last() == Some(&NO_POINT) {
            return Err(Error::content(
                dir,
                format!("a point has the id {NO_POINT}, which means none"),
            ));
        }
        for row in self.points {
            let mut observations = Vec::with_capacity(row.track.len());
            for (image, keypoint) in row.track {
                let index = find(dir, "image", &images, image, || format!("point {}", row.id))?;
                match point_ids[index].get_mut(keypoint as usize) {
                    Some(point_id) if *point_id == row.id => *point_id = NO_POINT,
                    Some(_) => {
                        return Err(Error::content(
                            dir,
                            format!(
                                "point {} is seen by keypoint {keypoint} of image {image}, which \
                                names another point",
                                row.id
                            ),
                        ));
                    }
                    None => {
                        return Err(Error::content(
                            dir,
                            format!(
                                "point {} is seen by keypoint {keypoint} of image {image}, which \
                                has {} keypoints",
                                row.id,
                                point_ids[index].len()
                            ),
                        ));
                    }
                }
                observations.push(Observation { image: ImageId::from_index(index), keypoint });
            }
            model.add_track(Track { color: row.color, ..Track::new(row.xyz, observations) });
        }
        for (id, point_ids) in images.iter().zip(&point_ids) {
            if let Some(keypoint) = point_ids.iter().position(|point_id| *point_id != NO_POINT) {
                return Err(Error::content(
                    dir,
                    format!(
                        "keypoint {keypoint} of image {id} names point {}, whose track does not \
                        hold it: take points3D and images of one model, or leave the keypoints \
                        of images out",
                        point_ids[keypoint]
                    ),
                ));
            }
        }
        let wide = |ids: Vec<u32>| ids.into_iter().map(u64::from).collect();
        model.original_ids = OriginalIds::new(wide(cameras), wide(images), points);
        Ok(model)
    }
}

/// Adds the rigs of several cameras and their frames to the model. If the pose of an image differs
/// from the pose that its frame gives, the pose of the frame is used, as in COLMAP. If the camera
/// has no pose in the rig, the image keeps its pose and is in no frame.
fn add_rigs(
    dir: &Path,
    model: &mut Reconstruction,
    mut rigs: Vec<RigRow>,
    mut frames: Vec<FrameRow>,
    cameras: &[u32],
    images: &[u32],
) -> Result<()> {
    let rig_ids = sort(dir, "rig", &mut rigs, |row| row.id)?;
    sort(dir, "frame", &mut frames, |row| row.id)?;
    // For each rig its index in the model, if it is kept, and its sensors.
    let mut sensors_of = Vec::with_capacity(rigs.len());
    let mut is_on_rig = vec![false; cameras.len()];
    for row in rigs {
        let mut sensors = Vec::with_capacity(row.cameras.len());
        for (k, (camera, cam_from_rig)) in row.cameras.into_iter().enumerate() {
            let index = find(dir, "camera", cameras, camera, || format!("rig {}", row.id))?;
            if std::mem::replace(&mut is_on_rig[index], true) {
                return Err(Error::content(
                    dir,
                    format!("camera {camera} is on two rigs, or twice on one"),
                ));
            }
            let cam_from_rig = if k == 0 { Some(Rigid3::identity()) } else { cam_from_rig };
            sensors.push(RigSensor { camera: CameraId::from_index(index), cam_from_rig });
        }
        // A camera without a pose in its rig is not rigidly connected.
        let posed: Vec<RigSensor> =
            sensors.iter().filter(|sensor| sensor.cam_from_rig.is_some()).copied().collect();
        let kept = (posed.len() > 1).then(|| {
            model.rigs.push(Rig { sensors: posed });
            RigId::from_index(model.rigs.len() - 1)
        });
        sensors_of.push((kept, sensors));
    }
    let mut is_in_frame = vec![false; images.len()];
    let mut new_frames = Vec::new();
    for row in frames {
        let referrer = || format!("frame {}", row.id);
        let (kept, sensors) = &sensors_of[find(dir, "rig", &rig_ids, row.rig, referrer)?];
        let mut members = Vec::with_capacity(row.images.len());
        for (_, image) in row.images {
            let id = ImageId::from_index(find(dir, "image", images, image, referrer)?);
            let camera = model.image(id).camera;
            let sensor =
                sensors.iter().find(|sensor| sensor.camera == camera).ok_or_else(|| {
                    Error::content(
                        dir,
                        format!(
                            "frame {} holds image {image} of a camera that is not on its rig",
                            row.id
                        ),
                    )
                })?;
            if std::mem::replace(&mut is_in_frame[id.index()], true) {
                return Err(Error::content(dir, format!("image {image} is in two frames")));
            }
            // A single camera of a rig is its reference sensor, whose pose is known.
            let Some(cam_from_rig) = sensor.cam_from_rig else { continue };
            let cam_from_world = cam_from_rig * row.rig_from_world;
            if model
                .image(id)
                .cam_from_world()
                .is_some_and(|own| !is_same_pose(own, &cam_from_world))
            {
                model.register(id, cam_from_world);
            }
            members.push(id);
        }
        if let Some(rig) = kept.filter(|_| !members.is_empty()) {
            new_frames.push(Frame { rig, rig_from_world: row.rig_from_world, images: members });
        }
    }
    model.frames = new_frames;
    Ok(())
}
