//! Keys of options in the records. Messages name an option by its key, and a stage as `stage.map`,
//! in backquotes; the program shows its flags and commands instead, and Python its keywords
//! (`cli/src/hints.rs`).

use tiepoint_input::cameras::Calibration;
use tiepoint_io::features::SiftExtractor;
use tiepoint_sfm::matching::NearestNeighbours;

/// Value of an option that is not given.
pub(crate) const NONE: &str = "none";

/// Key of known intrinsics, which the mapper keeps fixed.
pub(crate) const INTRINSICS: &str = "features.intrinsics";

/// Key of the camera model that cameras begin with.
pub(crate) const CAMERA_MODEL: &str = "features.camera_model";
/// Key that tells whether the default camera model was asked for, so that no other is selected.
pub(crate) const KEEPS_CAMERA_MODEL: &str = "features.keep_camera_model";
/// Key that tells whether the images may ask for other camera models.
pub(crate) const SELECT_CAMERA_MODELS: &str = "mapper.select_camera_models";
/// Key of the initial focal length.
pub(crate) const FOCAL_PRIOR: &str = "features.focal_prior";
/// Key of the larger side that photos are reduced to, in pixels.
pub(crate) const MAX_SIZE_KEY: &str = "features.max_size";
/// Key of the limit on the pixels of a photo, in millions.
pub(crate) const MAX_PIXELS_KEY: &str = "features.max_megapixels";

/// Key of the files of known calibrations.
pub(crate) const CALIBRATION_KEY: &str = "features.calibration";
/// Key of the standard deviation of calibrated intrinsics.
pub(crate) const CALIBRATION_SIGMA_KEY: &str = "mapper.calibration_sigma";

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
/// Key of measured positions.
pub(crate) const POSITION_PRIORS_KEY: &str = "mapper.position_priors";
/// Key of control points.
pub(crate) const CONTROL_POINTS_KEY: &str = "mapper.control_points";
/// Key of the file of known rigs.
pub(crate) const RIG_CALIBRATION_KEY: &str = "mapper.rig_calibration";
/// Key that tells whether known extrinsics are refined.
pub(crate) const REFINE_EXTRINSICS_KEY: &str = "mapper.refine.extrinsics";

/// Key of the photos that share a camera.
pub(crate) const CAMERAS_KEY: &str = "features.cameras";

/// How an option differs between two runs, given its values in the records, as in "made with
/// `match.pairs` exhaustive and not sequential:5".
pub(crate) fn difference(key: &str, was: &str, is: &str) -> String {
    let parameter = key.strip_prefix("mapper.refine.").map(|parameter| parameter.replace('_', "-"));
    if let Some(parameter) = parameter {
        let [was, is] = [was, is].map(|value| if value == "true" { "refined" } else { "fixed" });
        return format!("{parameter} {was} and not {is} (`mapper.refine`)");
    }
    if key == KEEPS_CAMERA_MODEL {
        let name = Calibration::DEFAULT_MODEL.name();
        let [was, is] = [was, is].map(|value| if value == NONE { "unset" } else { name });
        return format!("`features.camera_model` {was} and not {is}");
    }
    if key == SELECT_CAMERA_MODELS {
        let [was, is] = [was, is].map(|value| if value == NONE { "as given" } else { "selected" });
        return format!("camera models {was} and not {is}");
    }
    let built_in = [EXTRACTOR, MATCHER].into_iter().find(|(own, _)| *own == key);
    let [was, is] = [was, is].map(|value| match built_in {
        Some((_, name)) if value == NONE => name,
        _ => value,
    });
    format!("`{key}` {was} and not {is}")
}
