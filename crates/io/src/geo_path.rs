//! Paths of cameras on the earth, for maps: GeoJSON (RFC 7946) and GPX 1.1.

use std::io::Write;
use std::path::Path;

use serde_json::{Value, json};
use tiepoint_geometry::geodesy::Geodetic;
use tiepoint_store::AtomicFile;

use crate::Result;

/// How a GeoJSON file of this program begins.
pub const GEOJSON_START: &str = r#"{"type":"FeatureCollection","generator":"tiepoint","#;
/// How a GPX file of this program begins.
pub const GPX_START: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<gpx version=\"1.1\" \
                             creator=\"tiepoint\" ";

/// The photos of one body in the order in which they were taken.
#[derive(Clone, Debug, PartialEq)]
pub struct GeoPath {
    /// The name of the body, such as the folder of its photos.
    pub name: String,
    /// The photos.
    pub photos: Vec<GeoPhoto>,
}

/// A photo and its camera's centre.
#[derive(Clone, Debug, PartialEq)]
pub struct GeoPhoto {
    /// The name of the photo.
    pub name: String,
    /// Where its camera was.
    pub place: Geodetic,
    /// When it was taken, in seconds since 1970, if that is known.
    pub time_s: Option<f64>,
}

/// Digits behind the point of degrees (a tenth of a millimetre) and of metres.
const DEGREES: usize = 9;
const METRES: usize = 3;

/// Writes a line for each path, and a point for each photo. Without `has_heights` coordinates have
/// two dimensions.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write_geojson(path: &Path, paths: &[GeoPath], has_heights: bool) -> Result<()> {
    let position = |photo: &GeoPhoto| {
        let Geodetic { latitude_deg, longitude_deg, height_m } = photo.place;
        let height = if has_heights { format!(",{height_m:.METRES$}") } else { String::new() };
        format!("[{longitude_deg:.DEGREES$},{latitude_deg:.DEGREES$}{height}]")
    };
    let feature = |kind: &str, coordinates: &str, properties: Value| {
        format!(
            "{{\"type\":\"Feature\",\"properties\":{properties},\"geometry\":{{\"type\":\"{kind}\",\
             \"coordinates\":{coordinates}}}}}"
        )
    };
    let mut features = Vec::new();
    for path in paths {
        // A line has two places at least.
        if path.photos.len() >= 2 {
            let coordinates: Vec<String> = path.photos.iter().map(position).collect();
            let coordinates = format!("[{}]", coordinates.join(","));
            features.push(feature("LineString", &coordinates, json!({ "name": path.name })));
        }
        features.extend(path.photos.iter().map(|photo| {
            let properties = match photo.time_s {
                Some(time_s) => json!({ "image": photo.name, "seconds": time_s }),
                None => json!({ "image": photo.name }),
            };
            feature("Point", &position(photo), properties)
        }));
    }
    let text = format!("{GEOJSON_START}\"features\":[\n{}\n]}}\n", features.join(",\n"));
    Ok(AtomicFile::write_with(path, |out| out.write_all(text.as_bytes()))?)
}

/// Writes a track for each path, with the names of the photos, their heights with `has_heights`,
/// and their times in UTC, where they are known.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write_gpx(path: &Path, paths: &[GeoPath], has_heights: bool) -> Result<()> {
    let mut text = format!("{GPX_START}xmlns=\"http://www.topografix.com/GPX/1/1\">\n");
    for path in paths {
        text += &format!("<trk><name>{}</name><trkseg>\n", escaped(&path.name));
        for photo in &path.photos {
            let Geodetic { latitude_deg, longitude_deg, height_m } = photo.place;
            text += &format!(
                "<trkpt lat=\"{latitude_deg:.DEGREES$}\" lon=\"{longitude_deg:.DEGREES$}\">"
            );
            if has_heights {
                text += &format!("<ele>{height_m:.METRES$}</ele>");
            }
            if let Some(time_s) = photo.time_s {
                text += &format!("<time>{}</time>", utc(time_s));
            }
            text += &format!("<name>{}</name></trkpt>\n", escaped(&photo.name));
        }
        text += "</trkseg></trk>\n";
    }
    text += "</gpx>\n";
    Ok(AtomicFile::write_with(path, |out| out.write_all(text.as_bytes()))?)
}

/// Text in XML, without the control characters that XML 1.0 does not have.
fn escaped(text: &str) -> String {
    let mut escaped = String::new();
    for c in text.chars() {
        match c {
            '&' => escaped += "&amp;",
            '<' => escaped += "&lt;",
            '>' => escaped += "&gt;",
            c if c.is_control() || matches!(c, '\u{FFFE}' | '\u{FFFF}') => escaped.push('_'),
            c => escaped.push(c),
        }
    }
    escaped
}

