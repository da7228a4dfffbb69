//! Extrema that are one and the same.
//!
//! A blob is often found twice: on neighbouring levels, or at the end of an octave and the
//! beginning of the next one, refined to nearly the same place and scale. Each copy takes the
//! other's matches away, for the second-best distance is then as small as the best.

use crate::extrema::Extremum;

/// Extrema that are nearer to each other than this share of the smaller one's σ are the same,
const NEAR: f32 = 0.5;
/// if their σ differ by a smaller factor. On graf 1-3 as many matches are right from 0.35 octaves
/// on, up to a whole one.
const ALIKE: f32 = std::f32::consts::SQRT_2;

/// What is kept of a row of pixels, as a list from the last one back.
struct Kept {
    x: f32,
    y: f32,
    sigma: f32,
    before: u32,
}

const NONE: u32 = u32::MAX;

/// Keeps of extrema that are the same the first one. `height` is that of the image in pixels.
pub(crate) fn distinct(extrema: &mut Vec<Extremum>, height: usize) {
    let rows = height.max(1);
    let mut last_of_row = vec![NONE; rows];
    let mut kept: Vec<Kept> = Vec::with_capacity(extrema.len());
    extrema.retain(|extremum| {
        let pixels = 2f32.powi(extremum.octave);
        let [x, y, sigma] = [extremum.x, extremum.y, extremum.sigma].map(|length| length * pixels);
        // Negative ones become row 0.
        let row = |y: f32| (y as usize).min(rows - 1);
        let reach = NEAR * sigma;
        for &last in &last_of_row[row(y - reach)..=row(y + reach)] {
            let mut at = last;
            while let Some(other) = kept.get(at as usize) {
                let small = sigma.min(other.sigma);
                let square = (x - other.x).powi(2) + (y - other.y).powi(2);
                if square < (NEAR * small).powi(2) && sigma.max(other.sigma) < ALIKE * small {
                    return false;
                }
                at = other.before;
            }
        }
        let last = &mut last_of_row[row(y)];
        kept.push(Kept { x, y, sigma, before: *last });
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
    fn the_first_of_two_that_are_the_same_is_kept() {
        let octave_2 = at(2, 10.0, 20.0, 1.7);
        let same_in_octave_1 = at(1, 20.6, 40.5, 3.2);
        let elsewhere = at(1, 20.0, 43.0, 3.2);
        let blob_within = at(1, 20.0, 40.0, 2.2);
        let mut extrema = vec![octave_2, same_in_octave_1, elsewhere, blob_within];
        distinct(&mut extrema, 100);
        assert_eq!(extrema, [octave_2, elsewhere, blob_within]);
        let mut reversed = vec![same_in_octave_1, octave_2];
        distinct(&mut reversed, 100);
        assert_eq!(reversed, [same_in_octave_1]);
    }

    /// The slow twin: every one with every one that was kept.
    #[test]
    fn rows_hide_nothing() {
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
            let is_same = |other: &Extremum| {
                let [u, v, other] = pixels(other);
                (x - u).hypot(y - v) < NEAR * sigma.min(other)
                    && (sigma / other).log2().abs() < ALIKE.log2()
            };
            if !expected.iter().any(is_same) {
                expected.push(e);
            }
        }
        // Rows of the coarsest octave lie beyond the image's end.
        distinct(&mut extrema, 100);
        assert!(
            expected.len() < 3900 && extrema == expected,
            "{} {}",
            extrema.len(),
            expected.len()
        );
    }
}
