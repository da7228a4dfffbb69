//! COLMAP's options: what a verb accepts, and the values that were given.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::spec::{Effect, Kind, Spec};
use super::tables::{ALIASES, GENERAL};
use crate::args;
use crate::output::Output;

/// The options that were given, by their names in COLMAP 3.
pub(super) struct Options {
    verb: &'static str,
    specs: Vec<Spec>,
    given: BTreeMap<&'static str, String>,
}

impl Options {
    /// Parses `--name value` and `--name=value`. `specs`: the options of the verb.
    pub(super) fn parse(
        verb: &'static str,
        specs: Vec<Spec>,
        words: &[String],
        output: &Output,
    ) -> Result<Self, String> {
        let mut this = Self { verb, specs, given: BTreeMap::new() };
        let pairs = pairs(words)?;
        for (name, value) in &pairs {
            if name == "project_path" {
                for (name, value) in read_project(value)? {
                    // A project has the options of all verbs.
                    if this.spec(&name).is_some() && !value.is_empty() {
                        this.set(&name, &value, output)?;
                    }
                }
            }
        }
        for (name, value) in pairs.iter().filter(|(name, _)| name != "project_path") {
            this.set(name, value, output)?;
        }
        Ok(this)
    }

    fn spec(&self, name: &str) -> Option<Spec> {
        let old = old_name(name);
        self.specs.iter().chain(GENERAL).find(|spec| spec.name == old).copied()
    }

    fn set(&mut self, name: &str, value: &str, output: &Output) -> Result<(), String> {
        let Some(spec) = self.spec(name) else {
            return Err(format!(
                "{} has no option --{name}; `colmap {} -h` lists its options",
                self.verb, self.verb
            ));
        };
        let value = spec.kind.checked(value).ok_or_else(|| {
            format!("--{name} is {value:?}, and it takes {}", spec.kind.described())
        })?;
        let is_default = spec.kind.is_same(&value, spec.default);
        match spec.effect {
            Effect::Fixed if !is_default => {
                return Err(format!(
                    "--{name} {value} asks for what tiepoint does not do: leave it out{}, or use \
                    COLMAP itself",
                    if spec.default.is_empty() {
                        String::new()
                    } else {
                        format!(" or give its default {}", spec.default)
                    }
                ));
            }
            Effect::Tuning if !is_default => output.warning(&format!(
                "--{name} tunes a method that tiepoint does not have, and is ignored"
            )),
            _ => {}
        }
        self.given.insert(spec.name, value);
        Ok(())
    }

    /// The value of an option: the given one, or the default.
    fn value(&self, name: &str) -> &str {
        let given = self.given.get(name).map(String::as_str);
        let default = || self.spec(name).map_or("", |spec| spec.default);
        given.unwrap_or_else(default)
    }

    /// Whether an option was given.
    pub(super) fn is_given(&self, name: &str) -> bool {
        self.given.contains_key(name)
    }

    /// An option that is a number. Its kind was checked when it was set.
    pub(super) fn number<T: FromStr>(&self, name: &str) -> Result<T, String> {
        let value = self.value(name);
        value.parse().map_err(|_| format!("--{name} is {value}, which is out of its range"))
    }

    pub(super) fn flag(&self, name: &str) -> bool {
        self.value(name) == "1"
    }

    pub(super) fn text(&self, name: &str) -> &str {
        self.value(name)
    }

    pub(super) fn path(&self, name: &str) -> Option<PathBuf> {
        let value = self.value(name);
        (!value.is_empty()).then(|| PathBuf::from(value))
    }

    /// A path without which the verb cannot run.
    pub(super) fn required(&self, name: &str) -> Result<PathBuf, String> {
        self.path(name).ok_or_else(|| format!("{} needs --{name}", self.verb))
    }

