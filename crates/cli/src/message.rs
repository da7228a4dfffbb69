//! Messages to a caller in the same process.

/// What a command sends to its caller, as JSON.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Message {
    /// An event, as `--json` writes it to stderr.
    Progress(String),
    /// The result, as `--json` writes it to stdout.
    Result(String),
}
