//! A stereo bundle adjustment in three files, in the format of GTSAM's data: calibration (fx fy
//! skew cx cy baseline); one `world_from_left` per line (number, then 4 × 4 numbers); observations
//! (frame, landmark, uL, uR, v, the point in the left camera frame). Ground truth is in KITTI's
//! format, 3 × 4 numbers per line.

use std::collections::BTreeMap;

use tiepoint_ba::factors::RigReprojection;
use tiepoint_ba::nalgebra::{
    Matrix3, Matrix3x4, Rotation3, UnitQuaternion, Vector2, Vector3, Vector4,
};
use tiepoint_ba::{EliminationOrder, Error, Key, Loss, Problem};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::cameras::Pinhole;

/// Observation of a landmark in both images of a frame.
#[derive(Clone, Copy, Debug)]
struct Observation {
    frame: usize,
    landmark: usize,
    left: Vector2<f64>,
    right: Vector2<f64>,
    in_left: Vector3<f64>,
}

/// Contents of the three files.
#[derive(Clone, Debug)]
pub(crate) struct StereoData {
    intrinsics: Vector4<f64>,
    baseline_m: f64,
    /// `world_from_left` of each frame.
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

/// Parses true poses, `world_from_left`.
pub(crate) fn true_poses(text: &str) -> Result<Vec<Rigid3>, String> {
    Ok(rows::<12>(text, "true poses")?.iter().map(|row| rigid(row)).collect())
}

impl StereoData {
    /// Parses the files.
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
            let [frame, landmark, left, right, v, x, y, z] = *row;
            let (frame, landmark) = (frame as usize, landmark as usize);
            if frame >= poses.len() {
                return Err(format!("frame {frame} has no pose: there are {}", poses.len()));
            }
            Ok(Observation {
                frame,
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
        Ok(Self { intrinsics: Vector4::new(fx, fy, cx, cy), baseline_m, poses, observations })
    }

    /// Builds the problem. Rig extrinsics, the first pose and intrinsics are fixed; the x
    /// coordinate of the right principal point, which shifts all disparities, may be free.
    /// Landmarks start at the position of their first observation.
    pub(crate) fn problem(&self, loss: Loss, right: RightIntrinsics) -> Result<Adjustment, Error> {
        let mut problem = Problem::new();
        let intrinsics =
            [0, 1].map(|_| problem.add_parameter(self.intrinsics, EliminationOrder::Last));
        problem.fix(intrinsics[0]);
        match right {
            RightIntrinsics::Fixed => problem.fix(intrinsics[1]),
            RightIntrinsics::PrincipalPointFree => problem.fix_dofs(intrinsics[1], &[0, 1, 3])?,
        }
        let cameras = [0.0, -self.baseline_m].map(|x| {
            let right = Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(x, 0.0, 0.0));
            problem.add_parameter(right, EliminationOrder::Last)
        });
        cameras.iter().for_each(|&camera| problem.fix(camera));
        let poses: Vec<_> = (0u32..)
            .zip(&self.poses)
            .map(|(frame, pose)| problem.add_parameter(pose.inverse(), EliminationOrder::At(frame)))
            .collect();
        if let Some(&first) = poses.first() {
            problem.fix(first);
        }
        let mut points = BTreeMap::new();
        for seen in &self.observations {
            let point = *points
                .entry(seen.landmark)
                .or_insert_with(|| problem.add_landmark(self.poses[seen.frame] * seen.in_left));
            for (i, pixel) in [seen.left, seen.right].into_iter().enumerate() {
                let factor = RigReprojection::<Pinhole>::new(pixel, 1.0);
                problem.add((intrinsics[i], cameras[i], poses[seen.frame], point), factor, loss)?;
            }
        }
        Ok(Adjustment {
            problem,
            right_intrinsics: intrinsics[1],
            poses,
            initial_cx: self.intrinsics[2],
        })
    }
}

/// Treatment of the right intrinsics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum RightIntrinsics {
    Fixed,
    PrincipalPointFree,
}

/// A problem and the keys of its unknowns.
pub(crate) struct Adjustment {
    pub(crate) problem: Problem,
    right_intrinsics: Key<Vector4<f64>>,
    poses: Vec<Key<Rigid3>>,
    initial_cx: f64,
}

impl Adjustment {
    /// `world_from_left` of each frame.
    pub(crate) fn poses(&self) -> Vec<Rigid3> {
        self.poses.iter().map(|&key| self.problem.get(key).inverse()).collect()
    }

    /// Estimated shift of the right principal point.
    pub(crate) fn right_shift_px(&self) -> f64 {
        self.problem.get(self.right_intrinsics)[2] - self.initial_cx
    }
}

/// Errors of poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PoseErrors {
    /// Mean position error without alignment: both trajectories start at the origin.
    pub(crate) unaligned_m: f64,
    /// Mean position error after rigid alignment.
    pub(crate) aligned_m: f64,
    /// Mean translation error of the relative pose of two frames, which is independent of the
    /// alignment.
    pub(crate) relative_m: f64,
    /// Mean rotation error of the same relative poses.
    pub(crate) rotation_rad: f64,
}

pub(crate) fn pose_errors(found: &[Rigid3], truth: &[Rigid3], frames_apart: usize) -> PoseErrors {
    let count = found.len().min(truth.len());
    let (found, truth) = (&found[..count], &truth[..count]);
    let mean = |poses: &[Rigid3]| {
        poses.iter().map(|pose| pose.translation).sum::<Vector3<f64>>() / count as f64
    };
    let (a, b) = (mean(found), mean(truth));
    let pairs = || found.iter().zip(truth).map(|(x, y)| (x.translation, y.translation));
    // Rigid alignment by SVD of the correlation (Kabsch 1976).
    let svd =
        pairs().map(|(x, y)| (y - b) * (x - a).transpose()).sum::<Matrix3<f64>>().svd(true, true);
    let rotation = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => {
            u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()))
                * v_t
        }
        _ => Matrix3::identity(),
    };
    let relative = |poses: &[Rigid3], i: usize| poses[i].inverse() * poses[i + frames_apart];
    let (mut relative_m, mut rotation_rad) = (0.0, 0.0);
    let steps = count.saturating_sub(frames_apart);
    for i in 0..steps {
        let (found, truth) = (relative(found, i), relative(truth, i));
        relative_m += (found.translation - truth.translation).norm() / steps as f64;
        rotation_rad += found.rotation.angle_to(&truth.rotation) / steps as f64;
    }
    PoseErrors {
        unaligned_m: pairs().map(|(x, y)| (x - y).norm()).sum::<f64>() / count as f64,
        aligned_m: pairs().map(|(x, y)| (rotation * (x - a) - (y - b)).norm()).sum::<f64>()
            / count as f64,
        relative_m,
        rotation_rad,
    }
}
