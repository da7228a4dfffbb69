//! Time and memory over the length of a drive: two cameras on one vehicle, some thousand frames,
//! tracks of a few frames, intrinsics that all images of a camera share.
//!
//! `cargo run --release --example drive -- [FRAMES [POINTS_PER_FRAME]] [--no-rig] [--loop]`
//!
//! A factor of four poses between consecutive frames keeps the baseline constant; `--no-rig` leaves
//! it out. With `--loop` the drive is a circle whose end sees the points of its start.
#![allow(clippy::print_stdout)] // a program may
use std::time::Instant;

use tiepoint_ba::factor::{Linear, Refs};
use tiepoint_ba::factors::Reprojection;
use tiepoint_ba::nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3, Vector4};
use tiepoint_ba::{EliminationOrder, Error, Factor, Loss, Options, Problem, Solver};
use tiepoint_geometry::cameras::Pinhole;
use tiepoint_geometry::{CameraModel, Rigid3, Rng, so3};

/// The right camera's centre in the left camera frame, minus the same at the next frame. Variables:
/// left and right `cam_from_world`, then those of the next frame.
struct ConstantBaseline {
    sigma: f64,
}

/// The right camera's centre in the left camera frame, t_l − R_l R_rᵀ t_r, and its Jacobians with
/// respect to both poses.
fn baseline(
    left: &Rigid3,
    right: &Rigid3,
) -> (Vector3<f64>, SMatrix<f64, 3, 6>, SMatrix<f64, 3, 6>) {
    let left_from_right =
        (left.rotation * right.rotation.inverse()).to_rotation_matrix().into_inner();
    let centre = left.translation - left_from_right * right.translation;
    let (mut d_left, mut d_right) = (SMatrix::<f64, 3, 6>::zeros(), SMatrix::<f64, 3, 6>::zeros());
    d_left.fixed_view_mut::<3, 3>(0, 0).copy_from(&-so3::hat(&centre));
    d_left.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
    d_right.fixed_view_mut::<3, 3>(0, 3).copy_from(&-left_from_right);
    (centre, d_left, d_right)
}

impl Factor<3> for ConstantBaseline {
    type Vars = (Rigid3, Rigid3, Rigid3, Rigid3);

    fn linearize(&self, (l0, r0, l1, r1): Refs<'_, Self::Vars>) -> Option<Linear<Self::Vars, 3>> {
        let ((p0, l0, r0), (p1, l1, r1)) = (baseline(l0, r0), baseline(l1, r1));
        let weight = 1.0 / self.sigma;
        Some(((p0 - p1) * weight, (l0 * weight, r0 * weight, -l1 * weight, -r1 * weight)))
    }
}

/// Number of frames that see a point, and metres between frames.
const TRACK_LENGTH: usize = 5;
const STEP_M: f64 = 0.5;
const NOISE_PX: f64 = 0.5;

