//! Tests that run the program as a user does.

#![allow(clippy::unwrap_used)]

mod bad_input;
mod cameras;
mod colmap;
mod dense;
mod drive;
mod existing_models;
mod exits;
mod experiment;
mod faults;
mod generated;
mod hostile;
#[cfg(unix)]
mod hostile_folders;
mod known;
mod missing;
mod model;
mod names;
mod overlays;
mod own_files;
mod page;
mod photos;
mod records;
mod results;
mod shards;
#[path = "../../../../tests/skipped.rs"]
mod skipped;
mod undistort;
mod video;

use std::ffi::OsStr;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// The program with these arguments.
fn command<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
    command.args(arguments);
    command
}

/// Runs the program with these arguments.
fn tiepoint<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Run {
    Run(command(arguments).output().expect("the program starts"))
}

/// Runs a command line of words in a folder, which `{}` stands for.
fn tiepoint_in(dir: &Path, line: &str) -> Run {
    let name = dir.to_str().expect("a temporary folder has a plain name");
    let mut command = command(line.split_whitespace().map(|word| word.replace("{}", name)));
    Run(command.current_dir(dir).output().expect("the program starts"))
}

/// The exit code and the output of a run.
struct Run(Output);

impl Run {
    fn stdout(&self) -> String {
        String::from_utf8_lossy(&self.0.stdout).into_owned()
    }

    fn stderr(&self) -> String {
        String::from_utf8_lossy(&self.0.stderr).into_owned()
    }

    fn code(&self) -> i32 {
        self.0.status.code().expect("no signal")
    }

    /// Asserts success.
    fn done(self) -> Self {
        assert_eq!(self.code(), 0, "{}", self.stderr());
        self
    }

    /// The result as JSON.
    fn json(&self) -> Value {
        serde_json::from_slice(&self.0.stdout).expect("stdout is one JSON object")
    }

    /// The lines of JSON on stderr.
    fn events(&self) -> Vec<Value> {
        self.stderr()
            .lines()
            .map(|line| serde_json::from_str(line).expect("stderr is lines of JSON"))
            .collect()
    }

    /// Asserts that the run failed with this code, that the last line on stderr has these parts,
    /// and that stdout is empty.
    fn failed(self, code: i32, parts: &[&str]) -> Self {
        let stderr = self.stderr();
        assert_eq!(self.code(), code, "{stderr}");
        assert_eq!(self.stdout(), "");
        let last = stderr.lines().last().expect("it says why");
        let sentence = last.strip_prefix("tiepoint: ").unwrap_or_else(|| panic!("{last}"));
        for part in parts {
            assert!(sentence.contains(part), "no {part:?} in: {sentence}");
        }
        assert!(!stderr.contains("panicked"), "{stderr}");
        self
    }
}
