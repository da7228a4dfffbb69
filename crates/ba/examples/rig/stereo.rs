//! A stereo rig's bundle adjustment in three files, as GTSAM has them: calibration (fx fy skew cx
//! cy baseline), one `world_from_left` a line (number, then 4 × 4 numbers), and observations
//! (moment, landmark, uL, uR, v, the point in the left camera); and true poses as KITTI has them, 3
//! × 4 numbers a line.

use std::collections::BTreeMap;

use tiepoint_ba::factors::RigReprojection;
use tiepoint_ba::nalgebra::{
    Matrix3, Matrix3x4, Rotation3, UnitQuaternion, Vector2, Vector3, Vector4,
};
use tiepoint_ba::{Error, Key, Loss, Order, Problem};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::cameras::Pinhole;

/// What was seen once of one landmark.
#[derive(Clone, Copy, Debug)]
struct Observation {
    moment: usize,
    landmark: usize,
    left: Vector2<f64>,
    right: Vector2<f64>,
    in_left: Vector3<f64>,
}

/// The contents of the three files.
#[derive(Clone, Debug)]
pub(crate) struct Stereo {
    lens: Vector4<f64>,
    baseline_m: f64,
    /// `world_from_left` of each moment.
    pub(crate) poses: Vec<Rigid3>,
    observations: Vec<Observation>,
}

fn numbers(line: &str) -> Result<Vec<f64>, String> {
    let number = |word: &str| word.parse().map_err(|_| format!("'{word}' is not a number"));
    line.split_ascii_whitespace().map(number).collect()
}

fn rows<const N: usize>(text: &str, what: &str) -> Result<Vec<[f64; N]>, String> {
    let lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let row = |(number, line)| {
        let row = numbers(line).map_err(|error| format!("{what}, line {number}: {error}"))?;
        let len = row.len();
        row.try_into().map_err(|_| format!("{what}, line {number}: {len} numbers instead of {N}"))
    };
    lines.map(row).collect()
}

fn rigid(numbers: &[f64]) -> Rigid3 {
    let matrix = Matrix3x4::from_row_slice(&numbers[..12]);
    let rotation = Rotation3::from_matrix(&matrix.fixed_view::<3, 3>(0, 0).into_owned());
    Rigid3 {
        rotation: UnitQuaternion::from_rotation_matrix(&rotation),
        translation: matrix.column(3).into(),
    }
}

/// True poses, `world_from_left`.
pub(crate) fn true_poses(text: &str) -> Result<Vec<Rigid3>, String> {
    Ok(rows::<12>(text, "true poses")?.iter().map(|row| rigid(row)).collect())
}

impl Stereo {
    /// Reads the files' texts.
    pub(crate) fn parse(
        calibration: &str,
        poses: &str,
        observations: &str,
    ) -> Result<Self, String> {
        let calibrations = rows::<6>(calibration, "calibration")?;
        let [fx, fy, _, cx, cy, baseline_m] =
            *calibrations.first().ok_or("the calibration is empty")?;
        let poses: Vec<_> =
            rows::<17>(poses, "poses")?.iter().map(|row| rigid(&row[1..])).collect();
        let observation = |row: &[f64; 8]| {
            let [moment, landmark, left, right, v, x, y, z] = *row;
            let (moment, landmark) = (moment as usize, landmark as usize);
            if moment >= poses.len() {
                return Err(format!("moment {moment} has no pose: there are {}", poses.len()));
            }
            Ok(Observation {
                moment,
                landmark,
                left: Vector2::new(left, v),
                right: Vector2::new(right, v),
                in_left: Vector3::new(x, y, z),
            })
        };
        let observations = rows::<8>(observations, "observations")?
            .iter()
            .map(observation)
            .collect::<Result<_, _>>()?;
        Ok(Self { lens: Vector4::new(fx, fy, cx, cy), baseline_m, poses, observations })
    }

