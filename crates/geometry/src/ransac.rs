//! Robust estimation: RANSAC with local optimisation (Chum, Matas, Kittler 2003) and MSAC scores
//! (Torr, Zisserman 2000).
//!
//! One loop for every problem. Each minimal model that beats all minimal models before it is
//! refined by nonlinear optimisation of the truncated loss that scores it. The best refined model
//! is then fitted to small parts of its inliers, the inner samples of Chum et al., and refined
//! again from there; last comes a smoother loss. Data are scored in order, in chunks, and a model
//! is dropped as soon as its score can no longer win. Everything follows from the seed.

use std::ops::Range;

use crate::simd::LANES;
use crate::{Loss, Rng};

/// What the loop needs to know about a problem.
pub trait Estimator {
    /// What is estimated.
    type Model: Clone;
    /// How many data determine a model.
    const SAMPLE_SIZE: usize;
    /// How many data there are.
    fn num_data(&self) -> usize;
    /// Appends the models that fit `sample` (indices of data, `SAMPLE_SIZE` of them, distinct);
    /// none if it is degenerate.
    fn models(&self, sample: &[usize], models: &mut Vec<Self::Model>);
    /// Squared residuals of the data in `range`, into `squared` (of the same length); infinite
    /// where undefined.
    fn squared_residuals(&self, model: &Self::Model, range: Range<usize>, squared: &mut [f64]);
    /// The model of least loss over some of the data, starting from `model`.
    fn refine(&self, model: &Self::Model, data: &[usize], loss: Loss) -> Option<Self::Model>;
}

/// When to stop, and what counts as an inlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacOptions {
    /// Residual norm up to which a datum is an inlier, in the unit of the estimator's residual
    /// (pixels unless it says otherwise).
    pub max_error: f64,
    /// Stop when, with this probability, some sample had inliers only.
    pub confidence: f64,
    /// Fewest samples.
    pub min_iterations: usize,
    /// Most samples.
    pub max_iterations: usize,
    /// Models that fewer than this share of the data agree with are of no use: no more samples are
    /// drawn than find a better one with the asked confidence, and none that is far from this share
    /// is optimised.
    pub min_inlier_share: f64,
    /// Where the random numbers start.
    pub seed: u64,
}

impl Default for RansacOptions {
    fn default() -> Self {
        Self {
            max_error: 4.0,
            confidence: 0.9999,
            min_iterations: 100,
            max_iterations: 10_000,
            min_inlier_share: 0.0,
            seed: 0,
        }
    }
}

/// The outcome of [`ransac`].
#[derive(Clone, Debug, PartialEq)]
pub struct Report<M> {
    /// The best model.
    pub model: M,
    /// For each datum, whether it is an inlier.
    pub inliers: Vec<bool>,
    /// How many inliers.
    pub num_inliers: usize,
    /// Sum over the data of the squared residual, at most `max_error`² each (MSAC); lower is
    /// better.
    pub score: f64,
    /// Samples drawn.
    pub iterations: usize,
}

impl<M> Report<M> {
    /// The same report about another form of the model.
    pub fn map<N>(self, f: impl FnOnce(M) -> N) -> Report<N> {
        let Self { model, inliers, num_inliers, score, iterations } = self;
        Report { model: f(model), inliers, num_inliers, score, iterations }
    }
}

/// Data per scoring step: long enough for vector code, short enough to drop bad models early.
const CHUNK: usize = 64;

/// Data with residuals up to this multiple of the threshold take part in the local optimisation.
const OPTIMISATION_REACH: f64 = 3.0;

/// Most parts of the inliers that the best model is fitted to, how many may fail in a row, and
/// below which part of the score a new one is no failure.
const MAX_SHAKES: usize = 24;
const MAX_FAILED_SHAKES: usize = 5;
const SHAKE_GAIN: f64 = 0.999;

/// Size of these parts, in samples.
const SHAKE_SAMPLES: usize = 3;

/// Final refinements; each has the spread and the inliers of the one before.
const POLISHES: usize = 2;

/// Scale of the Cauchy loss in medians of the residual norm: one standard deviation. Least squares
/// on clean Gaussian noise would be a little better, but wrong data within the threshold make it
/// the worse choice (tried with `bench/geometry.py`).
const CAUCHY_PER_MEDIAN: f64 = 1.4826;

/// The model with the best MSAC score; `None` where no sample gave a model with at least
/// `SAMPLE_SIZE` inliers and the least share of them that the options ask for.
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
    let most = needed_iterations(options.min_inlier_share, E::SAMPLE_SIZE, options)
        .min(options.max_iterations);
    let mut needed = most;
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
                let num_inliers = below(&squared, options.max_error * options.max_error).len();
                needed = needed_iterations(
                    num_inliers as f64 / num_data as f64,
                    E::SAMPLE_SIZE,
                    options,
                )
                .min(most);
                best = Some(candidate);
            }
        }
    }
    let best = best?;
    if !scorer.is_promising(scorer.near(&best.model).len()) {
        return None;
    }
    let model = scorer.shake(best, &mut sampler.rng);
    let model = scorer.polish(model.model);
    let squared = scorer.squared_residuals(&model);
    let inliers: Vec<bool> =
        squared.iter().map(|&s| s < options.max_error * options.max_error).collect();
    let num_inliers = inliers.iter().filter(|inlier| **inlier).count();
    let score = truncated_sum(&squared, options.max_error * options.max_error);
    let enough = (options.min_inlier_share * num_data as f64).max(E::SAMPLE_SIZE as f64);
    (num_inliers as f64 >= enough).then_some(Report {
        model,
        inliers,
        num_inliers,
        score,
        iterations,
    })
}

struct Scored<M> {
    model: M,
    score: f64,
}

