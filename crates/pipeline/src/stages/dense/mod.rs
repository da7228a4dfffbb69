//! Stage 4: depth maps and the fused cloud, as a dense workspace of COLMAP in `dense/`.
//!
//! The stage goes through all images three times: it undistorts them, estimates planes at half
//! resolution, and refines these to depth maps; then it fuses the depth maps. Each image is
//! published on its own, so that an interrupted run loses one step of one image. At most one
//! reference image and its sources are in memory.

pub(crate) mod depth_maps;
mod masks;
pub(crate) mod options;

use std::path::{Path, PathBuf};

use tiepoint_dense::fusion::{FusionImage, FusionOptions, fuse};
use tiepoint_dense::stereo::{DepthMap, InverseDepthRange};
use tiepoint_dense::undistort::{UndistortOptions, Undistortion, undistort_model};
use tiepoint_dense::{neighbours, select_views};
use tiepoint_input::images::DepthScale;
use tiepoint_input::{Luma, Rgb};
use tiepoint_io::Error as IoError;
use tiepoint_io::colmap::Format;
use tiepoint_io::dense::{DenseMap, FusedPly, FusedVisibility};
use tiepoint_sfm::geometry::RowPoses;
use tiepoint_sfm::rolling_shutter::row_poses;
use tiepoint_sfm::scene::{Camera, Image, ImageId, Reconstruction};

use self::depth_maps::DepthMaps;
use self::masks::Masks;
use crate::stages::dense::options::DenseOptions;
use crate::stages::option_keys;
use crate::workspace::dense_names::{DenseNames, MapKind};
use crate::workspace::file_names::{DENSE, DENSE_CLOUD, model_path};
use crate::workspace::located_model::LocatedModel;
use crate::workspace::model_output::{model_names, stage_model};
use crate::workspace::model_photos::{check_sizes, photos_of, write_undistorted};
use crate::workspace::records::Recipe;
use crate::workspace::report::DenseReport;
use crate::workspace::stage_run::{StageRequest, StageResult, StageRun};
use crate::{DenseStep, Error, Event, Stage, Watch, Workspace, emit};

const SPARSE: &str = "dense/sparse";
const VISIBILITY: &str = "dense/fused.ply.vis";
/// The images that COLMAP's `patch_match_stereo` and `stereo_fusion` work on.
const STEREO_LIST: &str = "dense/stereo/patch-match.cfg";
const FUSION_LIST: &str = "dense/stereo/fusion.cfg";
/// Scale of the 16-bit depth maps.
const DEPTH_SCALE: &str = "dense/depth_png/scale.json";
/// The files of the images.
const NAMES: DenseNames = DenseNames::OF_WORKSPACE;

