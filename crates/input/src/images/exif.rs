//! EXIF data of a photo: focal length, orientation, time, camera body and lens.

use std::io::{BufRead, Cursor, Seek};
use std::path::Path;

use exif::{In, Rational, Tag, Value};
use tiepoint_io::{Error, Result};
use tiepoint_scene::Position;

use super::place::{add_rtk_deviations, position_of};

use super::jpeg;

/// Diagonal of 35 mm film (36 mm × 24 mm), in millimetres: the "35 mm equivalent" focal length
/// gives the same diagonal angle of view (CIPA DCG-001).
const FILM_DIAGONAL_MM: f64 = 43.266_615;

/// Plausible focal lengths, as multiples of the longer side of the image. The widest lenses of
/// photographers have 0.2 (8 mm on 36 mm), the longest zooms of compact cameras 83 (3000 mm, Nikon
/// P1000).
const FOCAL_RANGE: std::ops::RangeInclusive<f64> = 0.1..=150.0;

/// Value of `CustomRendered` in the panoramas of Apple's phones; the standard has 0 and 1.
const APPLE_PANORAMA: u32 = 6;

/// Longest name of a body or lens that is kept, in bytes; of a longer one the beginning.
const MAX_NAME_BYTES: usize = 128;

/// Camera body and lens, as the photo names them, without white space around the names.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Device {
    /// Maker of the body.
    pub make: Option<String>,
    /// Model of the body.
    pub model: Option<String>,
    /// Serial number of the body.
    pub serial: Option<String>,
    /// Model of the lens. Phones name each of their lenses.
    pub lens: Option<String>,
    /// Serial number of the lens.
    pub lens_serial: Option<String>,
}

/// The EXIF fields that are used; a photo without EXIF data has none.
#[derive(Clone, Debug, PartialEq)]
pub struct Exif {
    /// Focal length, in millimetres.
    pub focal_mm: Option<f64>,
    /// 35 mm equivalent focal length, in millimetres: the same diagonal angle of view on 35 mm
    /// film.
    pub focal_35mm: Option<f64>,
    /// Ratio of the digital zoom, more than 1; `None` without one.
    pub digital_zoom: Option<f64>,
    /// Resolution of the sensor, in pixels of the original photo per millimetre.
    pub pixels_per_mm: Option<f64>,
    /// Longer side of the original photo, in pixels.
    pub long_side_px: Option<f64>,
    /// Orientation of the stored pixels, 1 to 8; 1 is upright.
    pub orientation: u8,
    /// Time in seconds since 1970-01-01 00:00 on the clock of the camera: the first of
    /// `DateTimeOriginal`, `DateTimeDigitized` and `DateTime` that is a date, with the fraction of
    /// a second that stands in it, or else in the field `SubSecTime…` of the same name.
    pub time_s: Option<f64>,
    /// Whether the photo says that it is a panorama, in XMP or as Apple's phones do.
    pub is_panorama: bool,
    /// Body and lens.
    pub device: Device,
    /// Where the photo was taken: WGS 84, of a receiver with a fix. The deviation is that of
    /// `GPSHPositioningError`, or of DJI's RTK in XMP ([`Exif::read`] alone looks for it).
    pub position: Option<Position>,
}

impl Default for Exif {
    fn default() -> Self {
        Self {
            focal_mm: None,
            focal_35mm: None,
            digital_zoom: None,
            pixels_per_mm: None,
            long_side_px: None,
            orientation: 1,
            time_s: None,
            is_panorama: false,
            device: Device::default(),
            position: None,
        }
    }
}

impl Exif {
    /// Reads the EXIF data of a JPEG, PNG, TIFF or WebP file, and of a JPEG file whether XMP names
    /// a panorama. Missing and invalid fields are left out.
    ///
    /// # Errors
    ///
    /// If the file cannot be opened.
    pub fn read(path: &Path) -> Result<Self> {
        let file = std::fs::File::open(path).map_err(Error::io(path))?;
        let mut reader = std::io::BufReader::new(file);
        let mut exif = Self::from_reader(&mut reader);
        reader.rewind().map_err(Error::io(path))?;
        let is_panorama = exif.is_panorama || jpeg::is_panorama(&mut reader);
        if let Some(position) = &mut exif.position {
            add_rtk_deviations(position, path);
        }
        Ok(Self { is_panorama, ..exif })
    }

