//! The words of Rust source, without comments and without what literals say.

/// A word, or one character of punctuation; `::` is one too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind<'a> {
    Word(&'a str),
    Colons,
    Punctuation(char),
    /// A string, character, number or lifetime.
    Literal,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Token<'a> {
    pub(super) kind: Kind<'a>,
    /// From 1.
    pub(super) line: usize,
}

pub(super) fn tokens(text: &str) -> Vec<Token<'_>> {
    let (mut found, mut line, mut rest) = (Vec::new(), 1, text);
    while !rest.is_empty() {
        let (kind, len) = next(rest);
        found.extend(kind.map(|kind| Token { kind, line }));
        line += rest[..len].matches('\n').count();
        rest = &rest[len..];
    }
    found
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// What the text begins with, and its length in bytes. Space and comments are nothing.
fn next(text: &str) -> (Option<Kind<'_>>, usize) {
    let first = text.chars().next().expect("there is text");
    if text.starts_with("//") {
        return (None, text.find('\n').unwrap_or(text.len()));
    }
    if text.starts_with("/*") {
        return (None, comment(text));
    }
    if let Some(len) = string(text) {
        return (Some(Kind::Literal), len);
    }
    if first == '\'' {
        return (Some(Kind::Literal), quoted(text));
    }
    if is_word(first) {
        // `r#type` is the word `type`.
        let raw = if text.starts_with("r#") { 2 } else { 0 };
        let len = text[raw..].find(|c| !is_word(c)).map_or(text.len(), |len| len + raw);
        let kind = if first.is_ascii_digit() { Kind::Literal } else { Kind::Word(&text[raw..len]) };
        return (Some(kind), len);
    }
    if text.starts_with("::") {
        return (Some(Kind::Colons), 2);
    }
    ((!first.is_whitespace()).then_some(Kind::Punctuation(first)), first.len_utf8())
}

/// The length of a block comment, which may hold others.
fn comment(text: &str) -> usize {
    let (mut depth, mut at) = (0, 0);
    while at < text.len() {
        let rest = &text.as_bytes()[at..];
        let (change, len) = match rest {
            [b'/', b'*', ..] => (1, 2),
            [b'*', b'/', ..] => (-1, 2),
            _ => (0, 1),
        };
        depth += change;
        at += len;
        if depth == 0 {
            break;
        }
    }
    at
}

/// The length of a string, plain, raw, of bytes or of C.
fn string(text: &str) -> Option<usize> {
    let prefix = ["br", "cr", "b", "c", "r", ""].into_iter().find(|prefix| {
        let rest = text.strip_prefix(prefix).map(|rest| rest.trim_start_matches('#'));
        rest.is_some_and(|rest| rest.starts_with('"'))
    })?;
    let after = &text[prefix.len()..];
    let hashes = after.len() - after.trim_start_matches('#').len();
    let body = &after[hashes + 1..];
    let before = prefix.len() + hashes + 1;
    if prefix.ends_with('r') {
        let end = format!("\"{}", "#".repeat(hashes));
        return Some(body.find(&end).map_or(text.len(), |at| before + at + end.len()));
    }
    if hashes > 0 {
        return None;
    }
    Some(closed(body, b'"').map_or(text.len(), |len| before + len))
}

/// The length of a character or lifetime.
fn quoted(text: &str) -> usize {
    let body = &text[1..];
    let Some(first) = body.chars().next() else { return 1 };
    let is_character = first == '\\' || body[first.len_utf8()..].starts_with('\'');
    if is_character {
        return closed(body, b'\'').map_or(text.len(), |len| 1 + len);
    }
    body.find(|c| !is_word(c)).map_or(text.len(), |len| 1 + len)
}

/// Where a literal ends that begins before `body`: behind the first `quote` that no backslash
/// escapes.
fn closed(body: &str, quote: u8) -> Option<usize> {
    let mut escaped = false;
    let is_end = |byte: u8| {
        let ends = byte == quote && !escaped;
        escaped = byte == b'\\' && !escaped;
        ends
    };
    body.bytes().position(is_end).map(|at| at + 1)
}

#[test]
fn comments_and_literals_name_nothing() {
    let text = r####"
        a /* b /* c */ d */ e // f
        "g \" h" r#"i " j"# b"k" 'l' '\'' 'm n::r#type 1.5e3_f64 "\\" o b'p' r"q"
    "####;
    let words = tokens(text).into_iter().filter_map(|token| match token.kind {
        Kind::Word(word) => Some((word, token.line)),
        _ => None,
    });
    // The b of a byte is a word here, which is no path.
    assert_eq!(
        words.collect::<Vec<_>>(),
        [("a", 2), ("e", 2), ("n", 3), ("type", 3), ("o", 3), ("b", 3)]
    );
}
