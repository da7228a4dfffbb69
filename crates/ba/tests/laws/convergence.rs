//! Termination of a solve.

use std::ops::ControlFlow;

use tiepoint_ba::autodiff::{AutoDiff, Residual, Scalar};
use tiepoint_ba::nalgebra::SVector;
use tiepoint_ba::{EliminationOrder, Loss, Options, Problem, Solver, Termination};

/// x/√(1 + x²). Gauss-Newton goes from x to −x³, so from just below 1 a step hardly lowers the
/// cost.
struct Overshoots;

impl Residual<1> for Overshoots {
    type Vars = (SVector<f64, 1>,);
    fn residual<T: Scalar>(&self, ([x],): ([T; 1],)) -> Option<[T; 1]> {
        Some([x / (x * x + T::from(1.0)).sqrt()])
    }
}

/// The first step lowers the cost by 2e-7 of it, less than the tolerance.
const START: f64 = 1.0 - 1e-7;
/// Too little damping to shorten the first step.
const NO_DAMPING: f64 = 1e-12;
/// Distance from the minimum at zero.
const MAX_ERROR: f64 = 1e-3;

#[test]
fn a_tiny_decrease_with_a_low_gain_ratio_does_not_end_the_solve() {
    let mut problem = Problem::new();
    let x = problem.add_parameter(SVector::<f64, 1>::new(START), EliminationOrder::Last);
    problem.add(x, AutoDiff(Overshoots), Loss::Trivial).unwrap();
    let options = Options { initial_damping: NO_DAMPING, ..Options::default() };
    let mut first = None;
    let summary =
        Solver::new(&problem, &options).unwrap().solve_with(&mut problem, &mut |record| {
            first.get_or_insert(record.decrease / record.cost);
            ControlFlow::Continue(())
        });
    let summary = summary.unwrap();
    assert!((0.0..options.function_tolerance).contains(&first.unwrap()), "{first:?}");
    assert_ne!(summary.termination, Termination::MaxIterations);
    assert!(problem.get(x).x.abs() < MAX_ERROR, "{summary:?}");
}