struct Scorer<'a, E> {
    estimator: &'a E,
    max_error: f64,
    min_inlier_share: f64,
    loss: Loss,
    squared: [f64; CHUNK],
}

impl<'a, E: Estimator> Scorer<'a, E> {
    fn new(estimator: &'a E, options: &RansacOptions) -> Self {
        let RansacOptions { max_error, min_inlier_share, .. } = *options;
        let loss = Loss::Truncated(max_error);
        Self { estimator, max_error, min_inlier_share, loss, squared: [0.0; CHUNK] }
    }

    /// The data that are inliers of a model or not far from it.
    fn near(&self, model: &E::Model) -> Vec<usize> {
        below(&self.squared_residuals(model), (OPTIMISATION_REACH * self.max_error).powi(2))
    }

    /// Whether a model with so many data near it may come to have as many inliers as it must.
    fn is_promising(&self, near: usize) -> bool {
        near as f64 >= self.min_inlier_share * self.estimator.num_data() as f64
    }

    /// The MSAC score, if it is below `bound`.
    fn score(&mut self, model: &E::Model, bound: f64) -> Option<f64> {
        let mut score = 0.0;
        for range in chunks(self.estimator.num_data()) {
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

    /// Least truncated loss near a minimal model: over data a little beyond the threshold too, so
    /// that inliers that the noise of the sample hides come in.
    fn optimise(&mut self, minimal: Scored<E::Model>) -> Scored<E::Model> {
        let near = self.near(&minimal.model);
        if near.len() <= E::SAMPLE_SIZE || !self.is_promising(near.len()) {
            return minimal;
        }
        let refined = self.estimator.refine(&minimal.model, &near, self.loss);
        let scored = refined
            .and_then(|model| Some(Scored { score: self.score(&model, minimal.score)?, model }));
        scored.unwrap_or(minimal)
    }

    /// A better model from small parts of the inliers, which leave a local optimum that all of them
    /// hold fast.
    fn shake(&mut self, mut best: Scored<E::Model>, rng: &mut Rng) -> Scored<E::Model> {
        let inliers = below(&self.squared_residuals(&best.model), self.max_error * self.max_error);
        let size = (SHAKE_SAMPLES * E::SAMPLE_SIZE).min(inliers.len() / 2);
        if size <= E::SAMPLE_SIZE {
            return best;
        }
        let mut sample = vec![0; size];
        let mut failures = 0;
        for _ in 0..MAX_SHAKES {
            if failures == MAX_FAILED_SHAKES {
                break;
            }
            failures += 1;
            draw(rng, inliers.len(), &mut sample);
            let data: Vec<usize> = sample.iter().map(|&i| inliers[i]).collect();
            let Some(model) = self.estimator.refine(&best.model, &data, Loss::Trivial) else {
                continue;
            };
            let Some(score) = self.score(&model, f64::INFINITY) else { continue };
            let candidate = self.optimise(Scored { model, score });
            if candidate.score < best.score {
                if candidate.score < SHAKE_GAIN * best.score {
                    failures = 0;
                }
                best = candidate;
            }
        }
        best
    }

    /// The model of the inliers under a loss that weighs them down where they exceed their own
    /// spread: within the threshold there are wrong data too.
    fn polish(&mut self, mut model: E::Model) -> E::Model {
        for _ in 0..POLISHES {
            let squared = self.squared_residuals(&model);
            let inliers = below(&squared, self.max_error * self.max_error);
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
fn below(squared: &[f64], bound: f64) -> Vec<usize> {
    (0..squared.len()).filter(|&i| squared[i] < bound).collect()
}

/// The sum of min(s, bound), which is ρ of [`Loss::Truncated`]; NaN counts as `bound`. Eight
/// partial sums, for vectors.
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

fn chunks(num_data: usize) -> impl Iterator<Item = Range<usize>> {
    (0..num_data).step_by(CHUNK).map(move |first| first..(first + CHUNK).min(num_data))
}

/// Distinct uniform indices below `num_data`.
fn draw(rng: &mut Rng, num_data: usize, sample: &mut [usize]) {
    for position in 0..sample.len() {
        sample[position] = loop {
            let index = rng.below(num_data);
            if !sample[..position].contains(&index) {
                break index;
            }
        };
    }
}

/// Distinct indices below `num_data`: uniform, or every combination once where these are no more
/// than the iterations that are made anyway.
struct Sampler {
    rng: Rng,
    num_data: usize,
    sample: Vec<usize>,
    mode: Mode,
}

enum Mode {
    Uniform,
    FirstCombination,
    NextCombination,
}

impl Sampler {
    fn new(num_data: usize, sample_size: usize, options: &RansacOptions) -> Self {
        let combinations =
            (0..sample_size).fold(1.0, |c, i| c * (num_data - i) as f64 / (i + 1) as f64);
        let mode = if combinations <= options.min_iterations as f64 {
            Mode::FirstCombination
        } else {
            Mode::Uniform
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
            Mode::Uniform => {
                draw(rng, *num_data, sample);
            }
            Mode::FirstCombination => *mode = Mode::NextCombination,
            Mode::NextCombination => {
                // The last position that can still move does; those after it follow directly.
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

/// Samples until one without outliers was drawn with the asked confidence.
fn needed_iterations(inlier_ratio: f64, sample_size: usize, options: &RansacOptions) -> usize {
    let all_inliers = inlier_ratio.powi(sample_size as i32);
    if all_inliers >= 1.0 {
        return 1;
    }
    let needed = (1.0 - options.confidence).ln() / (-all_inliers).ln_1p();
    // `as` saturates: an infinite or NaN count becomes the maximum or zero.
    if needed.is_nan() { options.max_iterations } else { needed.ceil() as usize }
}
