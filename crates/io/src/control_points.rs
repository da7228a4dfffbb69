//! Ground control points: the `gcp_list.txt` of OpenDroneMap, and CSV.
//!
//! The first line of a `gcp_list.txt` is the frame: `EPSG:4326` (longitude, latitude), a UTM zone
//! of WGS 84 (`EPSG:32633`, `WGS84 UTM 33N`, `+proj=utm +zone=33`), or `local` (metres, z up). Each
//! line after it is a mark of a point in an image: `x y z px_x px_y image [name]`, with the pixel
//! from the top-left corner of the image. Marks of one name, or without names of one position, are
//! of one point.
//!
//! A CSV file has a header with the columns `point`, `lat,lon,alt` (WGS 84, degrees and metres) or
//! `x,y,z` (metres, z up), `image`, `px`, `py`, in any order, and a line for each mark. Columns of
//! standard deviations may be among them: `sigma_h` (along each horizontal axis) and `sigma_v` (of
//! the height), or `sigma` for both, in metres, and `sigma_px` of the coordinates of marks.
//!
//! Points whose names begin with `CHK-` are check points: they tell of errors, and determine
//! nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use tiepoint_geometry::geodesy::UtmZone;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_scene::Place;

use crate::Result;
use crate::text::excerpt::Excerpt;
use crate::text::{Lines, Words};

/// What the names of check points begin with.
const CHECK: &str = "CHK-";

/// A point with measured coordinates that is marked in images.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlPoint {
    /// Its name, or a number from 1 on.
    pub name: String,
    /// Where it is.
    pub place: Place,
    /// Standard deviations along a horizontal axis and of the height, in metres, if the file
    /// states them.
    pub sigmas_m: Option<[f64; 2]>,
    /// Standard deviation of the coordinates of a mark in pixels, if the file states it.
    pub mark_sigma_px: Option<f64>,
    /// Whether it only tells of errors.
    pub is_check: bool,
    /// Names of images, and the pixels in them.
    pub marks: Vec<(String, Vector2<f64>)>,
}

/// The frame of the coordinates.
#[derive(Clone, Copy)]
enum Frame {
    Degrees,
    Utm(UtmZone),
    Local,
}

impl Frame {
    fn parse(text: &str) -> Option<Self> {
        let lower = text.trim().to_ascii_lowercase();
        if lower == "local" {
            return Some(Self::Local);
        }
        if let Some(code) = lower.strip_prefix("epsg:") {
            let code: u32 = code.trim().parse().ok()?;
            return match code {
                4326 | 4979 => Some(Self::Degrees),
                code => UtmZone::from_epsg(code).map(Self::Utm),
            };
        }
        let zone = |number: u8, is_north| {
            (1..=60).contains(&number).then_some(Self::Utm(UtmZone { number, is_north }))
        };
        if let Some(rest) = lower.strip_prefix("wgs84 utm ") {
            let rest = rest.trim();
            let (number, letter) = rest.split_at_checked(rest.len().checked_sub(1)?)?;
            let is_north = match letter {
                "n" => true,
                "s" => false,
                _ => return None,
            };
            return zone(number.trim().parse().ok()?, is_north);
        }
        let parameter = |name: &str| {
            lower.split_whitespace().find_map(|word| word.strip_prefix(name)?.strip_prefix('='))
        };
        let is_wgs84 = [parameter("+datum"), parameter("+ellps")]
            .into_iter()
            .flatten()
            .all(|value| value == "wgs84");
        match parameter("+proj")? {
            "utm" if is_wgs84 => {
                let is_north = !lower.split_whitespace().any(|word| word == "+south");
                zone(parameter("+zone")?.parse().ok()?, is_north)
            }
            "longlat" | "latlong" if is_wgs84 => Some(Self::Degrees),
            _ => None,
        }
    }

    fn place(self, xyz: Vector3<f64>) -> Place {
        let geodetic = match self {
            Self::Local => return Place::Cartesian(xyz),
            Self::Degrees => {
                return Place::Geodetic {
                    latitude_deg: xyz.y,
                    longitude_deg: xyz.x,
                    altitude_m: Some(xyz.z),
                };
            }
            Self::Utm(zone) => zone.unproject(&xyz),
        };
        Place::Geodetic {
            latitude_deg: geodetic.latitude_deg,
            longitude_deg: geodetic.longitude_deg,
            altitude_m: Some(geodetic.height_m),
        }
    }
}

