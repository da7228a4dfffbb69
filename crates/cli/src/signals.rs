//! SIGINT and SIGTERM: a run stops at its next event, or after a grace period without one. In both
//! cases a final message says how to resume.

use std::sync::mpsc;
use std::time::Duration;
use std::{io, process, thread};

use signal_hook::consts::{SIGINT, SIGTERM};
use tiepoint_pipeline::Stage;

use crate::args::{Command, Dense, Features, Match, Reconstruct};
use crate::output::Output;

/// Polling interval for a received signal.
const POLL: Duration = Duration::from_millis(50);
/// Time for a run to stop at its next event: a database transaction takes less.
const GRACE: Duration = Duration::from_secs(1);
/// Time limit for writing the final message: a reader of stderr may have stopped reading.
const FINAL_MESSAGE_LIMIT: Duration = Duration::from_millis(500);

/// Installs the signal handlers, and starts the thread that exits the program if the run does not
/// stop within the grace period.
///
/// # Errors
///
/// The operating system refuses a handler or a thread.
pub(crate) fn listen(output: &Output) -> io::Result<()> {
    for signal in [SIGINT, SIGTERM] {
        output.interrupt.register(signal)?;
    }
    let output = output.clone();
    thread::Builder::new().name("interrupt".to_owned()).spawn(move || {
        while output.interrupt.signal().is_none() {
            thread::sleep(POLL);
        }
        thread::sleep(GRACE);
        exit_now(&output)
    })?;
    Ok(())
}

/// Prints the final message, if stderr accepts it in time, and exits.
fn exit_now(output: &Output) -> ! {
    let interrupt = &output.interrupt;
    let (message, code) = interrupt.final_message().unwrap_or_default();
    if !interrupt.claim_exit() {
        // The main thread is about to exit.
        thread::sleep(FINAL_MESSAGE_LIMIT);
        process::exit(code.into())
    }
    let (sender, receiver) = mpsc::channel();
    let writer = output.clone();
    // A thread of its own, because writing to stderr may block forever.
    let thread = thread::Builder::new().spawn(move || {
        writer.interrupt.clear_bar();
        writer.error(&message);
        // The receiver may have timed out.
        let _ = sender.send(());
    });
    if thread.is_ok() {
        // The program exits after a timeout, too.
        let _ = receiver.recv_timeout(FINAL_MESSAGE_LIMIT);
    }
    process::exit(code.into())
}

/// The stage of `--redo` whose existing results are replaced from the start. `map` is none: old
/// models stay until the new ones are complete.
pub(crate) fn stage_to_redo(command: &Command) -> Option<Stage> {
    let redo = match command {
        Command::Reconstruct(Reconstruct { redo, .. })
        | Command::Features(Features { redo, .. })
        | Command::Match(Match { redo, .. })
        | Command::Dense(Dense { redo, .. }) => *redo,
        _ => None,
    };
    redo.filter(|stage| *stage != Stage::Map)
}
