//! Bundle adjustment of two cameras on a rig, whose mounting is known.
//!
//! `cargo run --release --example rig -- CALIBRATION.txt POSES.txt OBSERVATIONS.txt [TRUE_POSES.txt]`

mod stereo;

use std::error::Error;
use std::ops::ControlFlow;

use stereo::{Distance, Stereo, distance, true_poses};
use tiepoint_ba::{Loss, Options, Solver};

/// Moments between poses whose relative rotation is compared.
const APART: usize = 20;

#[allow(clippy::print_stdout)] // a program may
fn main() -> Result<(), Box<dyn Error>> {
    let files: Vec<String> = std::env::args().skip(1).collect();
    let [calibration, poses, observations, truth @ ..] = &files[..] else {
        return Err("usage: rig CALIBRATION.txt POSES.txt OBSERVATIONS.txt [TRUE_POSES.txt]".into());
    };
    let read = std::fs::read_to_string;
    let stereo = Stereo::parse(&read(calibration)?, &read(poses)?, &read(observations)?)?;
    let (mut problem, keys) = stereo.problem(Loss::Cauchy(2.0))?;
    let summary = Solver::new(&problem, &Options::default())?
        .solve(&mut problem, &mut |_| ControlFlow::Continue(()))?;
    println!("{summary}");
    if let [truth, ..] = truth {
        let truth = true_poses(&read(truth)?)?;
        let after: Vec<_> = keys.iter().map(|&key| problem.get(key).inverse()).collect();
        for (when, poses) in [("before", &stereo.poses), ("after", &after)] {
            let Distance { as_they_are_m, aligned_m, turn_rad } = distance(poses, &truth, APART);
            println!(
                "{when}: {as_they_are_m:.3} m from the true positions, {aligned_m:.3} m when aligned; turns over {APART} moments {:.3} degrees off",
                turn_rad.to_degrees(),
            );
        }
    }
    Ok(())
}
