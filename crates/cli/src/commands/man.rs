//! `man`.

use clap::{Command, CommandFactory};
use clap_mangen::Man as Page;
use serde::Serialize;

use crate::args::{Cli, Man};
use crate::failure::Failure;
use crate::output::Output;

pub(crate) fn man(args: &Man, output: &Output) -> Result<(), Failure> {
    #[derive(Serialize)]
    struct Written {
        page: String,
    }
    // The `help` command repeats the tree of commands and has no page.
    let mut program = Cli::command().disable_help_subcommand(true);
    // Commands get their full names and the options of the program.
    program.build();
    let mut command = &program;
    for name in &args.command {
        command = command.find_subcommand(name).ok_or_else(|| unknown(command, name))?;
    }
    let mut page = Vec::new();
    Page::new(command.clone()).render(&mut page)?;
    let page = String::from_utf8_lossy(&page).into_owned();
    output.generated(&Written { page }, |written| &written.page)
}

/// A name is none of the commands of the program, or of a command.
fn unknown(command: &Command, name: &str) -> Failure {
    let names: Vec<&str> = command.get_subcommands().map(Command::get_name).collect();
    // The program itself has no path of commands.
    let of = command.get_bin_name().unwrap_or(command.get_name());
    Failure::Usage(if names.is_empty() {
        format!("man: '{of}' has no command '{name}': give `man` fewer names")
    } else {
        format!("man: '{of}' has no command '{name}': it has {}", names.join(", "))
    })
}
