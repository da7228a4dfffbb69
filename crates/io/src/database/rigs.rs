//! Rigs and frames.

use std::collections::BTreeMap;

use rusqlite::params;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{CameraId, ImageId, Rig, RigId, RigSensor};

use super::connection::{Database, DatabaseFrame, bytes, numbers};
use crate::binary::pose_numbers;
use crate::{Result, rotation};

/// Value of COLMAP for cameras among the types of sensors.
pub(super) const SENSOR_CAMERA: i64 = 0;

impl Database {
    /// Writes the rigs and frames; replaces those in the file. A camera in no rig gets a rig of its
    /// own, and an image in no frame gets a frame of its own, because COLMAP requires both:
    /// `write_rigs(&[], &[])` is for independent cameras. Cameras and images must be in the file.
    ///
    /// # Errors
    ///
    /// If a camera is in two rigs, if an image is in two frames or in a frame of a rig without its
    /// camera, if a camera or an image is not in the file, and if the file cannot be written.
    pub fn write_rigs(&mut self, rigs: &[Rig], frames: &[DatabaseFrame]) -> Result<()> {
        let mut rig_of: Vec<Option<usize>> = vec![None; self.num_cameras()];
        for (index, rig) in rigs.iter().enumerate() {
            for sensor in &rig.sensors {
                match rig_of.get_mut(sensor.camera.index()) {
                    Some(slot @ None) => *slot = Some(index),
                    Some(_) => {
                        return Err(
                            self.content(format!("camera {} is on two rigs", sensor.camera.0))
                        );
                    }
                    None => {
                        return Err(
                            self.content(format!("rig {index} names camera {}", sensor.camera.0))
                        );
                    }
                }
            }
        }
        let mut frame_of: Vec<Option<usize>> = vec![None; self.num_images()];
        for (index, frame) in frames.iter().enumerate() {
            for image in &frame.images {
                self.file_id(*image)?;
                if rig_of[self.camera_of[image.index()].index()] != Some(frame.rig.index()) {
                    return Err(self
                        .content(format!("frame {index} holds image {} of another rig", image.0)));
                }
                if frame_of[image.index()].replace(index).is_some() {
                    return Err(self.content(format!("image {} is in two frames", image.0)));
                }
            }
        }
        self.transaction(|db| {
            db.run(
                "DELETE FROM frame_data; DELETE FROM frames; DELETE FROM rig_sensors; DELETE \
            FROM rigs;",
            )?;
            let new_rig = |index: usize, camera: CameraId| {
                let sql = "INSERT INTO rigs(rig_id, ref_sensor_id, ref_sensor_type) VALUES (?1, \
                ?2, ?3)";
                db.execute(
                    sql,
                    params![index as i64 + 1, db.cameras[camera.index()], SENSOR_CAMERA],
                )
            };
            for (index, rig) in rigs.iter().enumerate() {
                for (k, sensor) in rig.sensors.iter().enumerate() {
                    if k == 0 {
                        new_rig(index, sensor.camera)?;
                        continue;
                    }
                    let pose = sensor.cam_from_rig.as_ref().map(|pose| bytes(&pose_numbers(pose)));
                    let sql = "INSERT INTO rig_sensors(rig_id, sensor_id, sensor_type, \
                    sensor_from_rig) \
                               VALUES (?1, ?2, ?3, ?4)";
                    let camera = db.cameras[sensor.camera.index()];
                    db.execute(sql, params![index as i64 + 1, camera, SENSOR_CAMERA, pose])?;
                }
            }
            for (camera, _) in rig_of.iter().enumerate().filter(|(_, rig)| rig.is_none()) {
                new_rig(rigs.len() + camera, CameraId::from_index(camera))?;
            }
            let new_frame = |index: usize, rig: usize, images: &[ImageId]| -> Result<()> {
                let id = index as i64 + 1;
                db.execute(
                    "INSERT INTO frames(frame_id, rig_id) VALUES (?1, ?2)",
                    params![id, rig as i64 + 1],
                )?;
                for image in images {
                    let sql = "INSERT INTO frame_data(frame_id, data_id, sensor_id, sensor_type) \
                               VALUES (?1, ?2, ?3, ?4)";
                    let camera = db.cameras[db.camera_of[image.index()].index()];
                    db.execute(sql, params![id, db.file_id(*image)?, camera, SENSOR_CAMERA])?;
                }
                Ok(())
            };
            for (index, frame) in frames.iter().enumerate() {
                new_frame(index, frame.rig.index(), &frame.images)?;
            }
            for (image, _) in frame_of.iter().enumerate().filter(|(_, frame)| frame.is_none()) {
                let camera = db.camera_of[image].index();
                let rig = rig_of[camera].unwrap_or(rigs.len() + camera);
                new_frame(frames.len() + image, rig, &[ImageId::from_index(image)])?;
            }
            Ok(())
        })
    }

