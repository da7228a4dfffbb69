//! Where a photo was taken: EXIF's GPS fields, and the deviations of DJI's RTK in XMP.

use std::io::Read;
use std::path::Path;

use exif::{In, Tag, Value};
use tiepoint_scene::{Place, Position};

/// Of 68 % of two-dimensional normal errors, the norm is at most this many standard deviations of
/// an axis: √(−2 ln 0.317). Phones give that radius as `GPSHPositioningError`.
const RADIUS_OF_68_PERCENT: f64 = 1.515;

/// The position that the EXIF fields give; `None` if a field is missing or impossible, if the
/// receiver had no fix, and at latitude and longitude 0.
///
/// `GPSDOP` is not used: it describes the satellites, and not the error.
pub(super) fn position_of(fields: &exif::Exif) -> Option<Position> {
    let value = |tag| fields.get_field(tag, In::PRIMARY).map(|field| &field.value);
    let letter = |tag| match value(tag)? {
        Value::Ascii(list) => list.first()?.first().map(u8::to_ascii_uppercase),
        Value::Undefined(bytes, _) => bytes.first().map(u8::to_ascii_uppercase),
        _ => None,
    };
    let numbers = |tag| match value(tag)? {
        Value::Rational(list) => {
            let list: Vec<f64> = list.iter().map(|number| number.to_f64()).collect();
            list.iter().all(|number| number.is_finite()).then_some(list)
        }
        _ => None,
    };
    let degrees = |tag| {
        let list = numbers(tag)?;
        let units = [1.0, 60.0, 3600.0];
        (!list.is_empty())
            .then(|| list.iter().zip(units).map(|(part, unit)| part / unit).sum::<f64>())
    };
    let signed = |tag, reference, [positive, negative]: [u8; 2]| match letter(reference)? {
        found if found == positive => degrees(tag),
        found if found == negative => Some(-degrees(tag)?),
        _ => None,
    };
    if letter(Tag::GPSStatus) == Some(b'V') {
        return None;
    }
    // 1 and 3 (EXIF 3.0) are below the sea and the ellipsoid.
    let is_below = value(Tag::GPSAltitudeRef)
        .is_some_and(|reference| matches!(reference.get_uint(0), Some(1 | 3)));
    let altitude_m = numbers(Tag::GPSAltitude)
        .and_then(|list| list.first().copied())
        .map(|altitude_m| if is_below { -altitude_m } else { altitude_m });
    let place = Place::Geodetic {
        latitude_deg: signed(Tag::GPSLatitude, Tag::GPSLatitudeRef, [b'N', b'S'])?,
        longitude_deg: signed(Tag::GPSLongitude, Tag::GPSLongitudeRef, [b'E', b'W'])?,
        altitude_m,
    };
    let sigma_horizontal_m = numbers(Tag::GPSHPositioningError)
        .and_then(|list| list.first().copied())
        .filter(|radius| *radius > 0.0)
        .map(|radius| radius / RADIUS_OF_68_PERCENT);
    let is_place = place.validate().is_ok() && !place.is_null();
    is_place.then_some(Position { place, sigma_horizontal_m, sigma_vertical_m: None })
}

/// Where XMP is in a photo of DJI: in the first segments of the file.
const XMP_BYTES: u64 = 1 << 18;

/// Sets the deviations that DJI's drones write in XMP for positions of RTK.
pub(super) fn add_rtk_deviations(position: &mut Position, path: &Path) {
    let mut bytes = Vec::new();
    let read = std::fs::File::open(path).map(|file| file.take(XMP_BYTES).read_to_end(&mut bytes));
    if read.is_err() {
        return;
    }
    let sigma_m = |name: &str| xmp_number(&bytes, name).filter(|sigma_m| *sigma_m > 0.0);
    if let (Some(lat), Some(lon)) = (sigma_m("RtkStdLat"), sigma_m("RtkStdLon")) {
        position.sigma_horizontal_m = Some(lat.max(lon));
        position.sigma_vertical_m = sigma_m("RtkStdHgt");
    }
}

