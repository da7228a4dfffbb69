//! Time and recall of all methods of nearest-neighbour search, as JSON lines. `bench/matching.py`
//! compares them with OpenCV.
//!
//! `cargo run --release -p tiepoint-matching --example search QUERIES POINTS [TRUTH_QUERIES]`,
//! where the files hold 128 bytes per descriptor and recall is taken over the first TRUTH_QUERIES
//! queries. Times are on one thread, the minimum of several runs.

#![expect(clippy::print_stdout, reason = "an example is a program")]

use std::error::Error;
use std::time::Instant;

use tiepoint_features::SiftDescriptor;
use tiepoint_matching::Options;
use tiepoint_matching::forest::{Checks, Forest, ForestOptions};
use tiepoint_matching::sift::{Isa, Nearest, Prepared, match_prepared_on, nearest, nearest_on};

/// Number of runs of each measurement. The minimum time is reported.
const RUNS: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (queries, points, limit) = match arguments.as_slice() {
        [queries, points] => (queries, points, usize::MAX),
        [queries, points, limit] => (queries, points, limit.parse()?),
        _ => return Err("usage: search QUERIES POINTS [TRUTH_QUERIES]".into()),
    };
    let (mut queries, points) = (read(queries)?, read(points)?);
    queries.truncate(limit);
    // The library uses the threads of the current pool: one.
    rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(|| measure(&queries, &points));
    Ok(())
}

fn measure(queries: &[SiftDescriptor], points: &[SiftDescriptor]) {
    let truth = nearest(&Prepared::new(queries), &Prepared::new(points)).of_a;

    let (packed_queries, packed_points) = (Prepared::new(queries), Prepared::new(points));
    for isa in Isa::supported() {
        // The portable kernel is about fifty times slower than the fastest.
        let runs = if isa == Isa::best() { RUNS } else { 1 };
        let (seconds, _) = shortest(runs, || nearest_on(isa, &packed_queries, &packed_points));
        println!(
            r#"{{"method":"brute force, both ways, {isa}","seconds":{seconds},"queries":{}}}"#,
            queries.len()
        );
        let options = Options::default();
        let (seconds, matches) =
            shortest(runs, || match_prepared_on(isa, &packed_queries, &packed_points, &options));
        print!(r#"{{"method":"matches with pruning, {isa}","seconds":{seconds},"#);
        println!(r#""queries":{},"matches":{}}}"#, queries.len(), matches.len());
    }
    for trees in [1, 4, 8] {
        let (build_seconds, forest) =
            shortest(1, || Forest::new(points, &ForestOptions { trees, seed: 1 }));
        for checks in [8, 16, 32, 64, 128, 256, 512] {
            let (seconds, found) =
                shortest(RUNS, || forest.nearest(queries, Checks::Total(checks)));
            print!(r#"{{"method":"forest","trees":{trees},"checks":{checks},"#);
            println!(
                r#""build_seconds":{build_seconds},"seconds":{seconds},"queries":{},"recall":{}}}"#,
                queries.len(),
                recall(&found, &truth)
            );
        }
    }
}

/// Fraction of the queries whose neighbour has the distance of the exact nearest neighbour.
fn recall(found: &[Nearest], truth: &[Nearest]) -> f64 {
    let right =
        found.iter().zip(truth).filter(|(found, truth)| found.distance == truth.distance).count();
    right as f64 / truth.len() as f64
}

fn shortest<T>(runs: usize, mut run: impl FnMut() -> T) -> (f64, T) {
    let timed = |run: &mut dyn FnMut() -> T| {
        let start = Instant::now();
        let result = run();
        (start.elapsed().as_secs_f64(), result)
    };
    let mut best = timed(&mut run);
    for _ in 1..runs {
        let next = timed(&mut run);
        if next.0 < best.0 {
            best = next;
        }
    }
    best
}

fn read(path: &str) -> Result<Vec<SiftDescriptor>, Box<dyn Error>> {
    let bytes = std::fs::read(path).map_err(|error| format!("{path}: {error}"))?;
    Ok(bytes.as_chunks::<128>().0.to_vec())
}
