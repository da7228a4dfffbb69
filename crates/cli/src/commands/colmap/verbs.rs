//! The verbs: their names, options and work.

use super::options::Options;
use super::spec::Spec;
use super::tables::{
    ALIGNER, ANALYZER, BUNDLE_ADJUSTMENT, CONVERTER, DATABASE, EXHAUSTIVE, EXTRACTION, IMAGE_LIST,
    IMAGES, INPUT, MAPPER, MATCHING, MERGER, OUTPUT, RIGS, SEQUENTIAL, TRIANGULATOR, UNDISTORTER,
    VOCAB_TREE,
};
use super::{features, mapping, matching, models, undistortion};
use crate::failure::Failure;
use crate::output::Output;

/// A command of COLMAP.
pub(super) struct Verb {
    pub(super) name: &'static str,
    options: &'static [&'static [Spec]],
    pub(super) run: fn(&Options, &Output) -> Result<(), Failure>,
}

impl Verb {
    /// Its options without those of all verbs.
    pub(super) fn options(&self) -> impl Iterator<Item = Spec> {
        self.options.iter().flat_map(|group| group.iter().copied())
    }
}

/// The verbs, in the order of their names.
pub(super) const VERBS: &[Verb] = &[
    Verb {
        name: "bundle_adjuster",
        options: &[INPUT, OUTPUT, BUNDLE_ADJUSTMENT],
        run: models::bundle_adjuster,
    },
    Verb {
        name: "exhaustive_matcher",
        options: &[DATABASE, MATCHING, EXHAUSTIVE],
        run: matching::exhaustive_matcher,
    },
    Verb {
        name: "feature_extractor",
        options: &[DATABASE, IMAGES, IMAGE_LIST, EXTRACTION],
        run: features::feature_extractor,
    },
    Verb {
        name: "image_registrator",
        options: &[DATABASE, INPUT, OUTPUT, MAPPER],
        run: mapping::image_registrator,
    },
    Verb {
        name: "image_undistorter",
        options: &[IMAGES, INPUT, OUTPUT, UNDISTORTER],
        run: undistortion::image_undistorter,
    },
    Verb {
        name: "mapper",
        options: &[DATABASE, IMAGES, INPUT, OUTPUT, IMAGE_LIST, MAPPER],
        run: mapping::mapper,
    },
    Verb {
        name: "model_aligner",
        options: &[INPUT, OUTPUT, DATABASE, ALIGNER],
        run: models::model_aligner,
    },
    Verb { name: "model_analyzer", options: &[ANALYZER], run: models::model_analyzer },
    Verb {
        name: "model_converter",
        options: &[INPUT, OUTPUT, CONVERTER],
        run: models::model_converter,
    },
    Verb { name: "model_merger", options: &[MERGER, OUTPUT], run: models::model_merger },
    Verb {
        name: "point_triangulator",
        options: &[DATABASE, IMAGES, INPUT, OUTPUT, TRIANGULATOR, MAPPER],
        run: mapping::point_triangulator,
    },
    Verb {
        name: "rig_configurator",
        options: &[DATABASE, INPUT, OUTPUT, RIGS],
        run: mapping::rig_configurator,
    },
    Verb {
        name: "sequential_matcher",
        options: &[DATABASE, MATCHING, SEQUENTIAL],
        run: matching::sequential_matcher,
    },
    Verb {
        name: "vocab_tree_matcher",
        options: &[DATABASE, MATCHING, VOCAB_TREE],
        run: matching::vocab_tree_matcher,
    },
];

#[cfg(test)]
mod tests {
    use super::super::tables::{ALIASES, GENERAL};
    use super::*;

    #[test]
    fn verbs_are_sorted_and_their_options_have_one_meaning() {
        assert!(VERBS.is_sorted_by_key(|verb| verb.name));
        for verb in VERBS {
            let mut names: Vec<&str> = verb.options().map(|spec| spec.name).collect();
            names.extend(GENERAL.iter().map(|spec| spec.name));
            let count = names.len();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), count, "{}", verb.name);
        }
    }

    #[test]
    fn names_of_colmap_4_have_one_of_colmap_3() {
        let all: Vec<&str> = VERBS.iter().flat_map(Verb::options).map(|spec| spec.name).collect();
        for (new, old) in ALIASES {
            assert!(all.contains(old) && !all.contains(new), "{new}");
        }
    }
}
