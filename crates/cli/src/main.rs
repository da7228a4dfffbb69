//! The program: parses, wires, prints, draws progress. Everything else is in the libraries.

mod args;
mod commands;
mod failure;
mod interrupt;
mod output;
mod progress;
mod signals;
mod summary;

use std::io::{self, Write};
use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;

use args::Cli;
use failure::Failure;
use interrupt::Interrupt;
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
    let output = Output::new(cli.json, Interrupt::new(signals::redone_stage(&cli.command)));
    if let Err(error) = signals::listen(&output) {
        output.error(&format!("cannot listen for SIGINT and SIGTERM: {error}"));
        return ExitCode::from(COULD_NOT);
    }
    if let Some(threads) = cli.threads
        && let Err(error) =
            rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()
    {
        output.error(&format!("cannot start {threads} threads: {error}"));
        return ExitCode::from(COULD_NOT);
    }
    let outcome = commands::run(cli.command, &output);
    output.interrupt.end();
    let (message, code) = match outcome {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Failure::Usage(message)) => (message, BAD_USAGE),
        Err(Failure::CouldNot(message)) => (message, COULD_NOT),
        Err(Failure::Cancelled) => {
            let cancelled = || (tiepoint_pipeline::Error::Cancelled.to_string(), COULD_NOT);
            output.interrupt.last_words().unwrap_or_else(cancelled)
        }
    };
    output.error(&message);
    ExitCode::from(code)
}

/// Help and version as clap writes them; what is wrong with a command line as one sentence.
fn usage(error: &clap::Error) -> ExitCode {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            match output::written(error.print().and_then(|()| io::stdout().flush())) {
                Ok(()) => ExitCode::SUCCESS,
                Err(cause) => {
                    Output::new(false, Interrupt::default())
                        .error(&output::not_written("this text", &cause));
                    ExitCode::from(COULD_NOT)
                }
            }
        }
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            ExitCode::from(BAD_USAGE)
        }
        _ => {
            let json = std::env::args_os().any(|argument| argument == "--json");
            Output::new(json, Interrupt::default())
                .error(&output::one_sentence(&error.render().to_string()));
            ExitCode::from(BAD_USAGE)
        }
    }
}
