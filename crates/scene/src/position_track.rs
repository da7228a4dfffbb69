//! Positions along the time of one clock.

use tiepoint_geometry::numeric::median;

use crate::position::{Georeference, Place, Position};

/// Longest gap that is interpolated, in usual intervals: a receiver that loses its fix in a tunnel
/// says nothing of what is between.
const MAX_GAP: f64 = 3.0;

/// Measured positions in the order of time, of a receiver with a clock of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionTrack {
    times_s: Vec<f64>,
    positions: Vec<Position>,
    max_gap_s: f64,
}

impl PositionTrack {
    /// Of positions with their times, in seconds, in any order. Of several at one time the first
    /// one counts; those whose time is no number do not.
    pub fn new(positions: impl IntoIterator<Item = (f64, Position)>) -> Self {
        let mut sorted: Vec<(f64, Position)> =
            positions.into_iter().filter(|(time_s, _)| time_s.is_finite()).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        sorted.dedup_by(|a, b| a.0 == b.0);
        let mut intervals: Vec<f64> = sorted.windows(2).map(|two| two[1].0 - two[0].0).collect();
        let max_gap_s = MAX_GAP * median(&mut intervals).unwrap_or(0.0);
        let (times_s, positions) = sorted.into_iter().unzip();
        Self { times_s, positions, max_gap_s }
    }

    /// The times, in seconds, in ascending order.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// The positions at these times.
    pub fn positions(&self) -> &[Position] {
        &self.positions
    }

    /// Between which two positions a time is: the index of the first one, and the part of the
    /// interval after it. `None` before the first position, after the last one, and in gaps of more
    /// than three usual intervals.
    pub fn place_of(&self, time_s: f64) -> Option<(usize, f64)> {
        let last = self.times_s.len().checked_sub(1).filter(|last| *last > 0)?;
        if !(self.times_s[0]..=self.times_s[last]).contains(&time_s) {
            return None;
        }
        let after = self.times_s.partition_point(|other| *other <= time_s);
        let before = (after - 1).min(last - 1);
        let gap_s = self.times_s[before + 1] - self.times_s[before];
        let part = (time_s - self.times_s[before]) / gap_s;
        (gap_s <= self.max_gap_s || part == 0.0 || part == 1.0).then_some((before, part))
    }

    /// The position at a time, on the line between its neighbours. It has an altitude and
    /// deviations if both have them.
    pub fn at(&self, time_s: f64) -> Option<Position> {
        let (index, part) = self.place_of(time_s)?;
        let (from, to) = (&self.positions[index], &self.positions[index + 1]);
        let is_high = |position: &Position| {
            !matches!(position.place, Place::Geodetic { altitude_m: None, .. })
        };
        let frame = Georeference::near([&from.place])?;
        let [a, b] = [frame.to_local(&from.place)?, frame.to_local(&to.place)?];
        let place = frame.to_place(&(a + part * (b - a)), is_high(from) && is_high(to));
        let larger = |a: Option<f64>, b: Option<f64>| Some(a?.max(b?));
        Some(Position {
            place,
            sigma_horizontal_m: larger(from.sigma_horizontal_m, to.sigma_horizontal_m),
            sigma_vertical_m: larger(from.sigma_vertical_m, to.sigma_vertical_m),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fix(longitude_deg: f64, altitude_m: Option<f64>) -> Position {
        let place = Place::Geodetic { latitude_deg: 60.0, longitude_deg, altitude_m };
        Position { place, sigma_horizontal_m: Some(2.0), sigma_vertical_m: None }
    }

    #[test]
    fn positions_are_interpolated_and_not_extrapolated() {
        let track = PositionTrack::new([
            (3.0, fix(-179.9999, Some(14.0))),
            (1.0, fix(179.9997, Some(10.0))),
            (2.0, fix(179.9999, Some(12.0))),
            (f64::NAN, fix(0.0, None)),
            (2.0, fix(7.0, None)),
            (9.0, fix(-179.9997, Some(16.0))),
            (10.0, fix(-179.9996, None)),
        ]);
        assert_eq!(track.times_s(), [1.0, 2.0, 3.0, 9.0, 10.0]);
        let longitude = |time_s: f64| match track.at(time_s)?.place {
            Place::Geodetic { longitude_deg, altitude_m, .. } => Some((longitude_deg, altitude_m)),
            Place::Cartesian(_) => None,
        };
        // On the ellipsoid, in arcs of metres: within a micrometre.
        let near = |found: Option<(f64, Option<f64>)>, longitude: f64, altitude: f64| {
            let (found, height) = found.unwrap();
            assert!((found - longitude).abs() < 1e-10, "{found}");
            assert!((height.unwrap() - altitude).abs() < 1e-4, "{height:?}");
        };
        near(longitude(1.0), 179.9997, 10.0);
        near(longitude(1.25), 179.99975, 10.5);
        // Across the date line.
        near(longitude(2.75), -179.99995, 13.5);
        near(longitude(3.0), -179.9999, 14.0);
        for outside in [0.99, 10.01, 5.0, f64::NAN] {
            assert_eq!(track.at(outside), None, "{outside}");
        }
        // The last one has no altitude.
        assert!(longitude(9.5).is_some_and(|(_, altitude)| altitude.is_none()));
        assert!(longitude(10.0).is_some_and(|(longitude, _)| (longitude + 179.9996).abs() < 1e-9));
        assert_eq!(track.at(1.5).unwrap().sigma_horizontal_m, Some(2.0));
        for few in [0, 1] {
            let track = PositionTrack::new([(1.0, fix(0.0, None))].into_iter().take(few));
            assert_eq!(track.at(1.0), None);
        }
    }
}