/// Reads control points, in the order of their first marks.
///
/// # Errors
///
/// If the file cannot be read or has no mark, if its frame is none of the above, or its header
/// lacks a column, if a number is missing, not finite or out of its range, if a point has two
/// positions, deviations or marks in an image, and if a place does not exist.
pub fn read(path: &Path) -> Result<Vec<ControlPoint>> {
    let mut lines = Lines::open(path)?;
    let header = lines.next()?.map(|mut words| words.rest().to_owned()).unwrap_or_default();
    let mut points = Points::default();
    if header.contains(',') && !header.contains("+proj") {
        let columns = Columns::of_header(&header).map_err(|what| lines.error(what))?;
        while let Some(mut line) = lines.next()? {
            let mark = columns.read(&mut line)?;
            points.add(mark, &line)?;
        }
    } else {
        let Some(frame) = Frame::parse(&header) else {
            return Err(lines.error(format!(
                "the frame is `{}` and must be EPSG:4326, a UTM zone of WGS 84 (as EPSG:32633), or \
                 local; the header of a CSV file has the columns {COLUMNS}",
                Excerpt(&header)
            )));
        };
        while let Some(mut line) = lines.next()? {
            let mark = frame.read(&mut line)?;
            points.add(mark, &line)?;
        }
    }
    if points.found.is_empty() {
        return Err(lines.error("has no mark of a point"));
    }
    Ok(points.found)
}

/// A line of a file.
struct MarkLine {
    /// Empty if it has none.
    name: String,
    /// What tells points without names apart.
    coordinates: Vector3<f64>,
    place: Place,
    sigmas_m: Option<[f64; 2]>,
    mark_sigma_px: Option<f64>,
    image: String,
    pixel: Vector2<f64>,
}

impl Frame {
    /// A line of a `gcp_list.txt`.
    fn read(self, line: &mut Words) -> Result<MarkLine> {
        let coordinates = Vector3::from(line.f64s::<3>("a coordinate of the point")?);
        let pixel = Vector2::from(line.f64s::<2>("a coordinate of the pixel")?);
        let image = line.word("the image")?.to_owned();
        let name = line.rest().trim().to_owned();
        let place = self.place(coordinates);
        let (sigmas_m, mark_sigma_px) = (None, None);
        Ok(MarkLine { name, coordinates, place, sigmas_m, mark_sigma_px, image, pixel })
    }
}

/// The columns that a CSV file has.
const COLUMNS: &str = "point, lat,lon,alt or x,y,z, image, px and py";
/// Columns of standard deviations.
const SIGMAS: [&str; 4] = ["sigma", "sigma_h", "sigma_v", "sigma_px"];

/// The columns of a CSV file: their places by their names.
struct Columns {
    of_name: BTreeMap<String, usize>,
    is_geodetic: bool,
}

impl Columns {
    /// An error says what is wrong with the header.
    fn of_header(header: &str) -> std::result::Result<Self, String> {
        let words = header.split(',').map(|word| word.trim().to_ascii_lowercase());
        let mut of_name = BTreeMap::new();
        for (index, word) in words.enumerate() {
            let what = format!("the column `{}` is in the header twice", Excerpt(&word));
            if of_name.insert(word, index).is_some() {
                return Err(what);
            }
        }
        let is_geodetic = of_name.contains_key("lat");
        let place = if is_geodetic { ["lat", "lon", "alt"] } else { ["x", "y", "z"] };
        let required = ["point", "image", "px", "py"].into_iter().chain(place);
        if let Some(missing) = required.clone().find(|name| !of_name.contains_key(*name)) {
            return Err(format!(
                "the header `{}` lacks the column {missing}: it has {COLUMNS}, and perhaps {}",
                Excerpt(header),
                SIGMAS.join(", ")
            ));
        }
        let known: BTreeSet<&str> = required.chain(SIGMAS).collect();
        if let Some(other) = of_name.keys().find(|name| !known.contains(name.as_str())) {
            let what = "is none of control points, which has";
            return Err(format!(
                "the column `{}` {what} {COLUMNS}, and perhaps {}",
                Excerpt(other),
                SIGMAS.join(", ")
            ));
        }
        if of_name.contains_key("sigma_h") != of_name.contains_key("sigma_v")
            || of_name.contains_key("sigma") && of_name.contains_key("sigma_h")
        {
            return Err("the deviations are sigma, or sigma_h and sigma_v".to_owned());
        }
        Ok(Self { of_name, is_geodetic })
    }

