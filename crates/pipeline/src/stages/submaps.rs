//! Sub-maps: parts of many images, which are mapped apart and then assembled.
//!
//! The state of each part is a tile, so that another process may map it, and a run that was killed
//! has to map only the parts that it was at. The bytes depend neither on who maps a part nor on how
//! many are mapped at once.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_input::parallel::{budget_bytes, for_each_within_budget};
use tiepoint_sfm::geometry::OptionError;
use tiepoint_sfm::scene::{CorrespondenceGraph, ImageId, ImagePair, Reconstruction};
use tiepoint_sfm::submaps::{SUBMAP_SIZE, are_sequences, cut};
use tiepoint_sfm::{self as sfm, Mapper, MapperOptions};

use crate::shard::Shard;
use crate::workspace::records::Recipe;
use crate::{Error, Event, Stage, Watch, Workspace, emit};

/// From this number of images on they are mapped in parts, unless an option says otherwise. The
/// time of one map per image grows with its size, and the accuracy of parts was measured on drives
/// of 1,000 images (`docs/design/scale.md`); no set with a published result is as large.
pub(crate) const MIN_IMAGES: usize = 2_000;
/// Smallest part: neighbours have most of half a part in common below.
const MIN_SIZE: usize = 50;
/// Memory for a part, in bytes: of the graph for each verified match, which it stores three times,
/// and of a bundle adjustment for each keypoint, if all observe points.
const BYTES_PER_MATCH: usize = 24;
const BYTES_PER_KEYPOINT: usize = 512;

/// Whether images are mapped in parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Submaps {
    /// Many are, in parts of [`SUBMAP_SIZE`] images.
    #[default]
    Auto,
    /// One map.
    Off,
    /// Parts of about this number of images.
    Size(usize),
}

impl Submaps {
    /// The number of images of a part; `None` for one map.
    ///
    /// # Errors
    ///
    /// A size that is too small; or parts are asked for, and something else gives the frame of the
    /// model.
    pub(crate) fn size(self, num_images: usize, has_frame: bool) -> Result<Option<usize>, Error> {
        match self {
            Self::Auto => Ok((num_images >= MIN_IMAGES && !has_frame).then_some(SUBMAP_SIZE)),
            Self::Off => Ok(None),
            Self::Size(_) if has_frame => Err(sfm::Error::SubmapsWithFrame.into()),
            Self::Size(size) => {
                let range = "at least 50";
                OptionError::check("submaps", size as f64, size >= MIN_SIZE, range)?;
                Ok(Some(size))
            }
        }
    }
}

/// The parts of a mapping.
pub(crate) struct Parts<'a> {
    graph: &'a CorrespondenceGraph,
    scene: &'a Reconstruction,
    options: &'a MapperOptions,
    images: Vec<BTreeSet<ImageId>>,
}

impl<'a> Parts<'a> {
    /// `None` if the images are too few for two parts, or, with `only_sequences`, if they are no
    /// sequences.
    pub(crate) fn new(
        graph: &'a CorrespondenceGraph,
        scene: &'a Reconstruction,
        options: &'a MapperOptions,
        size: usize,
        only_sequences: bool,
    ) -> Option<Self> {
        let links: Vec<(ImagePair, usize)> =
            graph.pairs().iter().map(|(pair, view)| (*pair, view.matches.len())).collect();
        if only_sequences && !are_sequences(scene, &links) {
            return None;
        }
        let images = cut(scene, &links, size);
        (images.len() > 1).then_some(Self { graph, scene, options, images })
    }

    pub(crate) fn count(&self) -> usize {
        self.images.len()
    }

    /// The number of images of the part at an index.
    pub(crate) fn images(&self, index: usize) -> usize {
        self.images[index].len()
    }

