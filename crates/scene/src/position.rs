//! Measured positions of cameras, and the frame in which a model may be that fits them.

use tiepoint_geometry::geodesy::{Geodetic, LocalFrame};
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::numeric::median;

/// A measured place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// On the earth, WGS 84.
    Geodetic {
        /// Latitude, north positive.
        latitude_deg: f64,
        /// Longitude, east positive.
        longitude_deg: f64,
        /// Altitude, above the ellipsoid or above the sea: receivers differ, and a set of one
        /// receiver has one kind.
        altitude_m: Option<f64>,
    },
    /// In a Cartesian frame in metres with z up, such as that of a total station or a projection.
    Cartesian(Vector3<f64>),
}

/// The measured position of a camera's centre, as from a satellite receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// Where it is.
    pub place: Place,
    /// Standard deviation along each horizontal axis, in metres, if it is known.
    pub sigma_horizontal_m: Option<f64>,
    /// Standard deviation of the height, in metres, if it is known.
    pub sigma_vertical_m: Option<f64>,
}

impl Place {
    /// Checks that such a place exists.
    ///
    /// # Errors
    ///
    /// What is wrong with which coordinate, as the end of a sentence.
    pub fn validate(&self) -> Result<(), String> {
        match *self {
            Self::Geodetic { latitude_deg, longitude_deg, altitude_m } => {
                let altitude = ("altitude", altitude_m.unwrap_or(0.0), ALTITUDES_M);
                for (name, value, range) in [
                    ("latitude", latitude_deg, -90.0..=90.0),
                    ("longitude", longitude_deg, -180.0..=360.0),
                    altitude,
                ] {
                    if !range.contains(&value) {
                        let (low, high) = (range.start(), range.end());
                        return Err(format!("the {name} {value} is not from {low} to {high}"));
                    }
                }
                Ok(())
            }
            Self::Cartesian(xyz) => match xyz.iter().find(|value| !WIDTHS_M.contains(*value)) {
                Some(value) => Err(format!(
                    "the coordinate {value} is not from {} to {}",
                    WIDTHS_M.start(),
                    WIDTHS_M.end()
                )),
                None => Ok(()),
            },
        }
    }

    /// Whether this is latitude 0 and longitude 0, which receivers without a fix write.
    pub fn is_null(&self) -> bool {
        matches!(self, Self::Geodetic { latitude_deg: 0.0, longitude_deg: 0.0, .. })
    }
}

/// Projections of the whole earth have coordinates of up to 20 000 km, and its centre is 6400 km
/// away: beyond five times as much it is no place on it.
const WIDTHS_M: std::ops::RangeInclusive<f64> = -1e8..=1e8;

/// From the deepest place of the sea to beyond satellites in low orbits.
const ALTITUDES_M: std::ops::RangeInclusive<f64> = -12_000.0..=2_000_000.0;

/// The frame of a model that fits measured positions: metric, x and y horizontal, z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Georeference {
    /// East, north and up of WGS 84 at an origin.
    Enu {
        /// The frame.
        frame: LocalFrame,
        /// Whether the height of the origin is known; else it is 0.
        has_height: bool,
    },
    /// A Cartesian frame, whose coordinates are those of the model plus `offset`.
    Cartesian {
        /// The model's origin in the measured frame.
        offset: Vector3<f64>,
    },
}

/// Coordinates beyond this are shifted to a near origin: clouds hold coordinates as `f32`, with a
/// millimetre at this distance.
const FAR_M: f64 = 1e4;

