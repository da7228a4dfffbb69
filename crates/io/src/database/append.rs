//! Images that are added to a database, also to one of another program: all other rows stay.

use std::path::Path;

use rusqlite::params;
use tiepoint_features::Features;
use tiepoint_scene::{Camera, CameraId, Image, ImageId};

use super::connection::{Database, bytes};
use super::rigs::SENSOR_CAMERA;
use crate::Result;

impl Database {
    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The ids in the file of the cameras, in the order of [`CameraId`].
    pub fn camera_file_ids(&self) -> &[i64] {
        &self.cameras
    }

    /// The ids in the file of the images, in the order of [`ImageId`].
    pub fn image_file_ids(&self) -> &[i64] {
        &self.images
    }

    /// Adds an image with its features behind those in the file, in one transaction. `new_camera`:
    /// its camera, which is added before it and which the camera of `image` then must name. Where
    /// the file has rigs, a new camera gets a rig of its own and the image a frame of its own.
    ///
    /// # Errors
    ///
    /// If the image names a camera that is not in the file, if the file has an image of that name,
    /// and if it cannot be written.
    pub fn append_image(
        &mut self,
        new_camera: Option<&Camera>,
        image: &Image,
        features: &Features,
    ) -> Result<ImageId> {
        let camera_count = self.cameras.len() + usize::from(new_camera.is_some());
        if image.camera.index() >= camera_count {
            return Err(self.content(format!(
                "image {} names camera {}, but there are {camera_count} cameras",
                image.name, image.camera.0
            )));
        }
        // Ids of rows that were deleted are not given again, as SQLite's AUTOINCREMENT does.
        let next = |ids: &[i64], table: &str| -> Result<i64> {
            let sql = format!("SELECT seq FROM sqlite_sequence WHERE name = '{table}'");
            let has_sequence = !self.columns("sqlite_sequence")?.is_empty();
            let used: Vec<i64> =
                if has_sequence { self.rows(&sql, |row| row.get(0))? } else { Vec::new() };
            Ok(used.into_iter().chain(ids.last().copied()).max().unwrap_or(0) + 1)
        };
        let mut cameras = self.cameras.clone();
        if new_camera.is_some() {
            cameras.push(next(&self.cameras, "cameras")?);
        }
        let camera_id = cameras[image.camera.index()];
        let image_id = next(&self.images, "images")?;
        self.transaction(|db| {
            if let (Some(camera), Some(id)) = (new_camera, cameras.last()) {
                let sql = "INSERT INTO cameras(camera_id, model, width, height, params, \
                prior_focal_length) VALUES (?1, ?2, ?3, ?4, ?5, ?6)";
                let model = camera.intrinsics.kind().colmap_id();
                let params = bytes(camera.intrinsics.params());
                let Camera { width, height, has_focal_prior, .. } = *camera;
                db.execute(sql, params![id, model, width, height, params, has_focal_prior])?;
            }
            let sql = "INSERT INTO images(image_id, name, camera_id) VALUES (?1, ?2, ?3)";
            db.execute(sql, params![image_id, image.name, camera_id])?;
            db.put_features(image_id, features, db.has_descriptor_kinds()?)?;
            if db.has_rig_tables()? { db.append_frame(image_id, camera_id) } else { Ok(()) }
        })?;
        self.cameras = cameras;
        self.images.push(image_id);
        self.camera_of.push(image.camera);
        Ok(ImageId::from_index(self.images.len() - 1))
    }

    /// Adds a frame of one image, and a rig for its camera unless there is one.
    fn append_frame(&self, image_id: i64, camera_id: i64) -> Result<()> {
        let sql = format!(
            "SELECT rig_id FROM rigs WHERE ref_sensor_id = {camera_id} AND ref_sensor_type = \
            {SENSOR_CAMERA} UNION SELECT rig_id FROM rig_sensors WHERE sensor_id = {camera_id} AND \
            sensor_type = {SENSOR_CAMERA}"
        );
        let found: Vec<i64> = self.rows(&sql, |row| row.get(0))?;
        let rig_id = match found.first() {
            Some(rig_id) => *rig_id,
            None => {
                let sql = "INSERT INTO rigs(ref_sensor_id, ref_sensor_type) VALUES (?1, ?2)";
                self.execute(sql, params![camera_id, SENSOR_CAMERA])?;
                self.connection.last_insert_rowid()
            }
        };
        self.execute("INSERT INTO frames(rig_id) VALUES (?1)", params![rig_id])?;
        let frame_id = self.connection.last_insert_rowid();
        let sql = "INSERT INTO frame_data(frame_id, data_id, sensor_id, sensor_type) VALUES (?1, \
        ?2, ?3, ?4)";
        self.execute(sql, params![frame_id, image_id, camera_id, SENSOR_CAMERA])
    }

    /// Sets the intrinsics of a camera.
    ///
    /// # Errors
    ///
    /// If the camera is not in the file, and if it cannot be written.
    pub fn set_camera(&mut self, id: CameraId, camera: &Camera) -> Result<()> {
        let Some(&file_id) = self.cameras.get(id.index()) else {
            return Err(self.content(format!("there is no camera {}", id.0)));
        };
        let sql = "UPDATE cameras SET model = ?2, width = ?3, height = ?4, params = ?5, \
        prior_focal_length = ?6 WHERE camera_id = ?1";
        let model = camera.intrinsics.kind().colmap_id();
        let params = bytes(camera.intrinsics.params());
        let Camera { width, height, has_focal_prior, .. } = *camera;
        self.transaction(|db| {
            db.execute(sql, params![file_id, model, width, height, params, has_focal_prior])
        })
    }
}
