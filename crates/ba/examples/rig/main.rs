//! Bundle adjustment of two cameras on a rig, whose mounting is known.
//!
//! ```text
//! cargo run --release --example rig -- CALIBRATION.txt POSES.txt OBSERVATIONS.txt [TRUE_POSES.txt]
//! ```

mod stereo;

use std::error::Error;
use std::ops::ControlFlow;

use stereo::{Distance, Right, Stereo, distance, true_poses};
use tiepoint_ba::{Loss, Options, Solver};
use tiepoint_geometry::Rigid3;

/// Moments between poses that are compared as one is seen from the other.
const APART: usize = 20;

#[allow(clippy::print_stdout)] // a program may
fn main() -> Result<(), Box<dyn Error>> {
    let files: Vec<String> = std::env::args().skip(1).collect();
    let [calibration, poses, observations, truth @ ..] = &files[..] else {
        return Err("usage: rig CALIBRATION.txt POSES.txt OBSERVATIONS.txt [TRUE_POSES.txt]".into());
    };
    let read = std::fs::read_to_string;
    let stereo = Stereo::parse(&read(calibration)?, &read(poses)?, &read(observations)?)?;
    let truth = match truth {
        [file, ..] => Some(true_poses(&read(file)?)?),
        [] => None,
    };
    let compare = |poses: &[Rigid3]| {
        let Some(truth) = &truth else { return };
        let Distance { as_they_are_m, aligned_m, ahead_m, turn_rad } =
            distance(poses, truth, APART);
        let turn_deg = turn_rad.to_degrees();
        println!("    {as_they_are_m:.3} m from the true positions, {aligned_m:.3} m when aligned");
        println!("    {APART} moments ahead {ahead_m:.3} m and {turn_deg:.3} degrees off");
    };
    println!("before");
    compare(&stereo.poses);
    for right in [Right::Held, Right::ColumnFree] {
        let mut adjustment = stereo.problem(Loss::Cauchy(2.0), right)?;
        let summary = Solver::new(&adjustment.problem, &Options::default())?
            .solve(&mut adjustment.problem, &mut |_| ControlFlow::Continue(()))?;
        println!("right lens {right:?}, moved by {:.3} px: {summary}", adjustment.right_shift_px());
        compare(&adjustment.poses());
    }
    Ok(())
}
