//! SIGINT and SIGTERM: a run ends at its next event, and where none comes soon, at once. Both end in
//! one sentence that says how to go on.

use std::io;
use std::ops::ControlFlow;
use std::process;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use indicatif::ProgressBar;
use signal_hook::consts::{SIGINT, SIGTERM};
use tiepoint_pipeline::{Event, Stage};

use crate::args::{Command, Features, Match, Reconstruct};
use crate::output::Output;

/// The program looks this often whether a signal came.
const POLL: Duration = Duration::from_millis(50);
/// A run has this long to end by itself: a transaction of the database takes less.
const GRACE: Duration = Duration::from_secs(1);
/// Somebody may hold stderr and not read it. Nobody waits longer than this for the last sentence.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// What shells add to the number of a signal.
const SIGNAL_BASE: u8 = 128;

/// Which signal came, and who ends the program for it.
#[derive(Debug)]
pub(crate) struct Interrupt {
    /// The number of the signal; 0 before one came.
    signal: Arc<AtomicUsize>,
    /// One thread alone says the last sentence.
    is_ending: AtomicBool,
    /// What is on the terminal. It is cleared before the last sentence.
    bar: Mutex<ProgressBar>,
    /// The stage that `--redo` makes anew in place of what there is.
    redo: Option<Stage>,
    /// Whether that stage has begun: what there was is gone, and the command without `--redo` goes on.
    has_begun_redo: AtomicBool,
}

impl Default for Interrupt {
    fn default() -> Self {
        Self::new(None)
    }
}

impl Interrupt {
    /// For a command that makes a stage anew in place of what there is.
    pub(crate) fn new(redo: Option<Stage>) -> Self {
        let bar = Mutex::new(ProgressBar::hidden());
        let (is_ending, has_begun_redo) = (AtomicBool::new(false), AtomicBool::new(false));
        Self { signal: Arc::default(), is_ending, bar, redo, has_begun_redo }
    }

    /// Takes the signals, and ends the program where the run does not end by itself.
    ///
    /// # Errors
    ///
    /// The system refuses a handler or a thread.
    pub(crate) fn listen(output: &Output) -> io::Result<()> {
        for signal in [SIGINT, SIGTERM] {
            let flag = Arc::clone(&output.interrupt.signal);
            signal_hook::flag::register_usize(signal, flag, signal as usize)?;
        }
        let output = output.clone();
        thread::Builder::new().name("interrupt".to_owned()).spawn(move || {
            while output.interrupt.signal().is_none() {
                thread::sleep(POLL);
            }
            thread::sleep(GRACE);
            output.interrupt.end_at_once(&output)
        })?;
        Ok(())
    }

    fn signal(&self) -> Option<usize> {
        Some(self.signal.load(Ordering::Relaxed)).filter(|signal| *signal != 0)
    }

    /// Takes note of an event. Breaks once a signal came.
    pub(crate) fn watch(&self, event: &Event) -> ControlFlow<()> {
        if let Event::StageBegan { stage, .. } = event
            && self.redo.is_some_and(|redo| redo <= *stage)
        {
            self.has_begun_redo.store(true, Ordering::Relaxed);
        }
        self.flow()
    }

    /// Breaks once a signal came.
    pub(crate) fn flow(&self) -> ControlFlow<()> {
        if self.signal().is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// What is on the terminal from now on.
    pub(crate) fn set_bar(&self, bar: &ProgressBar) {
        *self.bar.lock().unwrap_or_else(PoisonError::into_inner) = bar.clone();
    }

    /// The run has ended, and the caller ends the program. This never returns where the thread that
    /// listens ends it already.
    pub(crate) fn end(&self) {
        while self.is_ending.swap(true, Ordering::AcqRel) {
            thread::park();
        }
    }

    /// The last sentence and the exit code of a run that ended for a signal.
    pub(crate) fn last_words(&self) -> Option<(String, u8)> {
        let signal = self.signal()?;
        let go_on = self.how_to_go_on();
        let name = if signal == SIGTERM as usize { "SIGTERM" } else { "SIGINT" };
        Some((format!("stopped by {name}: {go_on}"), SIGNAL_BASE + signal as u8))
    }

    fn how_to_go_on(&self) -> &'static str {
        if self.has_begun_redo.load(Ordering::Relaxed) {
            "what is complete was kept; give the same command again without --redo to go on"
        } else {
            "what is complete was kept; give the same command again to go on"
        }
    }

    fn end_at_once(&self, output: &Output) -> ! {
        let (sentence, code) = self.last_words().unwrap_or_default();
        if self.is_ending.swap(true, Ordering::AcqRel) {
            // The main thread is about to end the program.
            thread::sleep(LAST_WORDS);
            process::exit(code.into())
        }
        let (tell, told) = mpsc::channel();
        let speaker = output.clone();
        // Another thread speaks: this one exits even where stderr does not take the sentence.
        let speaking = thread::Builder::new().spawn(move || {
            speaker.interrupt.bar.lock().unwrap_or_else(PoisonError::into_inner).finish_and_clear();
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
}

/// The stage that a command makes anew in place of what there is. Models stay until the new ones are there.
pub(crate) fn redone_stage(command: &Command) -> Option<Stage> {
    let redo = match command {
        Command::Reconstruct(Reconstruct { redo, .. })
        | Command::Features(Features { redo, .. })
        | Command::Match(Match { redo, .. }) => *redo,
        _ => None,
    };
    redo.filter(|stage| *stage != Stage::Map)
}
