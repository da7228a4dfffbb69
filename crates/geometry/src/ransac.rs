//! Robust estimation: RANSAC with local optimisation (Chum, Matas, Kittler 2003) and MSAC scores
//! (Torr, Zisserman 2000).
//!
//! One loop serves every problem. It has three stages:
//!
//! 1. Minimal models from random samples. A minimal model that scores better than all minimal
//!    models before it is refined by nonlinear optimisation of the truncated loss.
//! 2. Inner RANSAC (Chum et al. 2003). The best refined model is fitted to small random subsets of
//!    its inliers, and each fit is refined again.
//! 3. A final refinement of all inliers under the Cauchy loss.
//!
//! Data are scored in order, in blocks. Scoring stops as soon as the partial score is not better
//! than the best score. The result is a function of the data, the options and the seed.

use std::ops::Range;

use crate::simd::LANES;
use crate::{Loss, OptionError, Rng};

/// A model-fitting problem that [`ransac`] solves.
pub trait Estimator {
    /// The estimated quantity, for example a pose.
    type Model: Clone;
    /// Number of data in a minimal sample.
    const SAMPLE_SIZE: usize;
    /// Number of data.
    fn num_data(&self) -> usize;
    /// Appends the models that fit a minimal sample, none if it is degenerate. `sample` has
    /// `SAMPLE_SIZE` distinct indices of data.
    fn models(&self, sample: &[usize], models: &mut Vec<Self::Model>);
    /// Writes the squared residuals of the data in `range` to `squared`, which has the length of
    /// `range`. An undefined residual is infinite.
    fn squared_residuals(&self, model: &Self::Model, range: Range<usize>, squared: &mut [f64]);
    /// The model that minimises the loss over the data with indices `data`, by local optimisation
    /// that starts at `model`.
    fn refine(&self, model: &Self::Model, data: &[usize], loss: Loss) -> Option<Self::Model>;
}

/// Options of [`ransac`]: inlier threshold and stopping rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacOptions {
    /// Inlier threshold on the residual norm, in the unit of the estimator's residual (pixels
    /// unless its documentation names another unit).
    pub max_error: f64,
    /// Stop when at least one sample had only inliers with this probability.
    pub confidence: f64,
    /// Minimum number of samples.
    pub min_iterations: usize,
    /// Maximum number of samples.
    pub max_iterations: usize,
    /// Minimum inlier ratio of a model. The number of samples is limited to the number that finds
    /// a model of this inlier ratio with the given confidence. A model is not locally optimised if
    /// its inliers and near-inliers together are below this ratio.
    pub min_inlier_ratio: f64,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl RansacOptions {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// Names the first option that is out of range.
    pub fn validate(&self) -> Result<(), OptionError> {
        let Self {
            max_error, confidence, min_iterations, max_iterations, min_inlier_ratio, ..
        } = *self;
        OptionError::check_positive("max_error", max_error)?;
        let is_valid = confidence > 0.0 && confidence < 1.0;
        OptionError::check("confidence", confidence, is_valid, "above 0 and below 1")?;
        OptionError::check_ratio("min_inlier_ratio", min_inlier_ratio)?;
        let is_valid = max_iterations >= min_iterations.max(1);
        let range = "at least min_iterations, and at least 1";
        OptionError::check("max_iterations", max_iterations as f64, is_valid, range)
    }
}

impl Default for RansacOptions {
    fn default() -> Self {
        Self {
            max_error: 4.0,
            confidence: 0.9999,
            min_iterations: 100,
            max_iterations: 10_000,
            min_inlier_ratio: 0.0,
            seed: 0,
        }
    }
}

/// The outcome of [`ransac`].
#[derive(Clone, Debug, PartialEq)]
pub struct Report<M> {
    /// The best model.
    pub model: M,
    /// Inlier mask, one entry per datum.
    pub inliers: Vec<bool>,
    /// Number of inliers.
    pub num_inliers: usize,
    /// MSAC score: the sum over the data of min(squared residual, `max_error`²). Lower is better.
    pub score: f64,
    /// Number of samples drawn.
    pub iterations: usize,
}

