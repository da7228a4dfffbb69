//! Keys of options in the records, and their names in messages.

use tiepoint_io::features::SiftExtractor;
use tiepoint_sfm::matching::NearestNeighbours;

/// Value of an option that is not given.
pub(crate) const NONE: &str = "none";

/// Key of known intrinsics, which the mapper keeps fixed.
pub(crate) const INTRINSICS: &str = "features.intrinsics";

/// Key of the initial focal length.
pub(crate) const FOCAL_PRIOR: &str = "features.focal_prior";
/// Key of the limit on the pixels of a photo, in millions.
pub(crate) const MAX_PIXELS_KEY: &str = "features.max_megapixels";

/// Key of the files of known calibrations.
pub(crate) const CALIBRATION_KEY: &str = "features.calibration";
/// Key that tells whether known intrinsics are refined.
pub(crate) const REFINE_KNOWN_KEY: &str = "mapper.refine.known";

/// Key of the database of another program, whose features are taken.
pub(crate) const DATABASE: &str = "features.database";
/// Key that tells whether this database has pairs. It follows from the database.
pub(crate) const FOUND_PAIRS: &str = "found.pairs";
/// Keys of the names of extractor and matcher, which are left out for the built-in ones; and the
/// built-in ones.
pub(crate) const EXTRACTOR: (&str, &str) = ("features.detector", SiftExtractor::NAME);
pub(crate) const MATCHER: (&str, &str) = ("match.matcher", NearestNeighbours::NAME);

/// Key of the pairs to match, and its value for those of a database of another program.
pub(crate) const PAIRS: &str = "match.pairs";
pub(crate) const PAIRS_OF_DATABASE: &str = "database";
/// Key of the file of known rigs.
pub(crate) const RIG_CALIBRATION_KEY: &str = "mapper.rig_calibration";
/// Key that tells whether known extrinsics are refined.
pub(crate) const REFINE_EXTRINSICS_KEY: &str = "mapper.refine.extrinsics";

/// Key of the photos that share a camera.
pub(crate) const CAMERAS_KEY: &str = "features.cameras";

/// How an option differs between two runs, given its values in the records, as in "made with
/// --pairs exhaustive and not sequential:5".
pub(crate) fn difference(key: &str, was: &str, is: &str) -> String {
    let name = shown(key);
    let parameter = match key {
        REFINE_KNOWN_KEY => Some("known intrinsics"),
        _ => name.strip_prefix("--refine "),
    };
    if let Some(parameter) = parameter {
        let [was, is] = [was, is].map(|value| if value == "true" { "refined" } else { "fixed" });
        return format!("{parameter} {was} and not {is} (--refine)");
    }
    let built_in = [EXTRACTOR, MATCHER].into_iter().find(|(own, _)| *own == key);
    let [was, is] = [was, is].map(|value| match built_in {
        Some((_, name)) if value == NONE => name,
        _ => value,
    });
    format!("{name} {was} and not {is}")
}

/// Keys of options of the command line, and their names there.
pub(crate) const ON_COMMAND_LINE: [(&str, &str); 27] = [
    ("dense.max_image_size", "--max-size"),
    ("dense.normal_maps", "--normal-maps"),
    ("dense.depth_pngs", "--depth-pngs"),
    (CALIBRATION_KEY, "--calibration"),
    (REFINE_KNOWN_KEY, "--refine"),
    (REFINE_EXTRINSICS_KEY, "--refine extrinsics"),
    (RIG_CALIBRATION_KEY, "--rig-calibration"),
    ("mapper.refine.aspect", "--refine aspect"),
    ("mapper.refine.distortion", "--refine distortion"),
    ("mapper.refine.focal", "--refine focal"),
    ("mapper.refine.principal_point", "--refine principal-point"),
    ("mapper.refine.prism", "--refine prism"),
    ("features.camera_model", "--camera-model"),
    (DATABASE, "--database"),
    (FOCAL_PRIOR, "--focal-prior"),
    (INTRINSICS, "--intrinsics"),
    (CAMERAS_KEY, "--cameras"),
    (MAX_PIXELS_KEY, "--max-megapixels"),
    ("features.timestamps", "--timestamps"),
    (PAIRS, "--pairs"),
    ("match.seed", "--seed"),
    ("mapper.baseline", "--baseline"),
    ("mapper.fix_existing_frames", "--fix-existing-frames"),
    ("mapper.input_model", "--input-model"),
    ("mapper.readout", "--rolling-shutter"),
    ("mapper.rig", "--rig"),
    ("mapper.seed", "--seed"),
];

/// The name of an option in messages: that on the command line if it has one, else its key.
pub(crate) fn shown(key: &str) -> &str {
    ON_COMMAND_LINE.iter().find(|(own, _)| *own == key).map_or(key, |(_, name)| name)
}