/// Estimates the depth maps of the largest model of a workspace and fuses them.
///
/// # Errors
///
/// The workspace has no model; the stage was run with other options, and `redo` does not ask for
/// it; a photo or mask is gone or has another size; no two images share points; a file cannot be
/// read or written; `watch` returns `Break`.
pub fn dense(
    workspace: &mut Workspace,
    options: &DenseOptions,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<(), Error> {
    options.validate()?;
    let mut input = workspace.fingerprint(Stage::Map)?;
    let masks = match &options.masks {
        Some(folder) => Some(Masks::open(&workspace.records, folder)?),
        None => None,
    };
    if let Some(masks) = &masks {
        input = format!("{input} masked by {}", masks.fingerprint);
    }
    let recipe = Recipe::new(input, option_keys::dense_options(options));
    let request = StageRequest { stage: Stage::Dense, recipe, redo, inputs: None };
    workspace.run_stage(request, watch, |run| estimate_and_fuse(run, options, masks))
}

fn estimate_and_fuse(
    stage: &mut StageRun,
    options: &DenseOptions,
    masks: Option<Masks>,
) -> Result<StageResult, Error> {
    let workspace = &mut *stage.workspace;
    let folder = workspace.root().join(model_path(0));
    let located = LocatedModel::open(&folder)?;
    if let Some(what) = located.note() {
        emit(stage.watch, &Event::Noted { what })?;
    }
    let photos = photos_of(&located, None)?;
    let model = &located.reconstruction;
    // Before old results are removed, which bad photos would not replace.
    check_sizes(&photos, model)?;
    check_names(&photos)?;
    for (image, _) in &photos {
        masks.as_ref().map_or(Ok(()), |masks| masks.check(&image.name))?;
    }
    let undistort =
        UndistortOptions { max_image_size: options.max_image_size, ..UndistortOptions::default() };
    let undistorted = undistort_model(model, &undistort)
        .map_err(|cause| Error::Dense { path: folder.clone(), cause })?;
    let problems = select_views(&undistorted, options.sources);
    if problems.iter().all(|problem| problem.sources.is_empty() || problem.seeds.is_empty()) {
        return Err(Error::NothingDense { path: folder, images: problems.len() });
    }
    if stage.begins {
        remove_old_results(workspace, &undistorted)?;
    } else {
        // The record may still say that the stage is complete, although files of it were deleted.
        // From here on it says incomplete.
        workspace.note(|_| {})?;
    }
    let rows = rows_of_photos(&located);
    let mut maps = DepthMaps::new(&mut workspace.folder, NAMES, undistorted, problems);
    maps.rows = rows;
    let mut run = Run::new(maps, options, masks);
    let total = 3 * run.maps.count();
    let (done, has_all_depths) = run.count_done()?;
    emit(stage.watch, &Event::StageBegan { stage: Stage::Dense, total, done })?;
    run.write_model()?;
    for (index, (image, photo)) in photos.iter().enumerate() {
        if !run.is_undistorted(index)? {
            run.undistort(index, image, model, photo)?;
            run.done(DenseStep::Undistort, index, stage.watch)?;
        }
    }
    for index in 0..run.maps.count() {
        if !has_all_depths && !run.maps.has_planes(index)? {
            run.maps.estimate_planes(index)?;
            run.done(DenseStep::Planes, index, stage.watch)?;
        }
    }
    for index in 0..run.maps.count() {
        if !run.has_depths(index)? {
            run.estimate_depths(index)?;
            run.done(DenseStep::Depths, index, stage.watch)?;
        }
    }
    let (report, mut temporary) = run.fuse()?;
    // Names of files that earlier runs or somebody removed leave the manifest.
    let folder = &workspace.folder;
    let names = folder.names().filter(|name| Path::new(name).starts_with(DENSE));
    temporary.extend(names.filter(|name| !folder.exists(name)).map(str::to_owned));
    Ok(StageResult {
        files: vec![VISIBILITY.to_owned(), DENSE_CLOUD.to_owned()],
        removed: temporary,
        database: None,
        report: Box::new(move |all, seconds| {
            all.stages.dense = Some(DenseReport { seconds, ..report });
        }),
    })
}

/// The motion of each photo during its exposure, and its camera; `None` where it is not known, as
/// without a rolling shutter.
fn rows_of_photos(located: &LocatedModel) -> Vec<Option<(RowPoses, Camera)>> {
    let model = &located.reconstruction;
    let mut rows = row_poses(model, &located.shutters);
    model.registered().map(|(id, ..)| Some((rows.remove(&id)?, *model.camera_of(id)))).collect()
}

/// Checks that file systems, which allow names of 255 bytes, allow those of the depth maps.
fn check_names(photos: &[(&Image, PathBuf)]) -> Result<(), Error> {
    let suffix = MapKind::Geometric.suffix();
    let max = 255 - suffix.len();
    let is_long = |name: &str| name.rsplit('/').next().is_some_and(|name| name.len() > max);
    match photos.iter().find(|(image, _)| is_long(&image.name)) {
        None => Ok(()),
        Some((_, photo)) => {
            let what = format!(
                "its name is too long for that of its depth map, which adds `{suffix}`: rename \
                the photo to at most {max} bytes, and reconstruct anew"
            );
            Err(IoError::content(photo, what).into())
        }
    }
}

/// The depth map as an image of 16 bits a pixel.
fn depth_png_file(image: &str) -> String {
    format!("dense/depth_png/{image}.png")
}

/// The confidences as an image of 8 bits a pixel, 255 for 1.
fn confidence_png_file(image: &str) -> String {
    format!("dense/confidence_png/{image}.png")
}

/// Removes the results of an earlier run, and writes that the stage has begun.
///
/// # Errors
///
/// A file of the new results is foreign, or an old one was changed.
fn remove_old_results(workspace: &mut Workspace, model: &Reconstruction) -> Result<(), Error> {
    let of_image = |image: &Image| {
        let name = &image.name;
        let images = [NAMES.image(name), NAMES.mask(name)];
        let maps = [NAMES.planes(name), NAMES.depths(name), NAMES.confidences(name)];
        let exports = [NAMES.normals(name), depth_png_file(name), confidence_png_file(name)];
        images.into_iter().chain(maps).chain(exports)
    };
    let mut names: Vec<String> = model.images().flat_map(|(_, image)| of_image(image)).collect();
    names.extend(model_names(Some(SPARSE)));
    names.extend(
        [DENSE_CLOUD, VISIBILITY, STEREO_LIST, FUSION_LIST, DEPTH_SCALE].map(str::to_owned),
    );
    workspace.folder.ensure_writable(names.iter().map(String::as_str))?;
    let old = workspace.folder.names().filter(|name| Path::new(name).starts_with(DENSE));
    let old: Vec<String> = old.map(str::to_owned).collect();
    workspace.publish(Vec::new(), &old, |_| {})
}

/// A run of the stage.
struct Run<'a> {
    maps: DepthMaps<'a>,
    options: &'a DenseOptions,
    masks: Option<Masks>,
    depth_scale: DepthScale,
}