impl<M> Report<M> {
    /// Converts the model, for example a pose to an essential matrix.
    pub fn map<N>(self, f: impl FnOnce(M) -> N) -> Report<N> {
        let Self { model, inliers, num_inliers, score, iterations } = self;
        Report { model: f(model), inliers, num_inliers, score, iterations }
    }
}

/// Data per scoring step: long enough for SIMD, short enough to reject bad models early.
const BLOCK_SIZE: usize = 64;

/// Local optimisation uses the data with residuals up to this multiple of the threshold.
const NEAR_INLIER_FACTOR: f64 = 3.0;

/// Maximum number of inner samples.
const MAX_INNER_SAMPLES: usize = 24;

/// Inner RANSAC stops after this number of successive inner samples without progress.
const MAX_INNER_FAILURES: usize = 5;

/// An inner sample is progress if its score is below this multiple of the best score.
const INNER_PROGRESS: f64 = 0.999;

/// Size of an inner sample, in minimal sample sizes.
const INNER_SAMPLE_FACTOR: usize = 3;

/// Number of final refinements. Each takes its loss scale and its inliers from the model before.
const FINAL_REFINEMENTS: usize = 2;

/// Scale of the Cauchy loss over the median residual norm: the ratio of the standard deviation to
/// the median of |r| for scalar Gaussian residuals. Least squares is slightly better on Gaussian
/// noise alone, and worse with outliers within the threshold (measured by `bench/geometry.py`).
const CAUCHY_PER_MEDIAN: f64 = 1.4826;

/// Estimates the model of the best MSAC score.
///
/// Returns `None` if no model has at least `SAMPLE_SIZE` inliers and the minimum inlier ratio of
/// the options.
pub fn ransac<E: Estimator>(estimator: &E, options: &RansacOptions) -> Option<Report<E::Model>> {
    let num_data = estimator.num_data();
    if num_data < E::SAMPLE_SIZE {
        return None;
    }
    let mut sampler = Sampler::new(num_data, E::SAMPLE_SIZE, options);
    let mut scorer = Scorer::new(estimator, options);
    let mut models = Vec::new();
    let mut best: Option<Scored<E::Model>> = None;
    let mut best_minimal_score = f64::INFINITY;
    let max_needed = needed_iterations(options.min_inlier_ratio, E::SAMPLE_SIZE, options)
        .min(options.max_iterations);
    let mut needed = max_needed;
    let mut iterations = 0;
    while iterations < needed.max(options.min_iterations).min(options.max_iterations) {
        let Some(sample) = sampler.next_sample() else { break };
        iterations += 1;
        models.clear();
        estimator.models(sample, &mut models);
        for model in models.drain(..) {
            let Some(score) = scorer.score(&model, best_minimal_score) else { continue };
            best_minimal_score = score;
            let candidate = scorer.optimise(Scored { model, score });
            if best.as_ref().is_none_or(|best| candidate.score < best.score) {
                let squared = scorer.squared_residuals(&candidate.model);
                let num_inliers =
                    indices_below(&squared, options.max_error * options.max_error).len();
                needed = needed_iterations(
                    num_inliers as f64 / num_data as f64,
                    E::SAMPLE_SIZE,
                    options,
                )
                .min(max_needed);
                best = Some(candidate);
            }
        }
    }
    let best = best?;
    if !scorer.is_promising(scorer.near_inliers(&best.model).len()) {
        return None;
    }
    let best = scorer.inner_ransac(best, &mut sampler.rng);
    let model = scorer.refine_inliers(best.model);
    let squared = scorer.squared_residuals(&model);
    let inliers: Vec<bool> =
        squared.iter().map(|&s| s < options.max_error * options.max_error).collect();
    let num_inliers = inliers.iter().filter(|inlier| **inlier).count();
    let score = truncated_sum(&squared, options.max_error * options.max_error);
    let min_inliers = (options.min_inlier_ratio * num_data as f64).max(E::SAMPLE_SIZE as f64);
    (num_inliers as f64 >= min_inliers).then_some(Report {
        model,
        inliers,
        num_inliers,
        score,
        iterations,
    })
}

/// A model with its MSAC score.
struct Scored<M> {
    model: M,
    score: f64,
}

/// Scores and refines the models of one run.
struct Scorer<'a, E> {
    estimator: &'a E,
    max_error: f64,
    min_inlier_ratio: f64,
    loss: Loss,
    /// Squared residuals of one scoring block.
    squared: [f64; BLOCK_SIZE],
}

