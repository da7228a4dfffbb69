//! The arrows of ARCHITECTURE.md hold: a crate uses the crates that the list below allows, and
//! nothing else.
//!
//! Dependencies must be in the list itself. Dev-dependencies may be any crate below (along the
//! list's arrows), and the synthesiser, which makes scenes for tests of everything above the nouns.
//! What Cargo resolved is asked of Cargo.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::modules;

/// User, and the providers that it may name in its manifest.
const ARROWS: &[(&str, &[&str])] = &[
    ("geometry", &[]),
    ("features", &[]),
    ("matching", &["features"]),
    ("ba", &["geometry"]),
    ("rig", &["ba", "geometry"]),
    ("scene", &["geometry"]),
    ("eval", &["geometry"]),
    ("io", &["scene", "geometry", "features"]),
    ("synth", &["scene", "geometry", "features"]),
    ("sfm", &["features", "matching", "geometry", "ba", "rig", "scene"]),
    ("pipeline", &["sfm", "io", "eval"]),
    ("cli", LIBRARIES),
    ("tests", LIBRARIES),
];

const LIBRARIES: &[&str] = &[
    "geometry", "features", "matching", "ba", "rig", "scene", "eval", "io", "synth", "sfm",
    "pipeline",
];

/// Crates without C code, whatever features they have by default.
const PURE: &[&str] =
    &["geometry", "features", "matching", "ba", "rig", "scene", "eval", "io", "synth", "sfm"];

/// Packages that depend on a C compiler for one file of assembly on machines that we do not build
/// for: `generator`, of kiddo, on powerpc64.
const ASSEMBLERS: &[&str] = &["generator"];

/// The crates that the tests of others may use: one makes scenes, one judges what came out.
const FOR_TESTS: &[&str] = &["synth", "eval"];

/// Packages that compile or link C when they appear among a crate's dependencies.
fn is_c(package: &str) -> bool {
    package.ends_with("-sys")
        || ["cc", "cmake", "bindgen", "pkg-config", "vcpkg"].contains(&package)
}

fn cargo(arguments: &[&str]) -> String {
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

/// The crate's name in the list of arrows.
fn short(package: &str) -> Option<&str> {
    if package == "tiepoint" { Some("cli") } else { package.strip_prefix("tiepoint-") }
}

/// One arrow of a manifest: user, provider, and whether only its tests use it.
struct Edge {
    user: String,
    provider: String,
    is_dev: bool,
}

/// Our crates, and the arrows between them as the manifests have them.
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

/// Everything that a crate reaches along the arrows.
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
fn the_arrows_hold() {
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
    // The list is about this workspace: it knows arrows that are really there.
    assert!(edges.iter().any(|edge| edge.user == "scene" && edge.provider == "geometry"));
}

#[test]
fn the_arrows_have_no_cycle() {
    for (user, _) in ARROWS {
        assert!(!below(user).contains(user), "{user} uses itself");
    }
}

#[test]
fn modules_have_no_circles() {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates");
    let mut looked_at = Vec::new();
    let mut found = Vec::new();
    for (name, _) in ARROWS.iter().filter(|(name, _)| crates.join(name).is_dir()) {
        let circles = modules::circles_in(&crates.join(name).join("src"));
        found.extend(circles.into_iter().map(|circle| format!("{name}: {circle}")));
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
        // The packages on the way from ours to the line's.
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
/// Where they may be called: the one module for it, what locks files, and the renderer, which knows
/// no other crate.
const MAY_CHANGE_FILES: [&str; 5] = [
    "crates/io/src/disk/mod.rs",
    "crates/io/src/atomic.rs",
    "crates/io/src/database/create.rs",
    "crates/pipeline/src/workspace.rs",
    "crates/synth/src/write.rs",
];

#[test]
fn files_are_changed_in_one_place() {
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
                    // A word, and no part of another one such as AtomicFile.
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
