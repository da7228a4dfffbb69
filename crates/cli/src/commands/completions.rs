//! `completions`.

use clap::CommandFactory;
use serde::Serialize;

use crate::args::{Cli, Completions};
use crate::failure::Failure;
use crate::output::Output;

pub(crate) fn completions(args: &Completions, output: &Output) -> Result<(), Failure> {
    #[derive(Serialize)]
    struct Script {
        completions: String,
    }
    let mut script = Vec::new();
    let mut command = Cli::command();
    let name = command.get_name().to_owned();
    clap_complete::generate(args.shell, &mut command, name, &mut script);
    let completions = String::from_utf8_lossy(&script).into_owned();
    output.generated(&Script { completions }, |script| &script.completions)
}
