//! `exhaustive_matcher`, `sequential_matcher` and `vocab_tree_matcher`.

use std::sync::Arc;

use tiepoint_colmap::{DatabasePairs, match_database};
use tiepoint_pipeline::Error;
use tiepoint_pipeline::sfm::matching::{self, NearestNeighbours};
use tiepoint_pipeline::sfm::two_view::VerifyOptions;
use tiepoint_pipeline::stages::MatchOptions;

use super::options::Options;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

pub(super) fn exhaustive_matcher(options: &Options, output: &Output) -> Result<(), Failure> {
    run(DatabasePairs::Exhaustive, options, output)
}

pub(super) fn sequential_matcher(options: &Options, output: &Output) -> Result<(), Failure> {
    let pairs = (|| {
        let has_loops = options.flag("SequentialMatching.loop_detection");
        let loops = options.number("SequentialMatching.loop_detection_num_images")?;
        Ok(DatabasePairs::Sequential {
            overlap: options.number("SequentialMatching.overlap")?,
            is_quadratic: options.flag("SequentialMatching.quadratic_overlap"),
            loops: if has_loops { loops } else { 0 },
        })
    })();
    run(pairs.map_err(Failure::Usage)?, options, output)
}

/// The visual words are learnt from the images: a vocabulary is not read.
pub(super) fn vocab_tree_matcher(options: &Options, output: &Output) -> Result<(), Failure> {
    let count = options.number("VocabTreeMatching.num_images").map_err(Failure::Usage)?;
    run(DatabasePairs::Similar(count), options, output)
}

fn run(pairs: DatabasePairs, options: &Options, output: &Output) -> Result<(), Failure> {
    let database = options.required("database_path").map_err(Failure::Usage)?;
    let descriptors = descriptor_options(options).map_err(Failure::Usage)?;
    let matcher = NearestNeighbours::new(descriptors).map_err(Error::from)?;
    let matching = match_options(options, matcher).map_err(Failure::Usage)?;
    let mut progress = Progress::new(output);
    let report = match_database(&database, pairs, &matching, &mut |event| progress.watch(event))?;
    drop(progress);
    output.result(&report, || {
        format!(
            "{} pairs, {} verified, {} inlier matches; {:.1} s\n",
            report.pairs, report.verified_pairs, report.inlier_matches, report.seconds
        )
    })
}

fn descriptor_options(options: &Options) -> Result<matching::Options, String> {
    let real = |name: &str| options.number::<f64>(name);
    Ok(matching::Options {
        max_ratio: Some(real("SiftMatching.max_ratio")?),
        max_angle_rad: Some(real("SiftMatching.max_distance")?),
        mutual: options.flag("SiftMatching.cross_check"),
        ..matching::Options::default()
    })
}

fn match_options(options: &Options, matcher: NearestNeighbours) -> Result<MatchOptions, String> {
    let real = |name: &str| options.number::<f64>(name);
    Ok(MatchOptions {
        matcher: Arc::new(matcher),
        verify: VerifyOptions {
            max_error_px: real("SiftMatching.max_error")?,
            min_num_inliers: options.number("SiftMatching.min_num_inliers")?,
            min_e_f_inlier_ratio: real("TwoViewGeometry.min_E_F_inlier_ratio")?,
            max_h_inlier_ratio: real("TwoViewGeometry.max_H_inlier_ratio")?,
        },
        seed: options.seed()?,
        ..MatchOptions::default()
    })
}
