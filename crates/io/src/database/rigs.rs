//! Rigs and the moments at which they took images.

use std::collections::BTreeMap;

use rusqlite::params;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{CameraId, ImageId, Rig, RigId, RigSensor};

use super::connection::{Database, Moment, bytes, numbers};
use crate::binary::pose_numbers;
use crate::{Result, rotation};

/// COLMAP's number for a camera among the kinds of sensors.
const SENSOR_CAMERA: i64 = 0;

impl Database {
    /// Writes the rigs and moments; those that are there are replaced. A camera on no rig gets one
    /// of its own, and an image in no moment too, since COLMAP wants both: `write_rigs(&[], &[])`
    /// for cameras that do not ride together. Cameras and images must be there.
    pub fn write_rigs(&mut self, rigs: &[Rig], moments: &[Moment]) -> Result<()> {
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
        let mut moment_of: Vec<Option<usize>> = vec![None; self.num_images()];
        for (index, moment) in moments.iter().enumerate() {
            for image in &moment.images {
                self.file_id(*image)?;
                if rig_of[self.camera_of[image.index()].index()] != Some(moment.rig.index()) {
                    return Err(self.content(format!(
                        "moment {index} holds image {} of another rig",
                        image.0
                    )));
                }
                if moment_of[image.index()].replace(index).is_some() {
                    return Err(self.content(format!("image {} is in two moments", image.0)));
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
            let new_frame = |index: usize, rig: usize, images: &[ImageId]| {
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
            for (index, moment) in moments.iter().enumerate() {
                new_frame(index, moment.rig.index(), &moment.images)?;
            }
            for (image, _) in moment_of.iter().enumerate().filter(|(_, moment)| moment.is_none()) {
                let camera = db.camera_of[image].index();
                let rig = rig_of[camera].unwrap_or(rigs.len() + camera);
                new_frame(moments.len() + image, rig, &[ImageId::from_index(image)])?;
            }
            Ok(())
        })
    }

    /// Reads the rigs of more than one camera, and the moments at which they took images.
    pub fn read_rigs(&self) -> Result<(Vec<Rig>, Vec<Moment>)> {
        if self.columns("rig_sensors")?.is_empty() {
            return Ok((Vec::new(), Vec::new())); // a file older than COLMAP 3.12
        }
        let camera = |file_id: i64| {
            let found = self.cameras.binary_search(&file_id).map(CameraId::from_index);
            found.map_err(|_| {
                self.content(format!("a rig names camera {file_id}, which there is not"))
            })
        };
        // Two plain queries and no join: where a hostile file lists a rig twice, a join would
        // multiply its sensors.
        let references: BTreeMap<i64, i64> = self.pairs(&format!(
            "SELECT rig_id, ref_sensor_id FROM rigs WHERE ref_sensor_type = {SENSOR_CAMERA} ORDER \
            BY rig_id"
        ))?;
        // Rigs are listed by those sensors that are not the reference: a rig of one does not occur.
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
            self.pairs("SELECT frame_id, rig_id FROM frames ORDER BY frame_id")?;
        let rows: Vec<(i64, i64)> = self.rows(
            &format!(
                "SELECT frame_id, data_id FROM frame_data WHERE sensor_type = {SENSOR_CAMERA} \
                ORDER BY frame_id, data_id"
            ),
            |row| Ok((row.get(0)?, row.get(1)?)),
        )?;
        let mut moments: Vec<Moment> = Vec::new();
        let mut last = None;
        for (frame, image) in rows {
            let Some(Ok(rig)) = rig_of.get(&frame).map(|rig| ids.binary_search(rig)) else {
                continue;
            };
            let image = self.image_id(image, || format!("frame {frame}"))?;
            match moments.last_mut().filter(|_| last == Some(frame)) {
                Some(moment) => moment.images.push(image),
                None => moments.push(Moment { rig: RigId::from_index(rig), images: vec![image] }),
            }
            last = Some(frame);
        }
        Ok((rigs, moments))
    }

    /// The rows of two numbers, of which the first must differ from row to row.
    fn pairs(&self, sql: &str) -> Result<BTreeMap<i64, i64>> {
        let rows: Vec<(i64, i64)> = self.rows(sql, |row| Ok((row.get(0)?, row.get(1)?)))?;
        let count = rows.len();
        let pairs: BTreeMap<i64, i64> = rows.into_iter().collect();
        if pairs.len() < count {
            return Err(self.content("a rig or a frame is listed twice".to_owned()));
        }
        Ok(pairs)
    }
}
