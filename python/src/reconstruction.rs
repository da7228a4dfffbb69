//! Models as arrays: the methods of their class.

use std::ffi::CString;
use std::path::PathBuf;

use numpy::ndarray::{Array4, Ix2};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArray4};
use pyo3::exceptions::{PyIndexError, PyUserWarning};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tiepoint_geometry::nalgebra::{Matrix4, UnitQuaternion, Vector3};
use tiepoint_geometry::{Rigid3, Sim3};
use tiepoint_io::colmap::Format;
use tiepoint_pipeline::workspace::LocatedModel;
use tiepoint_scene::{CameraId, ImageId, Observation};
use tiepoint_sfm::rolling_shutter::row_poses;

use crate::arrays::{
    invalid_array, is_rotation, matrix, numbers, pose, poses, poses_of, rows, selection, vector,
};
use crate::camera::Camera;
use crate::errors::{failed, invalid};
use crate::image::ModelImage;
use crate::model::Reconstruction;

#[pymethods]
impl Reconstruction {
    /// Reads the model of a workspace or a folder with a COLMAP model, binary or text.
    #[new]
    fn open(python: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Self::read(python, path)
    }

    /// The same as `Reconstruction(path)`.
    #[staticmethod]
    fn read(python: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let located = python.detach(|| LocatedModel::open(&path)).map_err(failed)?;
        if let Some(note) = located.note() {
            let message = CString::new(note.replace('\0', "")).expect("it has no NUL");
            PyErr::warn(python, &python.get_type::<PyUserWarning>(), &message, 1)?;
        }
        Ok(Self::new(located.reconstruction, located.shutters))
    }

    /// Writes the model into a folder, as COLMAP's binary files or its text files. Ids stay those
    /// of the files that it was read from. It replaces a model that was written so, no other.
    #[pyo3(signature = (path, *, text=false))]
    fn write(&self, python: Python<'_>, path: PathBuf, text: bool) -> PyResult<()> {
        if path.as_os_str().is_empty() {
            return Err(invalid("path is empty: give the folder of a model"));
        }
        let format = if text { Format::Text } else { Format::Binary };
        python
            .detach(|| tiepoint_pipeline::workspace::write_model(&path, &self.model, format))
            .map_err(failed)
    }

    /// The cameras, in the order of their ids.
    #[getter]
    fn cameras(&self) -> Vec<Camera> {
        self.model.cameras().map(|(_, camera)| Camera { camera: *camera }).collect()
    }

    /// Ids of the cameras in the files, uint64 of shape (C,).
    #[getter]
    fn camera_ids<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<u64>> {
        let ids = self.model.cameras().map(|(id, _)| self.model.original_ids.camera(id));
        vector(python, ids.collect())
    }

    /// Replaces a camera, given by its index.
    fn set_camera(&mut self, index: usize, camera: Camera) -> PyResult<()> {
        if index >= self.model.num_cameras() {
            let count = self.model.num_cameras();
            return Err(PyIndexError::new_err(format!("camera {index} of {count}")));
        }
        *self.model.camera_mut(CameraId::from_index(index)) = camera.camera;
        Ok(())
    }