/// The finite number of `drone-dji:NAME`, an attribute or an element.
fn xmp_number(bytes: &[u8], name: &str) -> Option<f64> {
    let key = format!("drone-dji:{name}");
    let at = bytes.windows(key.len()).position(|window| window == key.as_bytes())?;
    let rest = &bytes[at + key.len()..];
    let rest = rest.strip_prefix(b"=\"").or_else(|| rest.strip_prefix(b">"))?;
    let end = rest.iter().position(|byte| matches!(byte, b'"' | b'<'))?;
    let text = std::str::from_utf8(&rest[..end]).ok()?;
    text.trim().parse().ok().filter(|number: &f64| number.is_finite())
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use exif::experimental::Writer;
    use exif::{Field, Rational};

    use super::*;

    fn rationals(list: &[(u32, u32)]) -> Value {
        Value::Rational(list.iter().map(|&(num, denom)| Rational { num, denom }).collect())
    }

    fn read(values: &[(Tag, Value)]) -> Option<Position> {
        let fields: Vec<Field> = values
            .iter()
            .map(|(tag, value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() })
            .collect();
        let mut writer = Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut bytes = Cursor::new(Vec::new());
        writer.write(&mut bytes, false).unwrap();
        position_of(&exif::Reader::new().read_raw(bytes.into_inner()).unwrap())
    }

    fn ascii(text: &str) -> Value {
        Value::Ascii(vec![text.as_bytes().to_vec()])
    }

    #[test]
    fn positions_have_their_hemispheres_and_heights() {
        let with = |changes: &[(Tag, Value)]| {
            let mut all = vec![
                (Tag::GPSLatitudeRef, ascii("N")),
                (Tag::GPSLatitude, rationals(&[(55, 1), (41, 1), (534, 10)])),
                (Tag::GPSLongitudeRef, ascii("E")),
                (Tag::GPSLongitude, rationals(&[(13, 1), (11, 1), (434, 10)])),
                (Tag::GPSAltitudeRef, Value::Byte(vec![0])),
                (Tag::GPSAltitude, rationals(&[(37, 1)])),
            ];
            for (tag, value) in changes {
                all.retain(|(other, _)| other != tag);
                all.push((*tag, value.clone()));
            }
            read(&all)
        };
        let place = |latitude_deg, longitude_deg, altitude_m| {
            Some(Place::Geodetic { latitude_deg, longitude_deg, altitude_m })
        };
        // The fields of lund/01.jpg.
        let [lat, lon] = [55.0 + 41.0 / 60.0 + 53.4 / 3600.0, 13.0 + 11.0 / 60.0 + 43.4 / 3600.0];
        let found = |changes: &[(Tag, Value)]| with(changes).map(|position| position.place);
        assert_eq!(found(&[]), place(lat, lon, Some(37.0)));
        let south_west = [(Tag::GPSLatitudeRef, ascii("S")), (Tag::GPSLongitudeRef, ascii("w"))];
        assert_eq!(found(&south_west), place(-lat, -lon, Some(37.0)));
        let below = [(Tag::GPSAltitudeRef, Value::Byte(vec![1]))];
        assert_eq!(found(&below), place(lat, lon, Some(-37.0)));
        let no_height = [(Tag::GPSAltitude, rationals(&[(1, 0)]))];
        assert_eq!(found(&no_height), place(lat, lon, None));
        let minutes = [(Tag::GPSLatitude, rationals(&[(55, 1), (419, 10)]))];
        assert_eq!(found(&minutes), place(55.0 + 41.9 / 60.0, lon, Some(37.0)));
        let error = with(&[(Tag::GPSHPositioningError, rationals(&[(1515, 100)]))]).unwrap();
        assert!((error.sigma_horizontal_m.unwrap() - 10.0).abs() < 1e-12);
        // Neither a place without its hemisphere, nor one of a receiver without a fix.
        for (tag, value) in [
            (Tag::GPSStatus, ascii("V")),
            (Tag::GPSLatitudeRef, ascii("")),
            (Tag::GPSLatitude, rationals(&[(91, 1), (0, 1), (0, 1)])),
            (Tag::GPSLatitude, rationals(&[(0, 0), (0, 0), (0, 0)])),
            (Tag::GPSLatitude, Value::Short(vec![55])),
        ] {
            assert_eq!(with(&[(tag, value)]), None, "{tag}");
        }
        let zero = rationals(&[(0, 1), (0, 1), (0, 1)]);
        assert_eq!(with(&[(Tag::GPSLatitude, zero.clone()), (Tag::GPSLongitude, zero)]), None);
    }

    #[test]
    fn deviations_of_rtk_are_read_from_xmp() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("0.jpg");
        let place = Place::Geodetic { latitude_deg: 1.0, longitude_deg: 2.0, altitude_m: None };
        let deviations = |xmp: &str| {
            std::fs::write(&path, [b"\xFF\xD8\xFF\xE1", xmp.as_bytes()].concat()).unwrap();
            let mut position = Position { place, sigma_horizontal_m: None, sigma_vertical_m: None };
            add_rtk_deviations(&mut position, &path);
            [position.sigma_horizontal_m, position.sigma_vertical_m]
        };
        let attributes = "drone-dji:RtkStdLon=\"0.01102\" drone-dji:RtkStdLat=\"0.01228\" \
                          drone-dji:RtkStdHgt=\"0.0234\"";
        assert_eq!(deviations(attributes), [Some(0.01228), Some(0.0234)]);
        let elements = "<drone-dji:RtkStdLon>0.02</drone-dji:RtkStdLon>\
                        <drone-dji:RtkStdLat>0.01</drone-dji:RtkStdLat>";
        assert_eq!(deviations(elements), [Some(0.02), None]);
        for other in ["", "drone-dji:RtkStdLon=\"0\" drone-dji:RtkStdLat=\"x\"", "drone-dji:RtkStd"]
        {
            assert_eq!(deviations(other), [None; 2]);
        }
    }
}
