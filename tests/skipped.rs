//! Tests that want what a machine may lack say so when they are left out. Part of each crate's test
//! program, by its path.
//!
//! Such a test passes, and the test runner hides what a passing test prints. So the line goes to
//! stderr directly, and to the file that `TIEPOINT_SKIPPED` names, which `./check` counts.

use std::fs::File;
use std::io::Write as _;
use std::path::PathBuf;

/// The folder of the reference data; without it, the test that asks is one that was left out.
#[allow(dead_code, reason = "not all programs want data")]
pub(crate) fn data() -> Option<PathBuf> {
    const VARIABLE: &str = "TIEPOINT_DATA";
    let data = std::env::var_os(VARIABLE).map(PathBuf::from);
    if data.is_none() {
        skipped(VARIABLE);
    }
    data
}

/// The running test is left out, for want of this.
pub(crate) fn skipped(want: &str) {
    let thread = std::thread::current();
    let line = format!(
        "SKIPPED for want of {want}: {} {}\n",
        env!("CARGO_PKG_NAME"),
        thread.name().unwrap_or("?")
    );
    // One write, so that lines of several programs do not mix.
    let _ = std::io::stderr().write_all(line.as_bytes());
    if let Some(path) = std::env::var_os("TIEPOINT_SKIPPED") {
        let mut file = File::options()
            .create(true)
            .append(true)
            .open(path)
            .expect("the list of skipped tests");
        file.write_all(line.as_bytes()).expect("a line is added to the list of skipped tests");
    }
}
