//! The commands and their options as data, for bindings of other languages.

use std::any::TypeId;
use std::path::PathBuf;

use clap::{Arg, ArgAction, Command, CommandFactory};
use serde::Serialize;

use crate::args::Cli;

/// A command of the program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CommandInfo {
    /// Its words, as `["evaluate", "poses"]`.
    pub words: Vec<String>,
    /// What it does.
    pub help: String,
    /// Its positional arguments in their order, then its options. Those of all commands,
    /// `--threads` and `--json`, are left out.
    pub arguments: Vec<ArgumentInfo>,
}

/// An argument of a command.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ArgumentInfo {
    /// The option without its dashes; the name of a positional argument.
    pub name: String,
    /// What it means.
    pub help: String,
    /// Whether it has no dashes.
    pub is_positional: bool,
    /// Whether the command fails without it in all cases.
    pub is_required: bool,
    /// Whether it is an option without a value.
    pub is_flag: bool,
    /// Whether it may be given more than once.
    pub is_repeated: bool,
    /// Whether its value is the path of a file or folder.
    pub is_path: bool,
    /// Its default; empty if there is none.
    pub default: String,
    /// The values that it may have; empty if they are not a list.
    pub values: Vec<String>,
}

/// The commands that work on data, in the order of the program's help, without `colmap`, whose
/// options are those of another program.
pub fn commands() -> Vec<CommandInfo> {
    let mut program = Cli::command();
    program.build();
    let mut found = Vec::new();
    for command in program.get_subcommands() {
        if !["help", "completions", "man", "colmap"].contains(&command.get_name()) {
            add(command, &[], &mut found);
        }
    }
    found
}

fn add(command: &Command, above: &[String], found: &mut Vec<CommandInfo>) {
    let mut words = above.to_vec();
    words.push(command.get_name().to_owned());
    let mut below =
        command.get_subcommands().filter(|command| command.get_name() != "help").peekable();
    if below.peek().is_some() {
        below.for_each(|command| add(command, &words, found));
        return;
    }
    let is_own =
        |arg: &&Arg| !["help", "version", "json", "threads"].contains(&arg.get_id().as_str());
    let (positional, options): (Vec<&Arg>, Vec<&Arg>) =
        command.get_arguments().filter(is_own).partition(|arg| arg.is_positional());
    let arguments = positional.into_iter().chain(options).map(info).collect();
    let help = command.get_long_about().or(command.get_about());
    let help = help.map(ToString::to_string).unwrap_or_default();
    found.push(CommandInfo { words, help, arguments });
}

fn info(arg: &Arg) -> ArgumentInfo {
    let help = arg.get_long_help().or(arg.get_help());
    let default: Vec<String> =
        arg.get_default_values().iter().map(|value| value.to_string_lossy().into()).collect();
    let is_flag = matches!(arg.get_action(), ArgAction::SetTrue);
    let values = if is_flag { Vec::new() } else { arg.get_possible_values() };
    ArgumentInfo {
        name: arg.get_long().unwrap_or(arg.get_id().as_str()).to_owned(),
        help: help.map(ToString::to_string).unwrap_or_default(),
        is_positional: arg.is_positional(),
        is_required: arg.is_required_set(),
        is_flag,
        is_repeated: matches!(arg.get_action(), ArgAction::Append)
            || arg.get_num_args().is_some_and(|range| range.max_values() > 1),
        is_path: arg.get_value_parser().type_id() == TypeId::of::<PathBuf>(),
        default: default.join(","),
        values: values.iter().map(|value| value.get_name().to_owned()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_have_their_arguments() {
        let all = commands();
        let words: Vec<String> = all.iter().map(|command| command.words.join(" ")).collect();
        assert!(words.contains(&"evaluate poses".to_owned()) && !words.contains(&"man".to_owned()));
        let reconstruct = &all[0];
        assert_eq!(reconstruct.words, ["reconstruct"]);
        let argument =
            |name: &str| reconstruct.arguments.iter().find(|argument| argument.name == name);
        let inputs = argument("inputs").unwrap();
        assert!(inputs.is_positional && inputs.is_repeated && !inputs.is_required);
        assert!(argument("output").unwrap().is_required);
        assert!(argument("calibration").unwrap().is_repeated);
        assert!(inputs.is_path && argument("masks").unwrap().is_path);
        assert!(!argument("pairs").unwrap().is_path);
        assert!(argument("fix-existing-frames").unwrap().is_flag);
        assert_eq!(argument("pairs").unwrap().default, "auto");
        assert!(argument("threads").is_none() && argument("seed").is_some());
        assert!(all.iter().all(|command| !command.help.is_empty()));
        assert!(all.iter().flat_map(|command| &command.arguments).all(|a| !a.help.is_empty()));
    }
}
