//! Parsers of option values, with their bounds.

use std::convert::Infallible;
use std::fmt;
use std::num::NonZeroUsize;
use std::str::FromStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use tiepoint_pipeline::sfm::RigMode;
use tiepoint_pipeline::sfm::adjust::RefineIntrinsics;
use tiepoint_pipeline::sfm::geometry::nalgebra::Vector3;
use tiepoint_pipeline::sfm::model_tools::BoundingBox;
use tiepoint_pipeline::sfm::rolling_shutter::Readout;
use tiepoint_pipeline::stages::{PositionPriors, Submaps};

/// Bytes of a gibibyte.
const GIB: f64 = 1_073_741_824.0;

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
        sides.ok_or_else(|| "expected width x height in pixels, as 640x480".to_owned())
    }
}

impl fmt::Display for ImageSize {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// Numbers separated by commas.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NumberList(pub(super) Vec<f64>);

impl FromStr for NumberList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number =
            |word: &str| word.trim().parse().map_err(|_| format!("'{word}' is not a number"));
        text.split(',').map(number).collect::<Result<_, _>>().map(Self)
    }
}

/// A positive number.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number > 0.0);
    number.ok_or_else(|| "expected a number above zero".to_owned())
}

/// A divisor of the size of images.
pub(super) fn downscale(text: &str) -> Result<u32, String> {
    let factor = text.parse().ok().filter(|factor| (2..=64).contains(factor));
    factor.ok_or_else(|| "expected whole numbers from 2 to 64, as 2,4,8".to_owned())
}

/// The numbers of a list of `N`.
fn numbers<const N: usize>(text: &str, expected: &str) -> Result<[f64; N], String> {
    let NumberList(numbers) = text.parse()?;
    let numbers: Option<[f64; N]> = numbers.try_into().ok();
    numbers
        .filter(|numbers| numbers.iter().all(|number| number.is_finite()))
        .ok_or_else(|| format!("expected {expected}"))
}

/// A box from six numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CropBox(pub(crate) BoundingBox);

impl FromStr for CropBox {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let [x1, y1, z1, x2, y2, z2] = numbers(text, "six numbers, x1,y1,z1,x2,y2,z2")?;
        if x1 > x2 || y1 > y2 || z1 > z2 {
            return Err("expected x1 <= x2, y1 <= y2 and z1 <= z2".to_owned());
        }
        let (min, max) = (Vector3::new(x1, y1, z1), Vector3::new(x2, y2, z2));
        Ok(Self(BoundingBox { min, max }))
    }
}

/// Two quantiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Quantiles(pub(crate) f64, pub(crate) f64);

impl FromStr for Quantiles {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let [low, high] = numbers(text, "two numbers, q1,q2")?;
        let are_ordered = 0.0 <= low && low <= high && high <= 1.0;
        are_ordered
            .then_some(Self(low, high))
            .ok_or_else(|| "expected 0 <= q1 <= q2 <= 1".to_owned())
    }
}

const MAX_THREADS: usize = 1024;

pub(crate) fn threads(text: &str) -> Result<NonZeroUsize, String> {
    let count = text.parse().ok().filter(|count: &NonZeroUsize| count.get() <= MAX_THREADS);
    count.ok_or_else(|| format!("expected a number of threads from 1 to {MAX_THREADS}"))
}

/// A positive length in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PositivePixels(pub(crate) f64);

impl FromStr for PositivePixels {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let value = text.parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0);
        value.map(Self).ok_or_else(|| "expected a number of pixels greater than 0".to_owned())
    }
}

impl fmt::Display for PositivePixels {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// A length, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Metres(pub(crate) f64);

/// Bounds of the distance between two cameras, in metres.
const MIN_BASELINE_M: f64 = 1e-4;
const MAX_BASELINE_M: f64 = 1e4;

impl FromStr for Metres {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // Longer suffixes first: "mm" ends with "m".
        let units = [("mm", 1e3), ("cm", 1e2), ("m", 1.0)];
        let split = units.iter().find_map(|(unit, per_m)| Some((text.strip_suffix(unit)?, per_m)));
        let length =
            split.and_then(|(number, per_m)| Some(number.trim_end().parse::<f64>().ok()? / per_m));
        let is_in_range = |length: &f64| (MIN_BASELINE_M..=MAX_BASELINE_M).contains(length);
        length.filter(is_in_range).map(Self).ok_or_else(|| {
            format!(
                "expected a length from {} mm to {MAX_BASELINE_M} m with its unit, m, cm or mm, as \
                0.62m",
                1e3 * MIN_BASELINE_M
            )
        })
    }
}

/// Longest readout time, in seconds.
const MAX_READOUT_S: f64 = 0.1;

