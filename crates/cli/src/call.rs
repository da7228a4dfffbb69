//! A command of the program, run in the process of a caller.

use std::ffi::OsString;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};
use std::thread::{self, JoinHandle};
use std::{fmt, io};

use clap::Parser;

use crate::args::Cli;
use crate::failure::Failure;
use crate::hints::{Reader, for_reader};
use crate::interrupt::Interrupt;
use crate::message::Message;
use crate::output::{Output, one_sentence, shortened};
use crate::{commands, signals};

/// Why a command failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Failed {
    /// The arguments are invalid: the program would end with exit code 2.
    Usage(String),
    /// The work failed: the program would end with exit code 1.
    CouldNot(String),
    /// [`Call::cancel`] stopped it.
    Cancelled,
}

impl fmt::Display for Failed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Usage(message) | Self::CouldNot(message) => f.write_str(message),
            Self::Cancelled => {
                f.write_str("stopped: completed work was kept; call it again to resume")
            }
        }
    }
}

impl std::error::Error for Failed {}

/// A command that runs in a thread of its own. Signals and the standard streams are the caller's.
#[derive(Debug)]
pub struct Call {
    messages: Receiver<Message>,
    interrupt: Arc<Interrupt>,
    thread: JoinHandle<Result<(), Failure>>,
}

impl Call {
    /// Starts a command. `arguments` are those of the program, without its name; `--json` has no
    /// effect.
    ///
    /// # Errors
    ///
    /// The arguments are invalid or ask for help, or the system refuses a thread.
    pub fn start(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, Failed> {
        let program = OsString::from(env!("CARGO_PKG_NAME"));
        let cli =
            Cli::try_parse_from(std::iter::once(program).chain(arguments)).map_err(|error| {
                let message = one_sentence(&error.render().to_string());
                Failed::Usage(for_reader(&message, Reader::Keywords).into_owned())
            })?;
        let interrupt = Arc::new(Interrupt::new(signals::stage_to_redo(&cli.command)));
        let (sender, messages) = mpsc::channel();
        let output = Output::to_caller(sender, Arc::clone(&interrupt));
        let refused =
            |what: &str, cause: &dyn fmt::Display| Failed::CouldNot(format!("{what}: {cause}"));
        let pool = cli
            .threads
            .map(|threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build();
                pool.map_err(|cause| refused(&format!("cannot start {threads} threads"), &cause))
            })
            .transpose()?;
        let run = move || {
            let run = || commands::run(cli.command, &output);
            match pool {
                Some(pool) => pool.install(run),
                None => run(),
            }
        };
        let thread = thread::Builder::new().name("tiepoint".to_owned()).spawn(run);
        let thread = thread.map_err(|cause: io::Error| refused("cannot start a thread", &cause))?;
        Ok(Self { messages, interrupt, thread })
    }

    /// The messages of the command so far and to come. The channel is closed when it ends.
    pub fn messages(&self) -> &Receiver<Message> {
        &self.messages
    }

    /// Stops the command at its next event. Completed work is kept.
    pub fn cancel(&self) {
        self.interrupt.cancel();
    }

    /// Whether the command has ended.
    pub fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    /// Waits for the end of the command.
    ///
    /// # Errors
    ///
    /// The command failed.
    pub fn join(self) -> Result<(), Failed> {
        let internal = |_| {
            let reason = "an internal error stopped it: please report the text above";
            Err(Failure::CouldNot(reason.to_owned()))
        };
        self.thread.join().unwrap_or_else(internal).map_err(Failed::from)
    }
}

impl From<Failure> for Failed {
    fn from(failure: Failure) -> Self {
        let shown = |message: &str| shortened(&for_reader(message, Reader::Keywords)).into_owned();
        match failure {
            Failure::Usage(message) => Self::Usage(shown(&message)),
            Failure::CouldNot(message) => Self::CouldNot(shown(&message)),
            Failure::Cancelled => Self::Cancelled,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn start(arguments: &[&str]) -> Result<Call, Failed> {
        Call::start(arguments.iter().map(OsString::from))
    }

    #[test]
    fn results_and_errors_come_as_values() {
        let call = start(&["completions", "bash", "--threads", "1"]).unwrap();
        let messages: Vec<Message> = call.messages().iter().collect();
        assert!(
            matches!(&messages[..], [Message::Result(text)] if text.starts_with('{')),
            "{messages:?}"
        );
        assert_eq!(call.join(), Ok(()));
        let error = start(&["map"]).unwrap_err();
        assert!(matches!(&error, Failed::Usage(what) if what.contains("WORKSPACE")), "{error}");
        let dir = tempfile::tempdir().unwrap();
        let absent = dir.path().join("absent");
        let error = start(&["map", absent.to_str().unwrap()]).unwrap().join().unwrap_err();
        assert!(matches!(&error, Failed::CouldNot(what) if what.contains("absent")), "{error}");
    }

    #[test]
    fn a_cancelled_command_stops_at_its_next_event() {
        let dir = tempfile::tempdir().unwrap();
        let drive = dir.path().join("drive");
        let length = ["--length", "300", "--size", "64x48"];
        let call =
            start(&[&["synth", "-o", drive.to_str().unwrap()][..], &length].concat()).unwrap();
        assert!(matches!(call.messages().recv(), Ok(Message::Progress(_))));
        call.cancel();
        assert_eq!(call.join(), Err(Failed::Cancelled));
    }
}
