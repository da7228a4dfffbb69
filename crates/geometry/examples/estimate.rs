//! Robust estimation of problems from standard input, with the time of each. `bench/geometry.py`
//! runs it.
//!
//! A problem is a line
//! `KIND max_error min_iterations max_iterations seed count repetitions CAMERA...`, where KIND is
//! `absolute_pose` (one CAMERA), `relative_pose` (two), `fundamental` or `homography` (none) and
//! CAMERA is a COLMAP model name and its parameters, followed by `count` lines of numbers: pixel
//! and world point, or pixel 1 and pixel 2. The answer is a line
//! `seconds num_inliers iterations score MODEL...`, or `seconds none`. A pose is
//! `qw qx qy qz tx ty tz`.

use std::error::Error;
use std::io::{BufRead, stdin};
use std::str::FromStr;
use std::time::Instant;

use nalgebra::{Matrix3, Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, RansacOptions, Report, Rigid3, estimate};

fn next<T: FromStr<Err: Error + 'static>>(
    tokens: &mut dyn Iterator<Item = &str>,
) -> Result<T, Box<dyn Error>> {
    Ok(tokens.next().ok_or("incomplete problem")?.parse()?)
}

fn camera(tokens: &mut dyn Iterator<Item = &str>) -> Result<Intrinsics, Box<dyn Error>> {
    let kind = CameraModelKind::from_name(tokens.next().ok_or("missing camera model")?)?;
    let params = (0..kind.num_params()).map(|_| next(tokens)).collect::<Result<Vec<f64>, _>>()?;
    Ok(Intrinsics::new(kind, &params)?)
}

fn pose_values(pose: Rigid3) -> Vec<f64> {
    let (q, t) = (pose.rotation, pose.translation);
    vec![q.w, q.i, q.j, q.k, t.x, t.y, t.z]
}

fn matrix_values(m: Matrix3<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}

#[allow(clippy::print_stdout)] // A program.
fn main() -> Result<(), Box<dyn Error>> {
    let mut lines = stdin().lock().lines();
    while let Some(header) = lines.next() {
        let header = header?;
        let tokens = &mut header.split_whitespace();
        let kind: String = next(tokens)?;
        let options = RansacOptions {
            max_error: next(tokens)?,
            confidence: RansacOptions::default().confidence,
            min_iterations: next(tokens)?,
            max_iterations: next(tokens)?,
            min_inlier_ratio: 0.0,
            seed: next(tokens)?,
        };
        let (count, repetitions): (usize, usize) = (next(tokens)?, next(tokens)?);
        let (mut first, mut second, mut points) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..count {
            let line = lines.next().ok_or("incomplete problem")??;
            let numbers =
                line.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>()?;
            match *numbers {
                [x, y, u, v] => {
                    first.push(Vector2::new(x, y));
                    second.push(Vector2::new(u, v));
                }
                [x, y, a, b, c] => {
                    first.push(Vector2::new(x, y));
                    points.push(Vector3::new(a, b, c));
                }
                _ => return Err("expected four or five numbers on a line".into()),
            }
        }
        let cameras = std::iter::from_fn(|| camera(tokens).ok()).collect::<Vec<_>>();
        let solve = || -> Option<Report<Vec<f64>>> {
            match kind.as_str() {
                "absolute_pose" => {
                    let report =
                        estimate::absolute_pose(&first, &points, cameras.first()?, &options);
                    report.map(|report| report.map(pose_values))
                }
                "relative_pose" => {
                    let report = estimate::relative_pose(
                        &first,
                        &second,
                        cameras.first()?,
                        cameras.get(1)?,
                        &options,
                    );
                    report.map(|report| report.map(pose_values))
                }
                "fundamental" => estimate::fundamental(&first, &second, &options)
                    .map(|report| report.map(matrix_values)),
                _ => estimate::homography(&first, &second, &options)
                    .map(|report| report.map(matrix_values)),
            }
        };
        let mut seconds = f64::INFINITY;
        let mut report = None;
        for _ in 0..repetitions.max(1) {
            let start = Instant::now();
            report = solve();
            seconds = seconds.min(start.elapsed().as_secs_f64());
        }
        match report {
            Some(Report { model, num_inliers, iterations, score, .. }) => {
                let model = model.iter().map(|v| format!("{v:e}")).collect::<Vec<_>>().join(" ");
                println!("{seconds:e} {num_inliers} {iterations} {score:e} {model}");
            }
            None => println!("{seconds:e} none"),
        }
    }
    Ok(())
}
