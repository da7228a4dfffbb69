//! One file a command.

mod adjust;
mod demo;
mod evaluate;
mod experiment;
mod export;
mod judge;
mod stages;
mod synth;
mod view;

use crate::args::{Command, Evaluate};
use crate::output::Output;

/// Why a command did not do what it was asked.
pub(crate) enum Failure {
    /// The command line contradicts itself.
    Usage(String),
    /// It could not be done.
    CouldNot(String),
    /// A signal asked to stop.
    Cancelled,
}

impl<E: std::error::Error + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        let of_pipeline = (&error as &dyn std::error::Error).downcast_ref();
        match of_pipeline {
            Some(tiepoint_pipeline::Error::Cancelled) => Self::Cancelled,
            _ => Self::CouldNot(error.to_string()),
        }
    }
}

pub(crate) fn run(command: Command, output: &Output) -> Result<(), Failure> {
    match command {
        Command::Reconstruct(args) => stages::reconstruct(&args, output),
        Command::Features(args) => stages::features(&args, output),
        Command::Match(args) => stages::match_images(&args, output),
        Command::Map(args) => stages::map(&args, output),
        Command::Adjust(args) => adjust::adjust(&args, output),
        Command::Evaluate(Evaluate::Poses(args)) => evaluate::poses(&args, output),
        Command::Evaluate(Evaluate::Cloud(args)) => evaluate::cloud(&args, output),
        Command::View(args) => view::view(&args, output),
        Command::Export(args) => export::export(&args, output),
        Command::Synth(args) => synth::synth(&args, output),
        Command::Demo(args) => demo::demo(&args, output),
        Command::Experiment(args) => experiment::experiment(&args, output),
    }
}
