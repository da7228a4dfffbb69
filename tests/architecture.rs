//! Checks the dependencies between crates against ARCHITECTURE.md.
//!
//! A dependency must be in the list below. A dev-dependency may be any direct or indirect
//! dependency in the list, or one of the crates for tests: the synthesiser and the evaluation.
//! Cargo lists the dependencies.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::modules;

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
    ("io", &["scene", "geometry", "features"]),
    ("synth", &["simd", "scene", "geometry", "features"]),
    ("sfm", &["features", "matching", "geometry", "ba", "rig", "scene"]),
    ("pipeline", &["sfm", "dense", "io", "eval"]),
    ("cli", LIBRARIES),
    ("tests", LIBRARIES),
];

const LIBRARIES: &[&str] = &[
    "simd", "geometry", "features", "matching", "ba", "rig", "scene", "eval", "io", "synth", "sfm",
    "dense", "pipeline",
];

/// Crates whose dependencies with default features have no C code.
const PURE: &[&str] = &[
    "simd", "geometry", "features", "matching", "ba", "rig", "scene", "eval", "io", "synth", "sfm",
    "dense",
];

/// Packages that need a C compiler only for an assembly file on unsupported platforms: `generator`,
/// a dependency of kiddo, on powerpc64.
const ASSEMBLERS: &[&str] = &["generator"];

/// Crates that tests of all crates may use: synthetic scenes and evaluation.
const FOR_TESTS: &[&str] = &["synth", "eval"];

/// Whether a package compiles or links C code.
fn is_c(package: &str) -> bool {
    package.ends_with("-sys")
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
    "crates/io/src/disk/mod.rs",
    "crates/io/src/atomic.rs",
    "crates/io/src/database/create.rs",
    "crates/pipeline/src/workspace.rs",
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
                let is_source =
                    !["tests", "benches", "examples"].iter().any(|other| name.ends_with(other));
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
                    assert_eq!(at, None, "{name}: {call} is for tiepoint_io::disk alone");
                }
            }
        }
    }
    assert!(looked_at > 100, "only {looked_at} files");
}
