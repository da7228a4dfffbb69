//! Export of models to the formats of other programs.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tiepoint_dense::undistort::{UndistortOptions, Undistortion, undistort_model};
use tiepoint_input::parallel::{budget_bytes, for_each_within_budget};
use tiepoint_input::sequences::number;
use tiepoint_input::{Exif, ImageFolder, Rgb};
use tiepoint_io::bal::Bal;
use tiepoint_io::colmap::Format;
use tiepoint_io::geo_path::{GeoPath, GeoPhoto};
use tiepoint_io::nerfstudio::{self, Motion};
use tiepoint_io::timestamps::is_absolute;
use tiepoint_io::trajectory::{self, TimedPose};
use tiepoint_io::{geo_path, gltf, gsplat, openmvs, ply, position_priors};
use tiepoint_sfm::frame_names::natural_order;
use tiepoint_sfm::geometry::Rigid3;
use tiepoint_sfm::geometry::crs::Crs;
use tiepoint_sfm::geometry::geodesy::Geodetic;
use tiepoint_sfm::geometry::nalgebra::Vector3;
use tiepoint_sfm::scene::{Georeference, Image, ImageId, Place, Reconstruction};
use tiepoint_store::disk::{self, FileId};
use tiepoint_store::{AtomicFile, Error as StoreError, Mark, OutputFolder, Replace, write_file};

use crate::Error;
use crate::models::in_crs::InCrs;
use crate::models::rigid::{RigidReport, rigid_model};
use crate::models::{kalibr, rolling_shutter};
use crate::workspace::file_marks::{COMMENT, COMMENT_MARK, GLTF_MARK, LAS_MARK, PLY_MARK};
use crate::workspace::folder::{current_records, is_workspace, refuse_workspace};
use crate::workspace::format::path_text;
use crate::workspace::image_names::first_stream;
use crate::workspace::located_model::LocatedModel;
use crate::workspace::model_output::{model_names, refuse_shadow, renamed, stage_model};
use crate::workspace::model_photos::{check_sizes, decoder_bytes, photos_of, write_undistorted};
use crate::workspace::sidecar::SIDECAR;

/// An export format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// COLMAP's binary files, in a folder.
    Colmap,
    /// COLMAP's text files, in a folder.
    ColmapText,
    /// Point cloud.
    Ply,
    /// TUM RGB-D trajectory (poses with times) of the camera of the first image.
    Tum,
    /// KITTI odometry trajectory of the camera of the first image.
    Kitti,
    /// BAL problem.
    Bal,
    /// `scene.mvs` and undistorted images, in a folder.
    OpenMvs,
    /// `transforms.json`, the images and the cloud, in a folder.
    Nerfstudio,
    /// The photos, the model with the detected keypoints, and `rolling_shutter.json` with the
    /// poses of first and last rows (the same without a rolling shutter), in a folder.
    Gsplat,
    /// [`Self::Nerfstudio`] with the keys of 3dgs-deblur: velocities and readout time.
    Deblur,
    /// The dense cloud of a workspace, as LAS or LAZ by the extension.
    Las,
    /// Binary glTF of the cameras, the points, and the dense cloud if there is one.
    Gltf,
    /// Extrinsics and time offsets of the rig as Kalibr's `camchain.yaml`.
    Kalibr,
    /// The paths of the cameras of a georeferenced model on WGS 84, for maps.
    GeoJson,
    /// The same as a track.
    Gpx,
    /// The centres of the cameras by the names of their images.
    Csv,
}

impl ExportFormat {
    /// All formats.
    pub const ALL: [Self; 16] = [
        Self::Colmap,
        Self::OpenMvs,
        Self::Nerfstudio,
        Self::Gsplat,
        Self::Deblur,
        Self::ColmapText,
        Self::Ply,
        Self::Las,
        Self::Gltf,
        Self::Tum,
        Self::Kitti,
        Self::Bal,
        Self::Kalibr,
        Self::GeoJson,
        Self::Gpx,
        Self::Csv,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Colmap => "colmap",
            Self::OpenMvs => "openmvs",
            Self::Nerfstudio => "nerfstudio",
            Self::Gsplat => "gsplat",
            Self::Deblur => "3dgs-deblur",
            Self::ColmapText => "colmap-text",
            Self::Ply => "ply",
            Self::Las => "las",
            Self::Gltf => "gltf",
            Self::Tum => "tum",
            Self::Kitti => "kitti",
            Self::Bal => "bal",
            Self::Kalibr => "kalibr",
            Self::GeoJson => "geojson",
            Self::Gpx => "gpx",
            Self::Csv => "csv",
        }
    }
}

