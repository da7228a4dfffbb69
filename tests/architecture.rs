//! Checks the dependencies between crates against ARCHITECTURE.md, those inside crates, and the
//! sizes of folders and functions.
//!
//! A dependency between crates must be in the list below. A dev-dependency may be any direct or
//! indirect dependency in the list, or one of the crates for tests: the synthesiser and the
//! evaluation. Cargo lists the dependencies.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::{functions, modules};

/// Each crate with the crates that its manifest may name.
const ARROWS: &[(&str, &[&str])] = &[
    ("simd", &[]),
    ("geometry", &["simd"]),
    ("features", &["simd"]),
    ("matching", &["simd", "features"]),
    ("ba", &["simd", "geometry"]),
    ("rig", &["ba", "geometry"]),
    ("scene", &["geometry"]),
    ("eval", &["geometry"]),
    ("dense", &["simd", "geometry", "scene"]),
    ("store", &[]),
    ("io", &["store", "scene", "geometry", "features"]),
    ("input", &["io", "store", "scene", "geometry", "matching"]),
    ("synth", &["simd", "scene", "geometry", "features"]),
    ("adjust", &["ba", "geometry", "scene"]),
    ("sfm", &["features", "matching", "geometry", "ba", "rig", "scene", "adjust"]),
    ("pipeline", &["sfm", "dense", "io", "input", "store", "eval"]),
    ("report", &["pipeline"]),
    ("colmap", &["pipeline"]),
    ("experiments", &["pipeline", "report", "synth"]),
    ("cli", LIBRARIES),
    ("tests", LIBRARIES),
];

const LIBRARIES: &[&str] = &[
    "simd",
    "geometry",
    "features",
    "matching",
    "ba",
    "rig",
    "scene",
    "eval",
    "store",
    "io",
    "input",
    "synth",
    "adjust",
    "sfm",
    "dense",
    "pipeline",
    "report",
    "colmap",
    "experiments",
];

/// Crates whose dependencies with default features have no C code.
const PURE: &[&str] = &[
    "simd", "geometry", "features", "matching", "ba", "rig", "scene", "eval", "store", "io",
    "input", "synth", "adjust", "sfm", "dense",
];

/// Packages that name a C compiler and call none: `generator`, a dependency of kiddo, only has an
/// assembly file for powerpc64, and `blake3` has its feature `pure`.
const ASSEMBLERS: &[&str] = &["generator", "blake3"];

/// Packages of declarations of system calls alone, for crates that call the system itself.
const DECLARATIONS: &[&str] = &["linux-raw-sys", "windows-sys"];

/// Crates that tests and examples of all crates below them may use: synthetic scenes, evaluation,
/// COLMAP's formats.
const FOR_TESTS: &[&str] = &["synth", "eval", "io"];

/// Whether a package compiles or links C code.
fn is_c(package: &str) -> bool {
    package.ends_with("-sys") && !DECLARATIONS.contains(&package)
        || ["cc", "cmake", "bindgen", "pkg-config", "vcpkg"].contains(&package)
}

