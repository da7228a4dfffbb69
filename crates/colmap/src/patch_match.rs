//! `patch_match_stereo`: depth and normal maps of the images of a dense workspace.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tiepoint_pipeline::input::fingerprint::{hash_bytes, hash_file_ends, hash_files};
use tiepoint_pipeline::io::colmap::read_model;
use tiepoint_pipeline::stages::DepthMaps;
use tiepoint_pipeline::store::OutputFolder;
use tiepoint_pipeline::workspace::{DenseNames, MapKind, model_files, refuse_workspace};
use tiepoint_pipeline::{DenseStep, Error, Event, Stage, Watch, emit};

use super::dense_lists::{Sources, read_problems};

/// Folder of the model in a dense workspace.
pub(super) const SPARSE: &str = "sparse";
/// Folder of the planes of a run that is not complete.
const PLANES: &str = "stereo/planes";

/// Options of [`estimate_depth_maps`].
#[derive(Clone, Debug)]
pub struct DepthMapOptions {
    /// The images that get a depth map, with their sources; `stereo/patch-match.cfg` if `None`.
    pub list: Option<PathBuf>,
    /// Largest width and height of a depth map, in pixels.
    pub max_image_size: Option<u32>,
    /// The names of the maps. The maps themselves are the same.
    pub kind: MapKind,
}

/// Result of [`estimate_depth_maps`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct EstimatedDepthMaps {
    /// Number of depth maps.
    pub depth_maps: usize,
    /// Number of those that an earlier run made.
    pub kept: usize,
    /// Images without a source image or a point of the model, which get no depth map.
    pub without_depth_map: Vec<String>,
}

/// Estimates depth and normal maps of the images of a dense workspace, whoever undistorted them.
/// Maps of an earlier run of the same images, model, list and options are kept.
///
/// # Errors
///
/// The folder belongs to a workspace of this program; an image, the model or the list is missing,
/// cannot be read, or does not fit the others; no two images share points; a map of another program
/// is there; writing fails; `watch` returns `Break`.
pub fn estimate_depth_maps(
    workspace: &Path,
    options: &DepthMapOptions,
    watch: Watch,
) -> Result<EstimatedDepthMaps, Error> {
    refuse_workspace(workspace)?;
    let sparse = workspace.join(SPARSE);
    let model = read_model(&sparse)?;
    let images: Vec<&str> = model.registered().map(|(_, image, _)| image.name.as_str()).collect();
    let index_of: BTreeMap<&str, usize> =
        images.iter().enumerate().map(|(index, name)| (*name, index)).collect();
    let list = options.list.clone().unwrap_or_else(|| workspace.join("stereo/patch-match.cfg"));
    let listed = read_problems(&list, &index_of)?;
    let photos: Vec<PathBuf> =
        images.iter().map(|name| workspace.join("images").join(name)).collect();
    let mut folder = OutputFolder::open(workspace)?;
    let read = model_files(&sparse).into_iter().chain(photos.iter().cloned()).chain([list]);
    folder.protect(read.collect::<Vec<_>>().iter().map(PathBuf::as_path));
    let names = DenseNames::new(options.kind);
    let mut maps = DepthMaps::of_images(&mut folder, names, &model, options.max_image_size)?;
    for (index, sources) in &listed {
        match sources {
            Sources::Auto(count) => {
                let best = maps.sources(*index).into_iter().take(*count);
                maps.set_sources(*index, best.collect::<Vec<_>>());
            }
            Sources::Named(sources) => maps.set_sources(*index, sources.iter().copied()),
        }
    }
    let (asked, without): (Vec<usize>, Vec<usize>) =
        listed.keys().copied().partition(|index| maps.has_problem(*index));
    if asked.is_empty() {
        return Err(Error::NothingDense { path: sparse, images: images.len() });
    }
    let origin = Origin::new(&maps, &asked, &sparse, &photos, options)?;
    begin(&mut maps, &origin, &asked, options.kind)?;
    let kept = run(&mut maps, &asked, watch)?;
    let planes = own_files(maps.folder(), |name| Path::new(name).starts_with(PLANES));
    maps.folder().publish(&[], &planes)?;
    Ok(EstimatedDepthMaps {
        depth_maps: asked.len(),
        kept,
        without_depth_map: without.iter().map(|index| images[*index].to_owned()).collect(),
    })
}