/// Summary of an export.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Exported {
    /// The file or folder that was written.
    #[serde(serialize_with = "path_text")]
    pub path: PathBuf,
    /// Number of poses in it.
    pub poses: usize,
    /// Number of points in it.
    pub points: usize,
    /// Number of photos that were in their places already and were not copied.
    pub photos_in_place: usize,
    /// The system of the coordinates and what they are, in words, with [`ExportSource::crs`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crs: Option<String>,
    /// The effect of exact rig extrinsics, with [`export_rigid`].
    pub rigid: Option<RigidReport>,
}

/// Input of an export.
#[derive(Clone, Copy, Debug)]
pub struct ExportSource<'a> {
    /// The model.
    pub model: &'a LocatedModel,
    /// The folder that the names of the model's images begin in; `None`: the photos are the inputs
    /// of the workspace that the model is in.
    pub images: Option<&'a Path>,
    /// The system that coordinates are written in; `None`: the frame of the model.
    pub crs: Option<Crs>,
    /// Replaces a file at the place of the result, whoever made it. Files in folders stay.
    pub overwrite: bool,
}

/// Writes a model to `to` in another format.
///
/// # Errors
///
/// The model or its photos cannot be read, the model lacks data that the format needs (capture
/// times, rig extrinsics, photos), or the result cannot be written.
pub fn export(from: &ExportSource, format: ExportFormat, to: &Path) -> Result<Exported, Error> {
    // Its files are read only by the formats that have it.
    write_as(from, from.model.dense_cloud().as_deref(), format, to)
}

/// Adjusts a model with exact rig extrinsics (one `cam_from_rig` per camera), whatever constraint
/// it was mapped with, and exports it with its rig and frames, without a dense cloud, which has the
/// poses from before. The model on disk is not changed.
///
/// # Errors
///
/// Those of [`export`]; no two cameras have poses at common frames; the format has no poses, or has
/// them on the earth.
pub fn export_rigid(
    from: &ExportSource,
    format: ExportFormat,
    to: &Path,
) -> Result<Exported, Error> {
    if matches!(format, ExportFormat::Kalibr | ExportFormat::Las) {
        return Err(Error::NoPoses { path: to.to_owned() });
    }
    if matches!(format, ExportFormat::GeoJson | ExportFormat::Gpx) {
        return Err(Error::RigidHasNoPlace { model: from.model.folder().to_owned() });
    }
    let (model, rigid) = rigid_model(from.model)?;
    let from = ExportSource { model: &from.model.changed(model), ..*from };
    Ok(Exported { rigid: Some(rigid), ..write_as(&from, None, format, to)? })
}

/// [`export`] of a model with its keypoints where they were detected. Those of a model with rolling
/// shutters are where a global shutter would have seen them, and its photos are not.
///
/// # Errors
///
/// Those of [`export`]; the model is in no workspace with the database of its keypoints.
pub fn export_detected(
    from: &ExportSource,
    format: ExportFormat,
    to: &Path,
) -> Result<Exported, Error> {
    let dense = from.model.dense_cloud();
    let model = from.model.changed(rolling_shutter::detected_keypoints(from.model)?);
    write_as(&ExportSource { model: &model, ..*from }, dense.as_deref(), format, to)
}

/// The files that a result does not replace: those of the model, and with `overwrite` what it was
/// made of. Where photos cannot be listed, there are none to protect.
fn protected(from: &ExportSource) -> Vec<PathBuf> {
    let mut files = from.model.files();
    if from.overwrite {
        files.push(from.model.database());
        let of_workspace = from.model.workspace().map(|root| Ok(current_records(root)?.inputs));
        let inputs = match (from.images, of_workspace) {
            (Some(images), _) => vec![images.to_owned()],
            (None, of_workspace) => {
                of_workspace.and_then(Result::<_, Error>::ok).unwrap_or_default()
            }
        };
        if let Ok(photos) = ImageFolder::open(&inputs, None) {
            files.extend((0..photos.images().len()).map(|index| photos.path(index).to_owned()));
        }
    }
    files
}

