//! Time offset between two recordings from their soundtracks.
//!
//! Microphones a metre apart on a vehicle record different wind noise, but the same doors, voices,
//! horns and engine. The signal that is correlated is the log energy per millisecond minus its mean
//! over half a second. It is correlated at every lag at which the recordings overlap. The peak is
//! accepted if it is far above the noise of the correlation, and if no other lag comes near it, as
//! it does for a periodic sound.

use rayon::prelude::*;
use tiepoint_geometry::numeric::median;

/// Sample rate of the soundtracks; voices have little energy above half of it.
pub const RATE_HZ: u32 = 8000;
/// Rate of the log energy.
const FINE_HZ: usize = 1000;
/// Rate of the log energy for the coarse search.
const COARSE_HZ: usize = 100;
/// Window of the mean that is subtracted from the log energy.
const MEAN_OVER_S: f64 = 0.5;
/// Minimum overlap of two recordings.
const MIN_OVERLAP_S: f64 = 5.0;
/// Minimum peak, in standard deviations of the correlation over all lags.
const MIN_DEVIATIONS: f64 = 10.0;
/// Lags at least this far from the peak must stay below `MAX_OTHERS` times the peak.
const OTHERS_FROM_S: f64 = 0.5;
const MAX_OTHERS: f64 = 0.7;
/// Median of the absolute value of a normal variable of standard deviation 1.
const MEDIAN_OF_NORMAL: f64 = 0.6745;

/// Start of `b` minus start of `a`, in seconds; `None` if the correlation has no clear peak. `a`
/// and `b` are mono samples at [`RATE_HZ`].
pub fn start_offset_s(a: &[i16], b: &[i16]) -> Option<f64> {
    let [fine_a, fine_b] = [a, b].map(loudness);
    let [coarse_a, coarse_b] = [&fine_a, &fine_b].map(|fine| coarse(fine));
    let (coarse_a, coarse_b) = (LevelSignal::new(coarse_a), LevelSignal::new(coarse_b));
    let least = (MIN_OVERLAP_S * COARSE_HZ as f64) as i64;
    let lags = least - coarse_b.len()..coarse_a.len() - least + 1;
    let scores: Vec<f64> =
        lags.clone().into_par_iter().map(|lag| coarse_a.score(&coarse_b, lag)).collect();
    let (peak, &best) = scores.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let deviation = median(&mut scores.iter().map(|score| score.abs()).collect::<Vec<f64>>())?
        / MEDIAN_OF_NORMAL;
    let far = (OTHERS_FROM_S * COARSE_HZ as f64) as usize;
    let others =
        scores[..peak.saturating_sub(far)].iter().chain(scores.iter().skip(peak + far + 1));
    let is_alone =
        others.fold(f64::NEG_INFINITY, |most, score| most.max(*score)) < MAX_OTHERS * best;
    if deviation == 0.0 || best < MIN_DEVIATIONS * deviation || !is_alone {
        return None;
    }
    let step = (FINE_HZ / COARSE_HZ) as i64;
    let about = (lags.start + peak as i64) * step;
    let (fine_a, fine_b) = (LevelSignal::new(fine_a), LevelSignal::new(fine_b));
    let near: Vec<f64> =
        (about - 2 * step..=about + 2 * step).map(|lag| fine_a.score(&fine_b, lag)).collect();
    let (peak, _) = near.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    Some((about - 2 * step + peak as i64) as f64 / FINE_HZ as f64)
}

/// Log energy of the sample differences in each millisecond, minus its moving average.
fn loudness(samples: &[i16]) -> Vec<f32> {
    let energy = |samples: &[i16]| {
        let slopes =
            samples.windows(2).map(|pair| (f64::from(pair[1]) - f64::from(pair[0])).powi(2));
        (1.0 + slopes.sum::<f64>()).ln()
    };
    let levels: Vec<f64> = samples.chunks_exact(RATE_HZ as usize / FINE_HZ).map(energy).collect();
    let sums = prefix_sums(levels.iter().copied());
    let half = (0.5 * MEAN_OVER_S * FINE_HZ as f64) as usize;
    let relative = |(k, level): (usize, &f64)| {
        let (from, to) = (k.saturating_sub(half), (k + half + 1).min(levels.len()));
        (level - (sums[to] - sums[from]) / (to - from) as f64) as f32
    };
    levels.iter().enumerate().map(relative).collect()
}

/// Log energy at [`COARSE_HZ`].
fn coarse(fine: &[f32]) -> Vec<f32> {
    let step = FINE_HZ / COARSE_HZ;
    fine.chunks_exact(step).map(|levels| levels.iter().sum::<f32>() / step as f32).collect()
}

fn prefix_sums(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let sums = values.scan(0.0, |sum, value| {
        *sum += value;
        Some(*sum)
    });
    std::iter::once(0.0).chain(sums).collect()
}

/// A log energy signal with the prefix sums of its squares.
struct LevelSignal {
    levels: Vec<f32>,
    squares: Vec<f64>,
}