    /// Whether the file has tables of rigs and frames, as since COLMAP 3.12.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn has_rig_tables(&self) -> Result<bool> {
        Ok(!self.columns("rig_sensors")?.is_empty())
    }

    /// Reads the rigs of several cameras and their frames.
    ///
    /// # Errors
    ///
    /// If a rig or a frame is listed twice, refers to a camera or an image that does not exist, or
    /// has an invalid pose, and if the file cannot be read.
    pub fn read_rigs(&self) -> Result<(Vec<Rig>, Vec<DatabaseFrame>)> {
        if !self.has_rig_tables()? {
            return Ok((Vec::new(), Vec::new()));
        }
        let camera = |file_id: i64| {
            let found = self.cameras.binary_search(&file_id).map(CameraId::from_index);
            found.map_err(|_| {
                self.content(format!("a rig names camera {file_id}, which does not exist"))
            })
        };
        // Two queries instead of a join: if a malicious file lists a rig twice, a join would
        // multiply its sensors.
        let references: BTreeMap<i64, i64> = self.unique_rows(&format!(
            "SELECT rig_id, ref_sensor_id FROM rigs WHERE ref_sensor_type = {SENSOR_CAMERA} ORDER \
            BY rig_id"
        ))?;
        // The table holds the sensors other than the reference, so that a rig of one camera does
        // not occur.
        type SensorRow = (i64, i64, Option<Vec<u8>>);
        let rows: Vec<SensorRow> = self.rows(
            &format!(
                "SELECT rig_id, sensor_id, sensor_from_rig FROM rig_sensors WHERE sensor_type = \
                {SENSOR_CAMERA} \
                 ORDER BY rig_id, sensor_id"
            ),
            |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)),
        )?;
        let mut ids: Vec<i64> = Vec::new();
        let mut rigs: Vec<Rig> = Vec::new();
        for (id, sensor, pose) in rows {
            let Some(reference) = references.get(&id) else { continue };
            if ids.last() != Some(&id) {
                ids.push(id);
                let reference = RigSensor {
                    camera: camera(*reference)?,
                    cam_from_rig: Some(Rigid3::identity()),
                };
                rigs.push(Rig { sensors: vec![reference] });
            }
            let pose = pose.map(|pose| {
                let values = numbers(&pose, 7)?;
                let rotation =
                    rotation::from_wxyz([values[0], values[1], values[2], values[3]]).ok()?;
                Some(Rigid3::new(rotation, Vector3::from_column_slice(&values[4..])))
            });
            if pose == Some(None) {
                return Err(
                    self.content(format!("the pose of camera {sensor} on rig {id} is broken"))
                );
            }
            let sensor = RigSensor { camera: camera(sensor)?, cam_from_rig: pose.flatten() };
            if let Some(rig) = rigs.last_mut() {
                rig.sensors.push(sensor);
            }
        }
        let rig_of: BTreeMap<i64, i64> =
            self.unique_rows("SELECT frame_id, rig_id FROM frames ORDER BY frame_id")?;
        let rows: Vec<(i64, i64)> = self.rows(
            &format!(
                "SELECT frame_id, data_id FROM frame_data WHERE sensor_type = {SENSOR_CAMERA} \
                ORDER BY frame_id, data_id"
            ),
            |row| Ok((row.get(0)?, row.get(1)?)),
        )?;
        let mut frames: Vec<DatabaseFrame> = Vec::new();
        let mut last = None;
        for (frame_id, image) in rows {
            let Some(Ok(rig)) = rig_of.get(&frame_id).map(|rig| ids.binary_search(rig)) else {
                continue;
            };
            let image = self.image_id(image, || format!("frame {frame_id}"))?;
            match frames.last_mut().filter(|_| last == Some(frame_id)) {
                Some(frame) => frame.images.push(image),
                None => {
                    frames.push(DatabaseFrame { rig: RigId::from_index(rig), images: vec![image] })
                }
            }
            last = Some(frame_id);
        }
        Ok((rigs, frames))
    }

    /// Rows of a unique key and a value.
    fn unique_rows(&self, sql: &str) -> Result<BTreeMap<i64, i64>> {
        let rows: Vec<(i64, i64)> = self.rows(sql, |row| Ok((row.get(0)?, row.get(1)?)))?;
        let count = rows.len();
        let unique: BTreeMap<i64, i64> = rows.into_iter().collect();
        if unique.len() < count {
            return Err(self.content("a rig or a frame is listed twice".to_owned()));
        }
        Ok(unique)
    }
}