fn write_as(
    from: &ExportSource,
    dense: Option<&Path>,
    format: ExportFormat,
    to: &Path,
) -> Result<Exported, Error> {
    let (located, model) = (from.model, &from.model.reconstruction);
    let folder = || located.folder().to_owned();
    let (mut poses, mut points, mut in_place) = (model.num_registered(), model.num_tracks(), 0);
    let inputs = protected(from);
    let in_crs = in_crs(from, format)?;
    let file = |mark, write: &dyn Fn(&Path) -> Result<(), Error>| {
        let replace = Replace::new(mark, from.overwrite);
        write_file(to, inputs.iter().map(PathBuf::as_path), replace, write)
    };
    match format {
        ExportFormat::Colmap => located.without_place().write_as(to, Format::Binary, &inputs)?,
        ExportFormat::ColmapText => located.without_place().write_as(to, Format::Text, &inputs)?,
        ExportFormat::Bal => {
            let bal =
                Bal::from_reconstruction(model).map_err(|error| error.of(located.folder()))?;
            file(None, &|to| Ok(bal.write(to)?))?;
        }
        ExportFormat::OpenMvs => export_openmvs(from, to)?,
        ExportFormat::Nerfstudio => {
            in_place = export_nerfstudio(from, to, &BTreeMap::new())?;
        }
        ExportFormat::Deblur => {
            let motions = rolling_shutter::for_nerfstudio(&rolling_shutter::motions(located)?);
            in_place = export_nerfstudio(from, to, &motions)?;
        }
        ExportFormat::Gsplat => in_place = export_gsplat(from, to)?,
        ExportFormat::Kalibr => {
            let (text, cameras) = camchain(located)?;
            let text = format!("{COMMENT}\n{text}");
            file(Some(COMMENT_MARK), &|to| {
                Ok(AtomicFile::write_with(to, |out| out.write_all(text.as_bytes()))?)
            })?;
            (poses, points) = (cameras, 0);
        }
        ExportFormat::Ply => {
            file(Some(PLY_MARK), &|to| write_ply(model, in_crs.as_ref(), to))?;
            poses = 0;
        }
        ExportFormat::Las => {
            let cloud = dense.ok_or_else(|| Error::NoDenseCloud { path: folder() })?;
            let inputs = inputs.iter().map(PathBuf::as_path).chain([cloud]);
            write_file(to, inputs, Replace::new(Some(LAS_MARK), from.overwrite), |to| {
                points = write_las(cloud, in_crs.as_ref(), to)?;
                Ok::<_, Error>(())
            })?;
            poses = 0;
        }
        ExportFormat::Gltf => points = write_gltf(from, dense, &inputs, to)?,
        ExportFormat::Kitti => {
            let images = trajectory_of(model);
            let names: Vec<&str> = images.iter().map(|(image, _)| image.name.as_str()).collect();
            if let Some(frames) = gaps(&names) {
                return Err(Error::TrajectoryGaps { model: folder(), frames });
            }
            let trajectory: Vec<Rigid3> = images.into_iter().map(|(_, pose)| pose).collect();
            file(None, &|to| Ok(trajectory::write_kitti(to, &trajectory)?))?;
            (poses, points) = (trajectory.len(), 0);
        }
        ExportFormat::GeoJson | ExportFormat::Gpx => {
            let (mark, write) = geo_writer(located, format)?;
            file(Some(mark), &*write)?;
            points = 0;
        }
        ExportFormat::Csv => {
            file(None, &|to| write_centres(model, in_crs.as_ref(), to))?;
            points = 0;
        }
        ExportFormat::Tum => {
            let timed = timed_trajectory_of(located)?;
            file(Some(COMMENT_MARK), &|to| Ok(trajectory::write_tum(to, &timed)?))?;
            (poses, points) = (timed.len(), 0);
        }
    }
    let crs = in_crs.map(|to_crs| to_crs.crs.in_words(to_crs.has_heights));
    Ok(Exported { path: to.to_owned(), poses, points, photos_in_place: in_place, crs, rigid: None })
}

