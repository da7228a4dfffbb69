//! The commands, one file each.

mod adjust;
mod colmap;
mod completions;
mod demo;
mod evaluate;
mod experiment;
mod export;
mod localize;
mod man;
mod model;
mod stages;
mod synth;
mod undistort;
mod view;

use crate::args::{Command, Evaluate};
use crate::failure::Failure;
use crate::output::Output;
pub(crate) use colmap::with_name;

pub(crate) fn run(command: Command, output: &Output) -> Result<(), Failure> {
    match command {
        Command::Reconstruct(args) => stages::reconstruct(&args, output),
        Command::Features(args) => stages::features(&args, output),
        Command::Match(args) => stages::match_images(&args, output),
        Command::Map(args) => stages::map(&args, output),
        Command::Dense(args) => stages::dense(&args, output),
        Command::Localize(args) => localize::localize(&args, output),
        Command::Adjust(args) => adjust::adjust(&args, output),
        Command::Evaluate(Evaluate::Poses(args)) => evaluate::poses(&args, output),
        Command::Evaluate(Evaluate::Cloud(args)) => evaluate::cloud(&args, output),
        Command::Evaluate(Evaluate::Points(args)) => evaluate::points(&args, output),
        Command::View(args) => view::view(&args, output),
        Command::Model(command) => model::model(&command, output),
        Command::Export(args) => export::export(&args, output),
        Command::Undistort(args) => undistort::undistort(&args, output),
        Command::Synth(args) => synth::synth(&args, output),
        Command::Demo(args) => demo::demo(&args, output),
        Command::Experiment(args) => experiment::experiment(&args, output),
        Command::Colmap(args) => colmap::colmap(&args, output),
        Command::Completions(args) => completions::completions(&args, output),
        Command::Man(args) => man::man(&args, output),
    }
}
