//! Whether a signal came, and who ends the program for it.

use std::io;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use indicatif::ProgressBar;
use signal_hook::consts::SIGTERM;
use tiepoint_pipeline::{Event, Stage};

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
    /// Whether that stage has begun: what there was is gone, and the command without `--redo` goes
    /// on.
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

    /// Notes this signal when it comes.
    ///
    /// # Errors
    ///
    /// The system refuses a handler.
    pub(crate) fn note(&self, signal: i32) -> io::Result<()> {
        signal_hook::flag::register_usize(signal, Arc::clone(&self.signal), signal as usize)?;
        Ok(())
    }

    /// The number of the signal that came.
    pub(crate) fn signal(&self) -> Option<usize> {
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
        while !self.begin_end() {
            thread::park();
        }
    }

    /// Whether the caller is the first that is to end the program.
    pub(crate) fn begin_end(&self) -> bool {
        !self.is_ending.swap(true, Ordering::AcqRel)
    }

    /// Takes what is on the terminal away.
    pub(crate) fn clear_bar(&self) {
        self.bar.lock().unwrap_or_else(PoisonError::into_inner).finish_and_clear();
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
}