/// Writes the points and cameras as binary glTF, and the dense cloud if there is one. Returns the
/// number of points.
fn write_gltf(
    from: &ExportSource,
    dense: Option<&Path>,
    inputs: &[PathBuf],
    to: &Path,
) -> Result<usize, Error> {
    if to.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gltf")) {
        return Err(Error::BinaryGltf { path: to.to_owned() });
    }
    let model = &from.model.reconstruction;
    let (sparse, dense_points) = (ply::points(model), dense.map(ply::read).transpose()?);
    let mut clouds = vec![("points", sparse.as_slice())];
    clouds.extend(dense_points.iter().map(|points| ("dense", points.as_slice())));
    let inputs = inputs.iter().map(PathBuf::as_path).chain(dense);
    let mut points = 0;
    write_file(to, inputs, Replace::new(Some(GLTF_MARK), from.overwrite), |to| {
        points = gltf::write(to, model, &clouds)?;
        Ok::<_, Error>(())
    })?;
    Ok(points)
}

/// Writes the points of a model.
fn write_ply(model: &Reconstruction, in_crs: Option<&InCrs>, to: &Path) -> Result<(), Error> {
    let points = ply::points(model);
    match in_crs {
        Some(in_crs) => {
            let points = in_crs.vertices(points)?;
            ply::write_in(to, &points, in_crs.crs, in_crs.has_heights)?;
        }
        None => ply::write(to, &points)?,
    }
    Ok(())
}

/// Writes the centres of the cameras by the names of their images.
fn write_centres(model: &Reconstruction, in_crs: Option<&InCrs>, to: &Path) -> Result<(), Error> {
    let place = |local: Vector3<f64>| match in_crs {
        Some(in_crs) => in_crs.coordinates(&local),
        None => Ok(Place::Cartesian(local)),
    };
    let centres = model
        .registered()
        .map(|(_, image, pose)| Ok((image.name.as_str(), place(pose.origin_in_a())?)));
    Ok(position_priors::write(to, &centres.collect::<Result<Vec<_>, Error>>()?)?)
}

/// The system of the coordinates, if the format can be written in it.
fn in_crs<'a>(from: &ExportSource<'a>, format: ExportFormat) -> Result<Option<InCrs<'a>>, Error> {
    let Some(crs) = from.crs else { return Ok(None) };
    let is_written = match format {
        ExportFormat::Ply | ExportFormat::Las | ExportFormat::Csv => true,
        ExportFormat::GeoJson | ExportFormat::Gpx => matches!(crs, Crs::Geographic { .. }),
        _ => false,
    };
    match is_written {
        true => InCrs::new(from.model, crs).map(Some),
        false => Err(Error::NotInCrs { format: format.name(), crs }),
    }
}

/// The poses of [`trajectory_of`] that have a time, in order of time.
fn timed_trajectory_of(located: &LocatedModel) -> Result<Vec<TimedPose>, Error> {
    let timed = trajectory_of(&located.reconstruction).into_iter();
    let timed = timed.filter_map(|(image, cam_from_world)| {
        Some(TimedPose { time_s: image.time_s?, cam_from_world })
    });
    let mut timed: Vec<TimedPose> = timed.collect();
    timed.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    match timed.is_empty() {
        true => Err(Error::NoTimes { model: located.folder().to_owned() }),
        false => Ok(timed),
    }
}

/// What writes a file.
type Writer = Box<dyn Fn(&Path) -> Result<(), Error>>;

/// What writes the paths of a georeferenced model, and how its files are known.
fn geo_writer(located: &LocatedModel, format: ExportFormat) -> Result<(Mark, Writer), Error> {
    let (mut paths, has_heights) = geo_paths(located)?;
    if format == ExportFormat::Gpx {
        // The times of a GPX file are UTC, and those of EXIF are on the clock of the camera.
        paths.iter_mut().flat_map(|path| &mut path.photos).for_each(|photo| photo.time_s = None);
    }
    let (start, write): (_, fn(&Path, &[GeoPath], bool) -> _) = match format {
        ExportFormat::Gpx => (geo_path::GPX_START, geo_path::write_gpx),
        _ => (geo_path::GEOJSON_START, geo_path::write_geojson),
    };
    let write = move |to: &Path| Ok(write(to, &paths, has_heights)?);
    Ok((Mark::Start(start), Box::new(write)))
}

