//! Output to stdout and stderr.

use std::borrow::Cow;
use std::io::{self, ErrorKind, Write};
use std::sync::Arc;
use std::sync::mpsc::Sender;

use serde::Serialize;

use crate::failure::Failure;
use crate::hints::{Reader, for_reader, with_names};
use crate::interrupt::Interrupt;
use crate::message::Message;

/// Where results and progress go, and the interruption state of the run.
#[derive(Clone, Debug)]
pub(crate) struct Output {
    destination: Destination,
    pub(crate) interrupt: Arc<Interrupt>,
}

#[derive(Clone, Debug)]
enum Destination {
    /// Results as text to stdout, progress as a bar on stderr.
    Text,
    /// Results as JSON to stdout, progress as JSON lines to stderr.
    Json,
    /// Both as JSON to a caller in the same process.
    Caller(Sender<Message>),
}

impl Output {
    pub(crate) fn new(json: bool, interrupt: Interrupt) -> Self {
        let destination = if json { Destination::Json } else { Destination::Text };
        Self { destination, interrupt: Arc::new(interrupt) }
    }

    /// Sends results and progress to a caller, who need not receive them.
    pub(crate) fn to_caller(caller: Sender<Message>, interrupt: Arc<Interrupt>) -> Self {
        Self { destination: Destination::Caller(caller), interrupt }
    }

    /// Writes progress as JSON; `false` if it is to be a progress bar.
    pub(crate) fn progress(&self, event: &impl Serialize) -> bool {
        match &self.destination {
            Destination::Text => return false,
            Destination::Json => line_to_stderr(&self.with_names(&json_line(event))),
            Destination::Caller(caller) => {
                let line = self.with_names(&json_line(event)).into_owned();
                let _ = caller.send(Message::Progress(line));
            }
        }
        true
    }

    /// Writes the result to stdout: `value` as one JSON object, or `text`.
    ///
    /// # Errors
    ///
    /// Writing to stdout fails.
    pub(crate) fn result(
        &self,
        value: &impl Serialize,
        text: impl FnOnce() -> String,
    ) -> Result<(), Failure> {
        let printable = || text().split_inclusive('\n').map(printable_line).collect::<String>();
        let shown = || self.for_reader(&printable()).into_owned();
        self.write(value, shown, |json| self.with_names(&json).into_owned())
    }

    /// Writes a text that the program itself generated to stdout: `value` as one JSON object, or
    /// its `text` byte for byte.
    ///
    /// # Errors
    ///
    /// Writing to stdout fails.
    pub(crate) fn generated<T: Serialize>(
        &self,
        value: &T,
        text: impl FnOnce(&T) -> &str,
    ) -> Result<(), Failure> {
        self.write(value, || text(value).to_owned(), |json| json)
    }

    fn write(
        &self,
        value: &impl Serialize,
        text: impl FnOnce() -> String,
        shown: impl FnOnce(String) -> String,
    ) -> Result<(), Failure> {
        match &self.destination {
            Destination::Text => write_result(&text()),
            Destination::Json => write_result(&(shown(json_line(value)) + "\n")),
            Destination::Caller(caller) => {
                let _ = caller.send(Message::Result(shown(json_line(value))));
                Ok(())
            }
        }
    }

    /// A message with the names of options and stages that its reader knows.
    pub(crate) fn for_reader<'a>(&self, message: &'a str) -> Cow<'a, str> {
        for_reader(message, self.reader())
    }

    /// The same for data, in which names of files stand.
    fn with_names<'a>(&self, json: &'a str) -> Cow<'a, str> {
        with_names(json, self.reader())
    }

    fn reader(&self) -> Reader {
        match &self.destination {
            Destination::Text | Destination::Json => Reader::CommandLine,
            Destination::Caller(_) => Reader::Keywords,
        }
    }

    /// Writes a warning to stderr, on one line.
    pub(crate) fn warning(&self, message: &str) {
        let event = serde_json::json!({ "event": "warning", "message": shortened(message) });
        if !self.progress(&event) {
            let line = format!("tiepoint: {}", shortened(message));
            line_to_stderr(&printable(&self.for_reader(&line)));
        }
    }

    /// Writes an error message to stderr, on one line.
    pub(crate) fn error(&self, message: &str) {
        let message = &*self.for_reader(message);
        let message = &*shortened(message);
        match &self.destination {
            Destination::Json => line_to_stderr(&json_line(
                &serde_json::json!({ "event": "error", "message": message }),
            )),
            // A caller gets the error from its call.
            Destination::Text | Destination::Caller(_) => {
                line_to_stderr(&printable(&format!("tiepoint: {message}")));
            }
        }
    }
}

fn write_result(text: &str) -> Result<(), Failure> {
    let mut stdout = io::stdout();
    ignore_broken_pipe(stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()))
        .map_err(|cause| Failure::CouldNot(write_error("the result", &cause)))
}

