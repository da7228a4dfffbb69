//! Ground control points: the `gcp_list.txt` of OpenDroneMap.
//!
//! The first line is the frame: `EPSG:4326` (longitude, latitude), a UTM zone of WGS 84
//! (`EPSG:32633`, `WGS84 UTM 33N`, `+proj=utm +zone=33`), or `local` (metres, z up). Each line
//! after it is a mark of a point in an image: `x y z px_x px_y image [name]`, with the pixel from
//! the top-left corner of the image. Marks of one name, or without names of one position, are of
//! one point. Points whose names begin with `CHK-` are check points: they tell of errors, and
//! determine nothing.

use std::collections::BTreeMap;
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
/// If the file cannot be read or has no mark, if its frame is none of the above, if a number is
/// missing or not finite, if a point has two positions or two marks in an image, and if a place
/// does not exist.
pub fn read(path: &Path) -> Result<Vec<ControlPoint>> {
    let mut lines = Lines::open(path)?;
    let header = lines.next()?.map(|mut words| words.rest().to_owned()).unwrap_or_default();
    let Some(frame) = Frame::parse(&header) else {
        return Err(lines.error(format!(
            "the frame is `{}` and must be EPSG:4326, a UTM zone of WGS 84 (as EPSG:32633), or \
             local",
            Excerpt(&header)
        )));
    };
    let mut points: Vec<ControlPoint> = Vec::new();
    let mut by_key: BTreeMap<String, usize> = BTreeMap::new();
    while let Some(mut line) = lines.next()? {
        let xyz = Vector3::from(line.f64s::<3>("a coordinate of the point")?);
        let pixel = Vector2::from(line.f64s::<2>("a coordinate of the pixel")?);
        let image = line.word("the image")?.to_owned();
        let name = line.rest().trim();
        let key = match name {
            "" => format!("{xyz:?}"),
            name => name.to_owned(),
        };
        let place = frame.place(xyz);
        place.validate().map_err(|what| line.error(what))?;
        let index = *by_key.entry(key).or_insert(points.len());
        if index == points.len() {
            let name = if name.is_empty() { (index + 1).to_string() } else { name.to_owned() };
            let is_check = name.starts_with(CHECK);
            points.push(ControlPoint { name, place, is_check, marks: Vec::new() });
        }
        add_mark(&mut points[index], place, image, pixel, &line)?;
    }
    if points.is_empty() {
        return Err(lines.error("has no mark of a point"));
    }
    Ok(points)
}

fn add_mark(
    point: &mut ControlPoint,
    place: Place,
    image: String,
    pixel: Vector2<f64>,
    line: &Words,
) -> Result<()> {
    let name = Excerpt(&point.name);
    if point.place != place {
        return Err(line.error(format!("the point {name} has another position above")));
    }
    if point.marks.iter().any(|(other, _)| *other == image) {
        return Err(line.error(format!("the point {name} is marked twice in {}", Excerpt(&image))));
    }
    point.marks.push((image, pixel));
    Ok(())
}