    pub(crate) fn from_bytes(bytes: &[u8]) -> Self {
        Self::from_reader(&mut Cursor::new(bytes))
    }

    fn from_reader(reader: &mut (impl BufRead + Seek)) -> Self {
        let Ok(fields) = exif::Reader::new().read_from_container(reader) else {
            return Self::default();
        };
        let value = |tag| fields.get_field(tag, In::PRIMARY).map(|field| &field.value);
        let integer = |tag| value(tag)?.get_uint(0);
        let number = |tag| match value(tag)? {
            Value::Rational(list) => list.first().map(Rational::to_f64),
            other => other.get_uint(0).map(f64::from),
        };
        let positive = |tag| number(tag).filter(|number| number.is_finite() && *number > 0.0);
        let unit_mm = match integer(Tag::FocalPlaneResolutionUnit) {
            Some(3) => Some(10.0),
            Some(4) => Some(1.0),
            Some(5) => Some(1e-3),
            _ => Some(25.4),
        };
        let sides = [Tag::PixelXDimension, Tag::PixelYDimension].map(positive);
        let orientation =
            integer(Tag::Orientation).filter(|turn| (1..=8).contains(turn)).unwrap_or(1);
        let ascii = |tag| match value(tag)? {
            Value::Ascii(list) => list.first().and_then(|bytes| std::str::from_utf8(bytes).ok()),
            // Some cameras write texts with the type of bytes that mean nothing.
            Value::Undefined(bytes, _) => std::str::from_utf8(bytes).ok(),
            _ => None,
        };
        let name = |tag| {
            let name = ascii(tag)?.trim_matches(is_blank);
            let name = &name[..name.floor_char_boundary(MAX_NAME_BYTES)];
            (!name.is_empty()).then(|| name.to_owned())
        };
        let time_s = TIME_TAGS.into_iter().find_map(|(date, sub_s)| {
            let date = parse_date(ascii(date)?)?;
            let sub_s = date.fraction_s.or_else(|| fraction_of_second(ascii(sub_s)?));
            Some(date.whole_s + sub_s.unwrap_or(0.0))
        });
        Self {
            focal_mm: positive(Tag::FocalLength),
            focal_35mm: positive(Tag::FocalLengthIn35mmFilm),
            digital_zoom: positive(Tag::DigitalZoomRatio).filter(|ratio| *ratio > 1.0),
            pixels_per_mm: positive(Tag::FocalPlaneXResolution)
                .zip(unit_mm)
                .map(|(count, mm)| count / mm),
            long_side_px: sides[0].zip(sides[1]).map(|(x, y)| x.max(y)),
            orientation: orientation as u8,
            time_s,
            is_panorama: integer(Tag::CustomRendered) == Some(APPLE_PANORAMA),
            device: Device {
                make: name(Tag::Make),
                model: name(Tag::Model),
                serial: name(Tag::BodySerialNumber),
                lens: name(Tag::LensModel),
                lens_serial: name(Tag::LensSerialNumber),
            },
            position: position_of(&fields),
        }
    }

    /// The focal length in pixels of a `width` × `height` image: the first plausible value from the
    /// width of the sensor (its longer side, if given), from the 35 mm equivalent, and from the
    /// resolution of the focal plane.
    pub fn focal_px(&self, width: u32, height: u32, sensor_width_mm: Option<f64>) -> Option<f64> {
        let candidates = self.focal_candidates_px(width, height, sensor_width_mm);
        candidates
            .into_iter()
            .flatten()
            .find(|focal_px| is_plausible_focal(*focal_px, width, height))
    }

    /// The first focal length in pixels that the EXIF data give, if none of them is plausible.
    pub fn implausible_focal_px(&self, width: u32, height: u32) -> Option<f64> {
        let first = self.focal_candidates_px(width, height, None).into_iter().flatten().next();
        first.filter(|_| self.focal_px(width, height, None).is_none())
    }

