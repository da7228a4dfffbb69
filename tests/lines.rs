//! No line of code, comments or prose is longer than 100 columns.

use std::fs;
use std::path::{Path, PathBuf};

const MAX_COLUMNS: usize = 100;
/// Extensions of the checked files.
const EXTENSIONS: &[&str] = &["rs", "md", "toml", "py", "sh", "yml", "cpp", "html", "js"];
/// Checked scripts without an extension.
const SCRIPTS: &[&str] = &[
    "check",
    "bench/asan",
    "bench/miri",
    "crates/pipeline/src/view/three/build",
    "python/check",
    "release/package",
    "release/wheel",
];
/// Ending of the names of generated files.
const MINIFIED: &str = ".min.js";
/// Folders with generated files.
const GENERATED: &[&str] = &["target", "corpus", "artifacts"];

/// Collects the checked files below a folder.
fn collect_files(dir: &Path, root: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            if !name.starts_with('.') && !GENERATED.contains(&name.as_str()) || name == ".github" {
                collect_files(&path, root, files);
            }
        } else {
            let ending = path.extension().map(|ending| ending.to_string_lossy().into_owned());
            let has_extension = ending.is_some_and(|ending| EXTENSIONS.contains(&ending.as_str()));
            let is_script = SCRIPTS.iter().any(|script| root.join(script) == path);
            if (has_extension || is_script) && !name.ends_with(MINIFIED) {
                files.push(path);
            }
        }
    }
}

/// Numbers of the lines that are too long. Tables, links and code blocks in Markdown may be long.
fn long_lines(path: &Path) -> Vec<usize> {
    let text = fs::read_to_string(path).unwrap();
    let is_markdown = path.extension().is_some_and(|ending| ending == "md");
    let mut is_code = false;
    let mut long = Vec::new();
    for (index, line) in text.lines().enumerate() {
        if is_markdown && line.trim_start().starts_with("```") {
            is_code = !is_code;
        }
        let is_table = line.trim_start().starts_with('|');
        let has_link = line.contains("](") || line.contains("://");
        let may_be_long = is_markdown && (is_code || is_table || has_link);
        if !may_be_long && line.chars().count() > MAX_COLUMNS {
            long.push(index + 1);
        }
    }
    long
}

#[test]
fn lines_have_at_most_100_columns() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let root = root.canonicalize().unwrap();
    let mut files = Vec::new();
    collect_files(&root, &root, &mut files);
    assert!(files.len() > 300, "{} files", files.len());
    let mut long = Vec::new();
    for file in &files {
        for line in long_lines(file) {
            long.push(format!("{}:{line}", file.strip_prefix(&root).unwrap().display()));
        }
    }
    assert!(long.is_empty(), "longer than {MAX_COLUMNS} columns: {long:#?}");
}