    /// The names in the file of an option, one on a line.
    pub(super) fn lines(&self, name: &str) -> Result<Option<Vec<String>>, String> {
        let Some(path) = self.path(name) else { return Ok(None) };
        let text = text_of(&path, "list")?;
        let names = text.lines().map(str::trim).filter(|line| !line.is_empty());
        Ok(Some(names.filter(|line| !line.starts_with('#')).map(str::to_owned).collect()))
    }

    /// The number of threads that the options ask for.
    pub(super) fn threads(&self) -> Result<Option<usize>, String> {
        let name = self.given.keys().find(|name| name.ends_with(".num_threads"));
        let Some(name) = name else { return Ok(None) };
        let threads: i64 = self.number(name)?;
        // COLMAP's −1 is for all of the machine.
        if threads <= 0 {
            return Ok(None);
        }
        let threads = args::threads(&threads.to_string());
        threads.map(|threads| Some(threads.get())).map_err(|reason| format!("--{name}: {reason}"))
    }

    /// The seed of all random numbers.
    pub(super) fn seed(&self) -> Result<u64, String> {
        let own = "Mapper.random_seed";
        let name = if self.is_given(own) { own } else { "random_seed" };
        // COLMAP 4: −1 is a fixed seed of its own.
        Ok(u64::try_from(self.number::<i64>(name)?).unwrap_or(0))
    }

    /// The options as COLMAP writes them beside a model.
    pub(super) fn project(&self) -> String {
        let mut text = "# tiepoint\n".to_owned();
        let all = || GENERAL.iter().chain(&self.specs).filter(|spec| spec.name != "project_path");
        let line = |name: &str, spec: &Spec| {
            let value = self.value(spec.name);
            let value = match (spec.kind, value) {
                (Kind::Bool, "1") => "true",
                (Kind::Bool, "0") => "false",
                (_, value) => value,
            };
            format!("{name}={value}\n")
        };
        for spec in all().filter(|spec| !spec.name.contains('.')) {
            text += &line(spec.name, spec);
        }
        let mut last = "";
        for spec in all() {
            let Some((section, name)) = spec.name.split_once('.') else { continue };
            if section != last {
                text += &format!("[{section}]\n");
                last = section;
            }
            text += &line(name, spec);
        }
        text
    }
}

/// Names and values of words `--name value` and `--name=value`.
fn pairs(words: &[String]) -> Result<Vec<(String, String)>, String> {
    let mut pairs = Vec::new();
    let mut words = words.iter();
    while let Some(word) = words.next() {
        let name = word
            .strip_prefix("--")
            .ok_or_else(|| format!("{word} is no option: options are --name value"))?;
        let (name, value) = match name.split_once('=') {
            Some((name, value)) => (name, value.to_owned()),
            None => {
                let value = words.next().ok_or_else(|| format!("--{name} has no value"))?;
                (name, value.clone())
            }
        };
        pairs.push((name.to_owned(), value));
    }
    Ok(pairs)
}

/// Longest list of names or project file, in bytes: a million names of 256 characters.
const MAX_TEXT_BYTES: u64 = 256 << 20;

/// The text of a file that an option names.
fn text_of(path: &Path, what: &str) -> Result<String, String> {
    tiepoint_pipeline::io::read_text(path, MAX_TEXT_BYTES, what)
        .map_err(|error| format!("cannot read {error}"))
}

/// The options of a project file: `name=value` in sections `[Section]`.
fn read_project(path: &str) -> Result<Vec<(String, String)>, String> {
    let text = text_of(Path::new(path), "project file")?;
    let mut section = String::new();
    let mut options = Vec::new();
    for line in text.lines().map(str::trim) {
        if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            section = format!("{name}.");
        } else if let Some((name, value)) = line.split_once('=')
            && !line.starts_with(['#', ';'])
        {
            options.push((format!("{section}{}", name.trim()), value.trim().to_owned()));
        }
    }
    Ok(options)
}

/// The name of an option in COLMAP 3.
fn old_name(name: &str) -> &str {
    ALIASES.iter().find(|(new, _)| *new == name).map_or(name, |(_, old)| old)
}
