//! The part of YAML that calibrations use: maps, lists and scalars with their lines. Tags, as
//! `!!opencv-matrix`, are ignored. Anchors and aliases are refused: a few lines of them expand to
//! any size.

use std::collections::BTreeSet;
use std::path::Path;

use saphyr_parser::{Event, Parser};

use crate::text::excerpt::Excerpt;
use crate::{Error, Result};

/// A value with the number of its line, counted from 1.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Node {
    pub(crate) line: usize,
    pub(crate) value: Value,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    Scalar(String),
    List(Vec<Node>),
    /// Keys and values in the order of the file; keys are unique.
    Map(Vec<(String, Node)>),
}

/// A list or map that is not complete yet.
enum Open {
    List(usize, Vec<Node>),
    Map(usize, Entries),
}

/// The entries of a map that is not complete yet.
#[derive(Default)]
struct Entries {
    complete: Vec<(String, Node)>,
    keys: BTreeSet<String>,
    /// The key whose value comes next.
    key: Option<String>,
}

/// Parses a text with one document. OpenCV's directive `%YAML:1.0`, which YAML does not know, is
/// ignored, and so is an empty document at the end: `ros2 topic echo` ends each message with `---`.
///
/// # Errors
///
/// If the text is not YAML, has an alias, a key twice, a key that is no scalar, no document or more
/// than one.
pub(crate) fn parse(path: &Path, text: &str) -> Result<Node> {
    let error = |line: usize, what: String| Error::Line { path: path.to_owned(), line, what };
    // As a comment; lines keep their numbers.
    let as_comment = text.starts_with("%YAML:").then(|| format!("#{text}"));
    let mut parser = Parser::new_from_str(as_comment.as_deref().unwrap_or(text));
    let mut open: Vec<Open> = Vec::new();
    let mut root: Option<Node> = None;
    while let Some(event) = parser.next_event() {
        let (event, span) = event.map_err(|cause| {
            error(
                cause.marker().line(),
                format!("is no YAML, or is cut off: {}", Excerpt(cause.info())),
            )
        })?;
        let line = span.start.line();
        let node = match event {
            Event::SequenceStart(..) => {
                open.push(Open::List(line, Vec::new()));
                continue;
            }
            Event::MappingStart(..) => {
                open.push(Open::Map(line, Entries::default()));
                continue;
            }
            Event::Alias(_) => return Err(error(line, "has an alias, give its value".to_owned())),
            Event::Scalar(text, ..) => Node { line, value: Value::Scalar(text.into_owned()) },
            Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                Some(Open::List(line, nodes)) => Node { line, value: Value::List(nodes) },
                Some(Open::Map(line, entries)) => {
                    Node { line, value: Value::Map(entries.complete) }
                }
                None => continue,
            },
            _ => continue,
        };
        match open.last_mut() {
            None if root.is_some() => {
                // The value of an empty document.
                if node.value != Value::Scalar(String::new()) {
                    let what = "a second document begins, one is expected";
                    return Err(error(line, what.to_owned()));
                }
            }
            None => root = Some(node),
            Some(Open::List(_, nodes)) => nodes.push(node),
            Some(Open::Map(_, entries)) => match (entries.key.take(), node.value) {
                (Some(name), value) => {
                    entries.complete.push((name, Node { line: node.line, value }));
                }
                (None, Value::Scalar(name)) => {
                    if !entries.keys.insert(name.clone()) {
                        return Err(error(line, format!("has the key {} twice", Excerpt(&name))));
                    }
                    entries.key = Some(name);
                }
                (None, _) => return Err(error(line, "a key is a list or a map".to_owned())),
            },
        }
    }
    root.ok_or_else(|| Error::content(path, "is empty"))
}

impl Node {
    /// An error at the line of this value.
    pub(crate) fn error(&self, path: &Path, what: impl Into<String>) -> Error {
        Error::Line { path: path.to_owned(), line: self.line, what: what.into() }
    }

    /// The entries of a map; none if this is no map.
    pub(crate) fn entries(&self) -> &[(String, Node)] {
        if let Value::Map(entries) = &self.value { entries } else { &[] }
    }

    /// The value of a key of a map.
    pub(crate) fn get(&self, key: &str) -> Option<&Node> {
        self.entries().iter().find(|(name, _)| name == key).map(|(_, node)| node)
    }

    /// The text of a scalar.
    pub(crate) fn text(&self) -> Option<&str> {
        if let Value::Scalar(text) = &self.value { Some(text) } else { None }
    }

    /// A whole number; `what` names it in the error.
    pub(crate) fn whole(&self, path: &Path, what: &str) -> Result<u32> {
        let number = self.text().and_then(|text| text.parse().ok());
        number.ok_or_else(|| self.error(path, format!("{what} is no whole number")))
    }

    /// A finite number.
    pub(crate) fn number(&self, path: &Path, what: &str) -> Result<f64> {
        let Some(text) = self.text() else {
            return Err(self.error(path, format!("{what} is a list or a map, not a number")));
        };
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => {
                let shown = Excerpt(text);
                Err(self.error(path, format!("{what} is `{shown}`, not a finite number")))
            }
        }
    }

    /// The numbers of a list, also of a list of lists.
    pub(crate) fn numbers(&self, path: &Path, what: &str) -> Result<Vec<f64>> {
        let Value::List(nodes) = &self.value else {
            return Err(self.error(path, format!("{what} is no list of numbers")));
        };
        let mut numbers = Vec::new();
        for node in nodes {
            match &node.value {
                Value::List(_) => numbers.extend(node.numbers(path, what)?),
                _ => numbers.push(node.number(path, what)?),
            }
        }
        Ok(numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn failure(text: &str) -> String {
        parse(Path::new("a.yaml"), text).unwrap_err().to_string()
    }

    #[test]
    fn maps_lists_and_scalars_have_lines() {
        let text = "%YAML:1.0\n---\na: !!opencv-matrix\n   data: [ 1., 2e0,\n     -3 ]\nb: c\n";
        let root = parse(Path::new("a.yaml"), text).unwrap();
        let data = root.get("a").and_then(|a| a.get("data")).unwrap();
        assert_eq!(data.numbers(Path::new("a.yaml"), "data").unwrap(), [1.0, 2.0, -3.0]);
        assert_eq!(root.get("b").unwrap(), &Node { line: 6, value: Value::Scalar("c".to_owned()) });
        assert!(root.get("c").is_none());
    }

    #[test]
    fn an_empty_document_at_the_end_is_ignored() {
        let one = parse(Path::new("a.yaml"), "a: 1\n").unwrap();
        assert_eq!(parse(Path::new("a.yaml"), "a: 1\n---\n").unwrap(), one);
    }

    #[test]
    fn errors_name_the_line() {
        for (text, says) in [
            ("", "is empty"),
            ("a: [1, 2", "line 2: is no YAML, or is cut off"),
            ("a: &x 1\nb: *x\n", "line 2: has an alias"),
            ("a: 1\na: 2\n", "line 2: has the key a twice"),
            ("[1]: 2\n", "a key is a list"),
            ("a: 1\n---\nb: 2\n", "a second document"),
            ("a: 1\n---\n~x\n", "a second document"),
            (&"[".repeat(100_000), "recursion limit"),
        ] {
            assert!(failure(text).contains(says), "{}", failure(text));
        }
    }
}