/// The path of each stream of a georeferenced model on the earth, in order of time or of names, and
/// whether heights are known.
fn geo_paths(located: &LocatedModel) -> Result<(Vec<GeoPath>, bool), Error> {
    let model = &located.reconstruction;
    let Some(Georeference::Enu { frame, has_height }) = &model.georeference else {
        return Err(Error::NoPlace { model: located.folder().to_owned() });
    };
    let mut of_streams: BTreeMap<&str, Vec<(&Image, Geodetic)>> = BTreeMap::new();
    for (_, image, pose) in model.registered() {
        let place = frame.to_geodetic(&pose.origin_in_a());
        of_streams.entry(&*image.stream).or_default().push((image, place));
    }
    let path = |(stream, mut images): (&str, Vec<(&Image, Geodetic)>)| {
        let are_timed = images.iter().all(|(image, _)| image.time_s.is_some());
        let time = |image: &Image| image.time_s.filter(|_| are_timed).unwrap_or_default();
        images.sort_by(|(a, _), (b, _)| {
            time(a).total_cmp(&time(b)).then_with(|| natural_order(&a.name, &b.name))
        });
        let photo = |(image, place): (&Image, Geodetic)| GeoPhoto {
            name: image.name.clone(),
            place,
            time_s: image.time_s.filter(|time_s| is_absolute(*time_s)),
        };
        GeoPath { name: stream.to_owned(), photos: images.into_iter().map(photo).collect() }
    };
    Ok((of_streams.into_iter().map(path).collect(), *has_height))
}

/// Kalibr's file of the rig of a model, and the number of its cameras.
fn camchain(located: &LocatedModel) -> Result<(String, usize), Error> {
    let no_rig = || Error::NoRig { path: located.folder().to_owned() };
    let rig = located.rig.as_ref().ok_or_else(no_rig)?;
    kalibr::camchain(&located.reconstruction, rig).map_err(|name| Error::Broken {
        path: located.folder().join(SIDECAR),
        what: format!("there is no camera {name} in the model"),
    })
}

/// Writes a cloud as LAS or LAZ. Returns the number of points.
#[cfg(feature = "las")]
fn write_las(cloud: &Path, in_crs: Option<&InCrs>, to: &Path) -> Result<usize, Error> {
    let vertices = ply::read(cloud)?;
    let points = vertices.len();
    match in_crs {
        Some(to_crs) => tiepoint_io::las::write_in(
            to,
            &to_crs.vertices(vertices)?,
            to_crs.crs,
            to_crs.has_heights,
        )?,
        None => tiepoint_io::las::write(to, &vertices)?,
    }
    Ok(points)
}

#[cfg(not(feature = "las"))]
fn write_las(_: &Path, _: Option<&InCrs>, to: &Path) -> Result<usize, Error> {
    Err(Error::NoLasWriter { path: to.to_owned() })
}

/// Folder of the images in an export.
const IMAGES: &str = "images";

fn image_name(image: &Image) -> String {
    format!("{IMAGES}/{}", image.name)
}

/// Writes `scene.mvs` and undistorted images: OpenMVS supports pinhole cameras only.
fn export_openmvs(from: &ExportSource, to: &Path) -> Result<(), Error> {
    const SCENE: &str = "scene.mvs";
    let model = &from.model.reconstruction;
    let is_spherical =
        |image: &Image| model.camera(image.camera).intrinsics.kind().focal_indices().is_empty();
    if let Some((_, image, _)) = model.registered().find(|(_, image, _)| is_spherical(image)) {
        return Err(Error::NoImagePlane { image: image.name.clone() });
    }
    let photos = photos_of(from.model, from.images)?;
    check_sizes(&photos, model)?;
    let mut folder = OutputFolder::open(to)?;
    folder.protect(photos.iter().map(|(_, path)| path.as_path()));
    let mut names: Vec<String> = photos.iter().map(|(image, _)| image_name(image)).collect();
    names.push(SCENE.to_owned());
    folder.ensure_writable(names.iter().map(String::as_str))?;
    let undistorted = undistort_model(model, &UndistortOptions::default())
        .map_err(|cause| Error::Dense { path: from.model.folder().to_owned(), cause })?;
    let write = |(image, path): &(&Image, PathBuf)| -> Result<(), Error> {
        let (old, new) = (model.camera(image.camera), undistorted.camera(image.camera));
        let target = folder.stage(&image_name(image))?;
        write_undistorted(path, &Undistortion::new(old, new), &target)
    };
    // The photo and its undistorted copy.
    let bytes = |(image, _): &(&Image, PathBuf)| 2 * decoder_bytes(model.camera(image.camera));
    for_each_within_budget(budget_bytes(), bytes, &photos, write, |_, written| written)?;
    openmvs::write(&folder.stage(SCENE)?, &undistorted, IMAGES)?;
    folder.publish(&names, &[])?;
    Ok(())
}

