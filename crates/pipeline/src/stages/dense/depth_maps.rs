//! Depth maps of the images of a dense workspace, as files: planes at half resolution from the
//! photos alone, then depths at full resolution that agree with the planes of other images. At most
//! one image and its sources are in memory.

use std::path::PathBuf;

use tiepoint_dense::stereo::{
    DepthMap, FineEstimate, FineSource, MAX_SOURCES, PlaneMap, StereoImage, estimate_coarse,
    estimate_fine, normals_of,
};
use tiepoint_dense::undistort::{UndistortOptions, Undistortion, undistort_model};
use tiepoint_dense::{Grey, PixelPoses, PosedPinhole, StereoProblem, select_views};
use tiepoint_input::Luma;
use tiepoint_io::dense::DenseMap;
use tiepoint_sfm::geometry::RowPoses;
use tiepoint_sfm::scene::{Camera, ImageId, Reconstruction};
use tiepoint_store::OutputFolder;

use crate::Error;
use crate::workspace::dense_names::DenseNames;
use crate::workspace::model_photos::ModelPhotos;

/// Channels of a file of planes: inverse depth, its two derivatives, and the cost.
const PLANE_CHANNELS: usize = 4;

/// The images of a model whose depth maps are estimated, and the files of their results.
pub struct DepthMaps<'a> {
    pub(super) folder: &'a mut OutputFolder,
    pub(super) names: DenseNames,
    /// Registered images with PINHOLE cameras, of the size of the depth maps.
    pub(super) model: Reconstruction,
    /// One for each image of the model, in order.
    pub(super) problems: Vec<StereoProblem>,
    /// The motion of each photo during its exposure, and its camera; `None` where it is not known,
    /// as without a rolling shutter.
    pub(super) rows: Vec<Option<(RowPoses, Camera)>>,
    /// `None` if the images have the size of the depth maps.
    images: Option<SizedImages>,
}

/// Images of any size, with the cameras of that size in order.
struct SizedImages {
    photos: ModelPhotos,
    cameras: Vec<Camera>,
}

impl<'a> DepthMaps<'a> {
    /// Of images that this program undistorts into the folder.
    pub(super) fn new(
        folder: &'a mut OutputFolder,
        names: DenseNames,
        model: Reconstruction,
        problems: Vec<StereoProblem>,
    ) -> Self {
        let rows = vec![None; problems.len()];
        Self { folder, names, model, problems, rows, images: None }
    }

    /// Of the images in `images` of a dense workspace, whoever undistorted them. `model` is theirs.
    /// Depth maps are at most `max_image_size` pixels wide and high.
    ///
    /// # Errors
    ///
    /// A camera of the model is no PINHOLE or SIMPLE_PINHOLE one; an image is missing or has not
    /// the size of its camera; `max_image_size` is 0.
    pub fn of_images(
        folder: &'a mut OutputFolder,
        names: DenseNames,
        model: &Reconstruction,
        max_image_size: Option<u32>,
    ) -> Result<Self, Error> {
        let images = folder.path().join(names.file("images"));
        for (id, image, pose) in model.registered() {
            let camera = model.camera_of(id);
            if PosedPinhole::new(camera, pose).is_none() {
                return Err(distorted(images.join(&image.name), &image.name, camera));
            }
        }
        let photos = ModelPhotos::below(&images, model, None)?.with_stored_pixels();
        photos.check_sizes(model)?;
        let cameras = model.registered().map(|(id, ..)| *model.camera_of(id)).collect();
        let options = UndistortOptions { max_image_size, ..UndistortOptions::default() };
        let sized = undistort_model(model, &options)
            .map_err(|cause| Error::Dense { path: images, cause })?;
        let problems = select_views(&sized, MAX_SOURCES);
        let images = Some(SizedImages { photos, cameras });
        Ok(Self { images, ..Self::new(folder, names, sized, problems) })
    }

    /// The output folder.
    pub fn folder(&mut self) -> &mut OutputFolder {
        self.folder
    }

    /// Number of images.
    pub fn count(&self) -> usize {
        self.problems.len()
    }

