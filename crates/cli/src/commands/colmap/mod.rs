//! `colmap VERB`: COLMAP's commands with COLMAP's options, and the program under the name `colmap`.

mod automatic;
mod features;
mod help;
mod mapping;
mod matching;
mod models;
mod options;
mod spec;
mod stereo;
mod tables;
mod undistortion;
mod verbs;

use std::ffi::OsString;
use std::path::Path;

use crate::args::Colmap;
use crate::failure::Failure;
use crate::output::Output;
use options::Options;
use verbs::{OTHERS, VERBS, Verb};

/// The name under which the program is this command.
const NAME: &str = "colmap";

/// The arguments of the process, with the command in front of them if the program is called by its
/// name, as a link `colmap` or a copy `colmap.exe`.
pub(crate) fn with_name(arguments: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = arguments.into_iter().collect();
    let stem = arguments.first().map(Path::new).and_then(Path::file_stem);
    if stem.is_some_and(|stem| stem.eq_ignore_ascii_case(NAME)) {
        arguments.insert(1, NAME.into());
    }
    arguments
}

pub(crate) fn colmap(args: &Colmap, output: &Output) -> Result<(), Failure> {
    // COLMAP has no exit code for bad usage.
    run(&args.words, output).map_err(|failure| match failure {
        Failure::Usage(message) => Failure::CouldNot(message),
        failure => failure,
    })
}

fn run(words: &[OsString], output: &Output) -> Result<(), Failure> {
    let words: Vec<String> = words
        .iter()
        .map(|word| word.to_str().map(str::to_owned))
        .collect::<Option<_>>()
        .ok_or_else(|| Failure::Usage("an argument is not UTF-8: rename the file".to_owned()))?;
    let Some((first, rest)) = words.split_first() else {
        return help::of_program(output);
    };
    match first.as_str() {
        "help" | "-h" | "--help" => return help::of_program(output),
        "version" | "--version" | "-v" => return help::version(output),
        _ => {}
    }
    let Some(verb) = VERBS.iter().find(|verb| verb.name == first) else {
        let other = OTHERS.iter().find(|(name, _)| name == first);
        return Err(Failure::Usage(match other {
            Some((name, instead)) => format!("tiepoint has no {name}: {instead}"),
            None => format!("COLMAP has no command {first}; `colmap help` lists those of tiepoint"),
        }));
    };
    if rest.iter().any(|word| word == "-h" || word == "--help") {
        return help::of_verb(verb, output);
    }
    let options = Options::parse(verb.name, verb.options().collect(), rest, output);
    let options = options.map_err(Failure::Usage)?;
    in_pool(verb, &options, output)
}

/// Runs a verb with the number of threads that its options ask for.
fn in_pool(verb: &Verb, options: &Options, output: &Output) -> Result<(), Failure> {
    let threads = options.threads().map_err(Failure::Usage)?;
    let Some(threads) = threads else { return (verb.run)(options, output) };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool
        .map_err(|cause| Failure::CouldNot(format!("cannot start {threads} threads: {cause}")))?;
    pool.install(|| (verb.run)(options, output))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_with_the_name_is_the_command() {
        let words = |line: &str| with_name(line.split(' ').map(OsString::from));
        for name in ["colmap", "/usr/bin/colmap", "COLMAP.exe"] {
            assert_eq!(words(&format!("{name} mapper -h"))[1..], ["colmap", "mapper", "-h"]);
        }
        assert_eq!(words("tiepoint map -h")[1..], ["map", "-h"]);
        assert_eq!(words("colmap2 map")[1..], ["map"]);
    }
}