impl LevelSignal {
    fn new(levels: Vec<f32>) -> Self {
        let squares = prefix_sums(levels.iter().map(|level| f64::from(*level).powi(2)));
        Self { levels, squares }
    }

    fn len(&self) -> i64 {
        self.levels.len() as i64
    }

    /// Normalised correlation with `other` delayed by `lag`, times the square root of the number of
    /// overlapping levels: this has standard deviation 1 for independent white noise.
    fn score(&self, other: &Self, lag: i64) -> f64 {
        let (from, to) = (lag.max(0), (lag + other.len()).min(self.len()));
        if to <= from {
            return 0.0;
        }
        let own = from as usize..to as usize;
        let others = (from - lag) as usize..(to - lag) as usize;
        let energy = |sound: &Self, range: &std::ops::Range<usize>| {
            sound.squares[range.end] - sound.squares[range.start]
        };
        let energies = energy(self, &own) * energy(other, &others);
        if energies <= 0.0 {
            return 0.0;
        }
        dot(&self.levels[own], &other.levels[others]) / energies.sqrt()
            * ((to - from) as f64).sqrt()
    }
}

/// Dot product in lanes that the compiler vectorises.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    const LANES: usize = 16;
    let mut sums = [0.0f32; LANES];
    let (a, b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f32 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a.zip(b) {
        for (lane, sum) in sums.iter_mut().enumerate() {
            *sum += a[lane] * b[lane];
        }
    }
    f64::from(sums.iter().sum::<f32>() + rest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_geometry::Rng;

    const SECOND: usize = RATE_HZ as usize;
    /// Sound travels 1.7 m in this time, more than the distance of the microphones.
    const TOLERANCE_S: f64 = 0.005;

    /// A recording of knocks at random times, each with a decay time of 0.05 s, with independent
    /// noise.
    fn recording(from_s: f64, seconds: f64, gain: f64, noise: f64, seed: u64) -> Vec<i16> {
        let mut world = Rng::stream(1, &[]);
        let knocks: Vec<(f64, f64)> =
            (0..60).map(|_| (120.0 * world.uniform(), 0.3 + world.uniform())).collect();
        let mut own = Rng::stream(seed, &[]);
        let mut samples = Vec::new();
        for k in 0..(seconds * SECOND as f64) as usize {
            let time_s = from_s + k as f64 / SECOND as f64;
            let near = knocks.iter().filter(|(at_s, _)| (0.0..0.3).contains(&(time_s - at_s)));
            let knock: f64 = near
                .map(|(at_s, loud)| {
                    loud * (-(time_s - at_s) / 0.05).exp() * (2000.0 * (time_s - at_s)).sin()
                })
                .sum();
            let value = gain * 8000.0 * knock + noise * 8000.0 * (own.uniform() - 0.5);
            samples.push(value.clamp(-32768.0, 32767.0) as i16);
        }
        samples
    }

    #[test]
    fn common_sounds_give_the_offset() {
        let left = recording(3.0, 60.0, 1.0, 0.05, 2);
        for (from_s, seconds) in [(10.345, 50.0), (3.0, 30.0), (0.5, 20.0), (45.25, 60.0)] {
            let right = recording(from_s, seconds, 0.4, 0.1, 3);
            let found = start_offset_s(&left, &right).unwrap();
            assert!(
                (found - (from_s - 3.0)).abs() < TOLERANCE_S,
                "{found} instead of {}",
                from_s - 3.0
            );
            let back = start_offset_s(&right, &left).unwrap();
            assert!((found + back).abs() < TOLERANCE_S);
        }
    }

    #[test]
    fn uncorrelated_and_periodic_sounds_give_no_offset() {
        let left = recording(0.0, 40.0, 1.0, 0.05, 2);
        assert_eq!(
            start_offset_s(&left, &recording(80.0, 40.0, 1.0, 0.05, 3)),
            None,
            "another place"
        );
        assert_eq!(start_offset_s(&left, &recording(0.0, 40.0, 0.0, 0.3, 3)), None, "wind alone");
        assert_eq!(start_offset_s(&left, &vec![0; 30 * SECOND]), None, "silence");
        assert_eq!(start_offset_s(&left, &left[..2 * SECOND]), None, "too short");
        assert_eq!(start_offset_s(&[], &left), None);
        // A periodic sound correlates at every period.
        let beats = |seed: u64| -> Vec<i16> {
            let mut rng = Rng::stream(seed, &[]);
            let beat = |k: usize| 4000.0 * (-(((k % (SECOND / 3)) as f64) / 300.0)).exp();
            (0..40 * SECOND)
                .map(|k| {
                    (beat(k) * if k % 2 == 0 { 1.0 } else { -1.0 } + 500.0 * rng.uniform()) as i16
                })
                .collect()
        };
        assert_eq!(start_offset_s(&beats(1), &beats(2)), None);
    }
}
