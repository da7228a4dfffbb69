//! Trajectories: the formats of the TUM RGB-D, KITTI odometry and EuRoC benchmarks. All three hold
//! `world_from_cam`; readers and writers convert from and to `cam_from_world`.
//!
//! | format | a line |
//! |---|---|
//! | TUM | `seconds tx ty tz qx qy qz qw` |
//! | KITTI | 12 numbers: the rows of \[R \| t\] |
//! | EuRoC | `nanoseconds, tx, ty, tz, qw, qx, qy, qz`, and more columns |

use std::io::{self, Write};
use std::path::Path;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix3x4, Vector3};

use crate::atomic::write_atomic;
use crate::text::{Lines, Number, Numbers, Words};
use crate::{Result, rotation};

/// A pose with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// Time in seconds.
    pub time_s: f64,
    /// Transform from the world to the camera.
    pub cam_from_world: Rigid3,
}

/// Reads x y z.
fn vector(words: &mut Words<'_>) -> Result<Vector3<f64>> {
    Ok(Vector3::from(words.f64s::<3>("the position")?))
}

fn world_from_cam(words: &Words<'_>, translation: Vector3<f64>, wxyz: [f64; 4]) -> Result<Rigid3> {
    let rotation = rotation::from_wxyz(wxyz).map_err(|what| words.error(what))?;
    Ok(Rigid3::new(rotation, translation))
}

/// Reads a trajectory in the TUM format.
///
/// # Errors
///
/// If the file cannot be read, and if a line is not a pose in this format.
pub fn read_tum(path: &Path) -> Result<Vec<TimedPose>> {
    let mut lines = Lines::open(path)?;
    let mut poses = Vec::new();
    while let Some(mut words) = lines.next()? {
        let time_s = words.f64("the time")?;
        let translation = vector(&mut words)?;
        let [x, y, z, w] = words.f64s("the quaternion")?;
        words.end()?;
        let cam_from_world = world_from_cam(&words, translation, [w, x, y, z])?.inverse();
        poses.push(TimedPose { time_s, cam_from_world });
    }
    Ok(poses)
}

/// Writes a trajectory in the TUM format.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write_tum(path: &Path, poses: &[TimedPose]) -> Result<()> {
    write_atomic(path, |file| {
        writeln!(file, "# tiepoint: timestamp tx ty tz qx qy qz qw")?;
        poses.iter().try_for_each(|pose| {
            let Rigid3 { rotation: q, translation: t } = pose.cam_from_world.inverse();
            writeln!(
                file,
                "{} {}",
                Number(pose.time_s),
                Numbers(&[t.x, t.y, t.z, q.i, q.j, q.k, q.w])
            )
        })
    })
}

/// Reads a trajectory in the KITTI format: `cam_from_world` of each frame.
///
/// # Errors
///
/// If the file cannot be read, and if a line is not a pose in this format.
pub fn read_kitti(path: &Path) -> Result<Vec<Rigid3>> {
    let mut lines = Lines::open(path)?;
    let mut poses = Vec::new();
    while let Some(mut words) = lines.next()? {
        poses.push(matrix_pose(&mut words)?.inverse());
        words.end()?;
    }
    Ok(poses)
}

/// Reads the 12 numbers of a matrix \[R | t\], by rows.
pub(crate) fn matrix_pose(words: &mut Words<'_>) -> Result<Rigid3> {
    let matrix = Matrix3x4::from_row_slice(&words.f64s::<12>("a pose of 12 numbers")?);
    let rotation = rotation::from_matrix(&matrix.fixed_view::<3, 3>(0, 0).into_owned())
        .map_err(|what| words.error(what))?;
    Ok(Rigid3::new(rotation, matrix.column(3).into_owned()))
}

/// Writes a trajectory in the KITTI format.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write_kitti(path: &Path, cam_from_world: &[Rigid3]) -> Result<()> {
    write_atomic(path, |file| {
        cam_from_world.iter().try_for_each(|pose| {
            // Transposed, because nalgebra stores columns.
            writeln!(file, "{}", Numbers(pose.inverse().to_matrix().transpose().as_slice()))
        })
    })
}

/// Reads a trajectory in the EuRoC format.
///
/// # Errors
///
/// If the file cannot be read, and if a line is not a pose in this format.
pub fn read_euroc(path: &Path) -> Result<Vec<TimedPose>> {
    let mut lines = Lines::open(path)?;
    let mut poses = Vec::new();
    while let Some(mut line) = lines.next()? {
        let text = line.rest().replace(',', " ");
        let mut words = line.with_text(&text);
        let nanoseconds: i64 = words.number("the time in nanoseconds")?;
        let translation = vector(&mut words)?;
        let wxyz = words.f64s("the quaternion")?;
        let cam_from_world = world_from_cam(&words, translation, wxyz)?.inverse();
        let (whole, rest) = (nanoseconds.div_euclid(NS_PER_S), nanoseconds.rem_euclid(NS_PER_S));
        poses.push(TimedPose {
            time_s: whole as f64 + rest as f64 / NS_PER_S as f64,
            cam_from_world,
        });
    }
    Ok(poses)
}

/// Nanoseconds in a second.
const NS_PER_S: i64 = 1_000_000_000;

/// A time in nanoseconds; `None` if it is more than 292 years from its origin.
fn nanoseconds(time_s: f64) -> Option<i64> {
    // Whole seconds and the fraction separately: an f64 does not hold the nanoseconds since 1970.
    let whole = time_s.floor();
    let rest = ((time_s - whole) * NS_PER_S as f64).round() as i64;
    let fits = whole.abs() < (i64::MAX / NS_PER_S) as f64;
    fits.then(|| whole as i64 * NS_PER_S + rest)
}

/// Writes a trajectory in the EuRoC format.
///
/// # Errors
///
/// If the file cannot be written, and if a time is not finite or more than 292 years from its
/// origin.
pub fn write_euroc(path: &Path, poses: &[TimedPose]) -> Result<()> {
    write_atomic(path, |file| {
        writeln!(file, "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []")?;
        poses.iter().try_for_each(|pose| {
            let Rigid3 { rotation: q, translation: t } = pose.cam_from_world.inverse();
            let nanoseconds = nanoseconds(pose.time_s).ok_or_else(|| {
                let what =
                    format!("the time {} s cannot be written in nanoseconds", Number(pose.time_s));
                io::Error::new(io::ErrorKind::InvalidInput, what)
            })?;
            write!(file, "{nanoseconds}")?;
            [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
                .iter()
                .try_for_each(|value| write!(file, ",{}", Number(*value)))?;
            writeln!(file)
        })
    })
}