/// A date of ISO 8601 to a millisecond, of seconds since 1970.
fn utc(time_s: f64) -> String {
    let milliseconds = (time_s * 1000.0).round() as i64;
    let (days, rest) = (milliseconds.div_euclid(86_400_000), milliseconds.rem_euclid(86_400_000));
    // The proleptic Gregorian calendar in eras of 400 years, which begin in March.
    let from_0000 = days + 719_468;
    let (era, day) = (from_0000.div_euclid(146_097), from_0000.rem_euclid(146_097));
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day_of_year = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + 400 * era + i64::from(month <= 2);
    let (hour, minute) = (rest / 3_600_000, rest / 60_000 % 60);
    let (second, millisecond) = (rest / 1000 % 60, rest % 1000);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{millisecond:03}Z")
}

#[cfg(test)]
mod tests {
    use tiepoint_scene::Place;

    use super::*;
    use crate::gpx;

    fn paths() -> Vec<GeoPath> {
        let photo = |k: u8| GeoPhoto {
            name: format!("a & <b>/{k}.jpg"),
            place: Geodetic {
                latitude_deg: -48.1 + f64::from(k) * 1e-5,
                longitude_deg: 179.99999,
                height_m: 519.25,
            },
            // `date -u -d '2024-02-29 12:34:56' +%s`
            time_s: Some(1_709_210_096.5 + f64::from(k)),
        };
        let photos = (0..3).map(photo).collect();
        vec![GeoPath { name: "a & <b>".to_owned(), photos }]
    }

    #[test]
    fn a_gpx_file_is_read_as_it_was_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.gpx");
        write_gpx(&path, &paths(), true).unwrap();
        let track = gpx::read(&path).unwrap();
        let photos = &paths()[0].photos;
        assert_eq!(track.times_s(), [0.5, 1.5, 2.5].map(|s| 1_709_210_096.0 + s));
        for (position, photo) in track.positions().iter().zip(photos) {
            let Geodetic { latitude_deg, longitude_deg, height_m } = photo.place;
            let Place::Geodetic { latitude_deg: latitude, longitude_deg: longitude, altitude_m } =
                position.place
            else {
                panic!("{position:?}");
            };
            // Half a unit of the last digit.
            assert!((latitude - latitude_deg).abs() < 6e-10, "{latitude}");
            assert!((longitude - longitude_deg).abs() < 6e-10, "{longitude}");
            assert_eq!(altitude_m, Some(height_m));
        }
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            text.starts_with(GPX_START) && text.contains("<name>a &amp; &lt;b&gt;/0.jpg</name>")
        );
        write_gpx(&path, &paths(), false).unwrap();
        assert_eq!(gpx::read(&path).unwrap().positions()[0].place.validate(), Ok(()));
        assert!(!std::fs::read_to_string(&path).unwrap().contains("<ele>"));
    }

    #[test]
    fn geojson_has_a_line_and_its_photos() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.geojson");
        write_geojson(&path, &paths(), true).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with(GEOJSON_START));
        let found: Value = serde_json::from_str(&text).unwrap();
        let features = found["features"].as_array().unwrap();
        assert_eq!(features.len(), 4);
        assert_eq!(features[0]["geometry"]["type"], "LineString");
        assert_eq!(features[0]["properties"]["name"], "a & <b>");
        // Longitude first, as the standard says.
        assert_eq!(features[1]["geometry"]["coordinates"], json!([179.99999, -48.1, 519.25]));
        assert_eq!(features[3]["properties"]["image"], "a & <b>/2.jpg");
        assert_eq!(features[3]["properties"]["seconds"], 1_709_210_098.5);
        write_geojson(&path, &paths(), false).unwrap();
        let found: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(found["features"][1]["geometry"]["coordinates"], json!([179.99999, -48.1]));
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (time_s, date) in [
            (0.0, "1970-01-01T00:00:00.000Z"),
            (-1.0, "1969-12-31T23:59:59.000Z"),
            (951_782_400.0, "2000-02-29T00:00:00.000Z"),
            (951_868_800.0, "2000-03-01T00:00:00.000Z"),
            (1_735_689_599.999_6, "2025-01-01T00:00:00.000Z"),
            (4_107_542_400.0, "2100-03-01T00:00:00.000Z"),
        ] {
            assert_eq!(utc(time_s), date);
        }
    }
}
