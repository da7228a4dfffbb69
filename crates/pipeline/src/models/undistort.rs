//! Undistorted images, masks and model, for programs that take PINHOLE cameras only: trainers of
//! Gaussian splats, and COLMAP's dense stereo.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tiepoint_dense::undistort::{
    UndistortOptions, Undistortion, is_too_wide_for_pinhole, undistort_model,
};
use tiepoint_input::parallel::{budget_bytes, for_each_within_budget};
use tiepoint_input::{Exif, Luma};
use tiepoint_io::colmap::Format;
use tiepoint_sfm::scene::{Image, Reconstruction};
use tiepoint_store::{OutputFolder, disk};

use crate::models::rolling_shutter::detected_keypoints;
use crate::workspace::folder::refuse_workspace;
use crate::workspace::format::path_text;
use crate::workspace::located_model::LocatedModel;
use crate::workspace::model_output::{model_names, refuse_shadow, stage_model};
use crate::workspace::model_photos::{ModelPhotos, decoder_bytes, undistorted_mask};
use crate::{Error, Event, Watch, emit};

/// Folders that COLMAP's `patch_match_stereo` writes into and does not create.
const STEREO_FOLDERS: [&str; 3] =
    ["stereo/depth_maps", "stereo/normal_maps", "stereo/consistency_graphs"];

/// The places of the files in the output folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UndistortLayout {
    /// `images`, `masks` and `sparse/0`, as trainers of Gaussian splats read them.
    #[default]
    Splats,
    /// `images`, `masks`, `sparse`, in `stereo` the lists of COLMAP's `patch_match_stereo` and
    /// `stereo_fusion`, and scripts: the output of COLMAP's `image_undistorter`. Photos are taken
    /// as they are stored, whatever the EXIF orientation says.
    Colmap,
}

impl UndistortLayout {
    /// The folder of the model.
    fn sparse(self) -> &'static str {
        match self {
            Self::Splats => "sparse/0",
            Self::Colmap => "sparse",
        }
    }
}

/// Options of [`undistort`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UndistortFolderOptions {
    /// The size of the undistorted images.
    pub camera: UndistortOptions,
    /// The folder that the names of the images begin in; by default the photos are those of the
    /// workspace.
    pub images: Option<PathBuf>,
    /// Folder of masks: the mask of `left/1.jpg` is `left/1.jpg.png`, `left/1.jpg` or `left/1.png`
    /// in it.
    pub masks: Option<PathBuf>,
    /// Also writes the images at these fractions of the size: 2 gives `images_2` of half the size.
    pub downscale: Vec<u32>,
    /// Whether the keypoints are those that were detected in the photos. By default they are those
    /// of the model, which for rolling shutters are where a global shutter would have seen them.
    pub has_detected_keypoints: bool,
    /// The places of the files.
    pub layout: UndistortLayout,
}

/// Summary of [`undistort`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Undistorted {
    /// The output folder.
    #[serde(serialize_with = "path_text")]
    pub path: PathBuf,
    /// Number of images.
    pub images: usize,
    /// Number of cameras.
    pub cameras: usize,
    /// Number of points.
    pub points: usize,
    /// Number of observations of the points that the undistorted images do not show.
    pub observations_lost: usize,
}

