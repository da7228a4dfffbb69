//! Recall and run time of the retrieval of loop candidates on rendered drives.
//!
//! ```text
//! cargo run --release -p tiepoint-pipeline --example loops -- \
//!     [SEEDS] [DIRECTIONS] [EFFECTS] [RATE_HZ]    (lists with commas)
//! ```
//!
//! Two cameras drive one and a half loops around a block. The overlap of two images is the smaller
//! of two fractions: of the surface points at a grid of pixels of one image (without sky and moving
//! objects), the fraction that is visible in the other. True loop pairs have an overlap of 30 % or
//! more and are more than 20 images apart; in a revisit they are more than half a loop apart. An
//! image often has dozens of true pairs, so that recall among ten candidates is relative to
//! min(10, number of true pairs). Some true pairs see a surface from such different directions that
//! no features match. Therefore the recall of pairs with 15 correct matches is counted as well, and
//! the number of images with such a revisit that have one among their candidates.

#![allow(clippy::print_stdout)]

use std::time::Instant;

use rayon::prelude::*;
use tiepoint_io::features::{Features, GrayView, Options, Sift, SiftDescriptor};
use tiepoint_sfm::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_sfm::matching;
use tiepoint_sfm::matching::retrieval::{RetrievalIndex, Vocabulary, VocabularyOptions};
use tiepoint_sfm::matching::sift::{Prepared, match_prepared};
use tiepoint_synth::image::DynamicImage;
use tiepoint_synth::trajectory::Motion;
use tiepoint_synth::{Drive, DriveOptions, Exposure, Mount, RouteKind, ViewDirection};

/// Minimum overlap of a true loop pair.
const MIN_OVERLAP: f64 = 0.3;
/// Number of candidates per image.
const TOP: usize = 10;
/// Number of images for the measurement of run time.
const BANK: usize = 4000;
/// Pairs within this number of images are matched by `--pairs sequential:20`.
const REACH: usize = 20;
const LENGTH_M: f64 = 200.0;
/// Columns and rows of the grid of pixels.
const GRID: [u32; 2] = [12, 9];
/// Images with centres further apart than this are assumed not to overlap.
const FAR_M: f64 = 60.0;
/// Minimum number of correct matches of a connected pair, as geometric verification needs them.
const MIN_MATCHES: usize = 15;
/// Maximum distance of a correct match to the true pixel.
const MAX_ERROR_PX: f64 = 4.0;
/// A point is visible if the surface at its pixel is within `SAME_M` + `SAME_SHARE` times its
/// distance.
const SAME_M: f64 = 0.05;
const SAME_SHARE: f64 = 0.02;

struct View<'a> {
    camera: usize,
    frame: usize,
    exposure: &'a Exposure,
    /// Surface points on the grid.
    points: Vec<Vector3<f64>>,
    centre: Vector3<f64>,
    features: Features,
    prepared: Prepared,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let argument =
        |at: usize, default: &str| arguments.get(at).map_or(default.to_owned(), String::clone);
    for seed in argument(0, "1").split(',') {
        for direction in argument(1, "front").split(',') {
            println!("seed {seed}, {direction}:");
            let facing = ViewDirection::ALL.into_iter().find(|facing| facing.name() == direction);
            let facing = facing.ok_or("no such view direction")?;
            measure(&Drive::new(&DriveOptions {
                seed: seed.parse()?,
                route: RouteKind::Loop,
                length_m: LENGTH_M,
                mounts: Mount::stereo(facing, 0.5).to_vec(),
                motion: Motion { overlap_m: 0.5 * LENGTH_M, ..Motion::default() },
                effects: argument(2, "all").parse()?,
                rate_hz: argument(3, "5").parse()?,
                ..DriveOptions::default()
            })?)?;
        }
    }
    Ok(())
}

