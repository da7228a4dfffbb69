//! Conversion of options in records of versions 1 and 2 to the keys of [`crate::option_keys`].
//!
//! These records have a few names, and as values the `#[derive(Debug)]` text of whole structs. The
//! text of a struct is flattened, with the fields as parts of the key. The keys were named after
//! these fields, so that only the few names and values below need a translation.

use std::collections::BTreeMap;

use crate::Stage;
use crate::option_keys::NONE;

/// Names of plain values, and their keys.
const PLAIN: [(Stage, &str, &str); 7] = [
    (Stage::Features, "camera-model", "features.camera_model"),
    (Stage::Features, "focal-prior", "features.focal_prior"),
    (Stage::Features, "intrinsics", "features.intrinsics"),
    (Stage::Features, "timestamps", "features.timestamps"),
    (Stage::Match, "pairs", "match.pairs"),
    (Stage::Match, "seed", "match.seed"),
    (Stage::Map, "baseline", "mapper.baseline"),
];
/// Names whose values are texts of structs, and the prefix of the keys of their fields.
const STRUCTS: [(Stage, &str, &str); 4] = [
    (Stage::Features, "detector", "features.detector"),
    (Stage::Match, "matching", "match.descriptors"),
    (Stage::Match, "verification", "match.verify"),
    (Stage::Map, "mapper", "mapper"),
];
/// Maximum nesting of structs and enums; the options have a nesting of four.
const MAX_DEPTH: usize = 8;

/// The options of a stage by key. An option that cannot be parsed keeps its old name, so that it
/// differs from every option that can be asked for.
pub(crate) fn by_key(stage: Stage, options: &BTreeMap<String, String>) -> BTreeMap<String, String> {
    let mut texts = BTreeMap::new();
    for (name, value) in options {
        let find = |table: &'static [(Stage, &str, &'static str)]| {
            table.iter().find(|(of, own, _)| *of == stage && own == name).map(|(.., key)| *key)
        };
        if let Some(key) = find(&PLAIN) {
            texts.insert(key.to_owned(), value.clone());
        } else if let Some((prefix, debug)) = find(&STRUCTS).zip(Debug::parse(value)) {
            debug.flatten(prefix, &mut texts);
        } else {
            texts.insert(name.clone(), value.clone());
        }
    }
    texts.retain(|_, value| value != NONE);
    // The old value has a space, "0.62 m".
    texts.entry("mapper.baseline".to_owned()).and_modify(|baseline| baseline.retain(|c| c != ' '));
    texts.entry("mapper.readout".to_owned()).and_modify(|readout| {
        if let Some(time_s) = readout.strip_prefix("known:") {
            *readout = format!("{time_s}s");
        } else if readout == "estimated" {
            *readout = "estimate".to_owned();
        }
    });
    texts
}

/// A parsed text of `#[derive(Debug)]`.
#[derive(Debug, PartialEq)]
enum Debug<'a> {
    /// `Name { field: value, .. }`.
    Struct(Vec<(&'a str, Debug<'a>)>),
    /// `Name(value, ..)`; a number, or a name alone, has no values.
    Value(&'a str, Vec<Debug<'a>>),
}

impl<'a> Debug<'a> {
    fn parse(text: &'a str) -> Option<Self> {
        let mut rest = text;
        let value = Self::take(&mut rest, MAX_DEPTH)?;
        rest.is_empty().then_some(value)
    }

    fn take(rest: &mut &'a str, depth: usize) -> Option<Self> {
        let depth = depth.checked_sub(1)?;
        let word = take_word(rest)?;
        if take_str(rest, " {") {
            let mut fields = Vec::new();
            loop {
                take_str(rest, " ");
                let field = take_word(rest)?;
                if !take_str(rest, ": ") {
                    return None;
                }
                fields.push((field, Self::take(rest, depth)?));
                if take_str(rest, " }") {
                    return Some(Self::Struct(fields));
                }
                if !take_str(rest, ",") {
                    return None;
                }
            }
        }
        let mut values = Vec::new();
        if take_str(rest, "(") {
            loop {
                values.push(Self::take(rest, depth)?);
                if take_str(rest, ")") {
                    break;
                }
                if !take_str(rest, ", ") {
                    return None;
                }
            }
        }
        Some(Self::Value(word, values))
    }

    fn flatten(&self, key: &str, texts: &mut BTreeMap<String, String>) {
        match self {
            Self::Struct(fields) => {
                fields
                    .iter()
                    .for_each(|(field, value)| value.flatten(&format!("{key}.{field}"), texts));
            }
            Self::Value("Some", values) => {
                values.iter().for_each(|value| value.flatten(key, texts))
            }
            value => drop(texts.insert(key.to_owned(), value.to_text())),
        }
    }

