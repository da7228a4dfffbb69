//! Coordinate reference systems of EPSG: what coordinates of a georeferenced model are in when they
//! leave it.

use std::fmt;
use std::str::FromStr;

use nalgebra::Vector3;

use crate::geodesy::{Geodetic, UtmZone};

/// A coordinate reference system.
///
/// Coordinates are in the order of maps and of LAS: east before north, so longitude before
/// latitude, where EPSG lists latitude first. Heights are above the ellipsoid: they are those of
/// EPSG:4979, which a system of two dimensions does not say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Crs {
    /// Longitude and latitude of WGS 84 in degrees, and height: EPSG:4326, and with its height
    /// EPSG:4979.
    Geographic {
        /// Whether its code is 4979.
        has_height: bool,
    },
    /// ECEF of WGS 84, in metres: EPSG:4978.
    Geocentric,
    /// Easting, northing and height in metres: EPSG:326xx and 327xx of WGS 84, EPSG:258xx of
    /// ETRS89.
    Utm {
        /// The zone.
        zone: UtmZone,
        /// Whether its code is that of ETRS89. Coordinates are taken over as they are: services of
        /// corrections for receivers in Europe give positions in ETRS89, which receivers write as
        /// WGS 84. True coordinates of WGS 84 are off by up to 0.9 m, the motion of the plate since
        /// 1989. The ellipsoids differ by 0.1 mm.
        is_etrs89: bool,
    },
}

/// The zones of ETRS89 that EPSG has.
const ETRS89_ZONES: std::ops::RangeInclusive<u8> = 28..=38;

/// How far from a zone of UTM places may be, in degrees of longitude: the neighbours of a zone,
/// since countries use one zone for all (Germany zone 32 and Norway zone 33 to three degrees beyond
/// their edges). There, lengths are wrong by up to 1.2 %; at half of it, where those maps end, by
/// 0.5 %; at double of it by 3.5 %. Also how far beyond the equator, in degrees of latitude.
const BESIDE_ZONE_DEG: f64 = 6.0;
/// UTM ends there towards the south and the north pole.
const UTM_LATITUDES_DEG: [f64; 2] = [-80.0, 84.0];

impl Crs {
    /// Its code.
    pub fn epsg(self) -> u32 {
        match self {
            Self::Geographic { has_height: false } => 4326,
            Self::Geographic { has_height: true } => 4979,
            Self::Geocentric => 4978,
            Self::Utm { zone: UtmZone { number, is_north }, is_etrs89 } => {
                let first = match (is_etrs89, is_north) {
                    (true, _) => 25800,
                    (false, true) => 32600,
                    (false, false) => 32700,
                };
                first + u32::from(number)
            }
        }
    }

    /// Of a code; `None` for one that is not supported.
    pub fn from_epsg(code: u32) -> Option<Self> {
        match code {
            4326 => Some(Self::Geographic { has_height: false }),
            4979 => Some(Self::Geographic { has_height: true }),
            4978 => Some(Self::Geocentric),
            _ => {
                let is_etrs89 = code / 100 == 258;
                let zone = UtmZone::from_epsg(if is_etrs89 { code % 100 + 32600 } else { code })?;
                let is_known = !is_etrs89 || ETRS89_ZONES.contains(&zone.number);
                is_known.then_some(Self::Utm { zone, is_etrs89 })
            }
        }
    }

    /// Whether its coordinates cannot be given without heights.
    pub fn needs_height(self) -> bool {
        matches!(self, Self::Geocentric | Self::Geographic { has_height: true })
    }

    /// The system and what the three coordinates are, with their units. Without `has_heights`, the
    /// height of the origin is not known.
    pub fn in_words(self, has_heights: bool) -> String {
        let place = match self {
            Self::Geocentric => return format!("{self} (X, Y and Z from the earth's centre, m)"),
            Self::Geographic { .. } => "longitude and latitude, degrees",
            Self::Utm { .. } => "easting and northing, m",
        };
        let height = match has_heights {
            true => "height above the ellipsoid, m",
            false => "height above the model's origin, m",
        };
        format!("{self} ({place}; {height})")
    }

    /// Whether a place is in the area of the system or beside it.
    pub fn contains(self, place: &Geodetic) -> bool {
        let Self::Utm { zone, .. } = self else { return true };
        let from_middle_deg = place.longitude_deg - zone.central_meridian_deg();
        let from_middle_deg = (from_middle_deg + 180.0).rem_euclid(360.0) - 180.0;
        let [south_deg, north_deg] = match zone.is_north {
            true => [-BESIDE_ZONE_DEG, UTM_LATITUDES_DEG[1]],
            false => [UTM_LATITUDES_DEG[0], BESIDE_ZONE_DEG],
        };
        from_middle_deg.abs() <= UtmZone::WIDTH_DEG / 2.0 + BESIDE_ZONE_DEG
            && (south_deg..=north_deg).contains(&place.latitude_deg)
    }

    /// The coordinates of a place that the system [contains](Self::contains).
    pub fn project(self, place: &Geodetic) -> Vector3<f64> {
        match self {
            Self::Geographic { .. } => {
                Vector3::new(place.longitude_deg, place.latitude_deg, place.height_m)
            }
            Self::Geocentric => place.to_ecef(),
            Self::Utm { zone, .. } => zone.project(place),
        }
    }
}

