//! `stereo_fusion`: one cloud of the depth maps of a dense workspace, whoever made them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tiepoint_pipeline::Error;
use tiepoint_pipeline::dense::fusion::{FusedPoint, FusionImage, FusionOptions, fuse};
use tiepoint_pipeline::dense::stereo::DepthMap;
use tiepoint_pipeline::dense::{
    Error as DenseError, PosedPinhole, StereoProblem, neighbours, select_views,
};
use tiepoint_pipeline::input::ImageFolder;
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::io::dense::{DenseMap, FusedPly, FusedVisibility};
use tiepoint_pipeline::sfm::scene::{ImageId, Reconstruction};
use tiepoint_pipeline::stages::DenseOptions;
use tiepoint_pipeline::store::{
    Error as StoreError, Mark, OutputFolder, Replace, disk, may_be_replaced,
};
use tiepoint_pipeline::workspace::{DenseNames, MapKind, model_files, refuse_workspace};

use super::dense_lists::read_fused;
use super::patch_match::SPARSE;

/// The first line of any PLY file, for the files that are known as this program's: COLMAP's clouds
/// have no comment.
const PLY: Mark = Mark::Start("ply");

/// Options of [`fuse_depth_maps`].
#[derive(Clone, Debug)]
pub struct FuseOptions {
    /// The depth maps to fuse.
    pub kind: MapKind,
    /// When depths agree.
    pub fusion: FusionOptions,
    /// Folder of masks, `left/1.jpg.png` for `left/1.jpg`; pixels where a mask is 0 give no point.
    pub masks: Option<PathBuf>,
    /// Smallest and largest coordinates of a point; others are left out.
    pub bounds: Option<[[f32; 3]; 2]>,
    /// Largest width and height of the depth maps, in pixels.
    pub max_image_size: Option<u32>,
    /// Whether existing files are replaced, whoever made them.
    pub overwrite: bool,
}

/// Result of [`fuse_depth_maps`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FusedDepthMaps {
    /// Number of points.
    pub points: u64,
    /// Number of depth maps.
    pub depth_maps: usize,
    /// Listed images that have no depth map.
    pub without_depth_map: Vec<String>,
}

/// Fuses the depth maps of the images in `stereo/fusion.cfg` into a PLY file, with the images that
/// see each point in a file `*.vis` beside it. Normals are those of the depth maps. Points have a
/// confidence if all depth maps have one, as those of this program.
///
/// # Errors
///
/// A file of the dense workspace cannot be read or does not fit the others; there is no depth map;
/// a depth map is larger than `max_image_size`; a file of another program is where the cloud shall
/// be; writing fails.
pub fn fuse_depth_maps(
    workspace: &Path,
    output: &Path,
    options: &FuseOptions,
) -> Result<FusedDepthMaps, Error> {
    let model = read_model(&workspace.join(SPARSE))?;
    let maps = Maps::find(workspace, &model, options)?;
    let (to, name) = (disk::folder_of(output), output.file_name().unwrap_or_default());
    let Some(name) = name.to_str().filter(|name| !name.is_empty()) else {
        let what = "is no name of a PLY file: give one, such as fused.ply";
        return Err(Error::Colmap { path: output.to_owned(), what: what.to_owned() });
    };
    refuse_workspace(to)?;
    let mut folder = OutputFolder::open(to)?;
    folder.protect(maps.files().iter().map(PathBuf::as_path));
    let names = [format!("{name}.vis"), name.to_owned()];
    if options.overwrite {
        folder.may_replace(&names);
    }
    // The user named it, and can permit that it is replaced.
    let named = |path| StoreError::NamedFile { path };
    folder.ensure_writable(names.iter().map(String::as_str)).map_err(|error| match error {
        StoreError::ForeignFile { path } => named(path),
        other => other,
    })?;
    // This program's other results, such as a model, may be in the folder, too.
    if !(options.overwrite || may_be_replaced(output, Replace::Marked(PLY))?) {
        return Err(named(output.to_owned()).into());
    }
    let mut visibility = FusedVisibility::create(&folder.stage(&names[0])?)?;
    let mut ply = FusedPly::create(&folder.stage(&names[1])?, maps.have_confidences)?;
    let take = |point: FusedPoint| -> Result<(), Error> {
        if is_within(point.xyz, options.bounds) {
            ply.push(point.xyz, point.normal, point.color, point.confidence)?;
            let views: Vec<u32> =
                point.views.iter().map(|view| maps.images[*view as usize].place).collect();
            visibility.push(&views)?;
        }
        Ok(())
    };
    fuse(&maps.neighbours(&model), &options.fusion, |index| maps.load(index), take)?;
    visibility.finish()?;
    let points = ply.finish()?;
    folder.publish(&names, &[])?;
    let Maps { images, without_depth_map, .. } = maps;
    Ok(FusedDepthMaps { points, depth_maps: images.len(), without_depth_map })
}