    fn to_text(&self) -> String {
        let (word, values) = match self {
            Self::Value(word, values) => (*word, values.as_slice()),
            // No enum variant in the options has a struct.
            Self::Struct(_) => ("", [].as_slice()),
        };
        let mut text = match word.parse::<f64>() {
            // Integers may have more digits than a float, and are kept as text.
            Ok(number) if word.parse::<i128>().is_err() => number.to_string(),
            Ok(_) => word.to_owned(),
            Err(_) => snake_case(word),
        };
        for value in values {
            text.push(':');
            text += &value.to_text();
        }
        text
    }
}

/// Takes a name or a number from the start of the text.
fn take_word<'a>(rest: &mut &'a str) -> Option<&'a str> {
    let is_of_word = |c: char| c.is_ascii_alphanumeric() || "_.-+".contains(c);
    let end = rest.find(|c| !is_of_word(c)).unwrap_or(rest.len());
    let (word, after) = rest.split_at(end);
    *rest = after;
    (!word.is_empty()).then_some(word)
}

fn take_str(rest: &mut &str, start: &str) -> bool {
    match rest.strip_prefix(start) {
        Some(after) => {
            *rest = after;
            true
        }
        None => false,
    }
}

/// `RootL1` becomes `root_l1`.
fn snake_case(name: &str) -> String {
    let mut text = String::with_capacity(name.len() + 4);
    for c in name.chars() {
        if c.is_ascii_uppercase() && !text.is_empty() {
            text.push('_');
        }
        text.push(c.to_ascii_lowercase());
    }
    text
}