impl<'a, E: Estimator> Scorer<'a, E> {
    fn new(estimator: &'a E, options: &RansacOptions) -> Self {
        let RansacOptions { max_error, min_inlier_ratio, .. } = *options;
        let loss = Loss::Truncated(max_error);
        Self { estimator, max_error, min_inlier_ratio, loss, squared: [0.0; BLOCK_SIZE] }
    }

    /// Indices of the inliers and near-inliers of a model.
    fn near_inliers(&self, model: &E::Model) -> Vec<usize> {
        indices_below(&self.squared_residuals(model), (NEAR_INLIER_FACTOR * self.max_error).powi(2))
    }

    /// Whether a model with this number of near-inliers can reach the minimum inlier ratio.
    fn is_promising(&self, num_near: usize) -> bool {
        num_near as f64 >= self.min_inlier_ratio * self.estimator.num_data() as f64
    }

    /// The MSAC score of a model; `None` if it is not below `bound`.
    fn score(&mut self, model: &E::Model, bound: f64) -> Option<f64> {
        let mut score = 0.0;
        for range in scoring_blocks(self.estimator.num_data()) {
            let squared = &mut self.squared[..range.len()];
            self.estimator.squared_residuals(model, range, squared);
            score += truncated_sum(squared, self.max_error * self.max_error);
            if score >= bound {
                return None;
            }
        }
        (score < bound).then_some(score)
    }

    /// The squared residuals of all data.
    fn squared_residuals(&self, model: &E::Model) -> Vec<f64> {
        let mut squared = vec![0.0; self.estimator.num_data()];
        self.estimator.squared_residuals(model, 0..squared.len(), &mut squared);
        squared
    }

    /// Local optimisation: minimises the truncated loss, starting at `initial`. Near-inliers take
    /// part, because the noise of a minimal sample moves true inliers beyond the threshold.
    fn optimise(&mut self, initial: Scored<E::Model>) -> Scored<E::Model> {
        let near = self.near_inliers(&initial.model);
        if near.len() <= E::SAMPLE_SIZE || !self.is_promising(near.len()) {
            return initial;
        }
        let refined = self.estimator.refine(&initial.model, &near, self.loss);
        let scored = refined
            .and_then(|model| Some(Scored { score: self.score(&model, initial.score)?, model }));
        scored.unwrap_or(initial)
    }

    /// Inner RANSAC (LO-RANSAC): fits the model to small random subsets of its inliers and
    /// optimises each fit. A subset can leave a local optimum of the full set of inliers.
    fn inner_ransac(&mut self, mut best: Scored<E::Model>, rng: &mut Rng) -> Scored<E::Model> {
        let inliers =
            indices_below(&self.squared_residuals(&best.model), self.max_error * self.max_error);
        let size = (INNER_SAMPLE_FACTOR * E::SAMPLE_SIZE).min(inliers.len() / 2);
        if size <= E::SAMPLE_SIZE {
            return best;
        }
        let mut sample = vec![0; size];
        let mut failures = 0;
        for _ in 0..MAX_INNER_SAMPLES {
            if failures == MAX_INNER_FAILURES {
                break;
            }
            failures += 1;
            sample_distinct(rng, inliers.len(), &mut sample);
            let data: Vec<usize> = sample.iter().map(|&i| inliers[i]).collect();
            let Some(model) = self.estimator.refine(&best.model, &data, Loss::Trivial) else {
                continue;
            };
            let Some(score) = self.score(&model, f64::INFINITY) else { continue };
            let candidate = self.optimise(Scored { model, score });
            if candidate.score < best.score {
                if candidate.score < INNER_PROGRESS * best.score {
                    failures = 0;
                }
                best = candidate;
            }
        }
        best
    }