/// Writes the undistorted images of a model with their names, their masks, and the model with
/// PINHOLE cameras and undistorted keypoints. Images without a pose are left out. Masks are written
/// if there are any; they are 0 also where a pixel has no source.
///
/// Files of an earlier run in the same folder are replaced, and removed if they have no successor.
///
/// # Errors
///
/// A camera has no PINHOLE camera, a photo or mask is missing or has another size, an option is out
/// of its range, a file of the output is not this program's, or writing fails.
pub fn undistort(
    from: &LocatedModel,
    to: &Path,
    options: &UndistortFolderOptions,
    watch: Watch,
) -> Result<Undistorted, Error> {
    let model = match options.has_detected_keypoints {
        true => detected_keypoints(from)?,
        false => from.reconstruction.clone(),
    };
    let dense_error = |cause| Error::Dense { path: from.folder().to_owned(), cause };
    options.camera.validate().map_err(dense_error)?;
    for (_, image, _) in model.registered() {
        if is_too_wide_for_pinhole(model.camera(image.camera)) {
            return Err(Error::TooWide { image: image.name.clone() });
        }
    }
    let masks = options.masks.as_deref();
    let photos = match &options.images {
        Some(images) => ModelPhotos::below(images, &model, masks)?,
        None => ModelPhotos::of_workspace(from, masks)?,
    };
    // COLMAP does not turn photos, so that the cameras of its models have the stored size.
    let is_stored = options.layout == UndistortLayout::Colmap;
    let photos = if is_stored { photos.with_stored_pixels() } else { photos };
    // First of all, as the size of a camera decides how long its undistortion takes.
    photos.check_sizes(&model)?;
    refuse_workspace(to)?;
    refuse_shadow(from.folder(), to)?;
    let undistorted = undistort_model(&model, &options.camera).map_err(dense_error)?;
    let mut output = OutputFolder::open(to)?;
    let inputs = from.files();
    output.protect(inputs.iter().map(PathBuf::as_path).chain(photos.files(&model)));
    let images: Vec<&Image> = model.registered().map(|(_, image, _)| image).collect();
    let task = Task { model: &model, undistorted: &undistorted, photos: &photos, options };
    let mut names: Vec<String> = images.iter().flat_map(|image| task.names(&image.name)).collect();
    let lists = task.lists(&images);
    names.extend(lists.iter().map(|(name, _)| (*name).to_owned()));
    let sparse = options.layout.sparse();
    let of_model = model_names(Some(sparse));
    output.ensure_writable(names.iter().chain(&of_model).map(String::as_str))?;
    let mut done = 0;
    for_each_within_budget(
        budget_bytes(),
        // The photo and its undistorted copy.
        |image| 2 * decoder_bytes(model.camera(image.camera)),
        &images,
        |image| task.write(image, &output),
        |image, written| {
            written?;
            done += 1;
            let (image, total) = (image.name.as_str(), images.len());
            emit(watch, &Event::ImageUndistorted { image, done, total })
        },
    )?;
    for (name, text) in &lists {
        output.stage_bytes(name, text.as_bytes())?;
    }
    names.extend(stage_model(&output, Some(sparse), &undistorted, Format::Binary)?);
    let is_left = |name: &&str| is_result(name, sparse) && !names.iter().any(|new| new == name);
    let removed: Vec<String> = output.names().filter(is_left).map(str::to_owned).collect();
    output.publish(&names, &removed)?;
    if options.layout == UndistortLayout::Colmap {
        for folder in STEREO_FOLDERS.map(|name| to.join(name)) {
            disk::create_folders(&folder).map_err(Error::output(&folder))?;
        }
    }
    let observations =
        |model: &Reconstruction| model.tracks().map(|(_, track)| track.observations.len()).sum();
    let (before, after): (usize, usize) = (observations(&model), observations(&undistorted));
    Ok(Undistorted {
        path: to.to_owned(),
        images: images.len(),
        cameras: undistorted.num_cameras(),
        points: undistorted.num_tracks(),
        observations_lost: before - after,
    })
}

/// Whether a file of the output folder may be the result of an earlier run.
fn is_result(name: &str, sparse: &str) -> bool {
    let top = name.split('/').next().unwrap_or_default();
    let kind = top.split('_').next().unwrap_or_default();
    ["images", "masks"].contains(&kind) || model_names(Some(sparse)).iter().any(|own| own == name)
}

/// The images of a model to undistort.
struct Task<'a> {
    model: &'a Reconstruction,
    undistorted: &'a Reconstruction,
    photos: &'a ModelPhotos,
    options: &'a UndistortFolderOptions,
}

