//! Bundle adjustment of a stereo rig with known extrinsics.
//!
//! ```text
//! cargo run --release --example rig -- CALIBRATION.txt POSES.txt OBSERVATIONS.txt [TRUE_POSES.txt]
//! ```

mod stereo;

use std::error::Error;

use stereo::{PoseErrors, RightIntrinsics, StereoData, pose_errors, true_poses};
use tiepoint_ba::{Loss, Options, Solver};
use tiepoint_geometry::Rigid3;

/// Frames between poses whose relative pose is compared.
const FRAMES_APART: usize = 20;

#[allow(clippy::print_stdout)] // a program may
fn main() -> Result<(), Box<dyn Error>> {
    let files: Vec<String> = std::env::args().skip(1).collect();
    let [calibration, poses, observations, truth @ ..] = &files[..] else {
        return Err("usage: rig CALIBRATION.txt POSES.txt OBSERVATIONS.txt [TRUE_POSES.txt]".into());
    };
    let read = std::fs::read_to_string;
    let stereo = StereoData::parse(&read(calibration)?, &read(poses)?, &read(observations)?)?;
    let truth = match truth {
        [file, ..] => Some(true_poses(&read(file)?)?),
        [] => None,
    };
    let compare = |poses: &[Rigid3]| {
        let Some(truth) = &truth else { return };
        let PoseErrors { unaligned_m, aligned_m, relative_m, rotation_rad } =
            pose_errors(poses, truth, FRAMES_APART);
        let rotation_deg = rotation_rad.to_degrees();
        println!("    {unaligned_m:.3} m from the true positions, {aligned_m:.3} m when aligned");
        println!(
            "    {FRAMES_APART} frames apart: {relative_m:.3} m and {rotation_deg:.3} degrees off"
        );
    };
    println!("before");
    compare(&stereo.poses);
    for right in [RightIntrinsics::Fixed, RightIntrinsics::PrincipalPointFree] {
        let mut adjustment = stereo.problem(Loss::Cauchy(2.0), right)?;
        let summary = Solver::new(&adjustment.problem, &Options::default())?
            .solve(&mut adjustment.problem)?;
        println!(
            "right intrinsics {right:?}, moved by {:.3} px: {summary}",
            adjustment.right_shift_px()
        );
        compare(&adjustment.poses());
    }
    Ok(())
}
