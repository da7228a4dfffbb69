//! Reports skipped tests, which need data or programs that the machine lacks. The test binaries of
//! the crates include this file by its path.
//!
//! A skipped test passes, and the test runner hides the output of passing tests. So the line is
//! written to stderr directly, and to the file named by `TIEPOINT_SKIPPED`, which `./check` counts.

use std::fs::File;
use std::io::Write as _;
use std::path::PathBuf;

/// The folder of the reference data; without it, reports the calling test as skipped.
#[allow(dead_code, reason = "not all programs want data")]
pub(crate) fn data() -> Option<PathBuf> {
    const VARIABLE: &str = "TIEPOINT_DATA";
    let data = std::env::var_os(VARIABLE).map(PathBuf::from);
    if data.is_none() {
        skipped(VARIABLE);
    }
    data
}

/// Reports the running test as skipped, because `want` is missing.
pub(crate) fn skipped(want: &str) {
    let thread = std::thread::current();
    let line = format!(
        "SKIPPED for want of {want}: {} {}\n",
        env!("CARGO_PKG_NAME"),
        thread.name().unwrap_or("?")
    );
    // A single write, so that lines of several processes do not mix.
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