    fn focal_candidates_px(
        &self,
        width: u32,
        height: u32,
        sensor_width_mm: Option<f64>,
    ) -> [Option<f64>; 3] {
        let (width, height) = (f64::from(width), f64::from(height));
        let long_side = width.max(height);
        let from_sensor = || Some(self.focal_mm? / sensor_width_mm? * long_side);
        let from_film = || Some(self.focal_35mm? / FILM_DIAGONAL_MM * width.hypot(height));
        // Accounts for an image that was scaled after it was taken.
        let from_plane = || {
            Some(
                self.focal_mm?
                    * self.pixels_per_mm?
                    * (long_side / self.long_side_px.unwrap_or(long_side)),
            )
        };
        [from_sensor(), from_film(), from_plane()]
    }
}

/// Whether a lens may have this focal length, in pixels of a `width` × `height` image: between 0.1
/// and 150 times the longer side.
pub fn is_plausible_focal(focal_px: f64, width: u32, height: u32) -> bool {
    FOCAL_RANGE.contains(&(focal_px / f64::from(width.max(height))))
}

/// The fields of a time and of its fraction of a second, the best first. `DateTime` is the time of
/// the last change: that of the photo, unless a program changed it.
const TIME_TAGS: [(Tag, Tag); 3] = [
    (Tag::DateTimeOriginal, Tag::SubSecTimeOriginal),
    (Tag::DateTimeDigitized, Tag::SubSecTimeDigitized),
    (Tag::DateTime, Tag::SubSecTime),
];

/// Seconds since 1970-01-01 00:00.
struct Date {
    whole_s: f64,
    /// The fraction of a second, if the date has one.
    fraction_s: Option<f64>,
}

/// A date as seconds since 1970-01-01 00:00, without time zones; [`parse_date`] has the forms.
pub(crate) fn seconds_of_date(text: &str) -> Option<f64> {
    parse_date(text).map(|date| date.whole_s + date.fraction_s.unwrap_or(0.0))
}

/// A date `YYYY:MM:DD HH:MM:SS`, as EXIF asks for, or in another form that cameras write: other
/// characters between the numbers, spaces for leading zeros, no seconds, a fraction of a second,
/// the first hour of a day as 24. What follows, as a time zone, is ignored: the clock of the camera
/// counts.
fn parse_date(text: &str) -> Option<Date> {
    const BETWEEN: [char; 6] = [':', '-', '/', '.', ' ', 'T'];
    let mut rest = text;
    let mut next = |may_follow: &[char]| -> Option<(i64, Option<char>)> {
        let number = take_number(&mut rest)?;
        let separator = rest.chars().next().filter(|c| may_follow.contains(c));
        rest = &rest[separator.map_or(0, char::len_utf8)..];
        Some((number, separator))
    };
    let ((year, _), (month, _), (day, _)) = (next(&BETWEEN)?, next(&BETWEEN)?, next(&BETWEEN)?);
    let (hour, between) = next(&BETWEEN)?;
    let hour = if hour == 24 { 0 } else { hour };
    let (minute, before_second) = next(between.as_slice())?;
    let second = match before_second {
        Some(_) if !rest.trim_matches(is_blank).is_empty() => take_number(&mut rest)?,
        _ => 0,
    };
    let fraction_s = rest.strip_prefix(['.', ',']).and_then(fraction_of_second);
    let in_range = (1..=9999).contains(&year)
        && (1..=12).contains(&month)
        && (1..=31).contains(&day)
        && (0..24).contains(&hour)
        && (0..60).contains(&minute)
        && (0..=60).contains(&second);
    if !in_range {
        return None;
    }
    // Days of the proleptic Gregorian calendar; years begin in March, so that the leap day is the
    // last one.
    let (y, m) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let days = 365 * y + y / 4 - y / 100 + y / 400 + (153 * m + 2) / 5 + day - 1 - 719_468;
    Some(Date { whole_s: (days * 86_400 + hour * 3_600 + minute * 60 + second) as f64, fraction_s })
}

fn is_blank(c: char) -> bool {
    c.is_whitespace() || c == '\0'
}

/// Takes a number from the beginning of a text; spaces may stand for its leading zeros.
fn take_number(rest: &mut &str) -> Option<i64> {
    let digits = rest.trim_start();
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    let (number, after) = digits.split_at(end);
    *rest = after;
    number.parse().ok()
}