impl Georeference {
    /// A frame near the middle of places of one kind; `None` without any.
    pub fn near<'a>(places: impl IntoIterator<Item = &'a Place>) -> Option<Self> {
        let (mut geodetic, mut cartesian) = (Vec::new(), Vec::new());
        for place in places {
            match *place {
                Place::Geodetic { latitude_deg, longitude_deg, altitude_m } => {
                    geodetic.push([latitude_deg, longitude_deg, altitude_m.unwrap_or(f64::NAN)]);
                }
                Place::Cartesian(xyz) => cartesian.push(xyz),
            }
        }
        let Some([_, first_deg, _]) = geodetic.first().copied() else {
            let axis =
                |k: usize| median(&mut cartesian.iter().map(|xyz| xyz[k]).collect::<Vec<_>>());
            let middle = Vector3::new(axis(0)?, axis(1)?, axis(2)?);
            let is_far = middle.amax() > FAR_M;
            let offset = if is_far { middle.map(f64::round) } else { Vector3::zeros() };
            return Some(Self::Cartesian { offset });
        };
        let middle = |value: &dyn Fn(&[f64; 3]) -> f64| -> Option<f64> {
            let mut known: Vec<f64> =
                geodetic.iter().map(value).filter(|value| value.is_finite()).collect();
            median(&mut known)
        };
        // The date line may be between them.
        let longitude_deg = |place: &[f64; 3]| {
            let from_first = (place[1] - first_deg + 180.0).rem_euclid(360.0) - 180.0;
            first_deg + from_first
        };
        let height_m = middle(&|place| place[2]);
        let origin = Geodetic {
            latitude_deg: middle(&|place| place[0])?,
            longitude_deg: (middle(&longitude_deg)? + 180.0).rem_euclid(360.0) - 180.0,
            height_m: height_m.unwrap_or(0.0),
        };
        Some(Self::Enu { frame: LocalFrame::new(origin), has_height: height_m.is_some() })
    }

    /// A place in this frame. Without an altitude it is at that of the origin. `None` for a place
    /// of the other kind.
    pub fn to_local(&self, place: &Place) -> Option<Vector3<f64>> {
        match (self, *place) {
            (
                Self::Enu { frame, .. },
                Place::Geodetic { latitude_deg, longitude_deg, altitude_m },
            ) => {
                let height_m = altitude_m.unwrap_or(frame.origin().height_m);
                Some(frame.to_local(&Geodetic { latitude_deg, longitude_deg, height_m }))
            }
            (Self::Cartesian { offset }, Place::Cartesian(xyz)) => Some(xyz - offset),
            _ => None,
        }
    }

    /// The place of local coordinates, whose height counts with `has_height`.
    pub fn to_place(&self, local: &Vector3<f64>, has_height: bool) -> Place {
        match self {
            Self::Enu { frame, .. } => {
                let Geodetic { latitude_deg, longitude_deg, height_m } = frame.to_geodetic(local);
                let altitude_m = has_height.then_some(height_m);
                Place::Geodetic { latitude_deg, longitude_deg, altitude_m }
            }
            Self::Cartesian { offset } => Place::Cartesian(local + offset),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geodetic(latitude_deg: f64, longitude_deg: f64, altitude_m: Option<f64>) -> Place {
        Place::Geodetic { latitude_deg, longitude_deg, altitude_m }
    }

    #[test]
    fn impossible_places_are_named() {
        assert_eq!(geodetic(90.0, -180.0, None).validate(), Ok(()));
        assert_eq!(geodetic(0.0, 359.9, Some(-400.0)).validate(), Ok(()));
        for (place, part) in [
            (geodetic(139.7, 35.7, None), "the latitude 139.7 is not from -90 to 90"),
            (geodetic(f64::NAN, 35.7, None), "the latitude NaN"),
            (geodetic(1.0, 361.0, None), "the longitude 361 is not from -180 to 360"),
            (geodetic(1.0, 2.0, Some(1e9)), "the altitude 1000000000"),
            (Place::Cartesian(Vector3::new(0.0, f64::INFINITY, 0.0)), "the coordinate inf"),
            (Place::Cartesian(Vector3::new(f64::NAN, 0.0, 0.0)), "the coordinate NaN"),
            (Place::Cartesian(Vector3::new(0.0, 0.0, -1.1e8)), "the coordinate -110000000"),
        ] {
            let found = place.validate().unwrap_err();
            assert!(found.contains(part), "{found}");
        }
        assert!(geodetic(0.0, 0.0, Some(7.0)).is_null() && !geodetic(0.0, 1e-6, None).is_null());
    }

    #[test]
    fn the_frame_is_near_the_places_and_one_of_them_far_away_does_not_move_it() {
        let place = |k: f64| geodetic(-17.0 + 1e-5 * k, 179.99999 + 1e-5 * k, Some(10.0 + k));
        let mut places: Vec<Place> = [0.0, 1.0, 2.0, 3.0]
            .map(place)
            .into_iter()
            .chain([geodetic(50.0, 8.0, None)])
            .collect();
        // The date line is crossed; longitudes beyond it are given from -180 on.
        let Place::Geodetic { longitude_deg, .. } = &mut places[3] else { unreachable!() };
        *longitude_deg -= 360.0;
        let frame = Georeference::near(&places).unwrap();
        for (k, place) in places.iter().take(4).enumerate() {
            let local = frame.to_local(place).unwrap();
            // A hundred-thousandth of a degree is 1.1 m.
            assert!(local.norm() < 5.0, "{k}: {local}");
        }
        assert_eq!(frame.to_local(&Place::Cartesian(Vector3::zeros())), None);
        // Without altitudes, all are level.
        let level = [geodetic(50.0, 8.0, None), geodetic(50.0, 8.001, None)];
        let frame = Georeference::near(&level).unwrap();
        assert!(matches!(frame, Georeference::Enu { has_height: false, .. }), "{frame:?}");
        let [a, b] = level.map(|place| frame.to_local(&place).unwrap());
        assert!((a - b).xy().norm() > 70.0 && (a.z - b.z).abs() < 1e-3, "{a} {b}");
    }

    #[test]
    fn far_cartesian_coordinates_get_a_near_origin() {
        let utm = [[691_000.2, 5_334_000.7, 519.5], [691_001.2, 5_334_010.7, 520.5]];
        let places = utm.map(|xyz| Place::Cartesian(xyz.into()));
        let frame = Georeference::near(&places).unwrap();
        let Georeference::Cartesian { offset } = frame else { panic!("{frame:?}") };
        assert_eq!(offset, Vector3::new(691_001.0, 5_334_011.0, 521.0));
        assert_eq!(frame.to_local(&places[1]), Some(Vector3::from(utm[1]) - offset));
        let near = [Place::Cartesian(Vector3::new(1.5, 2.0, 3.0))];
        let frame = Georeference::near(&near);
        assert_eq!(frame, Some(Georeference::Cartesian { offset: Vector3::zeros() }));
        assert_eq!(Georeference::near(&[]), None);
    }
}