/// Whether a point is finite, which depths of a damaged file are not, and in the box.
fn is_within(xyz: [f32; 3], bounds: Option<[[f32; 3]; 2]>) -> bool {
    let [min, max] = bounds.unwrap_or([[f32::MIN; 3], [f32::MAX; 3]]);
    (0..3).all(|axis| (min[axis]..=max[axis]).contains(&xyz[axis]))
}

/// An image with a depth map.
struct MappedImage {
    name: String,
    /// Its place among the images of the model, which `*.vis` names it by.
    place: u32,
    id: ImageId,
    camera: PosedPinhole,
    /// Its place in [`Maps::photos`].
    photo: usize,
}

/// The depth maps of a dense workspace.
struct Maps<'a> {
    workspace: &'a Path,
    options: &'a FuseOptions,
    names: DenseNames,
    images: Vec<MappedImage>,
    photos: ImageFolder,
    /// Whether all depth maps have confidences.
    have_confidences: bool,
    without_depth_map: Vec<String>,
}

impl<'a> Maps<'a> {
    /// Looks for the depth maps of the listed images.
    fn find(
        workspace: &'a Path,
        model: &Reconstruction,
        options: &'a FuseOptions,
    ) -> Result<Self, Error> {
        let registered: Vec<_> = model.registered().collect();
        let index_of = registered.iter().enumerate();
        let index_of: BTreeMap<&str, usize> =
            index_of.map(|(index, (_, image, _))| (image.name.as_str(), index)).collect();
        let listed = read_fused(&workspace.join("stereo/fusion.cfg"), &index_of)?;
        let names = DenseNames::new(options.kind);
        let has_file = |name: &str| workspace.join(name).is_file();
        let (found, without): (Vec<usize>, Vec<usize>) = listed
            .into_iter()
            .partition(|index| has_file(&names.depths(&registered[*index].1.name)));
        if found.is_empty() {
            let path = workspace.join("stereo/depth_maps");
            let suffix = options.kind.suffix();
            let what = format!(
                "has no *{suffix} of an image in stereo/fusion.cfg: run patch_match_stereo first, \
                 or give the other --input_type of geometric and photometric"
            );
            return Err(Error::Colmap { path, what });
        }
        let folder = workspace.join("images");
        let of_found = found.iter().map(|index| registered[*index].1.name.as_str());
        let photos = ImageFolder::of_names(&folder, of_found, options.masks.as_deref())?
            .with_stored_pixels()
            .with_max_pixels(u64::MAX);
        let photo_of: BTreeMap<&str, usize> =
            (0..).zip(photos.images()).map(|(at, image)| (image.name.as_str(), at)).collect();
        let mut images = Vec::new();
        for index in found {
            let (id, image, pose) = registered[index];
            let camera = model.camera_of(id);
            let photo = photo_of[image.name.as_str()];
            let Some(pinhole) = PosedPinhole::new(camera, pose) else {
                let model = camera.intrinsics.kind().name();
                let cause = DenseError::Distorted { image: image.name.clone(), model };
                return Err(Error::Dense { path: photos.path(photo).to_owned(), cause });
            };
            photos.check_size(photo, camera.width, camera.height)?;
            photos.check_mask(photo)?;
            let (name, place) = (image.name.clone(), index as u32);
            images.push(MappedImage { name, place, id, camera: pinhole, photo });
        }
        let have_confidences = images.iter().all(|image| has_file(&names.confidences(&image.name)));
        let name = |index: &usize| registered[*index].1.name.clone();
        let without_depth_map = without.iter().map(name).collect();
        drop(photo_of);
        Ok(Self { workspace, options, names, images, photos, have_confidences, without_depth_map })
    }

