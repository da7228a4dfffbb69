//! What crates.io and docs.rs show of each crate: the rules of
//! <https://doc.rust-lang.org/cargo/reference/manifest.html>, which only an upload would check.

use std::path::Path;

use serde_json::Value;

use crate::architecture::cargo;

/// Categories of crates.io that our crates have. An unknown one would be dropped with a warning.
const CATEGORIES: &[&str] = &[
    "algorithms",
    "command-line-utilities",
    "computer-vision",
    "data-structures",
    "encoding",
    "filesystem",
    "mathematics",
    "multimedia::images",
    "parser-implementations",
    "rendering",
    "science::robotics",
    "simulation",
    "visualization",
];
const MAX_KEYWORDS: usize = 5;
const MAX_KEYWORD_LETTERS: usize = 20;

fn texts(value: &Value) -> Vec<&str> {
    value.as_array().unwrap().iter().map(|text| text.as_str().unwrap()).collect()
}

#[test]
fn every_crate_has_what_crates_io_shows() {
    let metadata = cargo(&["metadata", "--no-deps", "--format-version", "1"]);
    let metadata: Value = serde_json::from_str(&metadata).unwrap();
    let mut seen = 0;
    for package in metadata["packages"].as_array().unwrap() {
        let name = package["name"].as_str().unwrap();
        // The list of registries is empty for `publish = false`.
        if package["publish"].is_array() {
            assert_eq!(name, "tiepoint-tests");
            continue;
        }
        seen += 1;
        let description = package["description"].as_str().unwrap();
        assert!(description.len() > 30 && !description.contains('\n'), "{name}: {description}");
        assert_eq!(package["license"], "MIT OR Apache-2.0", "{name}");
        assert!(package["rust_version"].is_string(), "{name}");
        let keywords = texts(&package["keywords"]);
        assert!((1..=MAX_KEYWORDS).contains(&keywords.len()), "{name}: {keywords:?}");
        for keyword in keywords {
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-+".contains(c);
            assert!(
                keyword.len() <= MAX_KEYWORD_LETTERS
                    && keyword.starts_with(|c: char| c.is_ascii_alphanumeric())
                    && keyword.chars().all(is_plain),
                "{name}: {keyword}"
            );
        }
        let categories = texts(&package["categories"]);
        assert!((1..=MAX_KEYWORDS).contains(&categories.len()), "{name}: {categories:?}");
        assert!(categories.iter().all(|c| CATEGORIES.contains(c)), "{name}: {categories:?}");
        // The page of a program is that of its files.
        let page = if name == "tiepoint" { "crate/tiepoint" } else { name };
        assert_eq!(package["documentation"], format!("https://docs.rs/{page}"));
        let folder = Path::new(package["manifest_path"].as_str().unwrap()).parent().unwrap();
        for file in ["README.md", "LICENSE-MIT", "LICENSE-APACHE"] {
            assert!(folder.join(file).is_file(), "{name}: no {file}");
        }
        assert_eq!(package["readme"], "README.md", "{name}");
    }
    assert!(seen > 10, "{seen} crates");
}
