//! Processes that were forked: the threads of the parent are not in them.

use std::process;
use std::sync::atomic::{AtomicU32, Ordering};

use pyo3::prelude::*;

use crate::errors::failed;

/// The process that started the threads; 0 before.
static STARTED_BY: AtomicU32 = AtomicU32::new(0);

/// Notes that this process starts the threads; an error if another one did, for then all work would
/// wait for ever.
pub(crate) fn refuse_after_fork() -> PyResult<()> {
    let own = process::id();
    let found = STARTED_BY.compare_exchange(0, own, Ordering::Relaxed, Ordering::Relaxed);
    match found {
        Err(other) if other != own => Err(failed(
            "this process was forked from one that had used tiepoint, whose threads it lacks: use \
            the start method spawn, as multiprocessing.get_context(\"spawn\")",
        )),
        _ => Ok(()),
    }
}