/// What cargo prints, without network.
pub(crate) fn cargo(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO"))
        .args(arguments)
        .args(["--offline", "--locked"])
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .expect("cargo, which runs this test, can be run");
    assert!(
        output.status.success(),
        "cargo {arguments:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).expect("cargo writes UTF-8")
}

/// The name of a package in [`ARROWS`].
fn short(package: &str) -> Option<&str> {
    if package == "tiepoint" { Some("cli") } else { package.strip_prefix("tiepoint-") }
}

/// A dependency in a manifest.
struct Edge {
    user: String,
    provider: String,
    is_dev: bool,
}

/// The crates of the workspace, and the dependencies between them in the manifests.
fn manifests() -> (BTreeSet<String>, Vec<Edge>) {
    let metadata = cargo(&["metadata", "--no-deps", "--format-version", "1"]);
    let metadata: Value = serde_json::from_str(&metadata).expect("cargo metadata is JSON");
    let mut crates = BTreeSet::new();
    let mut edges = Vec::new();
    for package in metadata["packages"].as_array().expect("packages is a list") {
        let name = package["name"].as_str().expect("a package has a name");
        let user = short(name).unwrap_or_else(|| panic!("{name} is not named tiepoint-…"));
        crates.insert(user.to_owned());
        for dependency in package["dependencies"].as_array().expect("dependencies is a list") {
            let provider = dependency["name"].as_str().and_then(short);
            edges.extend(provider.map(|provider| Edge {
                user: user.to_owned(),
                provider: provider.to_owned(),
                is_dev: dependency["kind"] == "dev",
            }));
        }
    }
    (crates, edges)
}

/// All direct and indirect dependencies that [`ARROWS`] gives a crate.
fn below(user: &str) -> BTreeSet<&'static str> {
    let arrows: BTreeMap<&str, &[&'static str]> = ARROWS.iter().copied().collect();
    let mut reached = BTreeSet::new();
    let mut open = arrows[user].to_vec();
    while let Some(provider) = open.pop() {
        if reached.insert(provider) {
            open.extend(arrows[provider]);
        }
    }
    reached
}

#[test]
fn dependencies_are_those_of_the_list() {
    let (crates, edges) = manifests();
    let arrows: BTreeMap<&str, &[&str]> = ARROWS.iter().copied().collect();
    for name in &crates {
        assert!(
            arrows.contains_key(name.as_str()),
            "crate {name} has no line in the list of arrows"
        );
    }
    for Edge { user, provider, is_dev } in &edges {
        let direct = arrows[user.as_str()].contains(&provider.as_str());
        let by_tests = *is_dev
            && (below(user).contains(provider.as_str())
                || (FOR_TESTS.contains(&provider.as_str())
                    && !below(provider).contains(user.as_str()))
                || (provider == user));
        assert!(direct || by_tests, "{user} <- {provider} is no arrow of ARCHITECTURE.md");
    }
    // Guards against an empty list of edges.
    assert!(edges.iter().any(|edge| edge.user == "scene" && edge.provider == "geometry"));
}

#[test]
fn list_of_dependencies_has_no_cycle() {
    for (user, _) in ARROWS {
        assert!(!below(user).contains(user), "{user} uses itself");
    }
}

/// Neither files of a crate nor its top-level folders use each other in a cycle. `lib.rs` and
/// `main.rs` are in no folder.
#[test]
fn modules_have_no_cycles() {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates");
    let mut looked_at = Vec::new();
    let mut found = Vec::new();
    for (name, _) in ARROWS.iter().filter(|(name, _)| crates.join(name).is_dir()) {
        let cycles = modules::cycles_in(&crates.join(name).join("src"));
        found.extend(cycles.into_iter().map(|cycle| format!("{name}: {cycle}")));
        looked_at.push(*name);
    }
    assert!(LIBRARIES.iter().all(|name| looked_at.contains(name)), "only {looked_at:?}");
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Folders with Rust code.
const CODE: [&str; 5] =
    ["crates", "tests", "bench/criterion/benches", "fuzz/src", "fuzz/fuzz_targets"];

/// The texts of all Rust code by their paths below the root of the repository.
fn code() -> BTreeMap<String, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let below = |folder: &&str| {
        let files = modules::files_below(&root.join(folder)).into_iter();
        let folder = (*folder).to_owned();
        files.map(move |(name, text)| (format!("{folder}/{name}"), text))
    };
    CODE.iter().flat_map(below).collect()
}

/// A folder has at most so many source files: a reader sees at a glance what there is.
const MOST_FILES: usize = 25;
/// Folders that have more, with a number that may only fall.
const CROWDED: &[(&str, usize)] = &[];

#[test]
fn folders_hold_few_files() {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for file in code().keys() {
        let (folder, _) = file.rsplit_once('/').expect("code is in folders");
        *counts.entry(folder.to_owned()).or_default() += 1;
    }
    assert!(counts.len() > 50, "only {} folders", counts.len());
    let crowded = counts.into_iter().filter(|(_, count)| *count > MOST_FILES);
    at_most(&crowded.collect(), CROWDED.iter().map(|(folder, most)| ((*folder).to_owned(), *most)));
}

/// The body of a function has at most so many lines: it fits on a screen.
const MOST_LINES: usize = 80;
/// Functions that are longer, with the reason. The numbers may only fall.
const LONG: &[(&str, usize, &str)] = &[
    ("crates/cli/src/progress.rs: draw", 101, "an arm for each event"),
    ("crates/dense/src/undistort/rgb_row.rs: mix", 85, "one pass with all values in registers"),
    ("crates/features/src/descriptor.rs: histogram", 107, "one loop with all values in registers"),
    ("crates/geometry/src/testing/solver_laws.rs: solver_problem", 93, "an arm for each solver"),
    (
        "crates/io/tests/io/exports.rs: gltf_has_the_points_and_cameras_of_the_model",
        99,
        "a reader of the format, which only this test needs",
    ),
    ("crates/synth/src/world/building.rs: house", 118, "one random stream gives all of a house"),
    ("crates/synth/src/world/material.rs: face", 86, "an arm for each material"),
    ("fuzz/src/seeds.rs: main", 142, "a list of files"),
];
const MOST_LONG: usize = 12;
/// Functions that are longer for no good reason. The numbers may only fall, and none is added.
const TO_SPLIT: &[(&str, usize)] = &[
    ("crates/cli/src/summary.rs: stages", 140),
    ("crates/cli/tests/program/results.rs: photos_become_a_model_and_a_second_run_keeps_it", 131),
    ("crates/features/src/octave.rs: compute_tile", 132),
    ("crates/io/src/database/rigs.rs: write_rigs", 85),
    ("crates/input/src/cameras/calibration.rs: assign", 113),
    ("crates/pipeline/src/stages/option_keys.rs: texts_of_other_values_are_fixed", 105),
    ("crates/sfm/src/two_view/verify.rs: verify_pair", 86),
];

#[test]
fn functions_are_short() {
    let code = code();
    let lengths: Vec<(String, usize)> = code
        .iter()
        .flat_map(|(file, text)| {
            let lengths = functions::lengths(text).into_iter();
            lengths.map(move |(name, lines)| (format!("{file}: {name}"), lines))
        })
        .collect();
    assert!(lengths.len() > 1000, "only {} functions", lengths.len());
    assert!(LONG.len() <= MOST_LONG, "{} long functions", LONG.len());
    let long = lengths.into_iter().filter(|(_, lines)| *lines > MOST_LINES).collect();
    let listed = LONG.iter().map(|(name, most, _)| (*name, *most)).chain(TO_SPLIT.iter().copied());
    at_most(&long, listed.map(|(name, most)| (name.to_owned(), most)));
}

/// What breaks a rule is in a list of exceptions with its size or a larger one, and nothing else
/// is in the list.
fn at_most(found: &BTreeMap<String, usize>, listed: impl Iterator<Item = (String, usize)>) {
    let mut listed: BTreeMap<String, usize> = listed.collect();
    let mut wrong = Vec::new();
    for (name, size) in found {
        let most = listed.remove(name);
        if most.is_none_or(|most| *size > most) {
            wrong.push(format!("{name} has {size}, the list {most:?}"));
        }
    }
    assert!(wrong.is_empty() && listed.is_empty(), "{wrong:#?}, no longer exceptions: {listed:?}");
}

#[test]
fn pure_crates_carry_no_c() {
    let (crates, _) = manifests();
    for name in PURE.iter().filter(|name| crates.contains(**name)) {
        let package = format!("tiepoint-{name}");
        let tree = cargo(&[
            "tree",
            "-p",
            &package,
            "-e",
            "normal,build",
            "--prefix",
            "depth",
            "--no-dedupe",
        ]);
        // The packages from ours to that of the line.
        let mut path: Vec<&str> = Vec::new();
        for line in tree.lines() {
            let name = line.trim_start_matches(|c: char| c.is_ascii_digit());
            let depth: usize =
                line[..line.len() - name.len()].parse().expect("a line begins with its depth");
            path.truncate(depth);
            let user = path.last().copied().unwrap_or_default();
            path.push(name.split(' ').next().unwrap_or_default());
            let found = path[depth];
            let is_allowed = ASSEMBLERS.contains(&user);
            assert!(
                is_allowed || !is_c(found),
                "{package} brings C code by default: {}",
                path.join(" <- ")
            );
        }
        assert!(tree.contains(&package), "cargo tree lists {package} itself");
    }
}

/// Functions of the standard library that change files.
const CHANGES_FILES: [&str; 11] = [
    "fs::write(",
    "fs::copy(",
    "fs::rename(",
    "fs::remove_",
    "fs::create_dir",
    "fs::hard_link(",
    "fs::set_permissions(",
    "File::create",
    "OpenOptions::new()",
    "symlink(",
    "set_len(",
];
/// Files that may call them: the module for file operations, the code that locks files, and the
/// renderer, which does not depend on `io`.
const MAY_CHANGE_FILES: [&str; 5] = [
    "crates/store/src/disk/mod.rs",
    "crates/store/src/atomic.rs",
    "crates/io/src/database/create.rs",
    "crates/pipeline/src/workspace/folder.rs",
    "crates/synth/src/write.rs",
];

#[test]
fn only_listed_files_change_the_file_system() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut folders = vec![root.join("crates")];
    let mut looked_at = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(&root).unwrap().to_str().unwrap().replace('\\', "/");
            if path.is_dir() {
                let is_source = !["tests", "examples"].iter().any(|other| name.ends_with(other));
                folders.extend(is_source.then_some(path));
            } else if name.ends_with(".rs") && !MAY_CHANGE_FILES.contains(&name.as_str()) {
                looked_at += 1;
                let text = std::fs::read_to_string(&path).unwrap();
                let code = text.split("#[cfg(test)]").next().unwrap();
                for call in CHANGES_FILES {
                    // A whole word, not part of another one such as AtomicFile.
                    let is_called = |line: &str| {
                        let line = line.trim_start();
                        let mut before =
                            line.match_indices(call).map(|(at, _)| line[..at].chars().next_back());
                        let is_word = |c: char| c.is_alphanumeric() || c == '_';
                        !line.starts_with("//") && before.any(|before| !before.is_some_and(is_word))
                    };
                    let at = code.lines().position(is_called).map(|at| at + 1);
                    assert_eq!(at, None, "{name}: {call} is for tiepoint_store::disk alone");
                }
            }
        }
    }
    assert!(looked_at > 100, "only {looked_at} files");
}
