//! The verbs: their names, options and work.

use super::options::Options;
use super::spec::Spec;
use super::tables::{
    ALIGNER, ANALYZER, AUTOMATIC, BUNDLE_ADJUSTMENT, CONVERTER, DATABASE, DENSE_WORKSPACE,
    EXHAUSTIVE, EXTRACTION, FUSION, IMAGE_LIST, IMAGES, INPUT, MAPPER, MATCHING, MERGER,
    ORIENTATION, OUTPUT, PATCH_MATCH, RIGS, SEQUENTIAL, TRIANGULATOR, UNDISTORTER, VOCAB_TREE,
};
use super::{automatic, features, mapping, matching, models, stereo, undistortion};
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
        name: "automatic_reconstructor",
        options: &[IMAGES, AUTOMATIC],
        run: automatic::automatic_reconstructor,
    },
    Verb {
        name: "bundle_adjuster",
        options: &[INPUT, OUTPUT, BUNDLE_ADJUSTMENT],
        run: models::bundle_adjuster,
    },
    Verb {
        name: "color_extractor",
        options: &[IMAGES, INPUT, OUTPUT],
        run: models::color_extractor,
    },
    Verb { name: "database_creator", options: &[DATABASE], run: features::database_creator },
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
        name: "model_orientation_aligner",
        options: &[INPUT, OUTPUT, ORIENTATION],
        run: models::model_orientation_aligner,
    },
    Verb {
        name: "patch_match_stereo",
        options: &[DENSE_WORKSPACE, PATCH_MATCH],
        run: stereo::patch_match_stereo,
    },
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
        name: "stereo_fusion",
        options: &[DENSE_WORKSPACE, OUTPUT, FUSION],
        run: stereo::stereo_fusion,
    },
    Verb {
        name: "vocab_tree_matcher",
        options: &[DATABASE, MATCHING, VOCAB_TREE],
        run: matching::vocab_tree_matcher,
    },
];

/// COLMAP's other commands of 3.x and 4.x, in the order of their names, and what serves instead.
pub(super) const OTHERS: &[(&str, &str)] = &[
    ("advancing_front_mesher", NO_MESH),
    ("database_cleaner", DATABASES),
    ("database_merger", DATABASES),
    ("delaunay_mesher", NO_MESH),
    ("feature_importer", "give the database of another program to `tiepoint features --database`"),
    ("geometric_verifier", "the matchers and the mapper verify matches themselves"),
    ("global_mapper", MAPPERS),
    ("gui", "`tiepoint view WORKSPACE` writes a page that a browser shows"),
    ("guided_geometric_verifier", "the matchers and the mapper verify matches themselves"),
    ("hierarchical_mapper", MAPPERS),
    ("image_deleter", MODELS),
    ("image_filterer", MODELS),
    ("image_rectifier", "`image_undistorter` writes undistorted images"),
    ("image_undistorter_standalone", "`tiepoint undistort` takes a model"),
    ("matches_importer", "give a database with matches to `tiepoint features --database`"),
    ("mesh_simplifier", NO_MESH),
    ("mesh_texturer", NO_MESH),
    ("model_clusterer", MODELS),
    ("model_comparer", "`tiepoint evaluate poses MODEL --truth colmap:MODEL` compares models"),
    ("model_cropper", "`tiepoint model crop MODEL --box x1,y1,z1,x2,y2,z2 -o OUT`"),
    ("model_splitter", "`tiepoint model crop` cuts a part out"),
    ("model_transformer", "`tiepoint model transform MODEL --by FILE -o OUT`"),
    ("point_filtering", MODELS),
    ("poisson_mesher", NO_MESH),
    ("pose_prior_mapper", "`tiepoint reconstruct --database FILE` takes `pose_priors`"),
    ("project_generator", "options are given on the command line"),
    ("rotation_averager", MAPPERS),
    ("spatial_matcher", "`sequential_matcher`, or `tiepoint match`, which chooses similar images"),
    ("transitive_matcher", "`exhaustive_matcher` or `tiepoint match`"),
    ("view_graph_calibrator", "`mapper` refines the intrinsics"),
    ("vocab_tree_builder", "`vocab_tree_matcher` needs no file of words"),
    ("vocab_tree_retriever", "`vocab_tree_matcher` finds similar images and matches them"),
];
const NO_MESH: &str = "there are no meshes: give fused.ply of `stereo_fusion` or `tiepoint dense` \
    to COLMAP, OpenMVS or CloudCompare";
const DATABASES: &str = "make a new database with `feature_extractor`, or use COLMAP itself";
const MAPPERS: &str = "`mapper` is the incremental one, the only one here";
const MODELS: &str = "edit the model in Python, or use COLMAP itself";

#[cfg(test)]
mod tests {
    use super::super::tables::{ALIASES, GENERAL};
    use super::*;

    #[test]
    fn verbs_are_sorted_and_their_options_have_one_meaning() {
        assert!(VERBS.is_sorted_by_key(|verb| verb.name));
        assert!(OTHERS.is_sorted_by_key(|other| other.0));
        let is_own = |name: &str| VERBS.iter().any(|verb| verb.name == name);
        assert!(!OTHERS.iter().any(|(name, _)| is_own(name)));
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

    /// The page says how many of COLMAP's commands there are, and names each.
    #[test]
    fn the_page_of_the_verbs_is_true() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/colmap.md");
        // A published package has no such folder.
        let Ok(page) = std::fs::read_to_string(path) else { return };
        let all = VERBS.len() + OTHERS.len();
        assert!(page.contains(&format!("{} of COLMAP's {all} commands", VERBS.len())), "{all}");
        for verb in VERBS {
            assert!(page.contains(&format!("`{}`", verb.name)), "{}", verb.name);
        }
        for (name, instead) in OTHERS {
            let row = format!("| `{name}` | {instead} |");
            assert!(page.contains(&row), "no line {row}");
        }
    }
}
