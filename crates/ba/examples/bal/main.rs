//! Bundle adjustment of a problem file of "Bundle adjustment in the large".
//!
//! ```text
//! cargo run --release --example bal -- PROBLEM.txt [--out ADJUSTED.txt] [--threads N] [--dual]
//!     [--trace]
//! ```
//!
//! `--dual` differentiates by dual numbers. `--trace` prints `seconds cost` after the analysis and
//! after every step, and nothing else.

mod file;
mod snavely;

use std::error::Error;
use std::time::Instant;

use file::{Bal, Derivatives};
use tiepoint_ba::{Options, Solver};

#[allow(clippy::print_stdout)] // a program may
fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (mut path, mut out, mut trace, mut derivatives) = (None, None, false, Derivatives::ByHand);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--out" => out = arguments.next(),
            "--threads" => {
                let threads = arguments.next().ok_or("--threads needs a number")?.parse()?;
                rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
            }
            "--dual" => derivatives = Derivatives::ByDualNumbers,
            "--trace" => trace = true,
            _ => path = Some(argument),
        }
    }
    let path =
        path.ok_or("usage: bal PROBLEM.txt [--out ADJUSTED.txt] [--threads N] [--dual] [--trace]")?;
    let mut bal = Bal::parse(&std::fs::read_to_string(path)?)?;
    let (mut problem, keys) = bal.problem(derivatives)?;

    let begin = Instant::now();
    let mut solver = Solver::new(&problem, &Options { max_iterations: 50, ..Options::default() })?;
    let analysis = begin.elapsed();
    let summary = solver.solve(&mut problem)?;
    if trace {
        println!("{:.6} {:.9e}", analysis.as_secs_f64(), summary.initial_cost);
        for it in &summary.iterations {
            println!("{:.6} {:.9e}", (analysis + it.elapsed).as_secs_f64(), it.cost);
        }
    } else {
        println!("{summary}\nanalysis {:.1} ms, {:?}", analysis.as_secs_f64() * 1e3, summary.times);
    }
    if let Some(out) = out {
        bal.update(&problem, &keys);
        std::fs::write(out, bal.to_text())?;
    }
    Ok(())
}
