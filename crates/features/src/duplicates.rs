//! Removal of duplicate extrema.
//!
//! A blob is often detected twice, on adjacent levels or in adjacent octaves, and refined to nearly
//! the same position and scale. Duplicates lose their matches in the ratio test, because the
//! distance to the second-best match is then as small as the distance to the best.

use crate::extrema::Extremum;

/// Maximum distance of duplicates, in units of the smaller σ.
const MAX_DISTANCE: f32 = 0.5;
/// Maximum ratio of the σ of duplicates. On graf 1-3, ratios between 0.35 octaves and one octave
/// give the same number of correct matches.
const MAX_SCALE_RATIO: f32 = std::f32::consts::SQRT_2;

/// A kept extremum, in pixels of the image. The kept extrema of a row of pixels are a linked list.
struct KeptExtremum {
    x: f32,
    y: f32,
    sigma: f32,
    /// Index of the previous kept extremum of the row, or [`NONE`].
    previous: u32,
}

const NONE: u32 = u32::MAX;

/// Removes extrema that are duplicates of an earlier extremum. `height` is the height of the image
/// in pixels.
pub(crate) fn remove_duplicates(extrema: &mut Vec<Extremum>, height: usize) {
    let rows = height.max(1);
    let mut last_of_row = vec![NONE; rows];
    let mut kept: Vec<KeptExtremum> = Vec::with_capacity(extrema.len());
    extrema.retain(|extremum| {
        let pixels = 2f32.powi(extremum.octave);
        let [x, y, sigma] = [extremum.x, extremum.y, extremum.sigma].map(|length| length * pixels);
        // The cast saturates: negative values become row 0.
        let row = |y: f32| (y as usize).min(rows - 1);
        let reach = MAX_DISTANCE * sigma;
        for &last in &last_of_row[row(y - reach)..=row(y + reach)] {
            let mut at = last;
            while let Some(other) = kept.get(at as usize) {
                let min_sigma = sigma.min(other.sigma);
                let squared_distance = (x - other.x).powi(2) + (y - other.y).powi(2);
                if squared_distance < (MAX_DISTANCE * min_sigma).powi(2)
                    && sigma.max(other.sigma) < MAX_SCALE_RATIO * min_sigma
                {
                    return false;
                }
                at = other.previous;
            }
        }
        let last = &mut last_of_row[row(y)];
        kept.push(KeptExtremum { x, y, sigma, previous: *last });
        *last = kept.len() as u32 - 1;
        true
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(octave: i32, x: f32, y: f32, sigma: f32) -> Extremum {
        Extremum { octave, level: 1, ix: x as usize, iy: y as usize, x, y, sigma, response: 1.0 }
    }

    #[test]
    fn keeps_the_first_of_two_duplicates() {
        let octave_2 = at(2, 10.0, 20.0, 1.7);
        let duplicate_in_octave_1 = at(1, 20.6, 40.5, 3.2);
        let elsewhere = at(1, 20.0, 43.0, 3.2);
        let smaller_blob = at(1, 20.0, 40.0, 2.2);
        let mut extrema = vec![octave_2, duplicate_in_octave_1, elsewhere, smaller_blob];
        remove_duplicates(&mut extrema, 100);
        assert_eq!(extrema, [octave_2, elsewhere, smaller_blob]);
        let mut reversed = vec![duplicate_in_octave_1, octave_2];
        remove_duplicates(&mut reversed, 100);
        assert_eq!(reversed, [duplicate_in_octave_1]);
    }

    /// The reference implementation compares each extremum with all kept extrema.
    #[test]
    fn agrees_with_exhaustive_comparison() {
        let mut state = 1u32;
        let mut random = |below: f32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32 * below
        };
        let mut extrema: Vec<Extremum> = (0..4000)
            .map(|i| at(i % 4 - 1, random(60.0), random(40.0), 1.6 + random(1.6)))
            .collect();
        let mut expected: Vec<Extremum> = Vec::new();
        for &e in &extrema {
            let pixels =
                |e: &Extremum| [e.x, e.y, e.sigma].map(|length| length * 2f32.powi(e.octave));
            let [x, y, sigma] = pixels(&e);
            let is_duplicate = |other: &Extremum| {
                let [u, v, other] = pixels(other);
                (x - u).hypot(y - v) < MAX_DISTANCE * sigma.min(other)
                    && (sigma / other).log2().abs() < MAX_SCALE_RATIO.log2()
            };
            if !expected.iter().any(is_duplicate) {
                expected.push(e);
            }
        }
        // Some extrema of the coarsest octave are below the image.
        remove_duplicates(&mut extrema, 100);
        assert!(
            expected.len() < 3900 && extrema == expected,
            "{} {}",
            extrema.len(),
            expected.len()
        );
    }
}
