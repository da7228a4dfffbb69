//! Messages of libraries name no flags and no commands of the program.

use std::path::Path;
use std::str::FromStr;

use proc_macro2::{TokenStream, TokenTree};

use crate::modules::files_below;

/// Crates with an interface of flags: the program, and COLMAP's commands.
const WITH_FLAGS: [&str; 3] = ["cli", "colmap", "experiments"];
/// A file that writes a script of commands of another program.
const SCRIPT: &str = "pipeline/src/models/undistort.rs";

/// The texts in Rust source outside of comments and of the tests at its end.
fn texts(source: &str) -> Vec<String> {
    let code = source.split_once("#[cfg(test)]\nmod ").map_or(source, |(code, _)| code);
    let mut found = Vec::new();
    collect(TokenStream::from_str(code).expect("sources can be parsed"), &mut found);
    found
}

fn collect(tokens: TokenStream, found: &mut Vec<String>) {
    let mut is_doc = false;
    for token in tokens {
        match token {
            TokenTree::Ident(ident) => is_doc = ident == "doc",
            TokenTree::Literal(literal) if !is_doc => found.push(literal.to_string()),
            TokenTree::Group(group) => collect(group.stream(), found),
            TokenTree::Literal(_) | TokenTree::Punct(_) => {}
        }
    }
}

/// Whether a text has a word such as `--pairs`, or names a command.
fn names_a_flag(text: &str) -> bool {
    let is_flag = |(at, _): (usize, &str)| {
        let (before, after) = (&text[..at], &text[at + 2..]);
        !before.ends_with(|c: char| c.is_alphanumeric() || c == '-')
            && after.starts_with(|c: char| c.is_ascii_lowercase())
    };
    text.contains("`tiepoint ") || text.match_indices("--").any(is_flag)
}

#[test]
fn libraries_name_no_flags() {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates");
    let is_library = |file: &str| {
        let mut folders = file.split('/');
        let name = folders.next().expect("it is in a crate");
        !WITH_FLAGS.contains(&name) && folders.next() == Some("src") && file != SCRIPT
    };
    let mut looked_at = 0;
    let mut found = Vec::new();
    for (file, source) in files_below(&crates).into_iter().filter(|(file, _)| is_library(file)) {
        let texts = texts(&source);
        looked_at += texts.len();
        found.extend(
            texts.iter().filter(|text| names_a_flag(text)).map(|text| format!("{file}: {text}")),
        );
    }
    assert!(looked_at > 1000, "only {looked_at} texts");
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn flags_are_found_in_messages_alone() {
    let source = "/// Of --pairs.\n#[error(\"give --pairs\")]\nfn a() { b!(\"x--y ---z -- 1\"); \
                  c(\"run `tiepoint map`\") } // --d\n#[cfg(test)]\nmod tests { \"--e\" }";
    let found: Vec<bool> = texts(source).iter().map(|text| names_a_flag(text)).collect();
    assert_eq!(found, [true, false, true]);
}
