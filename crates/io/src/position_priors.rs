//! Measured positions: a CSV file with the header `image,lat,lon,alt` (WGS 84, degrees and metres)
//! or `image,x,y,z` (a Cartesian frame in metres, z up). Columns of standard deviations in metres
//! may follow: `sigma`, or `sigma_h,sigma_v` (along each horizontal axis, and of the height). In
//! place of images, a track has times of a clock of its own, `seconds`.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{Place, Position, PositionTrack};

use crate::Result;
use crate::atomic::write_atomic;
use crate::text::excerpt::Excerpt;
use crate::text::{Lines, Words};

const IMAGE: &str = "image";
const SECONDS: &str = "seconds";

/// The columns behind the name.
struct Columns {
    is_geodetic: bool,
    num_sigmas: usize,
}

impl Columns {
    fn of_header(header: &str, key: &str) -> Option<Self> {
        let mut words = header.split(',').map(|word| word.trim().to_ascii_lowercase());
        let words: Vec<String> = words.by_ref().collect();
        let [first, place @ ..] = words.as_slice() else { return None };
        let place: Vec<&str> = place.iter().map(String::as_str).collect();
        let (place, sigmas) = place.split_at_checked(3)?;
        let is_geodetic = match place {
            ["lat" | "latitude", "lon" | "longitude", "alt" | "altitude"] => true,
            ["x", "y", "z"] => false,
            _ => return None,
        };
        let is_known = matches!(sigmas, [] | ["sigma"] | ["sigma_h", "sigma_v"]);
        (first == key && is_known).then_some(Self { is_geodetic, num_sigmas: sigmas.len() })
    }

    /// The name and the position of a line.
    fn read(&self, line: &mut Words) -> Result<(String, Position)> {
        let text = line.rest();
        let count = 3 + self.num_sigmas;
        let mut fields: Vec<&str> = text.rsplitn(count + 1, ',').map(str::trim).collect();
        fields.reverse();
        if fields.len() <= count || fields[0].is_empty() {
            return Err(line.error(format!(
                "`{}` is not a name and {count} numbers between commas",
                Excerpt(text)
            )));
        }
        let name = fields[0];
        // Of a number with a decimal comma, a part ends up in the name.
        let is_number = |text: &str| text.trim().parse::<f64>().is_ok();
        if name.rsplit_once(',').is_some_and(|(_, last)| is_number(last)) {
            return Err(line.error(format!(
                "`{}` has more than {count} numbers: decimals follow a point, not a comma",
                Excerpt(text)
            )));
        }
        let of_name = Excerpt(name);
        let number = |field: &str, what: &str| match field.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(line.error(format!("{what} of {of_name} is `{}`, no number", Excerpt(field)))),
        };
        let place = if self.is_geodetic {
            let altitude_m = match fields[3] {
                "" => None,
                field => Some(number(field, "the altitude")?),
            };
            let latitude_deg = number(fields[1], "the latitude")?;
            Place::Geodetic {
                latitude_deg,
                longitude_deg: number(fields[2], "the longitude")?,
                altitude_m,
            }
        } else {
            let [x, y, z] = [(1, "x"), (2, "y"), (3, "z")].map(|(k, what)| number(fields[k], what));
            Place::Cartesian(Vector3::new(x?, y?, z?))
        };
        place.validate().map_err(|what| {
            let is_swapped = what.starts_with("the latitude");
            let swapped = if is_swapped { ": latitude comes before longitude" } else { "" };
            line.error(format!("{what} for {of_name}{swapped}"))
        })?;
        let mut sigmas_m = [None; 2];
        for (sigma_m, field) in sigmas_m.iter_mut().zip(&fields[4..]) {
            if !field.is_empty() {
                let value = number(field, "a standard deviation")?;
                if value <= 0.0 {
                    let what =
                        format!("the standard deviation {value} of {of_name} is not above 0");
                    return Err(line.error(what));
                }
                *sigma_m = Some(value);
            }
        }
        if self.num_sigmas == 1 {
            sigmas_m[1] = sigmas_m[0];
        }
        let [sigma_horizontal_m, sigma_vertical_m] = sigmas_m;
        Ok((name.to_owned(), Position { place, sigma_horizontal_m, sigma_vertical_m }))
    }
}

