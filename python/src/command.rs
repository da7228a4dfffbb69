//! The commands of the program.

use std::ffi::OsString;
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use tiepoint_cli::{Call, Failed, Message};

use crate::errors::{failed, invalid};
use crate::fork::refuse_after_fork;

/// Time between two looks at the signals of Python.
const POLL: Duration = Duration::from_millis(50);
/// Time for a cancelled command to stop at its next event. After it, the exception is raised, and
/// the command stops in the background.
const GRACE: Duration = Duration::from_millis(800);

/// The commands and their arguments, as JSON.
#[pyfunction]
pub(crate) fn commands() -> PyResult<String> {
    serde_json::to_string(&tiepoint_cli::commands()).map_err(failed)
}

/// Runs a command. `on_event` is called with each event, a JSON text, on the calling thread; its
/// exception stops the command and is raised. Returns the result, a JSON text, or None.
#[pyfunction]
#[pyo3(signature = (arguments, on_event=None))]
pub(crate) fn run(
    python: Python<'_>,
    arguments: Vec<OsString>,
    on_event: Option<Py<PyAny>>,
) -> PyResult<Option<String>> {
    refuse_after_fork()?;
    wait_for_cancelled(python)?;
    let mut call = Call::start(arguments).map_err(exception)?;
    match receive(python, &mut call, on_event.as_ref()) {
        Ok(result) => python.detach(|| call.join()).map(|()| result).map_err(exception),
        Err(reason) => {
            call.cancel();
            python.detach(move || {
                let start = Instant::now();
                while !call.is_finished() && start.elapsed() < GRACE {
                    std::thread::sleep(POLL);
                }
                if !call.is_finished() {
                    cancelled().push(call);
                }
            });
            Err(reason)
        }
    }
}

/// The cancelled commands that have not ended yet.
fn cancelled() -> MutexGuard<'static, Vec<Call>> {
    static CANCELLED: Mutex<Vec<Call>> = Mutex::new(Vec::new());
    CANCELLED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits for cancelled commands, which may still hold a workspace.
fn wait_for_cancelled(python: Python<'_>) -> PyResult<()> {
    loop {
        cancelled().retain(|call| !call.is_finished());
        if cancelled().is_empty() {
            return Ok(());
        }
        python.detach(|| std::thread::sleep(POLL));
        python.check_signals()?;
    }
}

/// Passes events on until the command ends. The error is an exception of `on_event` or of a signal.
fn receive(
    python: Python<'_>,
    call: &mut Call,
    on_event: Option<&Py<PyAny>>,
) -> PyResult<Option<String>> {
    let mut result = None;
    let is_heard = on_event.is_some();
    loop {
        match next(python, call, is_heard) {
            Ok(Message::Progress(text)) => {
                if let Some(on_event) = on_event {
                    on_event.call1(python, (text,))?;
                }
            }
            Ok(Message::Result(text)) => result = Some(text),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(result),
        }
        python.check_signals()?;
    }
}

/// The next message, received without the lock of the interpreter. Events that nobody hears are
/// left out.
fn next(python: Python<'_>, call: &mut Call, is_heard: bool) -> Result<Message, RecvTimeoutError> {
    python.detach(move || {
        let start = Instant::now();
        loop {
            let left = POLL.saturating_sub(start.elapsed());
            match call.messages().recv_timeout(left) {
                Ok(Message::Progress(_)) if !is_heard && !left.is_zero() => {}
                other => return other,
            }
        }
    })
}

fn exception(failure: Failed) -> PyErr {
    match failure {
        Failed::Usage(what) => invalid(what),
        Failed::CouldNot(what) => failed(what),
        Failed::Cancelled => PyKeyboardInterrupt::new_err(failure.to_string()),
    }
}