fn measure(drive: &Drive) -> Result<(), Box<dyn std::error::Error>> {
    let views = views(drive)?;
    let overlaps: Vec<Vec<f64>> = (0..views.len())
        .into_par_iter()
        .map(|a| views.iter().map(|b| overlap(drive, &views[a], b)).collect())
        .collect();
    let is_true = |a: usize, b: usize| overlaps[a][b].min(overlaps[b][a]) >= MIN_OVERLAP;
    let connected: Vec<Vec<bool>> = (0..views.len())
        .into_par_iter()
        .map(|a| {
            (0..views.len())
                .map(|b| is_true(a, b) && connects(drive, &views[a], &views[b]))
                .collect()
        })
        .collect();

    // As the pipeline does: about 400 descriptors for each word.
    let sample: Vec<SiftDescriptor> = views
        .iter()
        .step_by(views.len().div_ceil(256))
        .flat_map(|view| Vocabulary::sample(sift(&view.features), 200).copied())
        .collect();
    let start = Instant::now();
    let vocabulary = Vocabulary::learn(&sample, &VocabularyOptions::default());
    let learn_s = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let described: Vec<_> =
        views.iter().map(|view| vocabulary.describe(sift(&view.features))).collect();
    let describe_ms = 1e3 * start.elapsed().as_secs_f64() / views.len() as f64;
    let index: RetrievalIndex = described.iter().cloned().collect();
    let full: RetrievalIndex = described.iter().cycle().take(BANK).cloned().collect();

    let half_round = views.iter().map(|view| view.frame).max().unwrap_or(0) / 3;
    let apart = |a: usize, b: usize| views[a].frame.abs_diff(views[b].frame);
    let count = |min_apart: usize, is_right: &dyn Fn(usize, usize) -> bool| {
        let found = index.related(TOP, |a, b| apart(a as usize, b as usize) > min_apart);
        let mut tally = Tally::default();
        for (a, found) in found.iter().enumerate() {
            let found: Vec<usize> = found.iter().map(|&b| b as usize).collect();
            let right = |b: usize| apart(a, b) > min_apart && is_right(a, b);
            tally.add(&found, (0..views.len()).filter(|&b| right(b)).count(), right);
        }
        tally
    };
    println!("  {} images; all true pairs: {}", views.len(), count(REACH, &is_true));
    println!("  revisits: {}", count(half_round, &is_true));
    println!("  connectable: {}", count(REACH, &|a, b| connected[a][b]));
    println!(
        "  connectable revisits in the same lists: {}",
        count(REACH, &|a, b| connected[a][b] && apart(a, b) > half_round)
    );
    let mut query_ms = f64::INFINITY;
    for (a, view) in views.iter().enumerate() {
        let start = Instant::now();
        let whole = vocabulary.describe(sift(&view.features));
        full.most_similar(&whole, TOP, |b| b as usize != a);
        query_ms = query_ms.min(1e3 * start.elapsed().as_secs_f64());
    }
    let start = Instant::now();
    let pairs = full.pairs(TOP, &[]).len();
    let all_s = start.elapsed().as_secs_f64();
    println!(
        "  vocabulary of {} descriptors {learn_s:.2} s; description {describe_ms:.2} ms an image; \
        a query with description \
         {query_ms:.2} ms among {BANK}; all {BANK} with each other {all_s:.2} s ({pairs} pairs)",
        sample.len()
    );
    Ok(())
}

fn sift(features: &Features) -> &[SiftDescriptor] {
    features.descriptors.as_sift().unwrap_or_default()
}

/// Counts of correct candidates.
#[derive(Default)]
struct Tally {
    queries: usize,
    first: usize,
    any: usize,
    hits: usize,
    possible: usize,
}

impl Tally {
    fn add(&mut self, found: &[usize], true_ones: usize, is_true: impl Fn(usize) -> bool) {
        if true_ones > 0 {
            self.queries += 1;
            self.first += usize::from(found.first().is_some_and(|&b| is_true(b)));
            self.any += usize::from(found.iter().any(|&b| is_true(b)));
            self.hits += found.iter().filter(|&&b| is_true(b)).count();
            self.possible += true_ones.min(TOP);
        }
    }
}