    fn read(&self, line: &mut Words) -> Result<MarkLine> {
        let text = line.rest();
        let fields: Vec<&str> = text.split(',').map(str::trim).collect();
        if fields.len() != self.of_name.len() {
            return Err(line.error(format!(
                "`{}` has {} fields and the header {}: decimals follow a point, and names have no \
                 comma",
                Excerpt(text),
                fields.len(),
                self.of_name.len()
            )));
        }
        let field = |name: &str| self.of_name.get(name).map(|&index| fields[index]);
        let word = |name: &str| match field(name) {
            None | Some("") => Err(line.error(format!("the column {name} is empty"))),
            Some(word) => Ok(word.to_owned()),
        };
        let number = |name: &str| {
            let text = field(name).unwrap_or_default();
            let value = text.parse().ok().filter(|value: &f64| value.is_finite());
            value.ok_or_else(|| {
                line.error(format!("the column {name} is `{}`, no number", Excerpt(text)))
            })
        };
        let sigma = |name: &str| match field(name) {
            None | Some("") => Ok(None),
            Some(text) => match number(name)? {
                value if value > 0.0 => Ok(Some(value)),
                _ => Err(line.error(format!("{name} is {}, not above 0", Excerpt(text)))),
            },
        };
        let names = if self.is_geodetic { ["lon", "lat", "alt"] } else { ["x", "y", "z"] };
        let [x, y, z] = names.map(number);
        let coordinates = Vector3::new(x?, y?, z?);
        let frame = if self.is_geodetic { Frame::Degrees } else { Frame::Local };
        let sigmas_m = match sigma("sigma")? {
            Some(both) => Some([both; 2]),
            None => match (sigma("sigma_h")?, sigma("sigma_v")?) {
                (Some(horizontal), Some(vertical)) => Some([horizontal, vertical]),
                (None, None) => None,
                _ => return Err(line.error("one of sigma_h and sigma_v is empty")),
            },
        };
        Ok(MarkLine {
            name: word("point")?,
            coordinates,
            place: frame.place(coordinates),
            sigmas_m,
            mark_sigma_px: sigma("sigma_px")?,
            image: word("image")?,
            pixel: Vector2::new(number("px")?, number("py")?),
        })
    }
}

/// Points as they are read.
#[derive(Default)]
struct Points {
    found: Vec<ControlPoint>,
    by_key: BTreeMap<String, usize>,
    marked: BTreeSet<(usize, String)>,
}

impl Points {
    fn add(&mut self, mark: MarkLine, line: &Words) -> Result<()> {
        let MarkLine { name, coordinates, place, sigmas_m, mark_sigma_px, image, pixel } = mark;
        place.validate().map_err(|what| line.error(what))?;
        let key = if name.is_empty() { format!("{coordinates:?}") } else { name.clone() };
        let index = *self.by_key.entry(key).or_insert(self.found.len());
        if index == self.found.len() {
            let name = if name.is_empty() { (index + 1).to_string() } else { name };
            let (is_check, marks) = (name.starts_with(CHECK), Vec::new());
            self.found.push(ControlPoint { name, place, sigmas_m, mark_sigma_px, is_check, marks });
        }
        let point = &mut self.found[index];
        let name = Excerpt(&point.name);
        if point.place != place {
            return Err(line.error(format!("the point {name} has another position above")));
        }
        if (point.sigmas_m, point.mark_sigma_px) != (sigmas_m, mark_sigma_px) {
            let what = format!("the point {name} has other standard deviations above");
            return Err(line.error(what));
        }
        if !self.marked.insert((index, image.clone())) {
            let image = Excerpt(&image);
            return Err(line.error(format!("the point {name} is marked twice in {image}")));
        }
        point.marks.push((image, pixel));
        Ok(())
    }
}
