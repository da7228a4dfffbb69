//! The options of each stage as texts: a dotted key and a value each.
//!
//! A complete stage is kept as long as these texts are the same, so that they are part of the
//! format of a workspace. Therefore keys and values are written out here instead of being derived
//! from the names of fields and types. Every struct is destructured without `..`, so that a new
//! option does not compile until it has a key. Floating-point numbers have the shortest digits that
//! round-trip. `none` stands for an option that is not given; records leave it out.
//!
//! Stages of existing workspaces become invalid if a value changes its meaning, or if a new key has
//! a value other than `none`.

use tiepoint_input::cameras::{Calibration, CameraGrouping};
use tiepoint_io::features::Extractor;
use tiepoint_sfm::MapperOptions;
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::geometry::{Intrinsics, Loss};
use tiepoint_sfm::matching::Matcher;
use tiepoint_sfm::register::RegisterOptions;
use tiepoint_sfm::rolling_shutter::Readout;
use tiepoint_sfm::tracks::{FilterOptions, TrackOptions};
use tiepoint_sfm::two_view::VerifyOptions;

use crate::stages::dense::options::DenseOptions;
use crate::workspace::option_names::{
    CALIBRATION_KEY, CALIBRATION_SIGMA_KEY, CAMERA_MODEL, CAMERAS_KEY, CONTROL_POINTS_KEY,
    DATABASE, EXTRACTOR, FOCAL_PRIOR, FOUND_PAIRS, INTRINSICS, KEEPS_CAMERA_MODEL, MATCHER,
    MAX_PIXELS_KEY, MAX_SIZE_KEY, NONE, PAIRS, POSITION_PRIORS_KEY, REFINE_EXTRINSICS_KEY,
    RIG_CALIBRATION_KEY, SELECT_CAMERA_MODELS,
};