/// Makes the maps that are missing. Returns the number of those that were there.
fn run(maps: &mut DepthMaps, asked: &[usize], watch: Watch) -> Result<usize, Error> {
    let mut missing = Vec::new();
    for index in asked {
        if !maps.have_files(&maps.depth_files(*index, true))? {
            missing.push(*index);
        }
    }
    let with_sources = |index: &usize| [vec![*index], maps.sources(*index)].concat();
    let of_planes: BTreeSet<usize> = missing.iter().flat_map(with_sources).collect();
    let mut without_planes = Vec::new();
    for index in &of_planes {
        if !maps.has_planes(*index)? {
            without_planes.push(*index);
        }
    }
    let kept = asked.len() - missing.len();
    let total = of_planes.len() + asked.len();
    let done = of_planes.len() - without_planes.len() + kept;
    emit(watch, &Event::StageBegan { stage: Stage::Dense, total, done })?;
    for index in without_planes {
        maps.estimate_planes(index)?;
        emit(watch, &Event::DenseDone { step: DenseStep::Planes, image: maps.name(index) })?;
    }
    for index in missing {
        let depths = maps.estimate_depths(index)?;
        maps.stage_depths(index, depths, true)?;
        maps.publish(&maps.depth_files(index, true))?;
        emit(watch, &Event::DenseDone { step: DenseStep::Depths, image: maps.name(index) })?;
    }
    Ok(kept)
}

/// Checks that the maps may be written, and removes those of other images, sources or options.
fn begin(
    maps: &mut DepthMaps,
    origin: &Origin,
    asked: &[usize],
    kind: MapKind,
) -> Result<(), Error> {
    let file = origin_file(kind);
    let mut names = vec![file.clone()];
    asked.iter().for_each(|index| names.extend(maps.depth_files(*index, true)));
    maps.folder().ensure_writable(names.iter().map(String::as_str))?;
    let before = match maps.folder().is_unmodified(&file)? {
        true => fs::read_to_string(maps.folder().path().join(&file)).unwrap_or_default(),
        false => String::new(),
    };
    let (text, is_kept) = origin.after(&before);
    if text == before {
        return Ok(());
    }
    // Planes are those of the sources of another run.
    let mut old = own_files(maps.folder(), |name| Path::new(name).starts_with(PLANES));
    for index in 0..maps.count() {
        if !is_kept(maps.name(index)) {
            let files = maps.depth_files(index, true);
            old.extend(files.into_iter().filter(|name| maps.folder().contains(name)));
        }
    }
    maps.folder().stage_bytes(&file, text.as_bytes())?;
    maps.folder().publish(&[file], &old)?;
    Ok(())
}

/// The names of files that this program made in a folder.
fn own_files(folder: &OutputFolder, is_asked: impl Fn(&str) -> bool) -> Vec<String> {
    folder.names().filter(|name| is_asked(name)).map(str::to_owned).collect()
}

/// The file of the [`Origin`] of all maps.
fn origin_file(kind: MapKind) -> String {
    format!("stereo/tiepoint{}", kind.suffix().replace(".bin", ".txt"))
}

/// What maps are of. A run keeps those of the same origin.
struct Origin {
    /// The images, the model and the size of the maps.
    all: String,
    /// A line for each image that gets a map: the hash of its sources, and its name.
    images: BTreeMap<String, String>,
}

impl Origin {
    fn new(
        maps: &DepthMaps,
        asked: &[usize],
        sparse: &Path,
        photos: &[PathBuf],
        options: &DepthMapOptions,
    ) -> Result<Self, Error> {
        let model = model_files(sparse).into_iter().filter(|path| path.is_file());
        let size = options.max_image_size.unwrap_or(0);
        let all = format!(
            "# tiepoint: `patch_match_stereo` keeps maps while this stays the same.\nimages {}\n\
             model {}\nsize {size}\n",
            hash_file_ends(photos)?,
            hash_files(&model.collect::<Vec<_>>())?,
        );
        let line = |index: &usize| {
            let sources = format!("{:?}", maps.sources(*index));
            (maps.name(*index).to_owned(), hash_bytes(sources.as_bytes()))
        };
        Ok(Self { all, images: asked.iter().map(line).collect() })
    }

    /// The text for maps that are there, of the origin `before`, and for those to come; and whether
    /// the map of an image is kept if it is there.
    fn after(&self, before: &str) -> (String, impl Fn(&str) -> bool) {
        let before = before.strip_prefix(&self.all).unwrap_or_default();
        let before = before.lines().filter_map(|line| line.split_once(' '));
        let before: BTreeMap<String, String> =
            before.map(|(hash, name)| (name.to_owned(), hash.to_owned())).collect();
        let mut now = before.clone();
        now.extend(self.images.clone());
        let lines = now.iter().map(|(name, hash)| format!("{hash} {name}\n"));
        let text = self.all.clone() + &lines.collect::<String>();
        let is_kept =
            move |name: &str| before.contains_key(name) && before.get(name) == now.get(name);
        (text, is_kept)
    }
}
