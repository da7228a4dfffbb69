use std::path::{Path, PathBuf};

use tiepoint_sfm::MapperOptions;

use crate::{
    Error, FeatureOptions, MatchOptions, Photos, Report, Stage, Watch, Workspace, extract_features, map,
    match_images,
};

/// How to reconstruct.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// First stage.
    pub features: FeatureOptions,
    /// Where nothing is to be detected: a folder with a mask for each image, 0 being out.
    pub masks: Option<PathBuf>,
    /// Second stage.
    pub matching: MatchOptions,
    /// Third stage.
    pub mapper: MapperOptions,
    /// Makes this stage and the later ones anew, whatever there is.
    pub redo: Option<Stage>,
}

/// Photos in, a COLMAP project out: all stages, going on where an earlier run stopped.
pub fn reconstruct(
    inputs: &[PathBuf],
    workspace: &Path,
    options: &Options,
    watch: Watch,
) -> Result<Report, Error> {
    let photos = Photos::open(inputs, options.masks.as_deref())?;
    let mut workspace = Workspace::create(workspace)?;
    extract_features(&photos, &mut workspace, &options.features, options.redo, watch)?;
    match_images(&mut workspace, &options.matching, options.redo, watch)?;
    map(&mut workspace, &options.mapper, options.redo, watch)?;
    workspace.report()
}
