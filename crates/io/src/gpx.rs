//! Tracks of satellite receivers: GPX 1.0 and 1.1
//! (<https://www.topografix.com/GPX/1/1/>).

use std::path::Path;

use roxmltree::{Document, Node, ParsingOptions};
use tiepoint_scene::{Place, Position, PositionTrack};

use crate::text::excerpt::Excerpt;
use crate::text::read_text;
use crate::{Error, Result};

/// A position in each second of a day takes some 20 MB.
const MAX_BYTES: u64 = 1 << 28;
/// Most elements, attributes aside: those of a million points. Each takes some 70 bytes.
const MAX_NODES: u32 = 10_000_000;

/// Reads the track points that have a time, in seconds since 1970 (UTC), and their places on WGS
/// 84. Heights are above the sea, by the standard.
///
/// # Errors
///
/// If the file cannot be read, is no XML or no GPX, if a point has no place on the earth or a time
/// that is no date, and if no point has a time.
pub fn read(path: &Path) -> Result<PositionTrack> {
    let text = read_text(path, MAX_BYTES, "GPX track")?;
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(&text, options)
        .map_err(|cause| Error::content(path, format!("is no XML: {cause}")))?;
    let root = document.root_element();
    if root.tag_name().name() != "gpx" {
        return Err(Error::content(path, "is no GPX: its root is not `gpx`"));
    }
    let mut positions = Vec::new();
    let points = || root.descendants().filter(|node| node.has_tag_name_of("trkpt"));
    for point in points() {
        let error = |what: String| {
            let line = document.text_pos_at(point.range().start).row as usize;
            Error::Line { path: path.to_owned(), line, what }
        };
        let degrees = |name: &str| {
            let text = point.attribute(name).unwrap_or_default();
            let number = text.trim().parse().ok().filter(|number: &f64| number.is_finite());
            number.ok_or_else(|| error(format!("`{name}` is `{}`, no number", Excerpt(text))))
        };
        let child = |name: &str| point.children().find(|node| node.has_tag_name_of(name));
        let text = |name: &str| child(name).and_then(|node| node.text()).map(str::trim);
        // Receivers without a height leave it out, or write something that is none.
        let altitude_m: Option<f64> = text("ele").and_then(|text| text.parse().ok());
        let place = Place::Geodetic {
            latitude_deg: degrees("lat")?,
            longitude_deg: degrees("lon")?,
            altitude_m: altitude_m.filter(|altitude_m| altitude_m.is_finite()),
        };
        place.validate().map_err(&error)?;
        let Some(time) = text("time") else { continue };
        let time_s = seconds_of(time)
            .ok_or_else(|| error(format!("the time is `{}`, no date", Excerpt(time))))?;
        let position = Position { place, sigma_horizontal_m: None, sigma_vertical_m: None };
        positions.push((time_s, position));
    }
    if positions.is_empty() {
        let what = match points().next() {
            Some(_) => "has no track point with a time",
            None => "has no track point: its routes and waypoints have no times",
        };
        return Err(Error::content(path, what));
    }
    Ok(PositionTrack::new(positions))
}

trait NameOf {
    /// Whether it is an element of this name, in any namespace: GPX 1.0 and 1.1 differ in it.
    fn has_tag_name_of(&self, name: &str) -> bool;
}