    /// The name of an image.
    pub fn name(&self, index: usize) -> &str {
        &self.model.image(ImageId::from_index(index)).name
    }

    /// The indices of the source images of an image, the best first.
    pub fn sources(&self, index: usize) -> Vec<usize> {
        self.problems[index].sources.iter().map(|image| image.index()).collect()
    }

    /// Sets the source images of an image, the best first; [`MAX_SOURCES`] of them count.
    pub fn set_sources(&mut self, index: usize, sources: impl IntoIterator<Item = usize>) {
        let sources = sources.into_iter().take(MAX_SOURCES).map(ImageId::from_index);
        self.problems[index].sources = sources.collect();
    }

    /// Whether an image has a source and a point of the model, without which it has no depth map.
    pub fn has_problem(&self, index: usize) -> bool {
        let StereoProblem { sources, seeds, .. } = &self.problems[index];
        !(sources.is_empty() || seeds.is_empty())
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Whether a file has still to be made.
    pub(super) fn is_missing(&self, name: &str) -> Result<bool, Error> {
        Ok(!self.folder.is_unmodified(name)?)
    }

    /// Whether the planes of an image are there.
    ///
    /// # Errors
    ///
    /// A file cannot be read.
    pub fn has_planes(&self, index: usize) -> Result<bool, Error> {
        Ok(!self.is_missing(&self.names.planes(self.name(index)))?)
    }

    /// The names of the files of a depth map, that of the depths last.
    pub fn depth_files(&self, index: usize, with_normals: bool) -> Vec<String> {
        let name = self.name(index);
        let normals = with_normals.then(|| self.names.normals(name));
        normals.into_iter().chain([self.names.confidences(name), self.names.depths(name)]).collect()
    }

    /// Whether these files are there, as this program wrote them.
    ///
    /// # Errors
    ///
    /// A file cannot be read.
    pub fn have_files(&self, names: &[String]) -> Result<bool, Error> {
        for name in names {
            if self.is_missing(name)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    pub(super) fn camera(&self, index: usize) -> Result<PosedPinhole, Error> {
        let id = ImageId::from_index(index);
        let (camera, image) = (self.model.camera_of(id), self.model.image(id));
        let pinhole = image
            .cam_from_world()
            .and_then(|cam_from_world| PosedPinhole::new(camera, cam_from_world));
        let mut pinhole = pinhole.ok_or_else(|| {
            distorted(self.path(&self.names.image(&image.name)), &image.name, camera)
        })?;
        pinhole.rows = self.rows[index]
            .map(|(rows, photo)| PixelPoses::new(rows, &Undistortion::new(&photo, camera)));
        Ok(pinhole)
    }

    /// An image of the size of its depth map. It is read from its file also in the run that wrote
    /// it, so that an interrupted run gives the same results.
    fn view(&self, index: usize) -> Result<StereoImage, Error> {
        let camera = self.camera(index)?;
        let path = self.path(&self.names.image(self.name(index)));
        let Luma { width, height, data } = match &self.images {
            None => Luma::read(&path)?,
            Some(SizedImages { photos, cameras }) => {
                let to = self.model.camera_of(ImageId::from_index(index));
                let undistortion = Undistortion::new(&cameras[index], to);
                photos.undistorted_grey(self.name(index), &undistortion)?
            }
        };
        let grey = Grey { width: width as usize, height: height as usize, pixels: data };
        if (grey.width, grey.height) != (camera.width, camera.height) {
            let (width, height) = (camera.width as u32, camera.height as u32);
            let cause = tiepoint_dense::Error::Size { width, height, found: grey.pixels.len() };
            return Err(Error::Dense { path, cause });
        }
        Ok(StereoImage { camera, grey })
    }

    /// Estimates the planes of an image, and publishes them.
    ///
    /// # Errors
    ///
    /// An image cannot be read or has another size, or writing fails.
    pub fn estimate_planes(&mut self, index: usize) -> Result<(), Error> {
        let reference = self.view(index)?;
        let sources: Vec<StereoImage> = self
            .sources(index)
            .into_iter()
            .map(|source| self.view(source))
            .collect::<Result<_, _>>()?;
        let sources: Vec<&StereoImage> = sources.iter().collect();
        let seeds = &self.problems[index].seeds;
        let map = estimate_coarse(&reference, &sources, seeds, index as u64);
        // An image without a source has no planes.
        let map = map.unwrap_or(PlaneMap { width: 0, height: 0, planes: Vec::new() });
        let count = map.planes.len();
        let mut values = vec![0.0; PLANE_CHANNELS * count];
        for (pixel, plane) in map.planes.iter().enumerate() {
            for (channel, value) in plane.iter().enumerate() {
                values[channel * count + pixel] = *value;
            }
        }
        let PlaneMap { width, height, .. } = map;
        let name = self.names.planes(self.name(index));
        let file = DenseMap { width, height, channels: PLANE_CHANNELS, values };
        file.write(&self.folder.stage(&name)?)?;
        self.publish(&[name])
    }

    fn read_planes(&self, index: usize) -> Result<PlaneMap, Error> {
        let path = self.path(&self.names.planes(self.name(index)));
        let DenseMap { width, height, channels, values } = DenseMap::read(&path)?;
        let count = width * height;
        if channels != PLANE_CHANNELS {
            let what = format!("it has {channels} channels and not {PLANE_CHANNELS}");
            return Err(Error::Broken { path, what });
        }
        let plane = |pixel| std::array::from_fn(|channel| values[channel * count + pixel]);
        Ok(PlaneMap { width, height, planes: (0..count).map(plane).collect() })
    }

    /// The depths of an image, from its planes and those of its sources, which must be there.
    ///
    /// # Errors
    ///
    /// A file cannot be read, or has another size.
    pub fn estimate_depths(&self, index: usize) -> Result<DepthMap, Error> {
        let reference = self.view(index)?;
        let coarse = self.read_planes(index)?;
        let mut sources = Vec::new();
        for source in self.sources(index) {
            let planes = self.read_planes(source)?;
            if !planes.planes.is_empty() {
                sources.push((self.view(source)?, planes));
            }
        }
        let sources: Vec<FineSource> = sources
            .iter()
            .map(|(view, planes)| FineSource { view, planes: planes.clone() })
            .collect();
        let seeds = &self.problems[index].seeds;
        let estimate = match coarse.planes.is_empty() {
            true => None,
            false => estimate_fine(&reference, sources, seeds, &coarse, index as u64),
        };
        let (width, height) = (reference.grey.width, reference.grey.height);
        let none = || DepthMap::empty(width, height);
        Ok(estimate.map_or_else(none, |FineEstimate { depths, .. }| depths))
    }

    /// Writes the staged files of a depth map, [`DepthMaps::depth_files`].
    ///
    /// # Errors
    ///
    /// Writing fails.
    pub fn stage_depths(
        &self,
        index: usize,
        depths: DepthMap,
        with_normals: bool,
    ) -> Result<(), Error> {
        let name = self.name(index);
        if with_normals {
            let normals = normals_of(&depths, &self.camera(index)?);
            let channel = |channel: usize| normals.iter().map(move |normal| normal[channel]);
            let values = (0..3).flat_map(channel).collect();
            let file = DenseMap { width: depths.width, height: depths.height, channels: 3, values };
            file.write(&self.folder.stage(&self.names.normals(name))?)?;
        }
        let DepthMap { width, height, depths, confidences } = depths;
        let maps = [(self.names.confidences(name), confidences), (self.names.depths(name), depths)];
        for (file, values) in maps {
            DenseMap { width, height, channels: 1, values }.write(&self.folder.stage(&file)?)?;
        }
        Ok(())
    }

    /// Publishes staged files.
    ///
    /// # Errors
    ///
    /// A foreign file would be replaced, or writing fails.
    pub fn publish(&mut self, names: &[String]) -> Result<(), Error> {
        self.folder.publish(names, &[])?;
        Ok(())
    }
}

fn distorted(path: PathBuf, image: &str, camera: &Camera) -> Error {
    let model = camera.intrinsics.kind().name();
    let cause = tiepoint_dense::Error::Distorted { image: image.to_owned(), model };
    Error::Dense { path, cause }
}
