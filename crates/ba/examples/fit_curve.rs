//! The smallest problem: a damped oscillation is fit to noisy samples with gross errors. Only the
//! residual is written; derivatives are automatic.
//!
//! `cargo run --example fit_curve`

use tiepoint_ba::autodiff::{AutoDiff, Residual, Scalar};
use tiepoint_ba::nalgebra::Vector4;
use tiepoint_ba::{EliminationOrder, Error, Loss, Options, Problem, Solver};

/// Measurement of a e^(−b t) cos(c t + d) at time `t`.
struct Sample {
    t: f64,
    value: f64,
    sigma: f64,
}

impl Residual<1> for Sample {
    type Vars = (Vector4<f64>,);

    fn residual<T: Scalar>(&self, ([a, b, c, d],): ([T; 4],)) -> Option<[T; 1]> {
        let model = a * (-b * self.t).exp() * (c * self.t + d).cos();
        Some([(model - self.value) / self.sigma])
    }
}

#[allow(clippy::print_stdout)] // a program may
fn main() -> Result<(), Error> {
    let truth = Vector4::new(2.0, 0.3, 4.0, 0.5);
    let mut rng = tiepoint_geometry::Rng::stream(0, &[]);
    let mut problem = Problem::new();
    let curve = problem.add_parameter(Vector4::new(1.0, 0.1, 3.8, 0.0), EliminationOrder::Last);
    let sigma = 0.05;
    for i in 0..200 {
        let t = f64::from(i) * 0.02;
        let gross = if i % 10 == 0 { 3.0 } else { 0.0 };
        let value = truth[0] * (-truth[1] * t).exp() * (truth[2] * t + truth[3]).cos()
            + sigma * rng.normal()
            + gross;
        problem.add(curve, AutoDiff(Sample { t, value, sigma }), Loss::Cauchy(1.0))?;
    }
    let mut solver = Solver::new(&problem, &Options::default())?;
    let summary = solver.solve(&mut problem)?;
    println!("{summary}");
    println!("true  {truth:.3?}\nfound {:.3?}", problem.get(curve));
    Ok(())
}