    /// The state of the part at an index. `first`: that of the first part, with whose
    /// intrinsics the others begin.
    pub(crate) fn map(
        &self,
        index: usize,
        first: Option<&[u8]>,
        watch: &mut dyn FnMut(&sfm::Event) -> ControlFlow<()>,
    ) -> Result<Vec<u8>, Error> {
        let mapper = Mapper::new(self.graph, self.scene).watch(watch);
        Ok(mapper.submap(&self.images[index], first, self.options)?)
    }

    /// The memory that mapping the part at an index takes, about.
    fn bytes(&self, index: usize) -> u64 {
        let images = &self.images[index];
        let keypoints: usize =
            images.iter().map(|image| self.scene.image(*image).keypoints.len()).sum();
        let is_inside = |pair: &ImagePair| images.contains(&pair.a) && images.contains(&pair.b);
        let pairs = self.graph.pairs().iter().filter(|(pair, _)| is_inside(pair));
        let matches: usize = pairs.map(|(_, view)| view.matches.len()).sum();
        (BYTES_PER_KEYPOINT * keypoints + BYTES_PER_MATCH * matches) as u64
    }

    /// The states of all parts that have tiles, in order.
    ///
    /// # Errors
    ///
    /// A tile cannot be read, is damaged, or is that of a process for a part of another recipe:
    /// somebody may need it, as in the other stages.
    pub(crate) fn found(
        &self,
        workspace: &Workspace,
        recipe: &Recipe,
    ) -> Result<Vec<Option<Vec<u8>>>, Error> {
        let shards: Vec<Shard> = Shard::all(self.count()).collect();
        let mut states = vec![None; self.count()];
        for shard in workspace.with_tiles(Stage::Map) {
            let state = workspace.state_of(shard, recipe)?;
            if let Some(index) = shards.iter().position(|other| *other == shard) {
                states[index] = state;
            }
        }
        Ok(states)
    }

    /// The states of all parts, in order. Those that are not found are mapped, as many at once as
    /// the memory holds, and get a tile.
    pub(crate) fn states(
        &self,
        mut states: Vec<Option<Vec<u8>>>,
        workspace: &Workspace,
        recipe: &Recipe,
        max_memory_bytes: Option<u64>,
        watch: Watch,
    ) -> Result<Vec<Vec<u8>>, Error> {
        let shards: Vec<Shard> = Shard::all(self.count()).collect();
        let keep = |index: usize, state: Vec<u8>, watch: Watch| -> Result<Vec<u8>, Error> {
            let mut tile = workspace.own_tile(Stage::Map, shards[index], recipe)?;
            tile.write_state(&state)?;
            tile.finish()?;
            let images = self.images[index].len();
            let what = format!("sub-map {} of {} images is there", shards[index], images);
            emit(watch, &Event::Noted { what: &what })?;
            Ok(state)
        };
        let first = match states[0].take() {
            Some(first) => first,
            None => keep(0, self.map(0, None, &mut |_| ControlFlow::Continue(()))?, watch)?,
        };
        let missing: Vec<usize> = (1..shards.len()).filter(|k| states[*k].is_none()).collect();
        let budget = max_memory_bytes.unwrap_or_else(budget_bytes);
        let work =
            |index: &usize| self.map(*index, Some(&first), &mut |_| ControlFlow::Continue(()));
        let take = |index: &usize, state: Result<Vec<u8>, Error>| {
            states[*index] = Some(keep(*index, state?, watch)?);
            Ok::<(), Error>(())
        };
        for_each_within_budget(budget, |index| self.bytes(*index), &missing, work, take)?;
        states[0] = Some(first);
        Ok(states.into_iter().flatten().collect())
    }
}

impl Workspace {
    /// The state in the tile of a part; `None` if it has none.
    ///
    /// # Errors
    ///
    /// The tile cannot be read, is damaged or has another recipe.
    pub(crate) fn state_of(&self, shard: Shard, recipe: &Recipe) -> Result<Option<Vec<u8>>, Error> {
        let tile = self.tile_of(Stage::Map, shard, recipe)?;
        Ok(tile.map(|mut tile| tile.read_state()).transpose()?)
    }
}