    /// Refines the model over its inliers under a Cauchy loss at the scale of their residuals. The
    /// loss reduces the weight of outliers that lie within the threshold.
    fn refine_inliers(&mut self, mut model: E::Model) -> E::Model {
        for _ in 0..FINAL_REFINEMENTS {
            let squared = self.squared_residuals(&model);
            let inliers = indices_below(&squared, self.max_error * self.max_error);
            if inliers.len() <= E::SAMPLE_SIZE {
                break;
            }
            let mut sorted: Vec<f64> = inliers.iter().map(|&i| squared[i]).collect();
            let middle = sorted.len() / 2;
            let median = sorted.select_nth_unstable_by(middle, f64::total_cmp).1.sqrt();
            let scale = (CAUCHY_PER_MEDIAN * median).min(self.max_error);
            let Some(next) = self.estimator.refine(&model, &inliers, Loss::Cauchy(scale)) else {
                break;
            };
            model = next;
        }
        model
    }
}

/// The indices of the values below a bound.
fn indices_below(squared: &[f64], bound: f64) -> Vec<usize> {
    (0..squared.len()).filter(|&i| squared[i] < bound).collect()
}

/// The sum of min(s, bound), which is ρ of [`Loss::Truncated`]. NaN counts as `bound`. The eight
/// partial sums let the compiler vectorise the loop.
fn truncated_sum(squared: &[f64], bound: f64) -> f64 {
    let mut sums = [0.0; LANES];
    let (blocks, rest) = squared.as_chunks::<LANES>();
    for block in blocks {
        for (sum, s) in sums.iter_mut().zip(block) {
            *sum += if *s < bound { *s } else { bound };
        }
    }
    for (sum, s) in sums.iter_mut().zip(rest) {
        *sum += if *s < bound { *s } else { bound };
    }
    sums.iter().sum()
}

/// The ranges of data that are scored in one step.
fn scoring_blocks(num_data: usize) -> impl Iterator<Item = Range<usize>> {
    (0..num_data).step_by(BLOCK_SIZE).map(move |first| first..(first + BLOCK_SIZE).min(num_data))
}

/// Fills `sample` with distinct uniform indices below `num_data`.
fn sample_distinct(rng: &mut Rng, num_data: usize, sample: &mut [usize]) {
    for position in 0..sample.len() {
        sample[position] = loop {
            let index = rng.below(num_data);
            if !sample[..position].contains(&index) {
                break index;
            }
        };
    }
}

/// Draws minimal samples: at random, or every combination once if there are at most
/// `min_iterations` combinations.
struct Sampler {
    rng: Rng,
    num_data: usize,
    sample: Vec<usize>,
    mode: SamplingMode,
}

enum SamplingMode {
    Uniform,
    FirstCombination,
    NextCombination,
}

impl Sampler {
    fn new(num_data: usize, sample_size: usize, options: &RansacOptions) -> Self {
        let combinations =
            (0..sample_size).fold(1.0, |c, i| c * (num_data - i) as f64 / (i + 1) as f64);
        let mode = if combinations <= options.min_iterations as f64 {
            SamplingMode::FirstCombination
        } else {
            SamplingMode::Uniform
        };
        Self {
            rng: Rng::stream(options.seed, &[]),
            num_data,
            sample: (0..sample_size).collect(),
            mode,
        }
    }

    fn next_sample(&mut self) -> Option<&[usize]> {
        let Self { rng, num_data, sample, mode } = self;
        match mode {
            SamplingMode::Uniform => {
                sample_distinct(rng, *num_data, sample);
            }
            SamplingMode::FirstCombination => *mode = SamplingMode::NextCombination,
            SamplingMode::NextCombination => {
                // Lexicographic order: increment the last position that is not at its maximum.
                let size = sample.len();
                let position = (0..size).rev().find(|&p| sample[p] < *num_data - size + p)?;
                let first = sample[position] + 1;
                for (offset, index) in sample[position..].iter_mut().enumerate() {
                    *index = first + offset;
                }
            }
        }
        Some(sample)
    }
}

/// Number of samples of which at least one has no outliers with the given confidence.
fn needed_iterations(inlier_ratio: f64, sample_size: usize, options: &RansacOptions) -> usize {
    let all_inliers = inlier_ratio.powi(sample_size as i32);
    if all_inliers >= 1.0 {
        return 1;
    }
    let needed = (1.0 - options.confidence).ln() / (-all_inliers).ln_1p();
    // `as` saturates: an infinite or NaN count becomes the maximum or zero.
    if needed.is_nan() { options.max_iterations } else { needed.ceil() as usize }
}
