//! Interruption by a signal, and which thread then exits the program.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::{io, thread};

use indicatif::ProgressBar;
use signal_hook::consts::{SIGINT, SIGTERM};
use tiepoint_pipeline::{Event, Stage};

/// Exit code of a process that signal N ended: 128 + N, as shells report it.
const SIGNAL_BASE: u8 = 128;

/// State of an interruption, shared by the main thread and the signal thread.
#[derive(Debug)]
pub(crate) struct Interrupt {
    /// Number of the received signal; 0 before.
    signal: Arc<AtomicUsize>,
    /// Whether a thread has claimed the exit: only that one prints the final message.
    is_exit_claimed: AtomicBool,
    /// The progress bar, which is cleared before the final message.
    bar: Mutex<ProgressBar>,
    /// The stage of `--redo`, if it replaces existing results.
    redo: Option<Stage>,
    /// Whether that stage has begun. Then the old results are gone, and the command without
    /// `--redo` resumes.
    has_begun_redo: AtomicBool,
}

impl Default for Interrupt {
    fn default() -> Self {
        Self::new(None)
    }
}

impl Interrupt {
    /// `redo`: the stage whose existing results the command replaces.
    pub(crate) fn new(redo: Option<Stage>) -> Self {
        let bar = Mutex::new(ProgressBar::hidden());
        let (is_exit_claimed, has_begun_redo) = (AtomicBool::new(false), AtomicBool::new(false));
        Self { signal: Arc::default(), is_exit_claimed, bar, redo, has_begun_redo }
    }

    /// Installs a handler that stores the number of this signal.
    ///
    /// # Errors
    ///
    /// The operating system refuses the handler.
    pub(crate) fn register(&self, signal: i32) -> io::Result<()> {
        signal_hook::flag::register_usize(signal, Arc::clone(&self.signal), signal as usize)?;
        Ok(())
    }

    /// Stops the run at its next event, as a signal does.
    pub(crate) fn cancel(&self) {
        self.signal.store(SIGINT as usize, Ordering::Relaxed);
    }

    /// The number of the received signal.
    pub(crate) fn signal(&self) -> Option<usize> {
        Some(self.signal.load(Ordering::Relaxed)).filter(|signal| *signal != 0)
    }

    /// Notes whether the stage of `--redo` has begun. Returns `Break` after a signal.
    pub(crate) fn watch(&self, event: &Event) -> ControlFlow<()> {
        if let Event::StageBegan { stage, .. } = event
            && self.redo.is_some_and(|redo| redo <= *stage)
        {
            self.has_begun_redo.store(true, Ordering::Relaxed);
        }
        self.flow()
    }

    /// `Break` after a signal.
    pub(crate) fn flow(&self) -> ControlFlow<()> {
        if self.signal().is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Sets the progress bar that [`Interrupt::clear_bar`] clears.
    pub(crate) fn set_bar(&self, bar: &ProgressBar) {
        *self.bar.lock().unwrap_or_else(PoisonError::into_inner) = bar.clone();
    }

    /// Claims the exit for the calling thread. Never returns if the signal thread has claimed it.
    pub(crate) fn claim_exit_or_park(&self) {
        while !self.claim_exit() {
            thread::park();
        }
    }

    /// Claims the exit; `true` for the first caller.
    pub(crate) fn claim_exit(&self) -> bool {
        !self.is_exit_claimed.swap(true, Ordering::AcqRel)
    }

    /// Clears the progress bar.
    pub(crate) fn clear_bar(&self) {
        self.bar.lock().unwrap_or_else(PoisonError::into_inner).finish_and_clear();
    }

    /// Final message and exit code after a signal.
    pub(crate) fn final_message(&self) -> Option<(String, u8)> {
        let signal = self.signal()?;
        let hint = self.resume_hint();
        let name = if signal == SIGTERM as usize { "SIGTERM" } else { "SIGINT" };
        Some((format!("stopped by {name}: {hint}"), SIGNAL_BASE + signal as u8))
    }

    fn resume_hint(&self) -> &'static str {
        if self.has_begun_redo.load(Ordering::Relaxed) {
            "completed work was kept; give the same command again without --redo to resume"
        } else {
            "completed work was kept; give the same command again to resume"
        }
    }
}
