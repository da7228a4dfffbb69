//! Completions and manual pages, which the program generates from its own command line.

use std::path::Path;
use std::process::Command;

use crate::tiepoint;

/// Names of the commands below a command, as `--help` lists them.
fn commands_of(command: &[&str]) -> Vec<String> {
    let help = tiepoint(command.iter().chain(&["--help"])).done().stdout();
    let Some((_, list)) = help.split_once("\nCommands:\n") else { return Vec::new() };
    let is_name = |line: &&str| line.starts_with("  ") && !line.starts_with("   ");
    let list = list.lines().take_while(|line| !line.is_empty());
    let names = list.filter(is_name).filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

#[test]
fn every_command_has_a_manual_page() {
    let program = commands_of(&[]);
    assert!(program.len() > 10 && program.iter().any(|name| name == "reconstruct"), "{program:?}");
    let of_program = tiepoint(["man"]).done().stdout();
    assert!(of_program.contains(".TH tiepoint 1"), "{of_program}");
    for name in &program {
        assert!(of_program.contains(&format!("tiepoint\\-{name}(1)")), "no {name}: {of_program}");
        let page = tiepoint(["man", name]).done().stdout();
        assert!(page.contains(&format!(".TH tiepoint-{name} 1")), "{page}");
        // The options of the program are options of each command.
        assert!(page.contains("\\-\\-threads"), "{page}");
        for below in commands_of(&[name]) {
            let page = tiepoint(["man", name, &below]).done().stdout();
            assert!(page.contains(&format!(".TH tiepoint-{name}-{below} 1")), "{page}");
        }
    }
    let page = tiepoint(["man", "model", "crop"]).done().stdout();
    assert!(page.contains("\\-\\-quantiles") && !page.contains("\u{1b}"), "{page}");
}

#[test]
fn completions_of_every_shell_name_the_commands() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = tiepoint(["completions", shell]).done().stdout();
        for word in ["reconstruct", "quantiles", "rolling-shutter", "view-direction"] {
            assert!(script.contains(word), "{shell}: no {word}");
        }
    }
}

/// The shell itself reads the script, and completes the name of a command and of an option.
/// macOS has bash 3.2, which knows less.
#[test]
#[cfg(target_os = "linux")]
fn bash_completes_commands_and_options() {
    let script = tiepoint(["completions", "bash"]).done().stdout();
    // Not a path, so that `complete` is asked as on a command line.
    let complete = |words: &str, last: usize| {
        let ask = format!(
            "{script}\nCOMP_WORDS=({words}); COMP_CWORD={last}\n\
             _tiepoint tiepoint \"${{COMP_WORDS[{last}]}}\" \"${{COMP_WORDS[{last} - 1]}}\"\n\
             echo \"${{COMPREPLY[*]}}\""
        );
        let output = Command::new("bash").args(["-c", &ask]).output().unwrap();
        assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    assert_eq!(complete("tiepoint rec", 1).trim(), "reconstruct");
    assert_eq!(complete("tiepoint model crop --qu", 3).trim(), "--quantiles");
}

#[test]
fn generated_texts_are_json_with_json_output() {
    let page = tiepoint(["man", "map"]).done().stdout();
    assert_eq!(tiepoint(["man", "map", "--json"]).done().json()["page"], page);
    let script = tiepoint(["completions", "zsh"]).done().stdout();
    assert!(script.contains('\t') || script.contains('\n'));
    assert_eq!(tiepoint(["completions", "zsh", "--json"]).done().json()["completions"], script);
}

#[test]
fn pages_and_shells_that_do_not_exist() {
    tiepoint(["man", "mop"]).failed(2, &["'tiepoint' has no command 'mop'", "reconstruct, "]);
    tiepoint(["man", "model", "mop"]).failed(2, &["'tiepoint model' has no command", "crop"]);
    tiepoint(["man", "map", "mop"]).failed(2, &["'tiepoint map' has no command", "fewer names"]);
    tiepoint(["completions", "dos"]).failed(2, &["dos", "bash, elvish, fish"]);
}

/// The page with the help of all commands. With `TIEPOINT_WRITE` in the environment it is written.
#[test]
fn the_page_of_commands_is_what_the_program_says() {
    let help = |words: &[String]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
        let output = command.args(words).arg("--help").env("COLUMNS", "100").output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    };
    let mut page = "# Commands\n\nThe help of every command, as `tiepoint COMMAND --help` prints \
                    it. `-h` is a screen. Generated:\n[how](../CONTRIBUTING.md).\n\n"
        .to_owned();
    let commands = tiepoint_cli::commands();
    let all: Vec<Vec<String>> = commands.into_iter().map(|command| command.words).collect();
    for words in &all {
        page += &format!("- [{}](#tiepoint-{})\n", words.join(" "), words.join("-"));
    }
    for words in &all {
        let lines = help(words);
        let lines: Vec<&str> = lines.lines().map(str::trim_end).collect();
        let text = lines.join("\n");
        page += &format!("\n## tiepoint {}\n\n```text\n{}\n```\n", words.join(" "), text.trim());
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/commands.md");
    if std::env::var_os("TIEPOINT_WRITE").is_some() {
        std::fs::write(&path, &page).unwrap();
    }
    // A published package has no such folder.
    let Ok(there) = std::fs::read_to_string(&path) else { return };
    assert!(there == page, "docs/commands.md is old: CONTRIBUTING.md says how it is generated");
}

/// A screen: as many lines as an editor shows.
const SCREEN: usize = 52;

#[test]
fn short_help_is_a_screen_with_headings() {
    for command in tiepoint_cli::commands() {
        let short = tiepoint(command.words.iter().map(String::as_str).chain(["-h"]));
        let short = short.done().stdout();
        assert!(short.lines().count() <= SCREEN, "{:?}: {}", command.words, short.lines().count());
        let long = tiepoint(command.words.iter().map(String::as_str).chain(["--help"]));
        assert!(short.len() <= long.done().stdout().len(), "{:?}", command.words);
    }
    let short = tiepoint(["reconstruct", "-h"]).done().stdout();
    for heading in ["Input:", "Cameras:", "Matching:", "Rig and time:", "Output:"] {
        assert!(short.contains(&format!("\n{heading}\n")), "no {heading}");
    }
}
