//! Robust estimation: RANSAC with local optimisation (Chum, Matas, Kittler 2003) and MSAC scores (Torr, Zisserman 2000).
//!
//! One loop for every problem. Each minimal model that beats all minimal models before it is refined on its inliers by
//! nonlinear least squares, again while that helps; the best refined model wins. Data are scored in order, in chunks, and a
//! model is dropped as soon as its score can no longer win. Everything follows from the seed.

use std::ops::Range;

use crate::{Loss, Rng};

/// What the loop needs to know about a problem.
pub trait Estimator {
    /// What is estimated.
    type Model: Clone;
    /// How many data determine a model.
    const SAMPLE_SIZE: usize;
    /// How many data there are.
    fn num_data(&self) -> usize;
    /// Appends the models that fit `sample` (indices of data, `SAMPLE_SIZE` of them, distinct); none if it is degenerate.
    fn models(&self, sample: &[usize], models: &mut Vec<Self::Model>);
    /// Squared residuals of the data in `range`, into `squared` (of the same length); infinite where undefined.
    fn squared_residuals(&self, model: &Self::Model, range: Range<usize>, squared: &mut [f64]);
    /// The least-squares model of the data `inliers`, starting from `model`.
    fn refine(&self, model: &Self::Model, inliers: &[usize]) -> Option<Self::Model>;
}

/// When to stop, and what counts as an inlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacOptions {
    /// Residual norm up to which a datum is an inlier, in the unit of the estimator's residual (pixels unless it says otherwise).
    pub max_error: f64,
    /// Stop when, with this probability, some sample had inliers only.
    pub confidence: f64,
    /// Fewest samples.
    pub min_iterations: usize,
    /// Most samples.
    pub max_iterations: usize,
    /// Where the random numbers start.
    pub seed: u64,
}

impl Default for RansacOptions {
    fn default() -> Self {
        Self { max_error: 4.0, confidence: 0.9999, min_iterations: 100, max_iterations: 10_000, seed: 0 }
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
    /// Sum over the data of the squared residual, at most `max_error`² each (MSAC); lower is better.
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

/// Most refinements of one model.
const MAX_REFINEMENTS: usize = 10;

/// The model with the best MSAC score; `None` where no sample gave a model with at least `SAMPLE_SIZE` inliers.
pub fn ransac<E: Estimator>(estimator: &E, options: &RansacOptions) -> Option<Report<E::Model>> {
    let num_data = estimator.num_data();
    if num_data < E::SAMPLE_SIZE {
        return None;
    }
    let mut sampler = Sampler::new(num_data, E::SAMPLE_SIZE, options);
    let mut scorer = Scorer { estimator, loss: Loss::Truncated(options.max_error), squared: [0.0; CHUNK] };
    let mut models = Vec::new();
    let mut best: Option<Scored<E::Model>> = None;
    let mut best_minimal_score = f64::INFINITY;
    let mut needed = options.max_iterations;
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
                let num_inliers = scorer.inliers(&candidate.model).len();
                needed = needed_iterations(num_inliers as f64 / num_data as f64, E::SAMPLE_SIZE, options);
                best = Some(candidate);
            }
        }
    }
    let Scored { model, score } = best?;
    let inliers = scorer.inliers(&model);
    if inliers.len() < E::SAMPLE_SIZE {
        return None;
    }
    let mut mask = vec![false; num_data];
    for &index in &inliers {
        mask[index] = true;
    }
    Some(Report { model, inliers: mask, num_inliers: inliers.len(), score, iterations })
}

struct Scored<M> {
    model: M,
    score: f64,
}

struct Scorer<'a, E> {
    estimator: &'a E,
    loss: Loss,
    squared: [f64; CHUNK],
}

impl<E: Estimator> Scorer<'_, E> {
    /// The MSAC score, if it is below `bound`.
    fn score(&mut self, model: &E::Model, bound: f64) -> Option<f64> {
        let mut score = 0.0;
        for range in chunks(self.estimator.num_data()) {
            let squared = &mut self.squared[..range.len()];
            self.estimator.squared_residuals(model, range, squared);
            score += squared.iter().map(|&s| self.loss.evaluate(s)[0]).sum::<f64>();
            if score >= bound {
                return None;
            }
        }
        (score < bound).then_some(score)
    }

    /// The data whose residuals the loss does not truncate.
    fn inliers(&mut self, model: &E::Model) -> Vec<usize> {
        let mut inliers = Vec::new();
        for range in chunks(self.estimator.num_data()) {
            let squared = &mut self.squared[..range.len()];
            self.estimator.squared_residuals(model, range.clone(), squared);
            let loss = self.loss;
            inliers.extend(
                range.zip(squared).filter(|(_, s)| loss.evaluate(**s)[1] > 0.0).map(|(index, _)| index),
            );
        }
        inliers
    }

    /// Least squares on the inliers, whose set then changes, until the score falls no more.
    fn optimise(&mut self, mut best: Scored<E::Model>) -> Scored<E::Model> {
        let mut inliers = self.inliers(&best.model);
        for _ in 0..MAX_REFINEMENTS {
            if inliers.len() <= E::SAMPLE_SIZE {
                break;
            }
            let Some(model) = self.estimator.refine(&best.model, &inliers) else { break };
            let Some(score) = self.score(&model, best.score) else { break };
            best = Scored { model, score };
            let next = self.inliers(&best.model);
            if next == inliers {
                break;
            }
            inliers = next;
        }
        best
    }
}

fn chunks(num_data: usize) -> impl Iterator<Item = Range<usize>> {
    (0..num_data).step_by(CHUNK).map(move |first| first..(first + CHUNK).min(num_data))
}

/// Distinct indices below `num_data`: uniform, or every combination once where these are no more than the iterations that are
/// made anyway.
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
        let combinations = (0..sample_size).fold(1.0, |c, i| c * (num_data - i) as f64 / (i + 1) as f64);
        let mode = if combinations <= options.min_iterations as f64 {
            Mode::FirstCombination
        } else {
            Mode::Uniform
        };
        Self { rng: Rng::stream(options.seed, &[]), num_data, sample: (0..sample_size).collect(), mode }
    }

    fn next_sample(&mut self) -> Option<&[usize]> {
        let Self { rng, num_data, sample, mode } = self;
        match mode {
            Mode::Uniform => {
                for position in 0..sample.len() {
                    sample[position] = loop {
                        let index = rng.below(*num_data);
                        if !sample[..position].contains(&index) {
                            break index;
                        }
                    };
                }
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
