//! The program: parses, wires, prints, draws progress. Everything else is in the libraries.

mod args;
mod commands;
mod output;
mod progress;
mod summary;

use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;

use args::Cli;
use output::Output;

/// The work could not be done.
const COULD_NOT: u8 = 1;
/// The command line says nothing that could be done.
const BAD_USAGE: u8 = 2;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    let output = Output { json: cli.json };
    if let Some(threads) = cli.threads
        && let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()
    {
        output.error(&format!("cannot start {threads} threads: {error}"));
        return ExitCode::from(COULD_NOT);
    }
    match commands::run(cli.command, &output) {
        Ok(()) => ExitCode::SUCCESS,
        Err(commands::Failure::Usage(message)) => {
            output.error(&message);
            ExitCode::from(BAD_USAGE)
        }
        Err(commands::Failure::CouldNot(message)) => {
            output.error(&message);
            ExitCode::from(COULD_NOT)
        }
    }
}

/// Help and version as clap writes them; what is wrong with a command line as one sentence.
fn usage(error: &clap::Error) -> ExitCode {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            // A closed pipe is no reason to fail.
            let _ = error.print();
            ExitCode::SUCCESS
        }
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            ExitCode::from(BAD_USAGE)
        }
        _ => {
            let json = std::env::args_os().any(|argument| argument == "--json");
            Output { json }.error(&output::one_sentence(&error.render().to_string()));
            ExitCode::from(BAD_USAGE)
        }
    }
}