/// The decimals at the beginning of a text as a fraction.
fn fraction_of_second(text: &str) -> Option<f64> {
    let digits = text.trim_start();
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    (end > 0).then(|| format!("0.{}", &digits[..end]).parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_converted_to_unix_time() {
        // `date -u -d '2024-02-29 12:34:56' +%s`
        for (date, expected) in [
            ("1970:01:01 00:00:00", 0.0),
            ("2024:02:29 12:34:56", 1_709_210_096.0),
            ("2000:03:01 00:00:00", 951_868_800.0),
        ] {
            assert_eq!(seconds_of_date(date), Some(expected));
        }
        // Forms of cameras and programs.
        for (date, second) in [
            ("2024:02:29 12:34:56.250", 56.25),
            ("2024:02:29 12:34:56,250+02:00", 56.25),
            ("2024:02:29 12:34:56+02:00", 56.0),
            ("2024-02-29T12:34:56Z", 56.0),
            ("2024-02-29-12-34-56", 56.0),
            ("2024/02/29 12:34:56", 56.0),
            ("2024: 2:29 12:34: 6\0", 6.0),
            ("2024:02:29 12:34", 0.0),
            ("2024:02:29 12:34:  ", 0.0),
            ("2024:02:29 12:34-07:00", 0.0),
        ] {
            assert_eq!(seconds_of_date(date), Some(1_709_210_040.0 + second), "{date}");
        }
        // An hour from 1 to 24: the first one of the day that the date names.
        let first_hour = seconds_of_date("2015:08:22 00:08:19");
        assert!(first_hour.is_some() && seconds_of_date("2015:08:22 24:08:19") == first_hour);
        let beyond = "9223372036854775807:01:01 00:00:00";
        for date in [
            "",
            "    :  :     :  :  ",
            "2024:13:01 00:00:00",
            "0000:00:00 00:00:00",
            "2024:01:01",
            "2024:01:01 12",
            "2024:01:01 25:00:00",
            "2024:01:01 12:60",
            "2024:01:01 12:00:x",
            beyond,
        ] {
            assert_eq!(seconds_of_date(date), None);
        }
    }

    #[test]
    fn focal_length_uses_the_available_fields() {
        let exif = Exif { focal_mm: Some(18.0), ..Exif::default() };
        assert_eq!(exif.focal_px(3000, 2000, None), None);
        assert_eq!(exif.focal_px(3000, 2000, Some(36.0)), Some(1500.0));
        assert_eq!(exif.focal_px(2000, 3000, Some(36.0)), Some(1500.0));
        let film = Exif { focal_35mm: Some(36.0), ..Exif::default() };
        // On a 3:2 image the equivalents by diagonal and by width agree: 36 mm is the width.
        assert!((film.focal_px(3000, 2000, None).unwrap() - 3000.0).abs() < 1e-3);
        // Without a width of the sensor, the resolution in the file is used.
        let plane = Exif { pixels_per_mm: Some(100.0), long_side_px: Some(6000.0), ..exif };
        assert_eq!(plane.focal_px(3000, 2000, None), Some(900.0));
    }

    #[test]
    fn implausible_focal_lengths_are_ignored() {
        for implausible in [1e-6, 2.0, 1e5, 1e300] {
            let exif = Exif { focal_35mm: Some(implausible), ..Exif::default() };
            assert_eq!(exif.focal_px(3000, 2000, None), None, "{implausible}");
            assert!(exif.implausible_focal_px(3000, 2000).is_some(), "{implausible}");
            // Another given focal length may be plausible.
            let both = Exif { focal_mm: Some(18.0), pixels_per_mm: Some(100.0), ..exif };
            assert_eq!(both.focal_px(3000, 2000, None), Some(1800.0));
            assert_eq!(both.implausible_focal_px(3000, 2000), None);
        }
        for real_mm in [8.0, 15.0, 26.0, 3000.0] {
            let exif = Exif { focal_35mm: Some(real_mm), ..Exif::default() };
            assert!(
                exif.focal_px(4000, 3000, None).is_some()
                    && exif.implausible_focal_px(4000, 3000).is_none()
            );
        }
    }
}