impl Task<'_> {
    /// The factors of the sizes, 1 first.
    fn factors(&self) -> impl Iterator<Item = u32> {
        let smaller = self.options.downscale.iter().copied().filter(|factor| *factor > 1);
        BTreeSet::from_iter(smaller.chain([1])).into_iter()
    }

    /// The names of the files of an image.
    fn names(&self, image: &str) -> Vec<String> {
        let has_masks = self.options.masks.is_some();
        let of_factor = |factor| {
            let mask = has_masks.then(|| mask_name(image, factor));
            mask.into_iter().chain([image_name(image, factor)])
        };
        self.factors().flat_map(of_factor).collect()
    }

    /// Writes the staged files of an image.
    fn write(&self, image: &Image, output: &OutputFolder) -> Result<(), Error> {
        let (from, to) = (self.model.camera(image.camera), self.undistorted.camera(image.camera));
        let undistortion = Undistortion::new(from, to);
        let photo = self.photos.path(&image.name);
        let target = |factor| output.stage(&image_name(&image.name, factor));
        // A photo without distortion stays as it is, unless it has to be rotated.
        let is_upright =
            self.options.layout == UndistortLayout::Colmap || Exif::read(photo)?.orientation == 1;
        let is_copied = undistortion.is_identity() && is_upright;
        if is_copied {
            disk::copy_new(photo, &target(1)?).map_err(Error::output(&target(1)?))?;
        }
        if !is_copied || self.factors().count() > 1 {
            let rgb = self.photos.undistorted(&image.name, &undistortion)?;
            for factor in self.factors().skip(usize::from(is_copied)) {
                rgb.reduced(factor).write(&target(factor)?)?;
            }
        }
        if self.options.masks.is_none() {
            return Ok(());
        }
        let mask = self.photos.mask(&image.name)?;
        let mask = undistorted_mask(photo, mask.as_ref(), &undistortion)?;
        for factor in self.factors() {
            let Luma { width, height, mut data } = mask.reduced(factor);
            // A pixel is used if all that it covers is used.
            data.iter_mut().filter(|value| **value != u8::MAX).for_each(|value| *value = 0);
            let target = output.stage(&mask_name(&image.name, factor))?;
            Luma { width, height, data }.write(&target)?;
        }
        Ok(())
    }

    /// The names and texts of the lists in COLMAP's layout.
    fn lists(&self, images: &[&Image]) -> Vec<(&'static str, String)> {
        if self.options.layout == UndistortLayout::Splats {
            return Vec::new();
        }
        let lines = |after: &str| -> String {
            images.iter().map(|image| format!("{}\n{after}", image.name)).collect()
        };
        // The sources of an image are chosen by `patch_match_stereo`, 20 of them.
        vec![
            ("stereo/patch-match.cfg", lines("__auto__, 20\n")),
            ("stereo/fusion.cfg", lines("")),
            ("run-colmap-geometric.sh", script("geometric", true)),
            ("run-colmap-photometric.sh", script("photometric", false)),
        ]
    }
}

/// A script that goes on with COLMAP's dense stereo.
fn script(input: &str, is_geometric: bool) -> String {
    format!(
        "# Set COLMAP_EXE_PATH to the folder of COLMAP's program.\n\
        \"$COLMAP_EXE_PATH/colmap\" patch_match_stereo --workspace_path . --workspace_format \
        COLMAP --PatchMatchStereo.max_image_size 2000 --PatchMatchStereo.geom_consistency \
        {is_geometric}\n\
        \"$COLMAP_EXE_PATH/colmap\" stereo_fusion --workspace_path . --workspace_format COLMAP \
        --input_type {input} --output_path ./fused.ply\n\
        \"$COLMAP_EXE_PATH/colmap\" poisson_mesher --input_path ./fused.ply --output_path \
        ./meshed-poisson.ply\n\
        \"$COLMAP_EXE_PATH/colmap\" delaunay_mesher --input_path . --input_type dense \
        --output_path ./meshed-delaunay.ply\n"
    )
}

/// A folder of images or masks of a size.
fn folder_name(kind: &str, factor: u32) -> String {
    if factor == 1 { kind.to_owned() } else { format!("{kind}_{factor}") }
}

fn image_name(image: &str, factor: u32) -> String {
    format!("{}/{image}", folder_name("images", factor))
}

fn mask_name(image: &str, factor: u32) -> String {
    format!("{}/{image}.png", folder_name("masks", factor))
}
