//! Detection of dependency cycles between the files of a crate.
//!
//! A file depends on another if an import or a path in it names an item that the other defines.
//! Re-exports are followed to the definition, so that `lib.rs` and `mod.rs` count only for their
//! own items. Code for tests, links in documentation, and method calls that do not name the type
//! are ignored.

mod graph;
mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use graph::{Edges, Files, edges};

/// Descriptions of the cycles of a crate with the folder `src`, between its files and between its
/// top-level folders: the members of each cycle, and the edges between them with a line of code
/// each.
pub(crate) fn cycles_in(src: &Path) -> Vec<String> {
    let edges = edges(&files_below(src));
    [cycles(&edges), cycles(&between_folders(&edges))].concat()
}

/// The edges between different top-level folders. Files beside `lib.rs` are in none.
fn between_folders(edges: &Edges) -> Edges {
    let folder = |file: &str| file.split_once('/').map(|(folder, _)| folder.to_owned());
    let mut found = Edges::new();
    for ((user, provider), place) in edges {
        if let (Some(from), Some(to)) = (folder(user), folder(provider))
            && from != to
        {
            found.entry((from, to)).or_insert_with(|| place.clone());
        }
    }
    found
}

/// The texts of the Rust files below a folder by their paths in it.
pub(crate) fn files_below(src: &Path) -> Files {
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

/// Strongly connected components of more than one member.
fn cycles(edges: &Edges) -> Vec<String> {
    let mut uses: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (user, provider) in edges.keys() {
        uses.entry(user).or_default().insert(provider);
    }
    let reach: BTreeMap<&str, BTreeSet<&str>> =
        uses.keys().map(|file| (*file, reached(&uses, file))).collect();
    let mut found = Vec::new();
    let mut seen = BTreeSet::new();
    for (file, below) in reach.iter().filter(|(file, below)| below.contains(*file)) {
        let cycle: BTreeSet<&str> = below
            .iter()
            .copied()
            .filter(|other| reach.get(other).is_some_and(|it| it.contains(file)))
            .collect();
        if !seen.insert(cycle.clone()) {
            continue;
        }
        let mut text = format!("{} in a cycle: {cycle:?}", cycle.len());
        for ((user, provider), place) in edges {
            if cycle.contains(user.as_str()) && cycle.contains(provider.as_str()) {
                text += &format!("\n  {user} -> {provider} ({place})");
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

    /// A cycle through a module whose item a child uses, and through a path within an expression.
    #[test]
    fn cycles_are_found() {
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
        let cycles = cycles(&found);
        assert_eq!(cycles.len(), 1, "{cycles:?}");
        assert!(
            cycles[0].starts_with(r#"3 in a cycle: {"a/inner.rs", "a/mod.rs", "b.rs"}"#),
            "{cycles:?}"
        );
        assert!(cycles[0].contains("b.rs -> a/mod.rs (b.rs:1: crate::Outer::f)"), "{cycles:?}");
    }

    /// No two files use each other here.
    #[test]
    fn cycles_of_folders_are_found() {
        let found = edges(&files(&[
            ("lib.rs", "mod a; mod b; mod c; pub use a::x::f;"),
            ("a/mod.rs", "pub mod x; pub mod y;"),
            ("a/x.rs", "pub fn f() { crate::b::w::g() }"),
            ("a/y.rs", "pub fn h() { crate::c::i() }"),
            ("b/mod.rs", "pub mod w; pub mod z;"),
            ("b/w.rs", "pub fn g() {}"),
            ("b/z.rs", "fn j() { crate::a::y::h() }"),
            ("c.rs", "pub fn i() { crate::b::w::g() }"),
        ]));
        assert_eq!(cycles(&found), [""; 0]);
        assert_eq!(
            cycles(&between_folders(&found)),
            ["2 in a cycle: {\"a\", \"b\"}\n  \
            a -> b (a/x.rs:1: crate::b::w::g)\n  \
            b -> a (b/z.rs:1: crate::a::y::h)"]
        );
    }

    /// Re-exports, a module and a function with the same name, macros, glob imports and inline
    /// modules.
    #[test]
    fn valid_structures_have_no_cycle() {
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
        assert_eq!(cycles(&found), [""; 0]);
    }

    #[test]
    #[should_panic(expected = "a.rs:2: crate::b::C leads nowhere")]
    fn unresolved_path_panics() {
        edges(&files(&[("lib.rs", "mod a; mod b;"), ("a.rs", "\nuse crate::b::C;"), ("b.rs", "")]));
    }
}
