//! What goes to stdout and stderr.

use std::borrow::Cow;
use std::io::{self, ErrorKind, Write};
use std::sync::Arc;

use serde::Serialize;

use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// How to speak: to people, or in JSON to programs; and whether to go on.
#[derive(Clone, Debug)]
pub(crate) struct Output {
    pub(crate) json: bool,
    pub(crate) interrupt: Arc<Interrupt>,
}

impl Output {
    pub(crate) fn new(json: bool, interrupt: Interrupt) -> Self {
        Self { json, interrupt: Arc::new(interrupt) }
    }

    /// The result, on stdout: one JSON object, or lines for people.
    ///
    /// # Errors
    ///
    /// Stdout does not take it.
    pub(crate) fn result(
        &self,
        value: &impl Serialize,
        text: impl FnOnce() -> String,
    ) -> Result<(), Failure> {
        let text = if self.json {
            serde_json::to_string(value).expect("our own types are JSON: string keys") + "\n"
        } else {
            text()
        };
        let mut stdout = io::stdout();
        written(stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()))
            .map_err(|cause| Failure::CouldNot(not_written("the result", &cause)))
    }

    /// The one sentence that says why nothing more came, on stderr.
    pub(crate) fn error(&self, message: &str) {
        let line = if self.json {
            serde_json::json!({ "event": "error", "message": message }).to_string()
        } else {
            printable(&format!("tiepoint: {message}")).into_owned()
        };
        line_to_stderr(&line);
    }
}

/// What became of a text for stdout. A reader that closed the pipe has read enough.
pub(crate) fn written(outcome: io::Result<()>) -> io::Result<()> {
    outcome.or_else(|cause| if cause.kind() == ErrorKind::BrokenPipe { Ok(()) } else { Err(cause) })
}

/// A sentence on a text that stdout did not take.
pub(crate) fn not_written(what: &str, cause: &io::Error) -> String {
    format!(
        "cannot write {what} to stdout: {cause}; files that were made are kept, so give the same command again"
    )
}

/// A line for people. Names of files may have control characters, which would tear the line or command
/// the terminal: escapes take their place.
pub(crate) fn printable(line: &str) -> Cow<'_, str> {
    if !line.contains(char::is_control) {
        return Cow::Borrowed(line);
    }
    let escaped = |c: char| if c.is_control() { c.escape_debug().to_string() } else { c.to_string() };
    Cow::Owned(line.chars().map(escaped).collect())
}

/// Writes a line to stderr, if anybody reads it.
pub(crate) fn line_to_stderr(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// The first paragraph of clap's message, with its hints, on one line.
pub(crate) fn one_sentence(message: &str) -> String {
    let mut paragraphs = message.split("\n\n");
    let join = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let first = join(paragraphs.next().unwrap_or_default());
    let hints = paragraphs.flat_map(str::lines).map(str::trim).filter_map(|line| line.strip_prefix("tip: "));
    let hints: Vec<String> = hints.map(|hint| format!("; {}", join(hint))).collect();
    format!("{}{}", first.trim_start_matches("error: "), hints.concat())
}

#[cfg(test)]
mod tests {
    use super::{one_sentence, printable};

    #[test]
    fn a_line_for_people_is_one_line() {
        assert_eq!(printable("photos/ä b.jpg is empty"), "photos/ä b.jpg is empty");
        assert_eq!(printable("a\nb\u{1b}[31m\r\u{7f}\u{85}"), r"a\nb\u{1b}[31m\r\u{7f}\u{85}");
    }

    #[test]
    fn a_message_of_clap_becomes_one_sentence() {
        let message = "error: unexpected argument '--pair' found\n\n  tip: a similar argument exists: '--pairs'\n\nUsage: tiepoint \
                       match\n\nFor more information, try '--help'.\n";
        let expected = "unexpected argument '--pair' found; a similar argument exists: '--pairs'";
        assert_eq!(one_sentence(message), expected);
        let message = "error: the following required arguments were not provided:\n  --output <WORKSPACE>\n\nUsage: x\n";
        let expected = "the following required arguments were not provided: --output <WORKSPACE>";
        assert_eq!(one_sentence(message), expected);
    }
}
