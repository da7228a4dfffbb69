//! All solvers of the table on random problems.

use tiepoint_geometry::{Rng, solvers, testing};

/// Problems per solver.
const PROBLEMS: usize = 20_000;
const SEED: u64 = 5;

/// Bound on the residual, in units of the data, for 99.9 % of the problems. PoseLib's benchmark has
/// the same bound.
const RESIDUAL: f64 = 1e-8;

/// Distance within which the true solution counts as found. It allows for badly conditioned
/// problems. PoseLib's benchmark has the same bound.
const FOUND: f64 = 1e-6;

#[test]
fn solvers_find_the_true_solution() {
    for info in solvers::TABLE {
        let mut rng = Rng::stream(SEED, &[]);
        let (mut bad, mut missed) = (0, 0);
        let mut residuals = Vec::new();
        for _ in 0..PROBLEMS {
            let problem =
                testing::solver_problem(info, &mut rng).expect("a generator for every row");
            let trial = problem.evaluate();
            assert!(trial.solutions <= info.max_solutions);
            bad += usize::from(trial.residual > RESIDUAL);
            missed += usize::from(trial.distance > FOUND);
            residuals.push(trial.residual);
        }
        residuals.sort_by(f64::total_cmp);
        println!(
            "{}: {missed} missed, {bad} inexact, median residual {:e}",
            info.name,
            residuals[PROBLEMS / 2]
        );
        assert!(residuals[PROBLEMS / 2] < 1e-12, "{}", info.name);
        assert!(bad <= PROBLEMS / 1000, "{}: {bad} inexact", info.name);
        assert!(missed <= PROBLEMS / 1000, "{}: {missed} missed", info.name);
    }
}

#[test]
fn the_readme_lists_every_solver() {
    let readme = include_str!("../../README.md");
    for solvers::SolverInfo { name, finds, sample_size, max_solutions, paper } in solvers::TABLE {
        let row = format!("| `{name}` | {finds} | {sample_size} | {max_solutions} | {paper} |");
        assert!(readme.contains(&row), "README.md lacks: {row}");
    }
}