fn drive(
    frames: usize,
    points_per_frame: usize,
    rig: bool,
    closed: bool,
) -> Result<Problem, Error> {
    let mut rng = Rng::stream(5, &[]);
    let mut problem = Problem::new();
    let intrinsics = Vector4::new(900.0, 900.0, 960.0, 540.0);
    let intrinsics_keys = [0, 1].map(|_| {
        problem.add_parameter(intrinsics + Vector4::new(3.0, 3.0, 0.0, 0.0), EliminationOrder::Last)
    });
    intrinsics_keys.iter().try_for_each(|&key| problem.fix_dofs(key, &[2, 3]))?;
    let radius = STEP_M * frames as f64 / std::f64::consts::TAU;
    let right_from_left = Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(-0.8, 0.0, 0.0));
    // The vehicle drives along x or around a circle; the cameras look sideways, along z.
    let left_at = |i: usize| {
        let angle = if closed { i as f64 / frames as f64 * std::f64::consts::TAU } else { 0.0 };
        let centre = match closed {
            true => Vector3::new(radius * angle.sin(), 0.0, radius * (1.0 - angle.cos())),
            false => Vector3::new(STEP_M * i as f64, 0.0, 0.0),
        };
        let rotation = so3::exp(&Vector3::new(0.0, angle, 0.0));
        Rigid3::new(rotation, -(rotation * centre))
    };
    let mut poses = Vec::with_capacity(frames);
    let mut truth = Vec::with_capacity(frames);
    for i in 0..frames {
        let left = left_at(i);
        let both = [left, right_from_left * left];
        let mut perturbation = || {
            let mut three = || Vector3::new(rng.normal(), rng.normal(), rng.normal()) * 0.002;
            Rigid3::from_axis_angle(three(), three() * 5.0)
        };
        poses.push(both.map(|pose| {
            problem.add_parameter(
                if i < 2 { pose } else { perturbation() * pose },
                EliminationOrder::At(i as u32),
            )
        }));
        truth.push(both);
    }
    poses[0].iter().chain(&poses[1]).for_each(|&pose| problem.fix(pose));
    for i in 0..frames {
        for _ in 0..points_per_frame {
            let in_left = Vector3::new(
                6.0 * rng.uniform() - 2.0,
                6.0 * rng.uniform() - 3.0,
                6.0 + 6.0 * rng.uniform(),
            );
            let point = truth[i][0].inverse() * in_left;
            let perturbation = Vector3::new(rng.normal(), rng.normal(), rng.normal()) * 0.05;
            let key = problem.add_landmark(point + perturbation);
            for j in i..i + TRACK_LENGTH {
                let j = match closed {
                    true => j % frames,
                    false if j < frames => j,
                    false => break,
                };
                for side in 0..2 {
                    // One in five keypoints is not detected.
                    let seen = Pinhole::project(&intrinsics, &(truth[j][side] * point))
                        .filter(|_| rng.below(5) > 0);
                    let Some(pixel) = seen else { continue };
                    let pixel = pixel + Vector2::new(rng.normal(), rng.normal()) * NOISE_PX;
                    let factor = Reprojection::<Pinhole>::new(pixel, NOISE_PX);
                    problem.add(
                        (intrinsics_keys[side], poses[j][side], key),
                        factor,
                        Loss::Huber(2.0),
                    )?;
                }
            }
        }
    }
    let end = if closed { frames } else { frames - 1 };
    for i in (0..end).filter(|_| rig) {
        let ([l0, r0], [l1, r1]) = (poses[i], poses[(i + 1) % frames]);
        problem.add((l0, r0, l1, r1), ConstantBaseline { sigma: 0.01 }, Loss::Trivial)?;
    }
    Ok(problem)
}

/// Mean squared residual, as a check of the solution.
fn mean_squared_residual(problem: &Problem) -> f64 {
    let residuals = problem.residuals::<2, Reprojection<Pinhole>>();
    let norms: SVector<f64, 2> = residuals
        .iter()
        .flatten()
        .fold(SVector::zeros(), |sum, r| sum + Vector2::new(r.norm_squared(), 2.0));
    norms.x / norms.y
}

/// Peak resident memory of this process in GiB; NaN if the system does not report it.
fn peak_gib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|line| line.trim().trim_end_matches(" kB").trim().parse::<f64>().ok());
    kib.unwrap_or(f64::NAN) / (1 << 20) as f64
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut rig, mut closed, mut sizes) = (true, false, Vec::new());
    for argument in std::env::args().skip(1) {
        match argument.as_str() {
            "--no-rig" => rig = false,
            "--loop" => closed = true,
            number => sizes.push(number.parse::<usize>()?),
        }
    }
    let frames = sizes.first().copied().unwrap_or(250).max(TRACK_LENGTH + 1);
    let points = sizes.get(1).copied().unwrap_or(500);
    let mut problem = drive(frames, points, rig, closed)?;
    let built = peak_gib();
    let begin = Instant::now();
    let mut solver = Solver::new(&problem, &Options { max_iterations: 10, ..Options::default() })?;
    let analysis = begin.elapsed();
    let summary = solver.solve(&mut problem)?;
    let steps = summary.iterations.len().max(1) as f64;
    // Time from step to step, without the first linearisation and its memory allocation.
    let mut durations: Vec<f64> = summary
        .iterations
        .windows(2)
        .map(|two| (two[1].elapsed - two[0].elapsed).as_secs_f64())
        .collect();
    durations.sort_by(f64::total_cmp);
    let median = durations.get(durations.len() / 2).copied().unwrap_or(f64::NAN);
    println!("{summary}");
    println!(
        "{} cameras, {} factors: analysis {:.2} s, {:.3} s a step (median {median:.3}); {:.2} \
        GiB, {built:.2} of it the problem; mean square {:.3}\n{:?}",
        2 * frames,
        problem.num_factors(),
        analysis.as_secs_f64(),
        summary.times.total.as_secs_f64() / steps,
        peak_gib(),
        mean_squared_residual(&problem),
        summary.times,
    );
    Ok(())
}