/// A closed pipe is no error: the reader has read enough.
pub(crate) fn ignore_broken_pipe(outcome: io::Result<()>) -> io::Result<()> {
    outcome.or_else(|cause| if cause.kind() == ErrorKind::BrokenPipe { Ok(()) } else { Err(cause) })
}

/// Error message for a text that could not be written to stdout.
pub(crate) fn write_error(text: &str, cause: &io::Error) -> String {
    format!(
        "cannot write {text} to stdout: {cause}; the result files were kept, so give the same \
        command again"
    )
}

/// Escapes line breaks, control characters and marks of text direction, which file names may
/// contain and which a terminal would interpret.
pub(crate) fn printable(line: &str) -> Cow<'_, str> {
    if !line.contains(commands_terminal) {
        return Cow::Borrowed(line);
    }
    let escaped = |c: char| match c {
        '\n' | '\r' | '\t' => c.escape_debug().to_string(),
        c if commands_terminal(c) => c.escape_unicode().to_string(),
        c => c.to_string(),
    };
    Cow::Owned(line.chars().map(escaped).collect())
}

/// Characters that are kept at either end of a long message: texts from files may have any length.
const SHOWN: usize = 1000;

/// A message with its middle replaced by an ellipsis if it is long.
pub(crate) fn shortened(message: &str) -> Cow<'_, str> {
    if message.chars().nth(2 * SHOWN).is_none() {
        return Cow::Borrowed(message);
    }
    let chars: Vec<char> = message.chars().collect();
    let text = |part: &[char]| part.iter().collect::<String>();
    Cow::Owned(format!("{} … {}", text(&chars[..SHOWN]), text(&chars[chars.len() - SHOWN..])))
}

/// [`printable`] of a line that may end with a line break, which is kept.
fn printable_line(line: &str) -> String {
    match line.strip_suffix('\n') {
        Some(line) => format!("{}\n", printable(line)),
        None => printable(line).into_owned(),
    }
}

/// A value as one line of JSON, with all control characters escaped, also those above U+007E.
pub(crate) fn json_line(value: &impl Serialize) -> String {
    let text =
        serde_json::to_string(value).expect("our own types are JSON: string keys, finite numbers");
    if !text.contains(commands_terminal) {
        return text;
    }
    let escaped = |c: char| {
        // All of them are below U+FFFF.
        if commands_terminal(c) { format!("\\u{:04x}", u32::from(c)) } else { c.to_string() }
    };
    text.chars().map(escaped).collect()
}

/// Control characters, separators of lines and paragraphs, and marks of direction.
fn commands_terminal(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Writes a line to stderr and ignores errors.
pub(crate) fn line_to_stderr(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// The first paragraph of an error message of clap with its tips, on one line.
pub(crate) fn one_sentence(message: &str) -> String {
    let mut paragraphs = message.split("\n\n");
    let join = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let first = join(paragraphs.next().unwrap_or_default());
    let hints = paragraphs
        .flat_map(str::lines)
        .map(str::trim)
        .filter_map(|line| line.strip_prefix("tip: "));
    let hints: Vec<String> = hints.map(|hint| format!("; {}", join(hint))).collect();
    format!("{}{}", first.trim_start_matches("error: "), hints.concat())
}

#[cfg(test)]
mod tests {
    use super::{SHOWN, json_line, one_sentence, printable, printable_line, shortened};

    #[test]
    fn printable_text_has_no_control_characters() {
        assert_eq!(printable("photos/ä b.jpg is empty"), "photos/ä b.jpg is empty");
        assert_eq!(printable("a\nb\u{1b}[31m\r\u{7f}\u{85}"), r"a\nb\u{1b}[31m\r\u{7f}\u{85}");
        assert_eq!(printable("a\u{202e}gpj.exe"), r"a\u{202e}gpj.exe");
        assert_eq!(printable_line("a\u{9b}2J\n"), "a\\u{9b}2J\n");
        assert_eq!(json_line(&"é\u{1b}\u{9b}\u{202e}"), r#""é\u001b\u009b\u202e""#);
    }

    #[test]
    fn long_messages_are_shortened() {
        let whole = "é".repeat(2 * SHOWN);
        assert_eq!(shortened(&whole), whole);
        let long = format!("a{}z", "é".repeat(10_000_000));
        let short = shortened(&long);
        assert!(
            short.starts_with("aé")
                && short.ends_with("éz")
                && short.chars().count() == 2 * SHOWN + 3
        );
    }

    #[test]
    fn clap_message_becomes_one_sentence() {
        let message = "error: unexpected argument '--pair' found\n\n  tip: a similar argument \
        exists: '--pairs'\n\nUsage: tiepoint \
                       match\n\nFor more information, try '--help'.\n";
        let expected = "unexpected argument '--pair' found; a similar argument exists: '--pairs'";
        assert_eq!(one_sentence(message), expected);
        let message = "error: the following required arguments were not provided:\n  --output \
        <WORKSPACE>\n\nUsage: x\n";
        let expected = "the following required arguments were not provided: --output <WORKSPACE>";
        assert_eq!(one_sentence(message), expected);
    }
}