impl NameOf for Node<'_, '_> {
    fn has_tag_name_of(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

/// Seconds since 1970 of a date of ISO 8601 such as `2024-02-29T12:34:56.7Z`; without a zone, of
/// UTC.
fn seconds_of(text: &str) -> Option<f64> {
    let (date, time) = text.split_once(['T', ' '])?;
    let [year, month, day] = numbers(date, '-')?.map(|number| number as i64);
    let zone = time.find(['Z', 'z', '+', '-']).unwrap_or(time.len());
    let [hour, minute, second] = numbers(&time[..zone], ':')?;
    let east_s = match &time[zone..] {
        "" | "Z" | "z" => 0.0,
        zone => {
            let sign = if zone.starts_with('-') { -1.0 } else { 1.0 };
            let (hours, minutes) = match zone[1..].split_once(':') {
                Some(parts) => parts,
                None => zone[1..].split_at_checked(2)?,
            };
            let minutes = if minutes.is_empty() { "0" } else { minutes };
            sign * (3600.0 * hours.parse::<f64>().ok()? + 60.0 * minutes.parse::<f64>().ok()?)
        }
    };
    let is_date = (1..=9999).contains(&year)
        && (1..=12).contains(&month)
        && (1..=31).contains(&day)
        && (0.0..24.0).contains(&hour)
        && (0.0..60.0).contains(&minute)
        && (0.0..61.0).contains(&second)
        && east_s.abs() < 86_400.0;
    if !is_date {
        return None;
    }
    // Days of the proleptic Gregorian calendar; years begin in March, so that the leap day is the
    // last one.
    let (y, m) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let days = 365 * y + y / 4 - y / 100 + y / 400 + (153 * m + 2) / 5 + day - 1 - 719_468;
    Some(days as f64 * 86_400.0 + hour * 3600.0 + minute * 60.0 + second - east_s)
}

/// Three numbers between separators.
fn numbers(text: &str, separator: char) -> Option<[f64; 3]> {
    let mut words = text.split(separator).map(|word| {
        let is_number = word.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
        word.parse::<f64>().ok().filter(|_| is_number)
    });
    let found = [words.next()??, words.next()??, words.next()??];
    words.next().is_none().then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<PositionTrack> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.gpx");
        std::fs::write(&path, text).unwrap();
        read(&path)
    }

    fn gpx(points: &str) -> String {
        format!(
            "<?xml version=\"1.0\"?><gpx xmlns=\"http://www.topografix.com/GPX/1/1\"><trk>\
             <trkseg>{points}</trkseg></trk></gpx>"
        )
    }

    #[test]
    fn times_are_those_of_utc() {
        // `date -u -d '2024-02-29 12:34:56' +%s`
        assert_eq!(seconds_of("2024-02-29T12:34:56Z"), Some(1_709_210_096.0));
        assert_eq!(seconds_of("2024-02-29T12:34:56.25"), Some(1_709_210_096.25));
        assert_eq!(seconds_of("2024-02-29T14:34:56+02:00"), Some(1_709_210_096.0));
        assert_eq!(seconds_of("2024-02-29T07:04:56-0530"), Some(1_709_210_096.0));
        assert_eq!(seconds_of("1970-01-01T00:00:00z"), Some(0.0));
        for wrong in [
            "",
            "2024-02-29",
            "2024-13-01T00:00:00Z",
            "9999999999999999999-01-01T00:00:00Z",
            "2024-02-29T24:00:00Z",
            "29.2.2024T1:2:3",
            "2024-02-29T12:34Z",
            "2024-02-29T12:34:56+x",
            "2024-02-29T1e1:34:56Z",
            "T",
            "é-é-éTé",
        ] {
            assert_eq!(seconds_of(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn points_have_their_times_and_heights() {
        let track = of(&gpx(
            "<trkpt lat=\"48.1\" lon=\"179.5\"><ele>519.25</ele><time>1970-01-01T00:00:07Z</time>\
             </trkpt><!-- <trkpt lat=\"x\"/> --><trkpt lat=\"48.2\" lon=\"-179.5\"><time>\
             1970-01-01T00:00:05Z</time></trkpt><trkpt lat=\"1\" lon=\"2\"><ele>NaN</ele></trkpt>",
        ));
        let track = track.unwrap();
        assert_eq!(track.times_s(), [5.0, 7.0]);
        let place = |latitude_deg, longitude_deg, altitude_m| Place::Geodetic {
            latitude_deg,
            longitude_deg,
            altitude_m,
        };
        let places: Vec<Place> = track.positions().iter().map(|position| position.place).collect();
        assert_eq!(places, [place(48.2, -179.5, None), place(48.1, 179.5, Some(519.25))]);
    }

    #[test]
    fn what_is_wrong_is_said() {
        let point = |attributes: &str, time: &str| {
            gpx(&format!("<trkpt {attributes}><time>{time}</time></trkpt>"))
        };
        let time = "2024-02-29T12:34:56Z";
        for (text, part) in [
            (point("lat=\"NaN\" lon=\"1\"", time), "`lat` is `NaN`, no number"),
            (point("lat=\"48,1\" lon=\"1\"", time), "`lat` is `48,1`, no number"),
            (point("lat=\"91\" lon=\"1\"", time), "the latitude 91 is not from -90 to 90"),
            (point("lat=\"1\"", time), "`lon` is ``, no number"),
            (point("lat=\"1\" lon=\"1\"", "noon"), "the time is `noon`, no date"),
            (gpx("<trkpt lat=\"1\" lon=\"1\"/>"), "has no track point with a time"),
            (gpx(""), "has no track point"),
            ("<kml/>".to_owned(), "its root is not `gpx`"),
            ("lat,lon".to_owned(), "is no XML"),
        ] {
            let found = of(&text).unwrap_err().to_string();
            assert!(found.contains(part), "{found}");
        }
    }
}