impl fmt::Display for Crs {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "EPSG:{}", self.epsg())
    }
}

impl FromStr for Crs {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let code = match text.split_once(':') {
            Some((authority, code)) if authority.eq_ignore_ascii_case("epsg") => code,
            Some(_) => "",
            None => text,
        };
        code.parse().ok().and_then(Self::from_epsg).ok_or_else(|| {
            "expected EPSG:4326 or EPSG:4979 (longitude and latitude), EPSG:4978 (ECEF), \
             EPSG:32601 to 32660 or 32701 to 32760 (UTM on WGS 84, north or south), or EPSG:25828 \
             to 25838 (UTM on ETRS89)"
                .to_owned()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// PROJ's values are printed to a micrometre.
    const PRINTED_M: f64 = 2e-6;
    /// Ours of ETRS89 are on the ellipsoid of WGS 84.
    const ELLIPSOIDS_M: f64 = 2e-4;

    fn place([latitude_deg, longitude_deg, height_m]: [f64; 3]) -> Geodetic {
        Geodetic { latitude_deg, longitude_deg, height_m }
    }

    #[test]
    fn codes_are_those_of_epsg() {
        let known: Vec<u32> = (0..40_000).filter(|code| Crs::from_epsg(*code).is_some()).collect();
        let expected = (4326..=4326)
            .chain(4978..=4979)
            .chain(25828..=25838)
            .chain(32601..=32660)
            .chain(32701..=32760);
        assert!(known.iter().copied().eq(expected), "{known:?}");
        for code in known {
            let crs = Crs::from_epsg(code).unwrap();
            assert_eq!((crs.epsg(), format!("epsg:{code}").parse()), (code, Ok(crs)));
            assert_eq!(code.to_string().parse(), Ok(crs));
        }
        for text in ["", "EPSG:", "EPSG:31467", "ESRI:32632", "EPSG:-1", "4326:EPSG", "UTM32"] {
            assert!(text.parse::<Crs>().unwrap_err().contains("EPSG:4978"), "{text}");
        }
    }

    /// Code, index of the place, and coordinates: values of pyproj 3.7.2 with PROJ 9.5.1,
    /// `Transformer.from_crs(4979, code, always_xy=True)`.
    #[rustfmt::skip]
    const PROJ: [(u32, usize, [f64; 3]); 13] = [
        (4326, 0, [11.57550000000, 48.13740000000, 519.000000]),
        (4979, 1, [151.21530000000, -33.85680000000, -20.500000]),
        (4978, 0, [4177959.247494, 855750.235972, 4727472.030087]),
        (4978, 3, [-6101191.456556, -1064.858803, -1852834.285414]),
        (32632, 0, [691603.031991, 5334780.030903, 519.000000]),
        (25832, 0, [691603.031993, 5334780.030781, 519.000000]),
        (32633, 0, [245243.210547, 5337245.006499, 519.000000]),
        (32756, 1, [334900.569652, 6252288.752888, -20.500000]),
        (32755, 1, [890060.205442, 6245719.056401, -20.500000]),
        (25835, 2, [377439.333326, 7843206.134438, 12.000000]),
        (32634, 2, [599089.695720, 7842045.458436, 12.000000]),
        (32701, 3, [181614.093911, 8118014.492348, 3.000000]),
        (32760, 3, [820517.208459, 8117981.834848, 3.000000]),
    ];

    #[test]
    fn coordinates_are_those_of_proj() {
        let [munich, sydney, hammerfest, fiji] = [
            place([48.1374, 11.5755, 519.0]),
            place([-33.8568, 151.2153, -20.5]),
            place([70.6634, 23.6821, 12.0]),
            place([-17.0, -179.99, 3.0]),
        ];
        for (code, place, expected) in PROJ {
            let place = [munich, sydney, hammerfest, fiji][place];
            let crs = Crs::from_epsg(code).unwrap();
            assert!(crs.contains(&place), "{code}");
            let found = crs.project(&place);
            let tolerance_m = match crs {
                Crs::Utm { is_etrs89: true, .. } => ELLIPSOIDS_M,
                _ => PRINTED_M,
            };
            assert!((found - Vector3::from(expected)).amax() < tolerance_m, "{code}: {found}");
        }
    }

    #[test]
    fn zones_end_a_zone_beside_them() {
        let contains = |code: u32, latitude_deg: f64, longitude_deg: f64| {
            Crs::from_epsg(code).unwrap().contains(&place([latitude_deg, longitude_deg, 0.0]))
        };
        // Görlitz is in zone 33, and maps of Germany use zone 32.
        assert!(contains(25832, 51.15, 15.0) && contains(32632, 51.15, 15.0));
        assert!(!contains(32632, 51.15, 18.01) && !contains(32632, -33.9, 9.0));
        assert!(contains(32760, -17.0, -179.0) && contains(32701, -17.0, 179.0));
        assert!(contains(32632, 84.0, 9.0) && !contains(32632, 84.1, 9.0));
        assert!(contains(32732, -80.0, 9.0) && !contains(32732, -80.1, 9.0));
        // Swapped coordinates.
        assert!(!contains(32632, 11.5, 48.1) && contains(4978, 11.5, 48.1));
        assert!(!contains(32632, f64::NAN, 9.0) && !contains(32632, 48.0, f64::NAN));
    }
}
