//! The command line of `tiepoint`: parses arguments, calls the libraries, and prints results and
//! progress ([`main`]), or sends them to a caller in the same process ([`Call`]).

mod args;
mod call;
mod commands;
mod describe;
mod failure;
mod finished_model;
mod hints;
mod interrupt;
mod message;
mod output;
mod points;
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

pub use call::{Call, Failed};
pub use describe::{ArgumentInfo, CommandInfo, commands};
pub use hints::with_keywords;
pub use message::Message;

/// Exit code of failed work.
const COULD_NOT: u8 = 1;
/// Exit code of an invalid command line.
const BAD_USAGE: u8 = 2;

/// Runs the program with the arguments of the process.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse_from(commands::with_name(std::env::args_os())) {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    let output = Output::new(cli.json, Interrupt::new(signals::stage_to_redo(&cli.command)));
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
    output.interrupt.claim_exit_or_park();
    let (message, code) = match outcome {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Failure::Usage(message)) => (message, BAD_USAGE),
        Err(Failure::CouldNot(message)) => (message, COULD_NOT),
        Err(Failure::Cancelled) => {
            let cancelled = || (tiepoint_pipeline::Error::Cancelled.to_string(), COULD_NOT);
            output.interrupt.final_message().unwrap_or_else(cancelled)
        }
    };
    output.error(&message);
    ExitCode::from(code)
}

/// Prints help and version as clap formats them, and usage errors as one sentence.
fn usage(error: &clap::Error) -> ExitCode {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            match output::ignore_broken_pipe(error.print().and_then(|()| io::stdout().flush())) {
                Ok(()) => ExitCode::SUCCESS,
                Err(cause) => {
                    Output::new(false, Interrupt::default())
                        .error(&output::write_error("this text", &cause));
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