impl std::fmt::Display for Tally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let share = |part: usize, whole: usize| part as f64 / whole.max(1) as f64;
        write!(
            f,
            "{} queries, {:.4} found among {TOP}, the first is right in {:.4}, one of them in \
            {:.4}",
            self.queries,
            share(self.hits, self.possible),
            share(self.first, self.queries),
            share(self.any, self.queries)
        )
    }
}

fn views(drive: &Drive) -> Result<Vec<View<'_>>, Box<dyn std::error::Error>> {
    let renderers: Vec<_> =
        (0..drive.cameras().len()).map(|camera| drive.renderer(camera)).collect();
    let exposures: Vec<(usize, usize, &Exposure)> = drive
        .cameras()
        .iter()
        .enumerate()
        .flat_map(|(camera, c)| {
            c.exposures.iter().enumerate().map(move |(frame, e)| (camera, frame, e))
        })
        .collect();
    let view = |&(camera, frame, exposure): &(usize, usize, _)| {
        let grey =
            DynamicImage::from(drive.render(camera, exposure, &renderers[camera])).to_luma8();
        let view = GrayView::new(grey.as_raw(), grey.width() as usize, grey.height() as usize);
        let features = Sift::new(Options::default())?.extract(&view, None)?;
        let pixel = |k: u32, cells: u32, size: u32| {
            (f64::from(k) + 0.5) * f64::from(size) / f64::from(cells)
        };
        let pixels = (0..GRID[0] * GRID[1]).map(|k| {
            Vector2::new(
                pixel(k % GRID[0], GRID[0], grey.width()),
                pixel(k / GRID[0], GRID[1], grey.height()),
            )
        });
        let surfaces = pixels.filter_map(|pixel| drive.surface_at(camera, exposure.time_s, &pixel));
        let points =
            surfaces.filter(|surface| !surface.is_moving).map(|surface| surface.point_in_world);
        let centre = drive.cam_from_world(camera, exposure.time_s).inverse().translation;
        let prepared = Prepared::new(sift(&features));
        Ok(View { camera, frame, exposure, points: points.collect(), centre, features, prepared })
    };
    let views: Result<Vec<_>, tiepoint_io::features::Error> =
        exposures.par_iter().map(view).collect();
    Ok(views?)
}

/// The fraction of the surface points of `a` that are visible in `b`.
fn overlap(drive: &Drive, a: &View<'_>, b: &View<'_>) -> f64 {
    if a.frame.abs_diff(b.frame) <= REACH
        || (a.centre - b.centre).norm() > FAR_M
        || a.points.is_empty()
    {
        return 0.0;
    }
    let size = &drive.cameras()[b.camera];
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    let is_seen = |point: &&Vector3<f64>| {
        let Some(pixel) = drive.project(b.camera, b.exposure.time_s, point) else { return false };
        if !(0.0..width).contains(&pixel.x) || !(0.0..height).contains(&pixel.y) {
            return false;
        }
        let Some(surface) = drive.surface_at(b.camera, b.exposure.time_s, &pixel) else {
            return false;
        };
        (surface.point_in_world - **point).norm()
            < SAME_M + SAME_SHARE * (b.centre - **point).norm()
    };
    a.points.iter().filter(is_seen).count() as f64 / a.points.len() as f64
}

/// Whether `a` and `b` have enough correct matches.
fn connects(drive: &Drive, a: &View<'_>, b: &View<'_>) -> bool {
    let matches = match_prepared(&a.prepared, &b.prepared, &matching::Options::default());
    let is_right = |m: &&matching::Match| {
        let (p, q) = (a.features.keypoints[m.a as usize], b.features.keypoints[m.b as usize]);
        let pixel = Vector2::new(f64::from(p.x), f64::from(p.y));
        let surface = drive.surface_at(a.camera, a.exposure.time_s, &pixel);
        let seen =
            surface.and_then(|s| drive.project(b.camera, b.exposure.time_s, &s.point_in_world));
        seen.is_some_and(|seen| {
            (seen - Vector2::new(f64::from(q.x), f64::from(q.y))).norm() < MAX_ERROR_PX
        })
    };
    matches.iter().filter(is_right).count() >= MIN_MATCHES
}
