//! Circles between the files of a crate.
//!
//! A file uses another where an import or a path in it names what the other defines. What is
//! imported through a module that only re-exports it is an edge to where it is defined, so that
//! `lib.rs` and `mod.rs` count for what they define themselves. Left out are code that is compiled
//! for tests alone, links in documentation, and methods that are called without naming their type.

mod graph;
mod source;
mod tokens;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use graph::{Edges, Files, edges};

/// The circles of a crate, given its folder `src`: for each the files, and the edges between them
/// with one place of each.
pub(crate) fn circles_in(src: &Path) -> Vec<String> {
    circles(&edges(&files_below(src)))
}

fn files_below(src: &Path) -> Files {
    let mut files = Files::new();
    let mut folders = vec![src.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of sources can be listed") {
            let path = entry.expect("a folder of sources can be listed").path();
            let name =
                path.strip_prefix(src).expect("it is below").to_str().expect("names are UTF-8");
            if path.is_dir() {
                folders.push(path);
            } else if name.ends_with(".rs") {
                let text = std::fs::read_to_string(&path).expect("sources are UTF-8");
                files.insert(name.replace('\\', "/"), text);
            }
        }
    }
    files
}

/// Strongly connected components of more than one file.
fn circles(edges: &Edges) -> Vec<String> {
    let mut uses: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (user, provider) in edges.keys() {
        uses.entry(user).or_default().insert(provider);
    }
    let reach: BTreeMap<&str, BTreeSet<&str>> =
        uses.keys().map(|file| (*file, reached(&uses, file))).collect();
    let mut found = Vec::new();
    let mut seen = BTreeSet::new();
    for (file, below) in reach.iter().filter(|(file, below)| below.contains(*file)) {
        let circle: BTreeSet<&str> = below
            .iter()
            .copied()
            .filter(|other| reach.get(other).is_some_and(|it| it.contains(file)))
            .collect();
        if !seen.insert(circle.clone()) {
            continue;
        }
        let mut text = format!("{} files in a circle: {circle:?}", circle.len());
        for ((user, provider), place) in edges {
            if circle.contains(user.as_str()) && circle.contains(provider.as_str()) {
                text += &format!("\n  {user} -> {provider} ({user}:{place})");
            }
        }
        found.push(text);
    }
    found
}

/// The files that a file uses, and those that these use.
fn reached<'a>(uses: &BTreeMap<&str, BTreeSet<&'a str>>, from: &str) -> BTreeSet<&'a str> {
    let direct = |file: &str| uses.get(file).into_iter().flatten().copied();
    let (mut reached, mut open) = (BTreeSet::new(), direct(from).collect::<Vec<_>>());
    while let Some(file) = open.pop() {
        if reached.insert(file) {
            open.extend(direct(file));
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(texts: &[(&str, &str)]) -> Files {
        texts.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).collect()
    }

    fn pairs(edges: &Edges) -> Vec<(&str, &str)> {
        edges.keys().map(|(user, provider)| (user.as_str(), provider.as_str())).collect()
    }

    /// Through a module that defines what a child uses, and by a path amid code.
    #[test]
    fn circles_are_found() {
        let found = edges(&files(&[
            ("lib.rs", "mod a; mod b; pub use a::{Outer, inner::Inner};"),
            (
                "a/mod.rs",
                "pub mod inner; mod leaf; pub struct Outer(inner::Inner); pub use leaf::Leaf;",
            ),
            (
                "a/inner.rs",
                "use super::Leaf; use crate::b::c as d; pub struct Inner; fn f() -> u8 { \
                super::leaf::LEN + d() }",
            ),
            (
                "a/leaf.rs",
                "pub struct Leaf; pub const LEN: u8 = 1; #[cfg(test)] mod tests { use \
                crate::Outer; }",
            ),
            ("b.rs", "/* crate::a */ pub fn c() -> u8 { crate::Outer::f(\"crate::b\") }"),
        ]));
        assert_eq!(
            pairs(&found),
            [
                ("a/inner.rs", "a/leaf.rs"),
                ("a/inner.rs", "b.rs"),
                ("a/mod.rs", "a/inner.rs"),
                ("a/mod.rs", "a/leaf.rs"),
                ("b.rs", "a/mod.rs"),
                ("lib.rs", "a/inner.rs"),
                ("lib.rs", "a/mod.rs"),
            ]
        );
        let circles = circles(&found);
        assert_eq!(circles.len(), 1, "{circles:?}");
        assert!(
            circles[0].starts_with(r#"3 files in a circle: {"a/inner.rs", "a/mod.rs", "b.rs"}"#),
            "{circles:?}"
        );
        assert!(circles[0].contains("b.rs -> a/mod.rs (b.rs:1: crate::Outer::f)"), "{circles:?}");
    }

    /// A module that re-exports, a module and a function of one name, a macro, names by `*`, and
    /// inline modules make none.
    #[test]
    fn what_only_looks_like_a_circle_is_none() {
        let found = edges(&files(&[
            (
                "lib.rs",
                "mod a; mod b; mod c; #[macro_export] macro_rules! m { () => { $crate::c::C } }\n \
                pub use a::a;",
            ),
            ("a/mod.rs", "mod x; mod y; pub(super) use x::a; pub(crate) use y::{Y, inner};"),
            (
                "a/x.rs",
                "use super::*; pub fn a() -> Y { inner::f() } macro_rules! z { () => {} } use z;",
            ),
            (
                "a/y.rs",
                "pub struct Y; pub mod inner { use super::Y; pub fn f() -> super::Y { Y } }",
            ),
            ("b.rs", "use crate::a::{self, Y}; use std::a; fn g() -> Y { a::inner::f(); b::h() }"),
            ("c.rs", "pub struct C; use super::a; fn h() { a::Y }"),
        ]));
        assert_eq!(
            pairs(&found),
            [
                ("a/mod.rs", "a/x.rs"),
                ("a/mod.rs", "a/y.rs"),
                ("a/x.rs", "a/y.rs"),
                ("b.rs", "a/y.rs"),
                ("c.rs", "a/y.rs"),
                ("lib.rs", "a/x.rs"),
                ("lib.rs", "c.rs"),
            ]
        );
        assert_eq!(circles(&found), [""; 0]);
    }

    #[test]
    #[should_panic(expected = "a.rs:2: crate::b::C leads nowhere")]
    fn a_path_that_leads_nowhere_is_no_silence() {
        edges(&files(&[("lib.rs", "mod a; mod b;"), ("a.rs", "\nuse crate::b::C;"), ("b.rs", "")]));
    }
}