pub(super) fn readout(text: &str) -> Result<Readout, String> {
    if text == "estimate" {
        return Ok(Readout::Estimated);
    }
    // The longer suffix first: "ms" ends with "s".
    let units = [("ms", 1e3), ("s", 1.0)];
    let split = units.iter().find_map(|(unit, per_s)| Some((text.strip_suffix(unit)?, per_s)));
    let time_s =
        split.and_then(|(number, per_s)| Some(number.trim_end().parse::<f64>().ok()? / per_s));
    time_s.filter(|time_s| time_s.abs() <= MAX_READOUT_S).map(Readout::Known).ok_or_else(|| {
        format!(
            "expected estimate, or a time of up to {} ms with its unit, ms or s, as 16ms; a \
            negative time means that the last row is read first",
            1e3 * MAX_READOUT_S
        )
    })
}

/// What bundle adjustment refines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Refine {
    pub(crate) intrinsics: RefineIntrinsics,
    /// The extrinsics of known rigs.
    pub(crate) extrinsics: bool,
}

pub(super) fn refine(text: &str) -> Result<Refine, String> {
    let (mut refine, mut extrinsics) = (RefineIntrinsics::NONE, false);
    if text == "none" {
        return Ok(Refine { intrinsics: refine, extrinsics });
    }
    for word in text.split(',') {
        let part = match word.trim() {
            "focal" => &mut refine.focal,
            "aspect" => &mut refine.aspect,
            "principal-point" => &mut refine.principal_point,
            "distortion" => &mut refine.distortion,
            "prism" => &mut refine.prism,
            "extrinsics" => &mut extrinsics,
            other => {
                return Err(format!(
                    "'{other}' is no part of the calibration: expected none, or a list of focal, \
                    aspect, principal-point, distortion, prism and extrinsics"
                ));
            }
        };
        *part = true;
    }
    // These are parts of others.
    if refine.aspect && !refine.focal || refine.prism && !refine.distortion {
        return Err("aspect is refined with focal, and prism with distortion: name both".to_owned());
    }
    Ok(Refine { intrinsics: refine, extrinsics })
}

/// One of a fixed set of values, by its name. Completions and descriptions know the names.
pub(super) fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let names: Vec<PossibleValue> =
        all.iter().map(|value| PossibleValue::new(name(*value))).collect();
    PossibleValuesParser::new(names).map(move |found: String| {
        let is_named = |value: &&T| name(**value).eq_ignore_ascii_case(&found);
        *all.iter().find(is_named).expect("clap has compared it with all names")
    })
}

/// A constraint of a rig; `hard` is a hidden alias of `rigid`.
pub(super) fn rig_mode() -> impl TypedValueParser<Value = RigMode> {
    let value = |mode: RigMode| match mode {
        RigMode::Rigid => PossibleValue::new(mode.name()).alias("hard"),
        mode => PossibleValue::new(mode.name()),
    };
    let values: Vec<PossibleValue> = RigMode::ALL.into_iter().map(value).collect();
    PossibleValuesParser::new(values)
        .map(|found: String| RigMode::from_name(&found).unwrap_or(RigMode::Rigid))
}

/// Where positions come from: a word, or the path of a file.
pub(super) fn position_priors(text: &str) -> Result<PositionPriors, Infallible> {
    Ok(match text {
        "auto" => PositionPriors::Auto,
        "off" => PositionPriors::Off,
        path => PositionPriors::File(path.into()),
    })
}

/// The size of sub-maps.
pub(super) fn submaps(text: &str) -> Result<Submaps, String> {
    Ok(match text {
        "auto" => Submaps::Auto,
        "off" => Submaps::Off,
        size => Submaps::Size(size.parse().map_err(|_| "expected auto, off or a number")?),
    })
}

/// A size of memory, in bytes.
pub(super) fn memory(text: &str) -> Result<u64, String> {
    let bytes = |(unit, bytes): (&str, f64)| {
        let number: f64 = text.strip_suffix(unit)?.trim().parse().ok()?;
        Some((number * bytes) as u64).filter(|_| number.is_finite() && number > 0.0)
    };
    let units = [("GB", 1e9), ("MB", 1e6), ("GiB", GIB), ("MiB", GIB / 1024.0)];
    let found = units.into_iter().find_map(bytes);
    found.ok_or_else(|| "expected a size as 8GB or 500MB".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_of_memory_have_units() {
        assert_eq!(memory("8GB"), Ok(8_000_000_000));
        assert_eq!(memory("0.5GiB"), Ok(1 << 29));
        for text in ["8", "GB", "-1GB", "0MB", "infGB", "8 gb"] {
            assert!(memory(text).is_err(), "{text}");
        }
    }

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
        for (text, metres) in
            [("0.62m", 0.62), ("62cm", 0.62), ("620 mm", 0.62), ("1e-1m", 0.1), ("0.1mm", 1e-4)]
        {
            let Metres(found) = text.parse().unwrap();
            assert!((found - metres).abs() <= f64::EPSILON, "{text}: {found}");
        }
        for wrong in [
            "", "m", "-1m", "0m", "0", "0.62", "620", "nan", "infm", "1e300m", "1e-300m", "0.6 ft",
            "62 c m", "m62", "0,62m",
        ] {
            assert!(wrong.parse::<Metres>().unwrap_err().contains("0.62m"), "{wrong}");
        }
    }
}
