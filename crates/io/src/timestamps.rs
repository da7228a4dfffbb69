//! Times of images: a CSV file with the header `image,seconds`.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use tiepoint_store::require_regular_file;

use crate::Result;
use crate::atomic::write_atomic;
use crate::text::excerpt::Excerpt;
use crate::text::{Lines, Number};

const HEADER: &str = "image,seconds";

/// Seconds since 1970 in the year 5138. Milliseconds since 1970 have exceeded it since 1973.
const MAX_S: f64 = 1e11;

/// The year 1980. Clocks that do not count from 1970 begin near 0.
const FIRST_ABSOLUTE_S: f64 = 3.15e8;

/// Whether a time in seconds counts from 1970; others begin anywhere.
pub fn is_absolute(time_s: f64) -> bool {
    time_s >= FIRST_ABSOLUTE_S
}

/// What a number that cannot be seconds since 1970 may be since then.
fn unit_of(number: f64) -> &'static str {
    match number.abs() {
        ..1e14 => "milliseconds",
        ..1e17 => "microseconds",
        ..1e20 => "nanoseconds",
        _ => "such numbers",
    }
}

/// Reads the times of images, in seconds on the clocks of their cameras, by name. A name may
/// contain commas: the last comma of a line separates. White space around the name is trimmed.
///
/// # Errors
///
/// If the file cannot be read, and if a line is not a name and a finite number that can be seconds.
pub fn read(path: &Path) -> Result<BTreeMap<String, f64>> {
    require_regular_file(path)?;
    let mut lines = Lines::open(path)?;
    let mut times = BTreeMap::new();
    let header = lines.next_raw()?.map(|mut words| words.rest().to_owned());
    if header.as_deref() != Some(HEADER) {
        return Err(lines.error(format!("must be `{HEADER}`")));
    }
    while let Some(mut line) = lines.next_raw()? {
        if line.is_empty() {
            continue;
        }
        let text = line.rest();
        let Some((name, seconds)) = text.rsplit_once(',') else {
            return Err(line.error(format!("`{}` has no comma: expected {HEADER}", Excerpt(text))));
        };
        let seconds: Option<f64> =
            seconds.trim().parse().ok().filter(|seconds: &f64| seconds.is_finite());
        let seconds = seconds.ok_or_else(|| {
            line.error(format!("the time of {} is not a number of seconds", Excerpt(name)))
        })?;
        if seconds.abs() >= MAX_S {
            let seconds = Number(seconds);
            return Err(line.error(format!(
                "the time of {} is {seconds} s, which no clock shows: seconds are expected, not {}",
                Excerpt(name),
                unit_of(seconds.0)
            )));
        }
        if times.insert(name.trim().to_owned(), seconds).is_some() {
            return Err(line.error(format!("the image {} is listed twice", Excerpt(name))));
        }
    }
    Ok(times)
}

/// Writes the times of images in the given order.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write<'a>(path: &Path, times: impl IntoIterator<Item = (&'a str, f64)>) -> Result<()> {
    write_atomic(path, |file| {
        writeln!(file, "{HEADER}")?;
        times
            .into_iter()
            .try_for_each(|(name, seconds)| writeln!(file, "{name},{}", Number(seconds)))
    })
}
