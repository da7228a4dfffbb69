//! SIGINT and SIGTERM: a run ends at its next event, and where none comes soon, at once. Both end
//! in one sentence that says how to go on.

use std::io;
use std::process;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGINT, SIGTERM};
use tiepoint_pipeline::Stage;

use crate::args::{Command, Features, Match, Reconstruct};
use crate::output::Output;

/// The program looks this often whether a signal came.
const POLL: Duration = Duration::from_millis(50);
/// A run has this long to end by itself: a transaction of the database takes less.
const GRACE: Duration = Duration::from_secs(1);
/// Somebody may hold stderr and not read it. Nobody waits longer than this for the last sentence.
const LAST_WORDS: Duration = Duration::from_millis(500);

/// Takes the signals, and ends the program where the run does not end by itself.
///
/// # Errors
///
/// The system refuses a handler or a thread.
pub(crate) fn listen(output: &Output) -> io::Result<()> {
    for signal in [SIGINT, SIGTERM] {
        output.interrupt.note(signal)?;
    }
    let output = output.clone();
    thread::Builder::new().name("interrupt".to_owned()).spawn(move || {
        while output.interrupt.signal().is_none() {
            thread::sleep(POLL);
        }
        thread::sleep(GRACE);
        end_at_once(&output)
    })?;
    Ok(())
}

/// The last sentence, if it can be said, and the end of the program.
fn end_at_once(output: &Output) -> ! {
    let interrupt = &output.interrupt;
    let (sentence, code) = interrupt.last_words().unwrap_or_default();
    if !interrupt.begin_end() {
        // The main thread is about to end the program.
        thread::sleep(LAST_WORDS);
        process::exit(code.into())
    }
    let (tell, told) = mpsc::channel();
    let speaker = output.clone();
    // Another thread speaks: this one exits even where stderr does not take the sentence.
    let speaking = thread::Builder::new().spawn(move || {
        speaker.interrupt.clear_bar();
        speaker.error(&sentence);
        // The receiver may have waited long enough.
        let _ = tell.send(());
    });
    if speaking.is_ok() {
        // The program ends either way.
        let _ = told.recv_timeout(LAST_WORDS);
    }
    process::exit(code.into())
}

/// The stage that a command makes anew in place of what there is. Models stay until the new ones
/// are there.
pub(crate) fn redone_stage(command: &Command) -> Option<Stage> {
    let redo = match command {
        Command::Reconstruct(Reconstruct { redo, .. })
        | Command::Features(Features { redo, .. })
        | Command::Match(Match { redo, .. }) => *redo,
        _ => None,
    };
    redo.filter(|stage| *stage != Stage::Map)
}