/// Writes `transforms.json`, the cloud, and copies of the photos: nerfstudio supports distortion.
/// With motions, `transforms.json` has the keys of 3dgs-deblur. Photos that are in their places
/// already are not copied; returns their number.
fn export_nerfstudio(
    from: &ExportSource,
    to: &Path,
    motions: &BTreeMap<ImageId, Motion>,
) -> Result<usize, Error> {
    const CLOUD: &str = "points.ply";
    const TRANSFORMS: &str = "transforms.json";
    if is_workspace(to) {
        // The points.ply of a workspace is the cloud of its model.
        return Err(StoreError::IsInput { path: to.join(CLOUD) }.into());
    }
    let model = &from.model.reconstruction;
    let names = [CLOUD, TRANSFORMS].map(str::to_owned);
    with_photos(from, to, &names, &[], |folder| {
        ply::write(&folder.stage(CLOUD)?, &ply::points(model))?;
        let staged = folder.stage(TRANSFORMS)?;
        nerfstudio::write_with_motion(&staged, model, IMAGES, Some(CLOUD), motions)
            .map_err(|error| renamed(error, &staged, &to.join(TRANSFORMS)))?;
        Ok(names.to_vec())
    })
}

/// Writes `rolling_shutter.json`, the model with the detected keypoints, which are those of the
/// photos, and copies of the photos. Returns as [`export_nerfstudio`].
fn export_gsplat(from: &ExportSource, to: &Path) -> Result<usize, Error> {
    const SPARSE: &str = "sparse/0";
    const ROWS: &str = "rolling_shutter.json";
    refuse_workspace(to)?;
    refuse_shadow(from.model.folder(), to)?;
    // Without rolling shutters all images are GLOBAL, and the keypoints are where they were found.
    let has_shutters = !from.model.shutters.is_empty();
    let (rows, model) = match has_shutters {
        true => {
            let motions = rolling_shutter::motions(from.model)?;
            let rows = rolling_shutter::for_gsplat(&from.model.reconstruction, &motions);
            (rows, rolling_shutter::detected_keypoints(from.model)?)
        }
        false => (BTreeMap::new(), from.model.reconstruction.clone()),
    };
    let inputs = from.model.files();
    let mut names = model_names(Some(SPARSE));
    names.push(ROWS.to_owned());
    with_photos(from, to, &names, &inputs, |folder| {
        let staged = folder.stage(ROWS)?;
        gsplat::write(&staged, &model, IMAGES, &rows)
            .map_err(|error| renamed(error, &staged, &to.join(ROWS)))?;
        let mut staged = stage_model(folder, Some(SPARSE), &model, Format::Binary)?;
        staged.push(ROWS.to_owned());
        Ok(staged)
    })
}

