//! Options and stages in messages of the libraries, as the caller knows them.
//!
//! A library names an option by its key, such as `features.timestamps`, and a stage as `stage.map`,
//! in backquotes. The program shows a flag or a command instead, and the Python package a keyword
//! or a function.

use std::borrow::Cow;

/// Who reads a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reader {
    /// Somebody at a command line.
    CommandLine,
    /// Somebody who calls functions with keywords.
    Keywords,
}

/// Options of the libraries, and their flags.
const OPTIONS: [(&str, &str); 38] = [
    ("dense.depth_pngs", "--depth-pngs"),
    ("dense.max_image_size", "--max-size"),
    ("dense.normal_maps", "--normal-maps"),
    ("export.images", "--images"),
    ("export.rigid", "--rigid"),
    ("features.calibration", "--calibration"),
    ("features.camera_model", "--camera-model"),
    ("features.cameras", "--cameras"),
    ("features.database", "--database"),
    ("features.every", "--every"),
    ("features.focal_prior", "--focal-prior"),
    ("features.intrinsics", "--intrinsics"),
    ("features.masks", "--masks"),
    ("features.max_megapixels", "--max-megapixels"),
    ("features.max_size", "--max-size"),
    ("features.timestamps", "--timestamps"),
    ("mapper.baseline", "--baseline"),
    ("mapper.calibration_sigma", "--calibration-sigma"),
    ("mapper.control_points", "--control-points"),
    ("mapper.fix_existing_frames", "--fix-existing-frames"),
    ("mapper.input_model", "--input-model"),
    ("mapper.position_priors", "--position-priors"),
    ("mapper.readout", "--rolling-shutter"),
    ("mapper.refine", "--refine"),
    ("mapper.refine.aspect", "--refine aspect"),
    ("mapper.refine.distortion", "--refine distortion"),
    ("mapper.refine.extrinsics", "--refine extrinsics"),
    ("mapper.refine.focal", "--refine focal"),
    ("mapper.refine.principal_point", "--refine principal-point"),
    ("mapper.refine.prism", "--refine prism"),
    ("mapper.rig", "--rig"),
    ("mapper.rig_calibration", "--rig-calibration"),
    ("mapper.seed", "--seed"),
    ("mapper.submaps", "--submaps"),
    ("match.pairs", "--pairs"),
    ("match.seed", "--seed"),
    ("output.overwrite", "--overwrite"),
    ("stage.redo", "--redo"),
];

/// Stages and tools: their commands, and the functions of the Python package.
const COMMANDS: [(&str, &str, &str); 7] = [
    ("model.align", "`tiepoint model align`", "model_align"),
    ("model.info", "`tiepoint model info`", "model_info"),
    ("model.undistort", "`tiepoint undistort`", "undistort_images"),
    ("stage.dense", "`tiepoint dense`", "dense"),
    ("stage.features", "`tiepoint features`", "extract_features"),
    ("stage.map", "`tiepoint map`", "map_images"),
    ("stage.match", "`tiepoint match`", "match_images"),
];

/// A message of the libraries with the keywords and functions of the Python package.
pub fn with_keywords(message: &str) -> String {
    for_reader(message, Reader::Keywords).into_owned()
}

/// The message with the names that its reader knows.
pub(crate) fn for_reader(message: &str, reader: Reader) -> Cow<'_, str> {
    let message = with_names(message, reader);
    match reader {
        Reader::Keywords if message.contains("--") => Cow::Owned(flags_as_keywords(&message)),
        _ => message,
    }
}

/// [`for_reader`] for data, in which only keys in backquotes are replaced: a name of a file may
/// look like a flag.
pub(crate) fn with_names(message: &str, reader: Reader) -> Cow<'_, str> {
    if !message.contains('`') {
        return Cow::Borrowed(message);
    }
    let mut text = String::with_capacity(message.len());
    let mut rest = message;
    while let Some((before, after)) = rest.split_once('`') {
        text += before;
        match after.split_once('`').and_then(|(key, end)| Some((name_of(key, reader)?, end))) {
            Some((name, end)) => {
                text += &name;
                rest = end;
            }
            None => {
                text.push('`');
                rest = after;
            }
        }
    }
    Cow::Owned(text + rest)
}

fn name_of(key: &str, reader: Reader) -> Option<Cow<'static, str>> {
    let option = OPTIONS.iter().find(|(own, _)| *own == key).map(|(_, flag)| match reader {
        Reader::CommandLine => Cow::Borrowed(*flag),
        Reader::Keywords => Cow::Owned(flags_as_keywords(flag)),
    });
    option.or_else(|| {
        let (_, command, function) = COMMANDS.iter().find(|(own, ..)| *own == key)?;
        Some(Cow::Borrowed(match reader {
            Reader::CommandLine => command,
            Reader::Keywords => function,
        }))
    })
}

/// Replaces flags (`--max-size`) by keywords (`max_size`).
fn flags_as_keywords(message: &str) -> String {
    let mut text = String::with_capacity(message.len());
    let mut rest = message;
    while let Some((before, after)) = rest.split_once("--") {
        let is_word = before.ends_with(|c: char| c.is_alphanumeric() || c == '-');
        let end = after.find(|c: char| !c.is_ascii_lowercase() && c != '-');
        let (flag, end) = after.split_at(end.unwrap_or(after.len()));
        text += before;
        if is_word || flag.is_empty() || flag.starts_with('-') {
            text += "--";
            rest = after;
        } else {
            let name = flag.trim_end_matches('-');
            text += &name.replace('-', "_");
            text += &flag[name.len()..];
            rest = end;
        }
    }
    text + rest
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::args::Cli;

    #[test]
    fn keys_become_flags_or_keywords() {
        let message = "give times to `stage.features` with `features.timestamps` FILE.csv \
                       `stage.redo` features; `no.key` and a ` stay";
        assert_eq!(
            for_reader(message, Reader::CommandLine),
            "give times to `tiepoint features` with --timestamps FILE.csv --redo features; \
             `no.key` and a ` stay"
        );
        assert_eq!(
            for_reader(message, Reader::Keywords),
            "give times to extract_features with timestamps FILE.csv redo features; `no.key` and a \
             ` stay"
        );
        assert_eq!(
            for_reader("a--b --- -- `--max-size=7`, x--", Reader::Keywords),
            "a--b --- -- `max_size=7`, x--"
        );
    }

    #[test]
    fn names_of_files_in_data_stay_as_they_are() {
        let data = r#"{"image": "a/--max-size.jpg", "note": "give `match.pairs`"}"#;
        let expected = r#"{"image": "a/--max-size.jpg", "note": "give --pairs"}"#;
        assert_eq!(with_names(data, Reader::CommandLine), expected);
        assert_eq!(with_names(data, Reader::Keywords), expected.replace("--pairs", "pairs"));
    }

    #[test]
    fn each_flag_is_one_of_the_program() {
        let cli = Cli::command();
        let flags: Vec<&str> = cli
            .get_subcommands()
            .flat_map(|command| command.get_arguments().filter_map(clap::Arg::get_long))
            .collect();
        for (key, flag) in OPTIONS {
            let long = flag.trim_start_matches("--").split(' ').next().unwrap();
            assert!(flags.contains(&long), "{key}: no command has {flag}");
        }
        for (key, command, _) in COMMANDS {
            let mut words = command.trim_matches('`').split(' ').skip(1);
            let found = words.try_fold(&cli, |command, word| command.find_subcommand(word));
            assert!(found.is_some(), "{key}: no command {command}");
        }
    }
}