/// Keys with their values.
type Texts = Vec<(&'static str, String)>;

/// Options of the feature stage. `timestamps`: hash of the file of capture times.
pub(crate) fn feature_options(calibration: &Calibration, timestamps: Option<String>) -> Texts {
    let default = Calibration::DEFAULT_MODEL;
    let (model, focal_px, intrinsics) = match calibration {
        Calibration::Unknown { model, focal_px } => (*model, *focal_px, None),
        Calibration::Known(intrinsics) => (Some(intrinsics.kind()), None, Some(intrinsics)),
    };
    let is_kept = model == Some(default) && intrinsics.is_none();
    let numbers = |intrinsics: &Intrinsics| {
        let params: Vec<String> = intrinsics.params().iter().map(f64::to_string).collect();
        params.join(",")
    };
    vec![
        (CAMERA_MODEL, model.unwrap_or(default).name().to_owned()),
        (KEEPS_CAMERA_MODEL, or_none(is_kept.then_some(true))),
        (FOCAL_PRIOR, or_none(focal_px)),
        (INTRINSICS, or_none(intrinsics.map(numbers))),
        ("features.timestamps", or_none(timestamps)),
    ]
}

/// Name and options of an extractor.
pub(crate) fn extractor_options(
    extractor: &dyn Extractor,
) -> impl Iterator<Item = (String, String)> {
    method_options(EXTRACTOR, extractor.name(), "features.detector", extractor.options())
}

/// Name and options of a method. The name of the built-in one is left out.
fn method_options(
    (key, built_in): (&str, &str),
    name: &str,
    prefix: &'static str,
    options: Texts,
) -> impl Iterator<Item = (String, String)> {
    let name = if name == built_in { NONE } else { name };
    let options = options.into_iter();
    std::iter::once((key.to_owned(), name.to_owned()))
        .chain(options.map(move |(key, value)| (format!("{prefix}.{key}"), value)))
}

/// The larger side that photos are reduced to, an option of the feature stage.
pub(crate) fn max_size_option(max_size: Option<u32>) -> (&'static str, String) {
    (MAX_SIZE_KEY, or_none(max_size.map(|most| most.to_string())))
}

/// The limit on pixels, an option of the feature stage.
pub(crate) fn pixel_limit_option(max_pixels: u64) -> (&'static str, String) {
    (MAX_PIXELS_KEY, (max_pixels as f64 / 1e6).to_string())
}

/// Which photos share a camera, an option of the feature stage.
pub(crate) fn cameras_option(cameras: CameraGrouping) -> (&'static str, String) {
    (CAMERAS_KEY, cameras.to_string())
}

/// Files of known calibrations by their fingerprints, an option of the feature stage.
pub(crate) fn calibration_files_option(files: &[String]) -> (&'static str, String) {
    (CALIBRATION_KEY, or_none((!files.is_empty()).then(|| files.join(" "))))
}

/// The standard deviation of calibrated intrinsics that are refined, an option of the map stage.
pub(crate) fn calibration_sigma_option(sigma_px: Option<f64>) -> (&'static str, String) {
    (CALIBRATION_SIGMA_KEY, or_none(sigma_px.map(|sigma_px| format!("{sigma_px}px"))))
}

/// Known rigs by the hash of their file, and whether they are refined: options of the map stage.
pub(crate) fn rig_calibration_options(hash: Option<String>, is_refined: bool) -> Texts {
    vec![(RIG_CALIBRATION_KEY, or_none(hash)), (REFINE_EXTRINSICS_KEY, is_refined.to_string())]
}

/// Control points by the hash of their file, an option of the map stage.
pub(crate) fn control_points_option(hash: Option<String>) -> (&'static str, String) {
    (CONTROL_POINTS_KEY, or_none(hash))
}

/// Measured positions by their hash, an option of the map stage.
pub(crate) fn position_priors_option(hash: Option<String>) -> (&'static str, String) {
    (POSITION_PRIORS_KEY, or_none(hash))
}

/// The number of images of a sub-map.
pub(crate) fn submaps_option(size: Option<usize>) -> (&'static str, String) {
    ("mapper.submaps", or_none(size.map(|size| size.to_string())))
}

/// Options of the match stage. `pairs`: in the format of the command line, or
/// [`PAIRS_OF_DATABASE`](crate::workspace::option_names::PAIRS_OF_DATABASE).
pub(crate) fn matching_options(pairs: String, verify: &VerifyOptions, seed: u64) -> Texts {
    let mut texts = vec![(PAIRS, pairs), ("match.seed", seed.to_string())];
    texts.extend(verification_options(verify));
    texts
}

/// Name and options of a matcher.
pub(crate) fn matcher_options(matcher: &dyn Matcher) -> impl Iterator<Item = (String, String)> {
    method_options(MATCHER, matcher.name(), "match.descriptors", matcher.options())
}

/// Options of the map stage.
pub(crate) fn mapping_options(mapper: &MapperOptions, baseline_m: Option<f64>) -> Texts {
    let MapperOptions {
        refine: RefineIntrinsics { focal, aspect, principal_point, distortion, prism },
        // Known by `calibration_sigma_option`.
        keep_calibrations: _,
        select_camera_models,
        tracks:
            TrackOptions {
                max_create_error_px,
                max_merge_error_px,
                min_angle_rad,
                two_view,
                max_transitivity,
            },
        filter: FilterOptions { max_error_px: filter_error_px, min_angle_rad: filter_angle_rad },
        register: RegisterOptions { max_error_px, min_num_inliers, min_inlier_ratio },
        min_initial_inliers,
        min_model_size,
        loss,
        local_images,
        global_growth,
        rig,
        readout,
        seed,
    } = mapper;
    let readout = readout.map(|readout| match readout {
        Readout::Known(time_s) => format!("{time_s}s"),
        Readout::Estimated => "estimate".to_owned(),
    });
    vec![
        ("mapper.baseline", or_none(baseline_m.map(|baseline_m| format!("{baseline_m}m")))),
        (SELECT_CAMERA_MODELS, or_none(select_camera_models.then_some(true))),
        ("mapper.rig", rig.name().to_owned()),
        ("mapper.readout", or_none(readout)),
        ("mapper.seed", seed.to_string()),
        ("mapper.refine.focal", focal.to_string()),
        ("mapper.refine.principal_point", principal_point.to_string()),
        ("mapper.refine.distortion", distortion.to_string()),
        ("mapper.refine.aspect", aspect.to_string()),
        ("mapper.refine.prism", prism.to_string()),
        ("mapper.tracks.max_create_error_px", max_create_error_px.to_string()),
        ("mapper.tracks.max_merge_error_px", max_merge_error_px.to_string()),
        ("mapper.tracks.min_angle_rad", min_angle_rad.to_string()),
        ("mapper.tracks.two_view", two_view.to_string()),
        ("mapper.tracks.max_transitivity", max_transitivity.to_string()),
        ("mapper.filter.max_error_px", filter_error_px.to_string()),
        ("mapper.filter.min_angle_rad", filter_angle_rad.to_string()),
        ("mapper.register.max_error_px", max_error_px.to_string()),
        ("mapper.register.min_num_inliers", min_num_inliers.to_string()),
        ("mapper.register.min_inlier_ratio", min_inlier_ratio.to_string()),
        ("mapper.min_initial_inliers", min_initial_inliers.to_string()),
        ("mapper.min_model_size", min_model_size.to_string()),
        ("mapper.loss", loss_text(loss)),
        ("mapper.local_images", local_images.to_string()),
        ("mapper.global_growth", global_growth.to_string()),
    ]
}

/// The feature stage with the features of another program. `hash`: of its database.
pub(crate) fn database_options(hash: &str, has_pairs: bool) -> Texts {
    vec![(DATABASE, hash.to_owned()), (FOUND_PAIRS, or_none(has_pairs.then_some(true)))]
}

/// Options of geometric verification.
fn verification_options(verify: &VerifyOptions) -> Texts {
    let VerifyOptions { max_error_px, min_num_inliers, min_e_f_inlier_ratio, max_h_inlier_ratio } =
        verify;
    vec![
        ("match.verify.max_error_px", max_error_px.to_string()),
        ("match.verify.min_num_inliers", min_num_inliers.to_string()),
        ("match.verify.min_e_f_inlier_ratio", min_e_f_inlier_ratio.to_string()),
        ("match.verify.max_h_inlier_ratio", max_h_inlier_ratio.to_string()),
    ]
}

/// The model that mapping goes on from; `hash`: of its files.
pub(crate) fn input_model_options(hash: &str, fix_existing_frames: bool) -> Texts {
    vec![
        ("mapper.input_model", hash.to_owned()),
        ("mapper.fix_existing_frames", fix_existing_frames.to_string()),
    ]
}

/// Options of the dense stage.
pub(crate) fn dense_options(options: &DenseOptions) -> Texts {
    // The input covers the content of the masks.
    let DenseOptions { max_image_size, sources, masks: _, write_normal_maps, write_depth_pngs } =
        options;
    vec![
        ("dense.max_image_size", or_none(*max_image_size)),
        ("dense.sources", sources.to_string()),
        ("dense.normal_maps", write_normal_maps.to_string()),
        ("dense.depth_pngs", write_depth_pngs.to_string()),
    ]
}

fn or_none(value: Option<impl ToString>) -> String {
    value.map_or_else(|| NONE.to_owned(), |value| value.to_string())
}

fn loss_text(loss: &Loss) -> String {
    match loss {
        Loss::Trivial => "trivial".to_owned(),
        Loss::Huber(scale) => format!("huber:{scale}"),
        Loss::SoftL1(scale) => format!("soft_l1:{scale}"),
        Loss::Cauchy(scale) => format!("cauchy:{scale}"),
        Loss::GemanMcClure(scale) => format!("geman_mc_clure:{scale}"),
        Loss::Tukey(scale) => format!("tukey:{scale}"),
        Loss::Truncated(scale) => format!("truncated:{scale}"),
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_input::DEFAULT_MAX_PIXELS;
    use tiepoint_io::features::{
        DomainSizes, Limit, Normalization, Options as SiftOptions, Orientation, SiftExtractor,
    };
    use tiepoint_sfm::RigMode;
    use tiepoint_sfm::geometry::CameraModelKind;
    use tiepoint_sfm::matching::forest::Checks;
    use tiepoint_sfm::matching::{
        Method, NearestNeighbours, Options as MatcherOptions, PairSelection, PreemptiveMatching,
    };

    use super::*;

    fn lines<K: std::fmt::Display>(texts: impl IntoIterator<Item = (K, String)>) -> Vec<String> {
        texts.into_iter().map(|(key, value)| format!("{key} = {value}")).collect()
    }

    fn sift_lines(options: SiftOptions) -> Vec<String> {
        lines(extractor_options(&SiftExtractor::new(options).unwrap()))
    }

    fn matcher_lines(options: MatcherOptions) -> Vec<String> {
        lines(matcher_options(&NearestNeighbours::new(options).unwrap()))
    }

    /// Existing workspaces have these texts. Changing a line invalidates all of them.
    #[test]
    fn keys_and_default_values_are_fixed() {
        let found = lines(feature_options(&Calibration::default(), None));
        let expected = [
            "features.camera_model = SIMPLE_RADIAL",
            "features.keep_camera_model = none",
            "features.focal_prior = none",
            "features.intrinsics = none",
            "features.timestamps = none",
        ];
        assert_eq!(found, expected);
        let expected = [
            "features.detector = none",
            "features.detector.first_octave = -1",
            "features.detector.octaves = 4",
            "features.detector.levels = 3",
            "features.detector.peak_threshold = 0.0066666664",
            "features.detector.edge_threshold = 10",
            "features.detector.max_features = 8192",
            "features.detector.limit = whole_levels",
            "features.detector.max_orientations = 2",
            "features.detector.orientation = dominant",
            "features.detector.normalization = root_l1",
        ];
        assert_eq!(sift_lines(SiftOptions::default()), expected);
        let expected = [
            "match.pairs = exhaustive",
            "match.seed = 0",
            "match.verify.max_error_px = 4",
            "match.verify.min_num_inliers = 15",
            "match.verify.min_e_f_inlier_ratio = 0.95",
            "match.verify.max_h_inlier_ratio = 0.8",
        ];
        let pairs = PairSelection::Exhaustive.to_string();
        assert_eq!(lines(matching_options(pairs, &VerifyOptions::default(), 0)), expected);
        let expected = [
            "match.matcher = none",
            "match.descriptors.mutual = true",
            "match.descriptors.method = brute_force",
            "match.descriptors.max_ratio = 0.8",
            "match.descriptors.max_angle_rad = 0.7",
        ];
        assert_eq!(matcher_lines(MatcherOptions::default()), expected);
        let expected = [
            "mapper.baseline = none",
            "mapper.select_camera_models = none",
            "mapper.rig = off",
            "mapper.readout = none",
            "mapper.seed = 0",
            "mapper.refine.focal = true",
            "mapper.refine.principal_point = true",
            "mapper.refine.distortion = true",
            "mapper.refine.aspect = false",
            "mapper.refine.prism = false",
            "mapper.tracks.max_create_error_px = 12",
            "mapper.tracks.max_merge_error_px = 4",
            "mapper.tracks.min_angle_rad = 0.026179938779914945",
            "mapper.tracks.two_view = false",
            "mapper.tracks.max_transitivity = 5",
            "mapper.filter.max_error_px = 4",
            "mapper.filter.min_angle_rad = 0.026179938779914945",
            "mapper.register.max_error_px = 12",
            "mapper.register.min_num_inliers = 30",
            "mapper.register.min_inlier_ratio = 0.25",
            "mapper.min_initial_inliers = 30",
            "mapper.min_model_size = 3",
            "mapper.loss = soft_l1:4",
            "mapper.local_images = 6",
            "mapper.global_growth = 1.1",
        ];
        assert_eq!(lines(mapping_options(&MapperOptions::default(), None)), expected);
        let expected = [
            "dense.max_image_size = none",
            "dense.sources = 8",
            "dense.normal_maps = false",
            "dense.depth_pngs = false",
        ];
        assert_eq!(lines(dense_options(&DenseOptions::default())), expected);
    }

    /// Values that are not the defaults.
    #[test]
    fn texts_of_other_values_are_fixed() {
        let intrinsics =
            Intrinsics::new(CameraModelKind::Pinhole, &[500.25, 501.0, 1e-7, 240.0]).unwrap();
        let sift = SiftOptions {
            peak_threshold: 1e-6,
            limit: Limit::Exact,
            orientation: Orientation::Upright,
            normalization: Normalization::L2,
            domain_sizes: Some(DomainSizes::default()),
            ..SiftOptions::default()
        };
        let known = Calibration::Known(intrinsics);
        let mut found = lines(feature_options(&known, Some("0a1b".to_owned())));
        found.extend(sift_lines(sift));
        for expected in [
            "features.camera_model = PINHOLE",
            "features.focal_prior = none",
            "features.intrinsics = 500.25,501,0.0000001,240",
            "features.timestamps = 0a1b",
            "features.detector.peak_threshold = 0.000001",
            "features.detector.limit = exact",
            "features.detector.orientation = upright",
            "features.detector.normalization = l2",
            "features.detector.domain_sizes.min = 0.16666667",
            "features.detector.domain_sizes.max = 3",
            "features.detector.domain_sizes.count = 10",
        ] {
            assert!(found.iter().any(|line| line == expected), "{expected}: {found:?}");
        }
        let unknown =
            Calibration::Unknown { model: Some(CameraModelKind::Opencv), focal_px: Some(1200.5) };
        let found = lines(feature_options(&unknown, None));
        for expected in [
            "features.camera_model = OPENCV",
            "features.keep_camera_model = none",
            "features.focal_prior = 1200.5",
        ] {
            assert!(found.iter().any(|line| line == expected), "{expected}: {found:?}");
        }

        let pairs: PairSelection = "sequential:10+ends+loops:5".parse().expect("a selection");
        let found = lines(matching_options(pairs.to_string(), &VerifyOptions::default(), u64::MAX));
        for expected in
            ["match.pairs = sequential:10+ends+loops:5", "match.seed = 18446744073709551615"]
        {
            assert!(found.iter().any(|line| line == expected), "{expected}: {found:?}");
        }
        for (method, text) in [
            (Method::Forest(Checks::Total(64)), "forest:total:64"),
            (Method::Cheapest(Checks::PerTree(8)), "cheapest:per_tree:8"),
        ] {
            let preempt = Some(PreemptiveMatching { min_matches: 2 });
            let options = MatcherOptions { max_ratio: None, method, preempt, ..Default::default() };
            let expected = [
                "match.matcher = none",
                "match.descriptors.mutual = true",
                &format!("match.descriptors.method = {text}"),
                "match.descriptors.max_angle_rad = 0.7",
                "match.descriptors.preempt.min_matches = 2",
            ];
            assert_eq!(matcher_lines(options), expected);
        }

        for (mapper, baseline_m, expected) in [
            (
                MapperOptions { rig: RigMode::Paper, ..Default::default() },
                Some(0.62),
                "mapper.baseline = 0.62m",
            ),
            (
                MapperOptions { rig: RigMode::Paper, ..Default::default() },
                None,
                "mapper.rig = paper",
            ),
            (MapperOptions { rig: RigMode::Soft, ..Default::default() }, None, "mapper.rig = soft"),
            (
                MapperOptions { rig: RigMode::Rigid, ..Default::default() },
                None,
                "mapper.rig = rigid",
            ),
            (MapperOptions { rig: RigMode::Auto, ..Default::default() }, None, "mapper.rig = auto"),
            (
                MapperOptions { readout: Some(Readout::Known(0.016)), ..Default::default() },
                None,
                "mapper.readout = 0.016s",
            ),
            (
                MapperOptions { readout: Some(Readout::Estimated), ..Default::default() },
                None,
                "mapper.readout = estimate",
            ),
            (
                MapperOptions { loss: Loss::GemanMcClure(0.5), ..Default::default() },
                None,
                "mapper.loss = geman_mc_clure:0.5",
            ),
            (
                MapperOptions { loss: Loss::Trivial, ..Default::default() },
                None,
                "mapper.loss = trivial",
            ),
        ] {
            let found = lines(mapping_options(&mapper, baseline_m));
            assert!(found.iter().any(|line| line == expected), "{expected}: {found:?}");
        }
    }

    #[test]
    fn keys_are_unique() {
        let mapper = MapperOptions::default();
        let methods = extractor_options(&SiftExtractor::default())
            .chain(matcher_options(&NearestNeighbours::default()))
            .collect::<Vec<_>>();
        let mut keys: Vec<&str> = feature_options(&Calibration::default(), None)
            .into_iter()
            .chain(matching_options(String::new(), &Default::default(), 0))
            .chain([pixel_limit_option(DEFAULT_MAX_PIXELS), cameras_option(CameraGrouping::Auto)])
            .chain([calibration_files_option(&[]), calibration_sigma_option(None)])
            .chain(rig_calibration_options(None, false))
            .chain([position_priors_option(None), submaps_option(None)])
            .chain([control_points_option(None)])
            .chain(mapping_options(&mapper, None))
            .chain(input_model_options("", false))
            .chain(database_options("", false))
            .chain(dense_options(&DenseOptions::default()))
            .map(|(key, _)| key)
            .chain(methods.iter().map(|(key, _)| key.as_str()))
            .collect();
        let count = keys.len();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), count);
    }
}
