//! The program `tiepoint`.

use std::process::ExitCode;

fn main() -> ExitCode {
    tiepoint_cli::main()
}
