//! What goes to stdout and stderr.

use std::io::{self, Write};

use serde::Serialize;

/// How to speak: to people, or in JSON to programs.
pub(crate) struct Output {
    pub(crate) json: bool,
}

impl Output {
    /// The result, on stdout: one JSON object, or lines for people.
    pub(crate) fn result(&self, value: &impl Serialize, text: impl FnOnce() -> String) {
        let text = if self.json {
            serde_json::to_string(value).expect("our own types are JSON: string keys") + "\n"
        } else {
            text()
        };
        // A reader that closed the pipe has read enough.
        let _ = io::stdout().write_all(text.as_bytes());
    }

    /// The one sentence that says why nothing more came, on stderr.
    pub(crate) fn error(&self, message: &str) {
        let line = if self.json {
            serde_json::json!({ "event": "error", "message": message }).to_string()
        } else {
            format!("tiepoint: {message}")
        };
        line_to_stderr(&line);
    }
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
    use super::one_sentence;

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
