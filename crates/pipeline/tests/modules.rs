//! No module uses, around any number of corners, one that uses it: each can be read with what it uses and nothing else.
#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// The sources of each module, with those of its own folder, without comments and tests.
fn modules(src: &Path) -> BTreeMap<String, String> {
    let mut modules: BTreeMap<String, String> = BTreeMap::new();
    let mut folders = vec![src.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = path.strip_prefix(src).unwrap().with_extension("");
            let name = name.iter().next().unwrap().to_str().unwrap().to_owned();
            let text = fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\nmod tests").next().unwrap();
            let lines = code.lines().map(|line| line.split("//").next().unwrap_or_default());
            modules.entry(name).or_default().extend(lines.map(|line| format!("{line}\n")));
        }
    }
    modules
}

/// The names that follow each `start` in a source: one, or the first ones of paths in braces.
fn names_after<'a>(code: &'a str, start: &str) -> Vec<&'a str> {
    let word = |text: &'a str| {
        let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
        &text[..end]
    };
    let mut names = Vec::new();
    for (at, _) in code.match_indices(start) {
        let rest = &code[at + start.len()..];
        let Some(inside) = rest.strip_prefix('{') else {
            names.push(word(rest));
            continue;
        };
        let (mut depth, mut is_first) = (0, true);
        for (at, c) in inside.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => is_first = true,
                c if is_first && !c.is_whitespace() => {
                    names.push(word(&inside[at..]));
                    is_first = false;
                }
                _ => {}
            }
        }
    }
    names
}

#[test]
fn names_are_found() {
    let code = "use crate::{\n    Error, a::{b, c},\n    d,\n};\nuse crate::e::f; crate::g()";
    assert_eq!(names_after(code, "crate::"), ["Error", "a", "d", "e", "g"]);
}

#[test]
fn modules_do_not_use_each_other_in_circles() {
    let mut modules = modules(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    let root = modules.remove("lib").unwrap();
    // What the root gives the names of is used where it is.
    let mut home: BTreeMap<&str, &str> = BTreeMap::new();
    for name in modules.keys() {
        home.insert(name, name);
        home.extend(names_after(&root, &format!("use {name}::")).into_iter().map(|own| (own, name.as_str())));
    }
    let mut uses: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (name, code) in &modules {
        for used in names_after(code, "crate::") {
            let used =
                home.get(used).copied().unwrap_or_else(|| panic!("{name} uses {used} of the root itself"));
            uses.entry(name).or_default().extend((used != name).then_some(used));
        }
    }
    assert!(uses.values().map(BTreeSet::len).sum::<usize>() > modules.len(), "{uses:?}");
    // Whoever uses nothing more is in no circle.
    loop {
        let before = uses.len();
        let users: BTreeSet<&str> = uses.keys().copied().collect();
        uses.retain(|_, used| used.iter().any(|used| users.contains(used)));
        if uses.len() == before {
            break;
        }
    }
    assert!(uses.is_empty(), "in circles, or users of such: {uses:#?}");
}
