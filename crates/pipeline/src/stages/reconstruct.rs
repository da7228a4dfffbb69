use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use crate::stages::dense::dense;
use crate::stages::dense::options::DenseOptions;
use crate::stages::features::{FeatureOptions, extract_features_of};
use crate::stages::foreign_database::import_features;
use crate::stages::mapping::{MapOptions, check_times, map};
use crate::stages::matching::{MatchOptions, match_images};
use crate::stages::positions::PositionPriors;
use crate::stages::video::{OpenedInput, open_input};
use crate::{Error, Report, Stage, Watch, Workspace};

/// Options of [`reconstruct`].
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// A database of another program whose features are taken in place of stage 1, and whose pairs,
    /// if it has any, in place of stage 2.
    pub database: Option<PathBuf>,
    /// Stage 1.
    pub features: FeatureOptions,
    /// Folder with a mask for each image; no keypoints and depths are estimated where a mask is 0.
    pub masks: Option<PathBuf>,
    /// The sharpest of every N frames of a video is used; `None`: as many as time and image motion
    /// ask for.
    pub every: Option<NonZeroUsize>,
    /// Stage 2.
    pub matching: MatchOptions,
    /// Stage 3.
    pub mapping: MapOptions,
    /// Stage 4, which is run if this is given. Its masks are those above.
    pub dense: Option<DenseOptions>,
    /// Runs this stage and the later ones again, even if they are complete.
    pub redo: Option<Stage>,
}

/// Runs all stages: photos or videos in, a COLMAP project out. Complete stages with the same input
/// and options are kept, incomplete ones are resumed.
///
/// # Errors
///
/// Those of [`open_input`], [`extract_features`](crate::stages::extract_features),
/// [`import_features`], [`match_images`], [`map`] and [`dense`]. What mapping cannot do with the
/// cameras and times of the photos is refused before features.
pub fn reconstruct(
    inputs: &[PathBuf],
    workspace: &Path,
    options: &Options,
    watch: Watch,
) -> Result<Report, Error> {
    if let Some(file) = &options.database {
        let mut workspace = Workspace::create(workspace)?;
        import_features(file, inputs, &mut workspace, options.redo, watch)?;
        return finish(workspace, options, watch);
    }
    let (masks, every) = (options.masks.as_deref(), options.every);
    let OpenedInput { mut workspace, photos, timestamps } =
        open_input(inputs, masks, workspace, every, options.redo, watch)?;
    let mut features = options.features.clone();
    features.timestamps = features.timestamps.or(timestamps);
    features.keeps_positions &= options.mapping.position_priors != PositionPriors::Off;
    // What cannot be mapped as asked for is refused before hours of matching. An input model may
    // have further cameras.
    let mapping = &options.mapping;
    let check = |workspace: &Workspace, scene: &_| match mapping.input_model {
        Some(_) => Ok(()),
        None => check_times(workspace, scene, mapping),
    };
    extract_features_of(&photos, &mut workspace, &features, options.redo, &check, watch)?;
    finish(workspace, options, watch)
}

/// Runs the stages after the features.
fn finish(mut workspace: Workspace, options: &Options, watch: Watch) -> Result<Report, Error> {
    match_images(&mut workspace, &options.matching, options.redo, watch)?;
    map(&mut workspace, &options.mapping, options.redo, watch)?;
    if let Some(options_of_dense) = &options.dense {
        let masks = options.masks.clone();
        let all = DenseOptions { masks, ..options_of_dense.clone() };
        dense(&mut workspace, &all, options.redo, watch)?;
    }
    workspace.report()
}