    /// The problem: the rig, the first pose and both lenses are held, but of the right one, if it
    /// is so `right`, the principal point's column, which is what disparities are off by. Each
    /// landmark starts where its first observation has it.
    pub(crate) fn problem(&self, loss: Loss, right: Right) -> Result<Adjustment, Error> {
        let mut problem = Problem::new();
        let lenses = [0, 1].map(|_| problem.add_parameter(self.lens, Order::Shared));
        problem.fix(lenses[0]);
        match right {
            Right::Held => problem.fix(lenses[1]),
            Right::ColumnFree => problem.fix_dofs(lenses[1], &[0, 1, 3])?,
        }
        let cameras = [0.0, -self.baseline_m].map(|x| {
            let right = Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(x, 0.0, 0.0));
            problem.add_parameter(right, Order::Shared)
        });
        cameras.iter().for_each(|&camera| problem.fix(camera));
        let poses: Vec<_> = (0u32..)
            .zip(&self.poses)
            .map(|(moment, pose)| problem.add_parameter(pose.inverse(), Order::At(moment)))
            .collect();
        if let Some(&first) = poses.first() {
            problem.fix(first);
        }
        let mut points = BTreeMap::new();
        for seen in &self.observations {
            let point = *points
                .entry(seen.landmark)
                .or_insert_with(|| problem.add_landmark(self.poses[seen.moment] * seen.in_left));
            for (i, pixel) in [seen.left, seen.right].into_iter().enumerate() {
                let factor = RigReprojection::<Pinhole>::new(pixel, 1.0);
                problem.add((lenses[i], cameras[i], poses[seen.moment], point), factor, loss)?;
            }
        }
        Ok(Adjustment { problem, right_lens: lenses[1], poses, column: self.lens[2] })
    }
}

/// What is known of the right lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Right {
    Held,
    ColumnFree,
}

/// A problem with the names of what is to be found.
pub(crate) struct Adjustment {
    pub(crate) problem: Problem,
    right_lens: Key<Vector4<f64>>,
    poses: Vec<Key<Rigid3>>,
    column: f64,
}

impl Adjustment {
    /// `world_from_left` of each moment.
    pub(crate) fn poses(&self) -> Vec<Rigid3> {
        self.poses.iter().map(|&key| self.problem.get(key).inverse()).collect()
    }

    /// By how much the right principal point has moved.
    pub(crate) fn right_shift_px(&self) -> f64 {
        self.problem.get(self.right_lens)[2] - self.column
    }
}

/// How far poses are from the true ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Distance {
    /// Mean distance of positions as they are: both begin at the origin.
    pub(crate) as_they_are_m: f64,
    /// The same after the rotation and translation that brings them nearest.
    pub(crate) aligned_m: f64,
    /// Mean error of the position of one pose as seen from another that is so many moments before,
    /// which knows of no frame.
    pub(crate) ahead_m: f64,
    /// The same of rotations.
    pub(crate) turn_rad: f64,
}

pub(crate) fn distance(found: &[Rigid3], truth: &[Rigid3], apart: usize) -> Distance {
    let count = found.len().min(truth.len());
    let (found, truth) = (&found[..count], &truth[..count]);
    let mean = |poses: &[Rigid3]| {
        poses.iter().map(|pose| pose.translation).sum::<Vector3<f64>>() / count as f64
    };
    let (a, b) = (mean(found), mean(truth));
    let pairs = || found.iter().zip(truth).map(|(x, y)| (x.translation, y.translation));
    // Kabsch 1976: the rotation of the singular vectors of the correlation.
    let svd =
        pairs().map(|(x, y)| (y - b) * (x - a).transpose()).sum::<Matrix3<f64>>().svd(true, true);
    let rotation = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => {
            u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()))
                * v_t
        }
        _ => Matrix3::identity(),
    };
    let ahead = |poses: &[Rigid3], i: usize| poses[i].inverse() * poses[i + apart];
    let (mut ahead_m, mut turn_rad) = (0.0, 0.0);
    let steps = count.saturating_sub(apart);
    for i in 0..steps {
        let (found, truth) = (ahead(found, i), ahead(truth, i));
        ahead_m += (found.translation - truth.translation).norm() / steps as f64;
        turn_rad += found.rotation.angle_to(&truth.rotation) / steps as f64;
    }
    Distance {
        as_they_are_m: pairs().map(|(x, y)| (x - y).norm()).sum::<f64>() / count as f64,
        aligned_m: pairs().map(|(x, y)| (rotation * (x - a) - (y - b)).norm()).sum::<f64>()
            / count as f64,
        ahead_m,
        turn_rad,
    }
}
