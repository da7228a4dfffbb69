//! What stands behind options: values with their bounds, and names.

use std::fmt;
use std::num::NonZeroUsize;
use std::str::FromStr;

use tiepoint_pipeline::eval::Alignment;
use tiepoint_pipeline::sfm::geometry::CameraModelKind;
use tiepoint_pipeline::sfm::{Readout, RigTerm};
use tiepoint_synth::RouteKind;

/// Width and height, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ImageSize {
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sides = text.split_once('x').and_then(|(width, height)| {
            Some(Self { width: width.parse().ok()?, height: height.parse().ok()? })
        });
        sides.ok_or_else(|| "it must be a width and a height in pixels, as 640x480".to_owned())
    }
}

impl fmt::Display for ImageSize {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// Numbers with commas between them.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NumberList(pub(super) Vec<f64>);

impl FromStr for NumberList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |word: &str| word.trim().parse().map_err(|_| format!("'{word}' is no number"));
        text.split(',').map(number).collect::<Result<_, _>>().map(Self)
    }
}

/// More threads than any machine has use for.
const MOST_THREADS: usize = 1024;

pub(super) fn threads(text: &str) -> Result<NonZeroUsize, String> {
    let count = text.parse().ok().filter(|count: &NonZeroUsize| count.get() <= MOST_THREADS);
    count.ok_or_else(|| format!("it must be a number of threads from 1 to {MOST_THREADS}"))
}

/// A length in pixels that is not zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PositivePixels(pub(super) f64);

impl FromStr for PositivePixels {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let value = text.parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0);
        value.map(Self).ok_or_else(|| "it must be a number of pixels above 0".to_owned())
    }
}

/// A length, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Metres(pub(crate) f64);

/// Cameras are no nearer to each other than this, in metres, and no farther apart.
const NEAREST_M: f64 = 1e-4;
const FARTHEST_M: f64 = 1e4;

impl FromStr for Metres {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // The longer endings first.
        let units = [("mm", 1e3), ("cm", 1e2), ("m", 1.0), ("", 1.0)];
        let split = units.iter().find_map(|(unit, per_m)| Some((text.strip_suffix(unit)?, per_m)));
        let length =
            split.and_then(|(number, per_m)| Some(number.trim_end().parse::<f64>().ok()? / per_m));
        length.filter(|length| (NEAREST_M..=FARTHEST_M).contains(length)).map(Self).ok_or_else(
            || {
                format!(
                    "it must be a length from {} mm to {} m with its unit, m, cm or mm, as 0.62m",
                    1e3 * NEAREST_M,
                    FARTHEST_M
                )
            },
        )
    }
}

/// Slowest readout, in seconds.
const SLOWEST_S: f64 = 0.1;

pub(super) fn readout(text: &str) -> Result<Readout, String> {
    if text == "estimate" {
        return Ok(Readout::Estimated);
    }
    // The longer ending first.
    let units = [("ms", 1e3), ("s", 1.0)];
    let split = units.iter().find_map(|(unit, per_s)| Some((text.strip_suffix(unit)?, per_s)));
    let time_s =
        split.and_then(|(number, per_s)| Some(number.trim_end().parse::<f64>().ok()? / per_s));
    time_s.filter(|time_s| time_s.abs() <= SLOWEST_S).map(Readout::Known).ok_or_else(|| {
        format!(
            "it must be the word estimate or a time of up to {} ms with its unit, ms or s, as \
            16ms; negative where the last row comes first",
            1e3 * SLOWEST_S
        )
    })
}

pub(super) fn alignment(name: &str) -> Result<Alignment, String> {
    match name {
        "similarity" => Ok(Alignment::Similarity),
        "rigid" => Ok(Alignment::Rigid),
        "none" => Ok(Alignment::None),
        _ => Err("use similarity, rigid or none".to_owned()),
    }
}

pub(super) fn camera_model(name: &str) -> Result<CameraModelKind, String> {
    CameraModelKind::from_name(&name.to_ascii_uppercase()).map_err(|error| error.to_string())
}

pub(super) fn route(name: &str) -> Result<RouteKind, String> {
    match name {
        "loop" => Ok(RouteKind::Loop),
        "open" => Ok(RouteKind::Open),
        _ => Err("it must be loop or open".to_owned()),
    }
}

pub(super) fn rig_term(mode: &str) -> Result<RigTerm, String> {
    match mode {
        "off" => Ok(RigTerm::Off),
        "paper" => Ok(RigTerm::Paper),
        "soft" => Ok(RigTerm::Soft),
        "hard" => Ok(RigTerm::Hard),
        "auto" => Ok(RigTerm::Auto),
        _ => Err("it must be off, paper, soft, hard or auto".to_owned()),
    }
}

/// The name of a mode on the command line.
pub(crate) fn rig_name(term: RigTerm) -> &'static str {
    match term {
        RigTerm::Off => "off",
        RigTerm::Paper => "paper",
        RigTerm::Soft => "soft",
        RigTerm::Hard => "hard",
        RigTerm::Auto => "auto",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_is_two_numbers() {
        let size: ImageSize = "640x480".parse().unwrap();
        assert_eq!(size, ImageSize { width: 640, height: 480 });
        assert_eq!(size.to_string(), "640x480");
        for wrong in ["640", "640*480", "x480", "640x-480", "640x480x3"] {
            assert!(wrong.parse::<ImageSize>().unwrap_err().contains("640x480"), "{wrong}");
        }
    }

    #[test]
    fn a_baseline_has_a_unit() {
        for (text, metres) in [
            ("0.62m", 0.62),
            ("62cm", 0.62),
            ("620 mm", 0.62),
            ("0.62", 0.62),
            ("1e-1m", 0.1),
            ("0.1mm", 1e-4),
        ] {
            let Metres(found) = text.parse().unwrap();
            assert!((found - metres).abs() <= f64::EPSILON, "{text}: {found}");
        }
        for wrong in [
            "", "m", "-1m", "0m", "0", "nan", "infm", "1e300m", "1e-300m", "0.6 ft", "62 c m",
            "m62", "0,62m",
        ] {
            assert!(wrong.parse::<Metres>().unwrap_err().contains("0.62m"), "{wrong}");
        }
    }
}
