//! Time and accuracy of every solver of the table. The accuracy is over 10,000 problems, or over
//! the number in the environment variable `TRIALS`.

use std::hint::black_box;
use std::time::Instant;

use criterion::{Criterion, criterion_group, criterion_main};
use tiepoint_geometry::testing::{SolverProblem, solver_problem};
use tiepoint_geometry::{Rng, solvers};

/// Number of different problems in a timing, so that the branch predictor does not learn one.
const PROBLEMS: usize = 1000;

fn solvers(criterion: &mut Criterion) {
    let trials =
        std::env::var("TRIALS").ok().and_then(|trials| trials.parse().ok()).unwrap_or(10_000);
    for info in solvers::TABLE {
        let mut rng = Rng::stream(1, &[]);
        let mut problems = std::iter::from_fn(|| solver_problem(info, &mut rng));
        let timed: Vec<SolverProblem> = problems.by_ref().take(PROBLEMS).collect();
        let mut index = 0;
        criterion.bench_function(info.name, |bencher| {
            bencher.iter(|| {
                index = (index + 1) % PROBLEMS;
                timed[index].solve()
            });
        });
        let (mut found, mut solutions) = (0, 0);
        for trial in problems.take(trials).map(|problem| problem.evaluate()) {
            found += usize::from(trial.distance < 1e-6);
            solutions += trial.solutions;
        }
        let share = 100.0 * found as f64 / trials as f64;
        let (solutions, least) = (solutions as f64 / trials as f64, least_time(&timed));
        println!(
            "    truth found {share:.4} %, {solutions:.2} solutions, {:.0} ns undisturbed",
            1e9 * least
        );
    }
}

/// Seconds per problem without interruptions: the mean over batches of the minimum time of a batch.
fn least_time(problems: &[SolverProblem]) -> f64 {
    let batch_time = |batch: &[SolverProblem]| {
        let start = Instant::now();
        black_box(batch.iter().map(SolverProblem::solve).sum::<usize>());
        start.elapsed().as_secs_f64()
    };
    let least = |batch| (0..200).map(|_| batch_time(batch)).fold(f64::INFINITY, f64::min);
    problems.chunks(50).map(least).sum::<f64>() / problems.len() as f64
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(20)
        .warm_up_time(std::time::Duration::from_millis(200))
        .measurement_time(std::time::Duration::from_secs(1));
    targets = solvers
}
criterion_main!(benches);
