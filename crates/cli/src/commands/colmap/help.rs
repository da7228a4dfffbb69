//! The texts that callers parse.

use std::fmt::Write;

use super::spec::Spec;
use super::tables::GENERAL;
use super::verbs::{VERBS, Verb};
use crate::failure::Failure;
use crate::output::Output;

/// The version of COLMAP whose commands and files these are. Its first line is what callers parse:
/// nerfstudio takes the second word of the line that begins with COLMAP.
const COLMAP_VERSION: &str = "3.12";

fn first_line() -> String {
    format!(
        "COLMAP {COLMAP_VERSION} -- commands of COLMAP, run by tiepoint {}; this is not COLMAP\n",
        env!("CARGO_PKG_VERSION")
    )
}

pub(super) fn version(output: &Output) -> Result<(), Failure> {
    output.generated(&first_line(), |text| text)
}

pub(super) fn of_program(output: &Output) -> Result<(), Failure> {
    let mut text = first_line();
    text += "\nUsage:\n  colmap [command] [options]\n\nAvailable commands:\n  help\n  version\n";
    for verb in VERBS {
        // Writing to a string does not fail.
        let _ = writeln!(text, "  {}", verb.name);
    }
    text += "\n`colmap [command] -h` lists the options of a command. `tiepoint --help` has what \
             tiepoint does beside.\n";
    output.generated(&text, |text| text)
}

pub(super) fn of_verb(verb: &Verb, output: &Output) -> Result<(), Failure> {
    let mut text = first_line();
    text += "\nOptions can either be specified via command-line or by defining\nthem in a .ini \
             project file passed to `--project_path`.\n\n  -h [ --help ]\n";
    for Spec { name, default, .. } in GENERAL.iter().copied().chain(verb.options()) {
        let default = if default.is_empty() { String::new() } else { format!(" (={default})") };
        let _ = writeln!(text, "  --{name} arg{default}");
    }
    output.generated(&text, |text| text)
}
