//! Writes a drive: images and time stamps as input, the ground truth as tables.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use crate::Exposure;
use crate::drive::Drive;
use crate::error::Error;
use crate::lens::Lens;
use crate::photometry::jpeg_bytes;
use crate::render::Renderer;

/// Writes a file under a temporary name and renames it, so that no incomplete file has the name.
pub(crate) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let part = path.with_extension("part");
    let written = path.parent().map_or(Ok(()), fs::create_dir_all);
    let written =
        written.and_then(|()| fs::write(&part, bytes)).and_then(|()| fs::rename(&part, path));
    written.map_err(|source| Error::Write { path: path.to_owned(), source })
}

impl Drive {
    /// The time stamps: `image,seconds`, one line for each image.
    pub fn timestamps_csv(&self) -> String {
        let mut text = String::from("image,seconds\n");
        for exposure in self.cameras().iter().flat_map(|camera| &camera.exposures) {
            writeln!(text, "{},{:.6}", exposure.name, exposure.stamp_s)
                .expect("a string can be written to");
        }
        text
    }

    /// The true poses: `image,true_seconds,qw,qx,qy,qz,tx,ty,tz` with cam_from_world at the middle
    /// row.
    pub fn poses_csv(&self) -> String {
        let mut text = String::from("image,true_seconds,qw,qx,qy,qz,tx,ty,tz\n");
        for (index, camera) in self.cameras().iter().enumerate() {
            for exposure in &camera.exposures {
                let pose = self.cam_from_world(index, exposure.time_s);
                let (q, t) = (pose.rotation, pose.translation);
                let numbers = [exposure.time_s, q.w, q.i, q.j, q.k, t.x, t.y, t.z];
                let numbers = numbers.map(|number| number.to_string()).join(",");
                writeln!(text, "{},{numbers}", exposure.name).expect("a string can be written to");
            }
        }
        text
    }

    /// The true poses of the first and of the last row: `image,y_px,qw,qx,qy,qz,tx,ty,tz` with
    /// cam_from_world at the centre of the row; `None` if no camera has a rolling shutter.
    pub fn rows_csv(&self) -> Option<String> {
        if self.cameras().iter().all(|camera| camera.readout_s == 0.0) {
            return None;
        }
        let mut text = String::from("image,y_px,qw,qx,qy,qz,tx,ty,tz\n");
        for (index, camera) in self.cameras().iter().enumerate() {
            for exposure in &camera.exposures {
                for y_px in [0.5, f64::from(camera.height) - 0.5] {
                    let row = self.row_pose(index, exposure.time_s, y_px);
                    let pose = row.world_from_cam.inverse();
                    let (q, t) = (pose.rotation, pose.translation);
                    let numbers = [y_px, q.w, q.i, q.j, q.k, t.x, t.y, t.z];
                    let numbers = numbers.map(|number| number.to_string()).join(",");
                    writeln!(text, "{},{numbers}", exposure.name)
                        .expect("a string can be written to");
                }
            }
        }
        Some(text)
    }

    /// The trajectory of a camera in the TUM format: `seconds tx ty tz qx qy qz qw` with true time
    /// and world_from_cam.
    pub fn trajectory_tum(&self, camera: usize) -> String {
        let mut text = String::new();
        for exposure in &self.cameras()[camera].exposures {
            let pose = self.cam_from_world(camera, exposure.time_s).inverse();
            let (q, t) = (pose.rotation, pose.translation);
            let numbers = [exposure.time_s, t.x, t.y, t.z, q.i, q.j, q.k, q.w];
            writeln!(text, "{}", numbers.map(|number| number.to_string()).join(" "))
                .expect("a string can be written to");
        }
        text
    }

