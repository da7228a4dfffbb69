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
use tiepoint_io::features::{
    DomainSizes, Limit, Normalization, Options as DetectorOptions, Orientation,
};
use tiepoint_sfm::geometry::{Intrinsics, Loss};
use tiepoint_sfm::matching::{
    Checks, Method, Options as DescriptorOptions, PairSelection, PreemptiveMatching,
};
use tiepoint_sfm::{
    FilterOptions, MapperOptions, Readout, RefineIntrinsics, RegisterOptions, TrackOptions,
    VerifyOptions,
};

use crate::stages::dense::options::DenseOptions;
use crate::workspace::option_names::{
    CALIBRATION_KEY, CAMERAS_KEY, DATABASE, FOCAL_PRIOR, FOUND_PAIRS, INTRINSICS, MAX_PIXELS_KEY,
    NONE, PAIRS, PAIRS_OF_DATABASE, REFINE_EXTRINSICS_KEY, REFINE_KNOWN_KEY, RIG_CALIBRATION_KEY,
};

/// Keys with their values.
type Texts = Vec<(&'static str, String)>;

/// Options of the feature stage. `timestamps`: hash of the file of capture times.
pub(crate) fn feature_options(
    calibration: &Calibration,
    detector: &DetectorOptions,
    timestamps: Option<String>,
) -> Texts {
    let (model, focal_px, intrinsics) = match calibration {
        Calibration::Unknown { model, focal_px } => (model.name(), *focal_px, None),
        Calibration::Known(intrinsics) => (intrinsics.kind().name(), None, Some(intrinsics)),
    };
    let numbers = |intrinsics: &Intrinsics| {
        let params: Vec<String> = intrinsics.params().iter().map(f64::to_string).collect();
        params.join(",")
    };
    let DetectorOptions {
        first_octave,
        octaves,
        levels,
        peak_threshold,
        edge_threshold,
        max_features,
        limit,
        max_orientations,
        orientation,
        normalization,
        domain_sizes,
    } = detector;
    let limit = match limit {
        Limit::WholeLevels => "whole_levels",
        Limit::Exact => "exact",
    };
    let orientation = match orientation {
        Orientation::Dominant => "dominant",
        Orientation::Upright => "upright",
    };
    let normalization = match normalization {
        Normalization::RootL1 => "root_l1",
        Normalization::L2 => "l2",
    };
    let mut texts = vec![
        ("features.camera_model", model.to_owned()),
        (FOCAL_PRIOR, or_none(focal_px)),
        (INTRINSICS, or_none(intrinsics.map(numbers))),
        ("features.timestamps", or_none(timestamps)),
        ("features.detector.first_octave", first_octave.to_string()),
        ("features.detector.octaves", octaves.to_string()),
        ("features.detector.levels", levels.to_string()),
        ("features.detector.peak_threshold", peak_threshold.to_string()),
        ("features.detector.edge_threshold", edge_threshold.to_string()),
        ("features.detector.max_features", max_features.to_string()),
        ("features.detector.limit", limit.to_owned()),
        ("features.detector.max_orientations", max_orientations.to_string()),
        ("features.detector.orientation", orientation.to_owned()),
        ("features.detector.normalization", normalization.to_owned()),
    ];
    match domain_sizes {
        None => texts.push(("features.detector.domain_sizes", NONE.to_owned())),
        Some(DomainSizes { min, max, count }) => texts.extend([
            ("features.detector.domain_sizes.min", min.to_string()),
            ("features.detector.domain_sizes.max", max.to_string()),
            ("features.detector.domain_sizes.count", count.to_string()),
        ]),
    }
    texts
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

/// Whether known intrinsics are refined, an option of the map stage.
pub(crate) fn known_intrinsics_option(refine: bool) -> (&'static str, String) {
    (REFINE_KNOWN_KEY, refine.to_string())
}

/// Known rigs by the hash of their file, and whether they are refined: options of the map stage.
pub(crate) fn rig_calibration_options(hash: Option<String>, is_refined: bool) -> Texts {
    vec![(RIG_CALIBRATION_KEY, or_none(hash)), (REFINE_EXTRINSICS_KEY, is_refined.to_string())]
}

/// Options of the match stage.
pub(crate) fn matching_options(
    pairs: &PairSelection,
    descriptors: &DescriptorOptions,
    verify: &VerifyOptions,
    seed: u64,
) -> Texts {
    let DescriptorOptions { max_ratio, max_angle_rad, mutual, method, preempt } = descriptors;
    let method = match method {
        Method::BruteForce => "brute_force".to_owned(),
        Method::Forest(checks) => format!("forest:{}", checks_text(checks)),
        Method::Cheapest(checks) => format!("cheapest:{}", checks_text(checks)),
    };
    let mut texts = vec![
        // In the format of the command line.
        (PAIRS, pairs.to_string()),
        ("match.seed", seed.to_string()),
        ("match.descriptors.max_ratio", or_none(*max_ratio)),
        ("match.descriptors.max_angle_rad", or_none(*max_angle_rad)),
        ("match.descriptors.mutual", mutual.to_string()),
        ("match.descriptors.method", method),
    ];
    texts.extend(verification_options(verify));
    texts.push(match preempt {
        None => ("match.descriptors.preempt", NONE.to_owned()),
        Some(PreemptiveMatching { min_matches }) => {
            ("match.descriptors.preempt.min_matches", min_matches.to_string())
        }
    });
    texts
}

/// Options of the map stage.
pub(crate) fn mapping_options(mapper: &MapperOptions, baseline_m: Option<f64>) -> Texts {
    let MapperOptions {
        refine: RefineIntrinsics { focal, aspect, principal_point, distortion, prism },
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

/// Options of the match stage with the pairs of another program.
pub(crate) fn imported_pairs_options(verify: &VerifyOptions, seed: u64) -> Texts {
    let mut texts = vec![(PAIRS, PAIRS_OF_DATABASE.to_owned()), ("match.seed", seed.to_string())];
    texts.extend(verification_options(verify));
    texts
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

fn checks_text(checks: &Checks) -> String {
    match checks {
        Checks::Total(checks) => format!("total:{checks}"),
        Checks::PerTree(checks) => format!("per_tree:{checks}"),
    }
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
    use tiepoint_sfm::RigMode;
    use tiepoint_sfm::geometry::CameraModelKind;

    use super::*;

    fn lines(texts: Texts) -> Vec<String> {
        texts.into_iter().map(|(key, value)| format!("{key} = {value}")).collect()
    }

    /// Existing workspaces have these texts. Changing a line invalidates all of them.
    #[test]
    fn keys_and_default_values_are_fixed() {
        let found =
            lines(feature_options(&Calibration::default(), &DetectorOptions::default(), None));
        let expected = [
            "features.camera_model = SIMPLE_RADIAL",
            "features.focal_prior = none",
            "features.intrinsics = none",
            "features.timestamps = none",
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
            "features.detector.domain_sizes = none",
        ];
        assert_eq!(found, expected);
        let (descriptors, verify) = (DescriptorOptions::default(), VerifyOptions::default());
        let expected = [
            "match.pairs = exhaustive",
            "match.seed = 0",
            "match.descriptors.max_ratio = 0.8",
            "match.descriptors.max_angle_rad = 0.7",
            "match.descriptors.mutual = true",
            "match.descriptors.method = brute_force",
            "match.verify.max_error_px = 4",
            "match.verify.min_num_inliers = 15",
            "match.verify.min_e_f_inlier_ratio = 0.95",
            "match.verify.max_h_inlier_ratio = 0.8",
            "match.descriptors.preempt = none",
        ];
        assert_eq!(
            lines(matching_options(&PairSelection::Exhaustive, &descriptors, &verify, 0)),
            expected
        );
        let expected = [
            "mapper.baseline = none",
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
        let detector = DetectorOptions {
            peak_threshold: 1e-6,
            limit: Limit::Exact,
            orientation: Orientation::Upright,
            normalization: Normalization::L2,
            domain_sizes: Some(DomainSizes::default()),
            ..DetectorOptions::default()
        };
        let found = lines(feature_options(
            &Calibration::Known(intrinsics),
            &detector,
            Some("0a1b".to_owned()),
        ));
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
            Calibration::Unknown { model: CameraModelKind::Opencv, focal_px: Some(1200.5) };
        let found = lines(feature_options(&unknown, &detector, None));
        assert_eq!(found[..2], ["features.camera_model = OPENCV", "features.focal_prior = 1200.5"]);

        let pairs = PairSelection::Sequential { overlap: 10, is_closed: true, loops: 5 };
        let descriptors = |method| DescriptorOptions {
            max_ratio: None,
            method,
            preempt: Some(PreemptiveMatching { min_matches: 2 }),
            ..DescriptorOptions::default()
        };
        for (method, text) in [
            (Method::Forest(Checks::Total(64)), "forest:total:64"),
            (Method::Cheapest(Checks::PerTree(8)), "cheapest:per_tree:8"),
        ] {
            let found = lines(matching_options(
                &pairs,
                &descriptors(method),
                &VerifyOptions::default(),
                u64::MAX,
            ));
            for expected in [
                "match.pairs = sequential:10+ends+loops:5",
                "match.seed = 18446744073709551615",
                "match.descriptors.max_ratio = none",
                &format!("match.descriptors.method = {text}"),
                "match.descriptors.preempt.min_matches = 2",
            ] {
                assert!(found.iter().any(|line| line == expected), "{expected}: {found:?}");
            }
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
    fn keys_are_unique_and_include_all_of_the_command_line() {
        let (detector, mapper) = (DetectorOptions::default(), MapperOptions::default());
        let mut keys: Vec<&str> = feature_options(&Calibration::default(), &detector, None)
            .into_iter()
            .chain(matching_options(
                &PairSelection::Exhaustive,
                &Default::default(),
                &Default::default(),
                0,
            ))
            .chain([pixel_limit_option(DEFAULT_MAX_PIXELS), cameras_option(CameraGrouping::Auto)])
            .chain([calibration_files_option(&[]), known_intrinsics_option(false)])
            .chain(rig_calibration_options(None, false))
            .chain(mapping_options(&mapper, None))
            .chain(input_model_options("", false))
            .chain(database_options("", false))
            .chain(dense_options(&DenseOptions::default()))
            .map(|(key, _)| key)
            .collect();
        let count = keys.len();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), count);
    }
}