    /// The images by their ids in the files: a dictionary, as of pycolmap.
    #[getter]
    fn images<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let (all, this_ref) = (PyDict::new(this.py()), this.try_borrow()?);
        for id in &this_ref.images {
            let image = ModelImage { reconstruction: this.clone().unbind(), id: *id };
            all.set_item(this_ref.model.original_ids.image(*id), image)?;
        }
        Ok(all)
    }

    /// The names of the images.
    #[getter]
    fn image_names(&self) -> Vec<&str> {
        self.images.iter().map(|id| self.model.image(*id).name.as_str()).collect()
    }

    /// Ids of the images in the files, uint64 of shape (N,).
    #[getter]
    fn image_ids<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<u64>> {
        vector(python, self.images.iter().map(|id| self.model.original_ids.image(*id)).collect())
    }

    /// Index of each image's camera in `cameras`, uint32 of shape (N,).
    #[getter]
    fn image_cameras<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        vector(python, self.images.iter().map(|id| self.model.image(*id).camera.0).collect())
    }

    /// cam_from_world of the images, of shape (N, 3, 4).
    #[getter]
    fn poses<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let all: Vec<Rigid3> = self.model.registered().map(|(.., pose)| *pose).collect();
        poses(python, &all)
    }

    /// Replaces the poses. Images of a frame of a rig are no longer rigidly connected.
    #[setter]
    fn set_poses(&mut self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let all = poses_of(value, "poses")?;
        let count = self.images.len();
        if all.len() != count {
            return Err(invalid_array(value, "poses", "numbers", &format!("({count}, 3, 4)")));
        }
        self.model.rigs.clear();
        self.model.frames.clear();
        for (id, pose) in self.images.iter().zip(all) {
            self.model.register(*id, pose);
        }
        Ok(())
    }

    /// Centres of the images in the world, of shape (N, 3).
    #[getter]
    fn centers<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let centers: Vec<[f64; 3]> =
            self.model.registered().map(|(.., pose)| pose.origin_in_a().into()).collect();
        matrix(python, &centers)
    }

    /// Keypoints of an image, given by its index, of shape (K, 2), in pixels.
    fn keypoints<'py>(
        &self,
        python: Python<'py>,
        image: usize,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let pixels: Vec<[f64; 2]> =
            self.image(image)?.keypoints.iter().map(|keypoint| keypoint.pixel.into()).collect();
        Ok(matrix(python, &pixels))
    }

    /// Positions of the points, of shape (P, 3).
    #[getter]
    fn points<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let points: Vec<[f64; 3]> =
            self.model.tracks().map(|(_, track)| track.xyz.into()).collect();
        matrix(python, &points)
    }

    /// Replaces the positions of the points.
    #[setter]
    fn set_points(&mut self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let points = rows::<3>(value, "points")?;
        let count = self.points.len();
        if points.len() != count {
            return Err(invalid_array(value, "points", "numbers", &format!("({count}, 3)")));
        }
        for (id, xyz) in self.points.iter().zip(points) {
            if let Some(track) = self.model.track_mut(*id) {
                track.xyz = xyz;
            }
        }
        Ok(())
    }

    /// Ids of the points in the files, uint64 of shape (P,).
    #[getter]
    fn point_ids<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<u64>> {
        vector(python, self.points.iter().map(|id| self.model.original_ids.point(*id)).collect())
    }

    /// Colours of the points, uint8 of shape (P, 3).
    #[getter]
    fn colors<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray2<u8>> {
        let colors: Vec<[u8; 3]> = self.model.tracks().map(|(_, track)| track.color).collect();
        matrix(python, &colors)
    }

    /// Mean reprojection error of each point, in pixels, of shape (P,).
    #[getter]
    fn point_errors<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let errors = self.model.tracks().map(|(_, track)| self.model.track_error_px(track));
        vector(python, errors.collect())
    }

    /// The observations, uint32 of shape (M, 3): index of the point, index of the image, and index
    /// of the keypoint in the image; ordered by points.
    #[getter]
    fn observations<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray2<u32>> {
        let mut all: Vec<[u32; 3]> = Vec::with_capacity(self.model.num_observations());
        for (point, (_, track)) in (0..).zip(self.model.tracks()) {
            let row = |o: &Observation| [point, self.row_of(o.image) as u32, o.keypoint];
            all.extend(track.observations.iter().map(row));
        }
        matrix(python, &all)
    }

    /// Removes points, given by a mask of shape (P,) or by their indices. The arrays of points and
    /// observations become shorter.
    fn remove_points(&mut self, points: &Bound<'_, PyAny>) -> PyResult<()> {
        for index in selection(points, "points", self.points.len())? {
            self.model.delete_track(self.points[index]);
        }
        self.list();
        Ok(())
    }

    /// Removes observations, given by a mask of shape (M,) or by their indices in `observations`.
    /// Points with fewer than two remaining ones are removed.
    fn remove_observations(&mut self, observations: &Bound<'_, PyAny>) -> PyResult<()> {
        let all: Vec<Observation> =
            self.model.tracks().flat_map(|(_, track)| track.observations.iter().copied()).collect();
        for index in selection(observations, "observations", all.len())? {
            self.model.remove_observation(all[index]);
        }
        self.list();
        Ok(())
    }

    /// Removes images, given by a mask of shape (N,) or by their indices, with their observations.
    /// Points with fewer than two remaining ones are removed.
    fn remove_images(&mut self, images: &Bound<'_, PyAny>) -> PyResult<()> {
        for index in selection(images, "images", self.images.len())? {
            self.model.deregister(self.images[index]);
        }
        self.list();
        Ok(())
    }

    /// The rigs of several cameras: a list of dictionaries with `cameras`, the indices of their
    /// cameras, and `cam_from_rig`, an array of shape (S, 3, 4).
    #[getter]
    fn rigs<'py>(&self, python: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let rig = |rig: &tiepoint_scene::Rig| {
            let all = PyDict::new(python);
            let cameras = rig.sensors.iter().map(|sensor| sensor.camera.0);
            let known = rig
                .sensors
                .iter()
                .map(|sensor| sensor.cam_from_rig.unwrap_or_else(Rigid3::identity));
            all.set_item("cameras", cameras.collect::<Vec<u32>>())?;
            all.set_item("cam_from_rig", poses(python, &known.collect::<Vec<_>>()))?;
            Ok(all)
        };
        self.model.rigs.iter().map(rig).collect()
    }

    /// The frames of the rigs: a list of dictionaries with `rig`, its index; `rig_from_world`, of
    /// shape (3, 4); and `images`, the indices of the images.
    #[getter]
    fn frames<'py>(&self, python: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let frame = |frame: &tiepoint_scene::Frame| {
            let all = PyDict::new(python);
            let images: Vec<usize> = frame.images.iter().map(|id| self.row_of(*id)).collect();
            all.set_item("rig", frame.rig.0)?;
            all.set_item("rig_from_world", pose(python, &frame.rig_from_world))?;
            all.set_item("images", images)?;
            Ok(all)
        };
        self.model.frames.iter().map(frame).collect()
    }

    /// Readout time of each camera in seconds, from the first to the last row, of shape (C,); 0 for
    /// a global shutter, and for models that are in no workspace.
    #[getter]
    fn readout_times<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let mut times = vec![0.0; self.model.num_cameras()];
        for shutter in &self.shutters {
            times[shutter.camera.index()] = shutter.readout_s;
        }
        Ok(vector(python, times))
    }

    /// Rolling shutters: cam_from_world at the centres of the first and of the last row of each
    /// image, of shape (N, 2, 3, 4). An image whose motion is not known has its one pose twice.
    #[getter]
    fn row_poses<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray4<f64>>> {
        let motions = row_poses(&self.model, &self.shutters);
        let mut all = Array4::zeros((self.images.len(), 2, 3, 4));
        for (index, (id, _, middle)) in self.model.registered().enumerate() {
            let rows = motions.get(&id).map_or([*middle; 2], |rows| {
                [0.5, rows.height_px - 0.5].map(|y_px| rows.cam_from_world(middle, y_px))
            });
            for (which, pose) in rows.iter().enumerate() {
                let matrix = pose.to_matrix();
                for (row, column) in (0..3).flat_map(|row| (0..4).map(move |at| (row, at))) {
                    all[(index, which, row, column)] = matrix[(row, column)];
                }
            }
        }
        Ok(all.into_pyarray(python))
    }

    /// Rolling shutters: velocity of each image's centre in the world, in units of the model a
    /// second, and angular velocity in the camera, in radians a second (that of cam_from_world), of
    /// shape (N, 6); NaN where the motion is not known.
    #[getter]
    fn row_velocities<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let motions = row_poses(&self.model, &self.shutters);
        let of_image = |id: &ImageId| {
            motions.get(id).map_or([f64::NAN; 6], |rows| {
                let (v, w) = (rows.velocity_in_world, rows.angular_velocity_rad_s);
                [v.x, v.y, v.z, w.x, w.y, w.z]
            })
        };
        Ok(matrix(python, &self.images.iter().map(of_image).collect::<Vec<_>>()))
    }

    /// Applies a similarity, a 4 × 4 matrix [sR t; 0 1] or [sR | t] of shape (3, 4).
    fn transform(&mut self, new_from_old: &Bound<'_, PyAny>) -> PyResult<()> {
        const SHAPE: &str = "(4, 4) or (3, 4)";
        let array = numbers::<Ix2>(new_from_old, "new_from_old", SHAPE)?;
        let array = array.as_array();
        if ![(3, 4), (4, 4)].contains(&array.dim()) {
            return Err(invalid_array(new_from_old, "new_from_old", "numbers", SHAPE));
        }
        let mut matrix = Matrix4::identity();
        for ((row, column), value) in array.indexed_iter() {
            matrix[(row, column)] = *value;
        }
        let linear = matrix.fixed_view::<3, 3>(0, 0).into_owned();
        let scale = linear.determinant().cbrt();
        let rotation = linear / scale;
        let translation: Vector3<f64> = matrix.fixed_view::<3, 1>(0, 3).into_owned();
        let is_last_row = (0..4).all(|at| matrix[(3, at)] == f64::from(u8::from(at == 3)));
        let is_finite = translation.iter().all(|value| value.is_finite());
        if !(scale > 0.0 && is_rotation(&rotation) && is_last_row && is_finite) {
            return Err(invalid("new_from_old must be a similarity [sR t; 0 1] with s > 0"));
        }
        let rotation = UnitQuaternion::from_matrix(&rotation);
        let mut moved = self.model.clone();
        moved.transform(&Sim3 { scale, rotation, translation });
        moved.validate().map_err(failed)?;
        self.model = moved;
        Ok(())
    }

    fn __repr__(&self) -> String {
        format!(
            "Reconstruction({} images, {} cameras, {} points, {} observations)",
            self.images.len(),
            self.model.num_cameras(),
            self.points.len(),
            self.model.num_observations()
        )
    }
}