impl<'a> Run<'a> {
    fn new(maps: DepthMaps<'a>, options: &'a DenseOptions, masks: Option<Masks>) -> Self {
        // The farthest depth that any image may have.
        let ranges =
            maps.problems.iter().filter_map(|problem| InverseDepthRange::of(&problem.seeds));
        let farthest = ranges.map(|range| 1.0 / range.min).fold(0.0, f32::max);
        let depth_scale = DepthScale::up_to(farthest);
        Self { maps, options, masks, depth_scale }
    }

    fn name(&self, index: usize) -> &str {
        self.maps.name(index)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.maps.path(name)
    }

    fn is_missing(&self, name: &str) -> Result<bool, Error> {
        self.maps.is_missing(name)
    }

    fn is_undistorted(&self, index: usize) -> Result<bool, Error> {
        let (image, mask) = (NAMES.image(self.name(index)), NAMES.mask(self.name(index)));
        let has_lost_mask =
            self.masks.is_some() && self.maps.folder.contains(&mask) && self.is_missing(&mask)?;
        Ok(!has_lost_mask && !self.is_missing(&image)?)
    }

    /// The files of the depths of an image, that of the depth map last.
    fn depth_files(&self, index: usize) -> Vec<String> {
        let name = self.name(index);
        let pngs = [depth_png_file(name), confidence_png_file(name)];
        let pngs = self.options.write_depth_pngs.then_some(pngs).into_iter().flatten();
        pngs.chain(self.maps.depth_files(index, self.options.write_normal_maps)).collect()
    }

    /// Whether the depth map of an image exists, with all that is asked for.
    fn has_depths(&self, index: usize) -> Result<bool, Error> {
        self.maps.have_files(&self.depth_files(index))
    }

    /// Number of steps that an earlier run completed, and whether all depth maps exist. The files
    /// of planes are deleted when all depth maps exist; their steps then count as completed.
    fn count_done(&self) -> Result<(usize, bool), Error> {
        let (mut images, mut planes, mut depths) = (0, 0, 0);
        for index in 0..self.maps.count() {
            images += usize::from(self.is_undistorted(index)?);
            planes += usize::from(self.maps.has_planes(index)?);
            depths += usize::from(self.has_depths(index)?);
        }
        let has_all_depths = depths == self.maps.count();
        Ok((images + depths + if has_all_depths { depths } else { planes }, has_all_depths))
    }

    fn done(&self, step: DenseStep, index: usize, watch: Watch) -> Result<(), Error> {
        emit(watch, &Event::DenseDone { step, image: self.name(index) })
    }

    /// Writes the undistorted model and the lists of images.
    fn write_model(&mut self) -> Result<(), Error> {
        let folder = &self.maps.folder;
        let mut names = stage_model(folder, Some(SPARSE), &self.maps.model, Format::Binary)?;
        let (mut stereo, mut fusion) = (String::new(), String::new());
        for problem in &self.maps.problems {
            let name = &self.maps.model.image(problem.image).name;
            let sources = problem.sources.iter().map(|id| self.maps.model.image(*id).name.as_str());
            stereo += &format!("{name}\n{}\n", sources.collect::<Vec<_>>().join(", "));
            fusion += &format!("{name}\n");
        }
        folder.stage_bytes(STEREO_LIST, stereo.as_bytes())?;
        folder.stage_bytes(FUSION_LIST, fusion.as_bytes())?;
        names.extend([STEREO_LIST, FUSION_LIST].map(str::to_owned));
        if self.options.write_depth_pngs {
            folder.stage_bytes(DEPTH_SCALE, self.depth_scale.json().as_bytes())?;
            names.push(DEPTH_SCALE.to_owned());
        }
        self.maps.publish(&names)
    }