/// Writes copies of the photos, and files that `write` stages and names. `names`: all that it may
/// write. Photos that are in their places already are not copied; returns their number.
fn with_photos(
    from: &ExportSource,
    to: &Path,
    names: &[String],
    inputs: &[PathBuf],
    write: impl FnOnce(&OutputFolder) -> Result<Vec<String>, Error>,
) -> Result<usize, Error> {
    let model = &from.model.reconstruction;
    let photos = photos_of(from.model, from.images)?;
    check_sizes(&photos, model)?;
    // Readers of these formats take the pixels as they are stored.
    let is_turned = |path: &Path| Exif::read(path).is_ok_and(|exif| exif.orientation > 1);
    let mut folder = OutputFolder::open(to)?;
    let is_in_place = |image: &Image, path: &Path| {
        let there = FileId::of(&to.join(image_name(image)));
        there.is_some() && there == FileId::of(path)
    };
    let turned = |(image, path): &&(&Image, PathBuf)| is_in_place(image, path) && is_turned(path);
    if let Some((_, path)) = photos.iter().find(turned) {
        return Err(Error::TurnedInPlace { path: path.clone() });
    }
    let copied: Vec<&(&Image, PathBuf)> =
        photos.iter().filter(|(image, path)| !is_in_place(image, path)).collect();
    folder.protect(photos.iter().map(|(_, path)| path.as_path()));
    folder.protect(inputs.iter().map(PathBuf::as_path));
    folder.ensure_writable(names.iter().map(String::as_str))?;
    let copy = |(image, path): &&(&Image, PathBuf)| -> Result<(), Error> {
        let target = folder.stage(&image_name(image))?;
        if is_turned(path) {
            return Ok(Rgb::read(path)?.write(&target)?);
        }
        disk::copy_new(path, &target).map_err(Error::output(&to.join(image_name(image))))
    };
    let bytes = |(image, _): &&(&Image, PathBuf)| decoder_bytes(model.camera(image.camera));
    for_each_within_budget(budget_bytes(), bytes, &copied, copy, |_, copied| copied)?;
    let mut staged: Vec<String> = copied.iter().map(|(image, _)| image_name(image)).collect();
    staged.extend(write(&folder)?);
    folder.publish(&staged, &[])?;
    Ok(photos.len() - copied.len())
}

/// Most gaps that an error names.
const MAX_NAMED_GAPS: usize = 4;

/// The frames without a pose among numbered images of a camera, such as `3 to 5, 9`. `None` if
/// there are none, or if the numbers do not tell: usually they rise by one step.
fn gaps(names: &[&str]) -> Option<String> {
    let numbers: Vec<usize> = names.iter().map(|name| number(name)).collect::<Option<_>>()?;
    let steps: Vec<usize> = numbers
        .windows(2)
        .map(|two| two[1].checked_sub(two[0]).filter(|step| *step > 0))
        .collect::<Option<_>>()?;
    let step = *steps.iter().min()?;
    let gaps: Vec<String> = numbers
        .iter()
        .zip(&steps)
        .filter(|(_, found)| **found > step)
        .map(|(from, found)| match (from + step, from + found - step) {
            (first, last) if first >= last => first.to_string(),
            (first, last) => format!("{first} to {last}"),
        })
        .collect();
    if gaps.is_empty() || 2 * gaps.len() >= steps.len() || steps.iter().any(|s| s % step != 0) {
        return None;
    }
    let mut named = gaps[..gaps.len().min(MAX_NAMED_GAPS)].join(", ");
    if gaps.len() > MAX_NAMED_GAPS {
        named += &format!(" and {} more gaps", gaps.len() - MAX_NAMED_GAPS);
    }
    Some(named)
}

/// Registered images of the first camera and their poses (`cam_from_world`), ordered by name,
/// numbers by value.
fn trajectory_of(model: &Reconstruction) -> Vec<(&Image, Rigid3)> {
    let stream = first_stream(model);
    let mut images: Vec<(&Image, Rigid3)> = model
        .registered()
        .filter(|(_, image, _)| *image.stream == *stream)
        .map(|(_, image, pose)| (image, *pose))
        .collect();
    images.sort_by(|a, b| natural_order(&a.0.name, &b.0.name));
    images
}

#[cfg(test)]
mod tests {
    use super::gaps;

    #[test]
    fn gaps_of_numbered_images_are_named() {
        let names = |numbers: &[usize]| -> Option<String> {
            let names: Vec<String> = numbers.iter().map(|n| format!("l/{n:04}.png")).collect();
            gaps(&names.iter().map(String::as_str).collect::<Vec<_>>())
        };
        assert_eq!(names(&[0, 1, 2, 5, 6, 8, 9, 10]).as_deref(), Some("3 to 4, 7"));
        assert_eq!(names(&[5, 10, 15, 25, 30]).as_deref(), Some("20"));
        // Frames of a video at irregular numbers, and names without numbers.
        for regular in [&[3, 4, 5, 6][..], &[1, 4, 6, 11, 13, 18], &[7], &[2, 9]] {
            assert_eq!(names(regular), None, "{regular:?}");
        }
        assert_eq!(gaps(&["a.png", "b.png", "c.png"]), None);
    }
}
