//! Poses in order of time: the formats of the TUM RGB-D, KITTI odometry and EuRoC benchmarks. All
//! three hold `world_from_cam`; it is turned round at this border.
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

use crate::text::{Lines, Number, Numbers, Words};
use crate::{AtomicFile, Result, rotation};

/// A pose and when it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// In seconds.
    pub time_s: f64,
    /// The pose.
    pub cam_from_world: Rigid3,
}

/// x y z.
fn vector(words: &mut Words<'_>) -> Result<Vector3<f64>> {
    Ok(Vector3::from(words.f64s::<3>("the position")?))
}

fn world_from_cam(words: &Words<'_>, translation: Vector3<f64>, wxyz: [f64; 4]) -> Result<Rigid3> {
    let rotation = rotation::from_wxyz(wxyz).map_err(|what| words.error(what))?;
    Ok(Rigid3::new(rotation, translation))
}

/// Reads a trajectory in the TUM format.
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
pub fn write_tum(path: &Path, poses: &[TimedPose]) -> Result<()> {
    AtomicFile::write_with(path, |file| {
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
pub fn read_kitti(path: &Path) -> Result<Vec<Rigid3>> {
    let mut lines = Lines::open(path)?;
    let mut poses = Vec::new();
    while let Some(mut words) = lines.next()? {
        poses.push(matrix_pose(&mut words)?.inverse());
        words.end()?;
    }
    Ok(poses)
}

/// The rows of [R | t].
pub(crate) fn matrix_pose(words: &mut Words<'_>) -> Result<Rigid3> {
    let matrix = Matrix3x4::from_row_slice(&words.f64s::<12>("a pose of 12 numbers")?);
    let rotation = rotation::from_matrix(&matrix.fixed_view::<3, 3>(0, 0).into_owned())
        .map_err(|what| words.error(what))?;
    Ok(Rigid3::new(rotation, matrix.column(3).into_owned()))
}

/// Writes a trajectory in the KITTI format.
pub fn write_kitti(path: &Path, cam_from_world: &[Rigid3]) -> Result<()> {
    AtomicFile::write_with(path, |file| {
        cam_from_world.iter().try_for_each(|pose| {
            // Transposed, since memory is column by column.
            writeln!(file, "{}", Numbers(pose.inverse().to_matrix().transpose().as_slice()))
        })
    })
}

/// Reads a trajectory in the EuRoC format.
pub fn read_euroc(path: &Path) -> Result<Vec<TimedPose>> {
    let mut lines = Lines::open(path)?;
    let mut poses = Vec::new();
    while let Some(mut line) = lines.next()? {
        let text = line.rest().replace(',', " ");
        let mut words = line.again(&text);
        let nanoseconds: i64 = words.number("the time in nanoseconds")?;
        let translation = vector(&mut words)?;
        let wxyz = words.f64s("the quaternion")?;
        let cam_from_world = world_from_cam(&words, translation, wxyz)?.inverse();
        let (whole, rest) = (nanoseconds.div_euclid(GIGA), nanoseconds.rem_euclid(GIGA));
        poses.push(TimedPose { time_s: whole as f64 + rest as f64 / GIGA as f64, cam_from_world });
    }
    Ok(poses)
}

/// Nanoseconds in a second.
const GIGA: i64 = 1_000_000_000;

/// A time as EuRoC has it, where it fits: within 292 years of its origin.
fn nanoseconds(time_s: f64) -> Option<i64> {
    // Whole seconds apart from the rest: nanoseconds since 1970 do not fit an f64.
    let whole = time_s.floor();
    let rest = ((time_s - whole) * GIGA as f64).round() as i64;
    let fits = whole.abs() < (i64::MAX / GIGA) as f64;
    fits.then(|| whole as i64 * GIGA + rest)
}

/// Writes a trajectory in the EuRoC format.
///
/// # Errors
///
/// The file cannot be written, or a time is not finite or farther than 292 years from its origin.
pub fn write_euroc(path: &Path, poses: &[TimedPose]) -> Result<()> {
    AtomicFile::write_with(path, |file| {
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