    fn undistort(
        &mut self,
        index: usize,
        image: &Image,
        model: &Reconstruction,
        photo: &Path,
    ) -> Result<(), Error> {
        let from = model.camera(image.camera);
        let to = *self.maps.model.camera_of(ImageId::from_index(index));
        let name = NAMES.image(&image.name);
        let target = self.maps.folder.stage(&name)?;
        let undistortion = Undistortion::new(from, &to);
        write_undistorted(photo, &undistortion, &target)?;
        let mut names = vec![name];
        if let Some(masks) = &self.masks
            && let Some(mask) = masks.undistorted(&image.name, &undistortion)?
        {
            let name = NAMES.mask(&image.name);
            mask.write(&self.maps.folder.stage(&name)?)?;
            names.insert(0, name);
        }
        self.maps.publish(&names)
    }

    fn estimate_depths(&mut self, index: usize) -> Result<(), Error> {
        let mut depths = self.maps.estimate_depths(index)?;
        self.apply_mask(index, &mut depths)?;
        if self.options.write_depth_pngs {
            let (folder, name) = (&self.maps.folder, self.name(index));
            let DepthMap { width, height, depths, confidences } = &depths;
            let (wide, high) = (*width as u32, *height as u32);
            self.depth_scale.write(&folder.stage(&depth_png_file(name))?, wide, high, depths)?;
            let data = confidences.iter().map(|value| (255.0 * value).round() as u8).collect();
            let png = Luma { width: wide, height: high, data };
            png.write(&folder.stage(&confidence_png_file(name))?)?;
        }
        self.maps.stage_depths(index, depths, self.options.write_normal_maps)?;
        let names = self.depth_files(index);
        self.maps.publish(&names)
    }

    /// Removes the depths where the mask of an image is 0.
    fn apply_mask(&self, index: usize, depths: &mut DepthMap) -> Result<(), Error> {
        let name = NAMES.mask(self.name(index));
        if self.masks.is_none() || self.is_missing(&name)? {
            return Ok(());
        }
        let path = self.path(&name);
        let mask = Luma::read(&path)?;
        if mask.data.len() != depths.depths.len() {
            let (width, height) = (depths.width as u32, depths.height as u32);
            let cause = tiepoint_dense::Error::Size { width, height, found: mask.data.len() };
            return Err(Error::Dense { path, cause });
        }
        let values = depths.depths.iter_mut().zip(&mut depths.confidences);
        for ((depth, confidence), _) in values.zip(mask.data).filter(|(_, used)| *used == 0) {
            (*depth, *confidence) = (0.0, 0.0);
        }
        Ok(())
    }

    /// Fuses the depth maps into the staged cloud. Returns the report and the names of the files
    /// that are of no further use.
    fn fuse(&mut self) -> Result<(DenseReport, Vec<String>), Error> {
        let folder = &self.maps.folder;
        let mut ply = FusedPly::create(&folder.stage(DENSE_CLOUD)?, true)?;
        let mut visibility = FusedVisibility::create(&folder.stage(VISIBILITY)?)?;
        let mut report = DenseReport::default();
        for index in 0..self.maps.count() {
            match self.maps.has_problem(index) {
                false => report.without_depth_map.push(self.name(index).to_owned()),
                true => {
                    let camera = self.maps.camera(index)?;
                    report.depth_maps += 1;
                    report.depth_maps_with_row_poses += usize::from(camera.rows.is_some());
                    report.megapixels += (camera.width * camera.height) as f64 / 1e6;
                }
            }
        }
        let load = |index: usize| self.fusion_image(index);
        let take = |point: tiepoint_dense::fusion::FusedPoint| -> Result<(), Error> {
            ply.push(point.xyz, point.normal, point.color, point.confidence)?;
            Ok(visibility.push(&point.views)?)
        };
        fuse(&neighbours(&self.maps.problems), &FusionOptions::default(), load, take)?;
        visibility.finish()?;
        report.points = ply.finish()?;
        let planes = (0..self.maps.count()).map(|index| NAMES.planes(self.name(index)));
        Ok((report, planes.collect()))
    }

    fn fusion_image(&self, index: usize) -> Result<FusionImage, Error> {
        let camera = self.maps.camera(index)?;
        let path = self.path(&NAMES.depths(self.name(index)));
        let DenseMap { width, height, values, .. } = DenseMap::read(&path)?;
        let photo = self.path(&NAMES.image(self.name(index)));
        let rgb = Rgb::read_of_size(&photo, camera.width as u32, camera.height as u32)?;
        let confidences = DenseMap::read(&self.path(&NAMES.confidences(self.name(index))))?.values;
        let depths = DepthMap { width, height, depths: values, confidences };
        FusionImage::new(camera, depths, rgb.data).map_err(|cause| Error::Dense { path, cause })
    }
}