#[cfg(test)]
mod tests {
    use tiepoint_io::features as sift;
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Loss};
    use tiepoint_sfm::matching::{self, Checks, Ends, Method, PairSelection, PreemptiveMatching};
    use tiepoint_sfm::{MapperOptions, Readout, RefineIntrinsics, RigTerm, VerifyOptions};

    use super::*;
    use crate::cameras::Calibration;
    use crate::option_keys::{of_features, of_mapping, of_matching};

    const PLAIN_DETECTOR: &str = "Options { first_octave: -1, octaves: 4, levels: 3, \
    peak_threshold: 0.0066666664, \
        edge_threshold: 10.0, max_features: 8192, limit: WholeLevels, max_orientations: 2, \
        orientation: Dominant, \
        normalization: RootL1, domain_sizes: None }";
    const VERIFICATION: &str = "VerifyOptions { max_error_px: 4.0, min_num_inliers: 15, \
    min_essential_share: 0.95, \
        max_homography_share: 0.8 }";

    fn legacy(stage: Stage, options: &[(&str, &str)]) -> BTreeMap<String, String> {
        by_key(
            stage,
            &options
                .iter()
                .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
                .collect(),
        )
    }

    fn now(texts: Vec<(&'static str, String)>) -> BTreeMap<String, String> {
        let given = texts.into_iter().filter(|(_, value)| value != NONE);
        given.map(|(key, value)| (key.to_owned(), value)).collect()
    }

    /// The texts are those of the previous version.
    #[test]
    fn feature_options_of_the_previous_version() {
        let unknown = [("camera-model", "SIMPLE_RADIAL"), ("detector", PLAIN_DETECTOR)];
        let (calibration, detector) = (Calibration::default(), sift::Options::default());
        assert_eq!(
            legacy(Stage::Features, &unknown),
            now(of_features(&calibration, &detector, None))
        );

        let calibration = Calibration::Unknown {
            model: CameraModelKind::ThinPrismFisheye,
            focal_px: Some(1200.5),
        };
        let texts = [
            ("camera-model", "THIN_PRISM_FISHEYE"),
            ("focal-prior", "1200.5"),
            ("detector", PLAIN_DETECTOR),
        ];
        assert_eq!(
            legacy(Stage::Features, &texts),
            now(of_features(&calibration, &detector, None))
        );

        let intrinsics =
            Intrinsics::new(CameraModelKind::Pinhole, &[500.25, 501.0, 320.0, 240.0]).unwrap();
        let detector = sift::Options {
            first_octave: 0,
            peak_threshold: 1e-6,
            limit: sift::Limit::Exact,
            orientation: sift::Orientation::Upright,
            normalization: sift::Normalization::L2,
            domain_sizes: Some(sift::DomainSizes::default()),
            ..sift::Options::default()
        };
        let texts = [
            ("camera-model", "PINHOLE"),
            ("intrinsics", "500.25,501,320,240"),
            ("timestamps", "0a1b"),
            (
                "detector",
                "Options { first_octave: 0, octaves: 4, levels: 3, peak_threshold: 1e-6, \
                edge_threshold: 10.0, \
                 max_features: 8192, limit: Exact, max_orientations: 2, orientation: Upright, \
                 normalization: L2, \
                 domain_sizes: Some(DomainSizes { min: 0.16666667, max: 3.0, count: 10 }) }",
            ),
        ];
        let asked =
            of_features(&Calibration::Known(intrinsics), &detector, Some("0a1b".to_owned()));
        assert_eq!(legacy(Stage::Features, &texts), now(asked));
    }

    #[test]
    fn match_options_of_the_previous_version() {
        let texts = [
            (
                "matching",
                "Options { max_ratio: Some(0.8), max_angle_rad: Some(0.7), mutual: true, method: \
                BruteForce, \
                 preempt: None }",
            ),
            ("pairs", "exhaustive"),
            ("seed", "0"),
            ("verification", VERIFICATION),
        ];
        let (descriptors, verify) = (matching::Options::default(), VerifyOptions::default());
        let asked = of_matching(&PairSelection::Exhaustive, &descriptors, &verify, 0);
        assert_eq!(legacy(Stage::Match, &texts), now(asked));

        let texts = [
            (
                "matching",
                "Options { max_ratio: None, max_angle_rad: Some(0.7), mutual: false, method: \
                Cheapest(PerTree(8)), \
                 preempt: Some(Preempt { min_matches: 2 }) }",
            ),
            ("pairs", "sequential:10+ends+loops:5"),
            ("seed", "18446744073709551615"),
            ("verification", VERIFICATION),
        ];
        let descriptors = matching::Options {
            max_ratio: None,
            mutual: false,
            method: Method::Cheapest(Checks::PerTree(8)),
            preempt: Some(PreemptiveMatching { min_matches: 2 }),
            ..matching::Options::default()
        };
        let pairs = PairSelection::Sequential { reach: 10, ends: Ends::Closed, loops: 5 };
        assert_eq!(
            legacy(Stage::Match, &texts),
            now(of_matching(&pairs, &descriptors, &verify, u64::MAX))
        );
    }

    #[test]
    fn map_options_of_the_previous_version() {
        let mapper = |refine: &str, loss: &str, end: &str| {
            format!(
                "MapperOptions {{ refine: RefineIntrinsics {{ focal: {refine}, principal_point: \
                {refine}, \
                 distortion: {refine} }}, tracks: TrackOptions {{ max_create_error_px: 12.0, \
                 max_merge_error_px: 4.0, \
                 min_angle_rad: 0.026179938779914945, two_view: false, max_transitivity: 5 }}, \
                 filter: FilterOptions {{ \
                 max_error_px: 4.0, min_angle_rad: 0.026179938779914945 }}, register: \
                 RegisterOptions {{ \
                 max_error_px: 12.0, min_num_inliers: 30, min_inlier_share: 0.25 }}, \
                 min_initial_inliers: 30, \
                 min_model_size: 3, loss: {loss}, local_images: 6, global_growth: 1.1, {end} }}"
            )
        };
        let auto = MapperOptions { rig: RigTerm::Auto, ..MapperOptions::default() };
        let known = MapperOptions { refine: RefineIntrinsics::NONE, rig: RigTerm::Paper, ..auto };
        let shutter =
            |readout| MapperOptions { readout: Some(readout), seed: 7, ..MapperOptions::default() };
        for (refine, loss, end, baseline_m, options) in [
            ("true", "SoftL1(4.0)", "rig: Auto, readout: None, seed: 0", None, auto),
            ("false", "SoftL1(4.0)", "rig: Paper, readout: None, seed: 0", Some(0.62), known),
            (
                "true",
                "SoftL1(4.0)",
                "rig: Off, readout: Some(Known(-0.016)), seed: 7",
                Some(2.0),
                shutter(Readout::Known(-0.016)),
            ),
            (
                "true",
                "GemanMcClure(0.5)",
                "rig: Off, readout: Some(Estimated), seed: 7",
                None,
                MapperOptions { loss: Loss::GemanMcClure(0.5), ..shutter(Readout::Estimated) },
            ),
        ] {
            let mapper = mapper(refine, loss, end);
            let mut texts = vec![("mapper", mapper.as_str())];
            let baseline = baseline_m.map(|baseline_m: f64| format!("{baseline_m} m"));
            texts.extend(baseline.as_deref().map(|baseline| ("baseline", baseline)));
            assert_eq!(legacy(Stage::Map, &texts), now(of_mapping(&options, baseline_m)), "{end}");
        }
    }

    #[test]
    fn unparsable_options_are_kept() {
        let deep = "A(".repeat(1 << 20);
        for text in [
            "",
            "Options {",
            "Options { a: }",
            "Options { a: 1 } x",
            "Options { a: 1, b }",
            "A(1",
            &deep,
        ] {
            let found = legacy(Stage::Features, &[("detector", text), ("other", "1")]);
            assert_eq!(found.get("detector").map(String::as_str), Some(text));
            assert_eq!(found.get("other").map(String::as_str), Some("1"));
        }
    }
}