    /// The true cameras: `camera,quantity,value`. Quantities are the lens (`focal_px`, `cx`, `cy`,
    /// and for the action lens `a1`..`a4`, `p1`, `p2`), the clock, the readout time, cam_from_rig
    /// (the first camera is the reference sensor), and for the lens field `field_x_i_j` and
    /// `field_y_i_j`, the displacements of the mode of i and j half waves in pixels.
    pub fn cameras_csv(&self) -> String {
        let mut text = String::from("camera,quantity,value\n");
        for (index, camera) in self.cameras().iter().enumerate() {
            let (centre, in_rig) = (camera.lens.principal_point(), self.cam_from_rig(index));
            let (q, t) = (in_rig.rotation, in_rig.translation);
            let mut rows = vec![
                ("width", f64::from(camera.width)),
                ("height", f64::from(camera.height)),
                ("focal_px", camera.lens.focal_px()),
                ("cx", centre.x),
                ("cy", centre.y),
                ("readout_s", camera.readout_s),
                ("clock_offset_s", camera.clock.offset_s),
                ("clock_drift", camera.clock.drift),
                ("rig_qw", q.w),
                ("rig_qx", q.i),
                ("rig_qy", q.j),
                ("rig_qz", q.k),
                ("rig_tx", t.x),
                ("rig_ty", t.y),
                ("rig_tz", t.z),
            ];
            let (lens, field) = match &camera.lens {
                Lens::WithField { lens, field } => (lens.as_ref(), Some(field)),
                lens => (lens, None),
            };
            if let Lens::Action(lens) = lens {
                rows.extend(["a1", "a2", "a3", "a4"].into_iter().zip(lens.radial));
                rows.extend(["p1", "p2"].into_iter().zip(lens.decentring));
            }
            let rows = rows.into_iter().map(|(quantity, value)| (quantity.to_owned(), value));
            let modes = field.into_iter().flat_map(|field| field.modes());
            let modes = modes.flat_map(|([i, j], c)| {
                [(format!("field_x_{i}_{j}"), c.x), (format!("field_y_{i}_{j}"), c.y)]
            });
            for (quantity, value) in rows.chain(modes) {
                writeln!(text, "{},{quantity},{value}", camera.name)
                    .expect("a string can be written to");
            }
        }
        text
    }

    /// Writes `timestamps.csv` and, under `truth/`, `poses.csv`, `cameras.csv`, a TUM trajectory of
    /// each camera and, of a rolling shutter, `rows.csv`.
    ///
    /// # Errors
    ///
    /// [`Error::Write`] if a file cannot be written.
    pub fn write_tables(&self, folder: &Path) -> Result<(), Error> {
        write_file(&folder.join("timestamps.csv"), self.timestamps_csv().as_bytes())?;
        write_file(&folder.join("truth/poses.csv"), self.poses_csv().as_bytes())?;
        write_file(&folder.join("truth/cameras.csv"), self.cameras_csv().as_bytes())?;
        if let Some(rows) = self.rows_csv() {
            write_file(&folder.join("truth/rows.csv"), rows.as_bytes())?;
        }
        for (index, camera) in self.cameras().iter().enumerate() {
            let path = folder.join("truth").join(format!("{}.tum", camera.name));
            write_file(&path, self.trajectory_tum(index).as_bytes())?;
        }
        Ok(())
    }

    /// Renders an image and writes it under its name in `folder`.
    ///
    /// # Errors
    ///
    /// [`Error::Encode`] if the image cannot be encoded, [`Error::Write`] if the file cannot be
    /// written.
    pub fn write_image(
        &self,
        folder: &Path,
        camera: usize,
        exposure: &Exposure,
        renderer: &Renderer,
    ) -> Result<(), Error> {
        let path = folder.join(&exposure.name);
        let image = self.render_raw(camera, exposure, renderer);
        let bytes = match self.jpeg_quality() {
            Some(quality) => jpeg_bytes(&image, quality, &[]),
            None => {
                let mut bytes = std::io::Cursor::new(Vec::new());
                image
                    .write_to(&mut bytes, image::ImageFormat::Png)
                    .ok()
                    .map(|()| bytes.into_inner())
            }
        };
        let bytes = bytes.ok_or_else(|| Error::Encode {
            path: path.clone(),
            reason: format!(
                "an image of {} x {} pixels was refused",
                image.width(),
                image.height()
            ),
        })?;
        write_file(&path, &bytes)
    }
}
