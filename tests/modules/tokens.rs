//! A tokeniser for Rust source that drops comments and the content of literals.

/// The kind of a token.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind<'a> {
    /// An identifier or keyword.
    Word(&'a str),
    /// `::`.
    Colons,
    Punctuation(char),
    /// A string, character, number or lifetime.
    Literal,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Token<'a> {
    pub(super) kind: Kind<'a>,
    /// Number of the line, from 1.
    pub(super) line: usize,
}

/// Splits source text into tokens.
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

/// The first token of the text (`None` for white space and comments), and its length in bytes.
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

/// The length of a block comment, which may be nested.
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

/// The length of a string literal, plain or raw, of characters or bytes, or a C string.
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

/// The length of a character literal or lifetime.
fn quoted(text: &str) -> usize {
    let body = &text[1..];
    let Some(first) = body.chars().next() else { return 1 };
    let is_character = first == '\\' || body[first.len_utf8()..].starts_with('\'');
    if is_character {
        return closed(body, b'\'').map_or(text.len(), |len| 1 + len);
    }
    body.find(|c| !is_word(c)).map_or(text.len(), |len| 1 + len)
}

/// End of a literal that begins before `body`: behind the first `quote` without a backslash.
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
fn comments_and_literals_have_no_words() {
    let text = r####"
        a /* b /* c */ d */ e // f
        "g \" h" r#"i " j"# b"k" 'l' '\'' 'm n::r#type 1.5e3_f64 "\\" o b'p' r"q"
    "####;
    let words = tokens(text).into_iter().filter_map(|token| match token.kind {
        Kind::Word(word) => Some((word, token.line)),
        _ => None,
    });
    // The prefix b of a byte literal is a word here, which does no harm.
    assert_eq!(
        words.collect::<Vec<_>>(),
        [("a", 2), ("e", 2), ("n", 3), ("type", 3), ("o", 3), ("b", 3)]
    );
}