    /// The files that are read.
    fn files(&self) -> Vec<PathBuf> {
        let of_image = |image: &MappedImage| {
            let maps = [self.names.depths(&image.name), self.names.confidences(&image.name)];
            let maps = maps.map(|name| self.workspace.join(name));
            let mask = self.photos.mask_path(image.photo).map(Path::to_owned);
            maps.into_iter().chain([self.photos.path(image.photo).to_owned()]).chain(mask)
        };
        let lists = ["stereo/fusion.cfg", "stereo/patch-match.cfg"];
        self.images
            .iter()
            .flat_map(of_image)
            .chain(model_files(&self.workspace.join(SPARSE)))
            .chain(lists.map(|name| self.workspace.join(name)))
            .collect()
    }

    /// The images that may see the surfaces of each image, as for depth maps.
    fn neighbours(&self, model: &Reconstruction) -> Vec<Vec<usize>> {
        let place_of: BTreeMap<ImageId, usize> =
            self.images.iter().enumerate().map(|(index, image)| (image.id, index)).collect();
        let all = select_views(model, DenseOptions::default().sources);
        let problem = |(index, image): (usize, &MappedImage)| {
            let sources = all[image.place as usize].sources.iter();
            let sources = sources.filter_map(|source| place_of.get(source).copied());
            StereoProblem {
                image: ImageId::from_index(index),
                sources: sources.map(ImageId::from_index).collect(),
                seeds: Vec::new(),
            }
        };
        neighbours(&self.images.iter().enumerate().map(problem).collect::<Vec<_>>())
    }

    /// An image at the size of its depth map.
    fn load(&self, index: usize) -> Result<FusionImage, Error> {
        let image = &self.images[index];
        let path = self.workspace.join(self.names.depths(&image.name));
        let broken = |what: String| Error::Colmap { path: path.clone(), what };
        let DenseMap { width, height, channels, mut values } = DenseMap::read(&path)?;
        if channels != 1 {
            return Err(broken(format!("has {channels} channels, and a depth map has one")));
        }
        let camera = &image.camera;
        // Programs round the sides of a smaller map.
        let is_scaled = width > 0
            && (height as f64 - (camera.height * width) as f64 / camera.width as f64).abs() <= 1.0;
        if !is_scaled {
            return Err(broken(format!(
                "has {width} × {height} pixels, and its image {} × {}, which is another shape: \
                 run patch_match_stereo again",
                camera.width, camera.height
            )));
        }
        if let Some(most) = self.options.max_image_size
            && width.max(height) > most as usize
        {
            return Err(broken(format!(
                "has {width} × {height} pixels, more than --StereoFusion.max_image_size {most}, \
                 and tiepoint fuses depth maps as they are: give \
                 --PatchMatchStereo.max_image_size {most} to patch_match_stereo"
            )));
        }
        // The pixel of the image at the centre of that of the map.
        let at = |index: usize| {
            let scaled = |pixel: usize, from: usize, to: usize| {
                (((pixel as f64 + 0.5) * to as f64 / from as f64) as usize).min(to - 1)
            };
            let (x, y) = (index % width, index / width);
            scaled(y, height, camera.height) * camera.width + scaled(x, width, camera.width)
        };
        let mask = match self.options.masks {
            Some(_) => self.photos.mask(image.photo)?,
            None => None,
        };
        for (index, depth) in values.iter_mut().enumerate() {
            let is_used = mask.as_ref().is_none_or(|mask| mask.data[at(index)] > 0);
            if !(is_used && depth.is_finite() && *depth > 0.0) {
                *depth = 0.0;
            }
        }
        let rgb =
            self.photos.rgb_of_size(image.photo, camera.width as u32, camera.height as u32)?;
        let colors = (0..width * height).flat_map(|index| rgb.data.as_chunks::<3>().0[at(index)]);
        let colors = colors.collect();
        let confidences = match self.have_confidences {
            true => {
                DenseMap::read(&self.workspace.join(self.names.confidences(&image.name)))?.values
            }
            // Not written.
            false => vec![0.5; width * height],
        };
        let depths = DepthMap { width, height, depths: values, confidences };
        FusionImage::new(resized(camera, width, height), depths, colors)
            .map_err(|cause| Error::Dense { path, cause })
    }
}

/// The camera of an image of another size.
fn resized(camera: &PosedPinhole, width: usize, height: usize) -> PosedPinhole {
    let scale = [width as f64 / camera.width as f64, height as f64 / camera.height as f64];
    PosedPinhole {
        width,
        height,
        focal: [0, 1].map(|axis| scale[axis] * camera.focal[axis]),
        centre: [0, 1].map(|axis| scale[axis] * camera.centre[axis]),
        ..camera.clone()
    }
}
