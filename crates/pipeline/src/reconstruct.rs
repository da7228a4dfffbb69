use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use crate::{
    DEFAULT_EVERY, Error, FeatureOptions, MapOptions, MatchOptions, OpenedInput, Report, Stage,
    Watch, extract_features, map, match_images, open_input,
};

/// How to reconstruct.
#[derive(Clone, Debug)]
pub struct Options {
    /// First stage.
    pub features: FeatureOptions,
    /// Where nothing is to be detected: a folder with a mask for each image, 0 being out.
    pub masks: Option<PathBuf>,
    /// Of videos, one frame of so many is taken, the sharpest.
    pub every: NonZeroUsize,
    /// Second stage.
    pub matching: MatchOptions,
    /// Third stage.
    pub mapping: MapOptions,
    /// Makes this stage and the later ones anew, whatever there is.
    pub redo: Option<Stage>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            features: FeatureOptions::default(),
            masks: None,
            every: DEFAULT_EVERY,
            matching: MatchOptions::default(),
            mapping: MapOptions::default(),
            redo: None,
        }
    }
}

/// Photos or videos in, a COLMAP project out: all stages, going on where an earlier run stopped.
pub fn reconstruct(
    inputs: &[PathBuf],
    workspace: &Path,
    options: &Options,
    watch: Watch,
) -> Result<Report, Error> {
    let (masks, every) = (options.masks.as_deref(), options.every);
    let OpenedInput { mut workspace, photos, timestamps } =
        open_input(inputs, masks, workspace, every, options.redo, watch)?;
    let mut features = options.features.clone();
    features.timestamps = features.timestamps.or(timestamps);
    extract_features(&photos, &mut workspace, &features, options.redo, watch)?;
    match_images(&mut workspace, &options.matching, options.redo, watch)?;
    map(&mut workspace, &options.mapping, options.redo, watch)?;
    workspace.report()
}