/// Whether a file has positions of images: its first line begins with `image` and a separator.
///
/// # Errors
///
/// If the file cannot be read.
pub fn has_header(path: &Path) -> Result<bool> {
    begins_with(path, IMAGE)
}

/// Whether a file is a track: its first line begins with `seconds` and a separator.
///
/// # Errors
///
/// If the file cannot be read.
pub fn is_track(path: &Path) -> Result<bool> {
    begins_with(path, SECONDS)
}

fn begins_with(path: &Path, key: &str) -> Result<bool> {
    let mut lines = Lines::open(path)?;
    let first = lines.next()?.map(|mut words| words.rest().to_ascii_lowercase());
    let rest = first.as_deref().and_then(|line| line.strip_prefix(key));
    Ok(rest.is_some_and(|rest| rest.trim_start().starts_with([',', ';'])))
}

/// Reads measured positions by the names of the images. The last commas of a line separate, so that
/// a name may contain some. An altitude or standard deviation may be left empty.
///
/// # Errors
///
/// If the file cannot be read or has no position, if its header is another one, if a number is
/// missing, not finite or out of its range, and if a name is listed twice.
pub fn read(path: &Path) -> Result<BTreeMap<String, Position>> {
    let mut positions = BTreeMap::new();
    read_lines(path, IMAGE, |name, position, line| {
        match positions.insert(name.to_owned(), position) {
            Some(_) => Err(line.error(format!("the image {} is listed twice", Excerpt(name)))),
            None => Ok(()),
        }
    })?;
    Ok(positions)
}

/// Writes places by the names of images, all of one kind, as [`read`] reads them: places on the
/// earth to a tenth of a millimetre, Cartesian ones, whose unit may be any, with all their digits.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write(path: &Path, places: &[(&str, Place)]) -> Result<()> {
    let is_geodetic = matches!(places.first(), Some((_, Place::Geodetic { .. })));
    let columns = if is_geodetic { "lat,lon,alt" } else { "x,y,z" };
    write_atomic(path, |file| {
        writeln!(file, "{IMAGE},{columns}")?;
        places.iter().try_for_each(|(name, place)| match place {
            Place::Geodetic { latitude_deg, longitude_deg, altitude_m } => {
                let altitude = altitude_m.map_or_else(String::new, |m| format!("{m:.4}"));
                writeln!(file, "{name},{latitude_deg:.9},{longitude_deg:.9},{altitude}")
            }
            Place::Cartesian(xyz) => writeln!(file, "{name},{},{},{}", xyz.x, xyz.y, xyz.z),
        })
    })
}

/// Reads a track: in each line the time in seconds, of any clock, comes first.
///
/// # Errors
///
/// As of [`read`], and if a time is no finite number.
pub fn read_track(path: &Path) -> Result<PositionTrack> {
    let mut positions = Vec::new();
    read_lines(path, SECONDS, |text, position, line| {
        let time_s = text.parse().ok().filter(|time_s: &f64| time_s.is_finite());
        let time_s: f64 = time_s.ok_or_else(|| {
            line.error(format!("the time is `{}`, not a number of seconds", Excerpt(text)))
        })?;
        positions.push((time_s, position));
        Ok(())
    })?;
    Ok(PositionTrack::new(positions))
}

/// Takes the first column and the position of each line.
fn read_lines(
    path: &Path,
    key: &str,
    mut take: impl FnMut(&str, Position, &Words) -> Result<()>,
) -> Result<()> {
    let mut lines = Lines::open(path)?;
    let header = lines.next()?.map(|mut words| words.rest().to_owned()).unwrap_or_default();
    let Some(columns) = Columns::of_header(&header, key) else {
        let separators = if header.contains([';', '\t']) { ", separated by commas" } else { "" };
        return Err(lines.error(format!(
            "the header is `{}` and must be `{key},lat,lon,alt` or `{key},x,y,z`, perhaps with \
             `,sigma` or `,sigma_h,sigma_v`{separators}",
            Excerpt(&header)
        )));
    };
    let mut is_empty = true;
    while let Some(mut line) = lines.next()? {
        let (first, position) = columns.read(&mut line)?;
        take(&first, position, &line)?;
        is_empty = false;
    }
    if is_empty {
        return Err(lines.error("has no position"));
    }
    Ok(())
}
