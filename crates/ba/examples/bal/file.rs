//! Problem files of "Bundle adjustment in the large": counts, then observations (camera, point, x,
//! y), then for each camera the rotation vector, the translation and f, k₁, k₂, then the points.

use std::fmt::Write;
use std::str::FromStr;

use tiepoint_ba::autodiff::AutoDiff;
use tiepoint_ba::nalgebra::{Vector2, Vector3};
use tiepoint_ba::{EliminationOrder, Key, Loss, Problem};
use tiepoint_geometry::{Rigid3, so3};

use crate::snavely::{Snavely, SnavelyResidual};

/// An observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Observation {
    pub(crate) camera: usize,
    pub(crate) point: usize,
    pub(crate) pixel: Vector2<f64>,
}

/// Contents of a file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Bal {
    pub(crate) observations: Vec<Observation>,
    pub(crate) poses: Vec<Rigid3>,
    /// f, k₁, k₂ of each camera.
    pub(crate) intrinsics: Vec<Vector3<f64>>,
    pub(crate) points: Vec<Vector3<f64>>,
}

/// Method of differentiation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Derivatives {
    ByHand,
    ByDualNumbers,
}

/// Keys of the variables of a [`Bal`] in a [`Problem`].
pub(crate) struct Keys {
    cameras: Vec<(Key<Rigid3>, Key<Vector3<f64>>)>,
    points: Vec<Key<Vector3<f64>>>,
}

impl Bal {
    /// Parses a file.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let mut words = text.split_ascii_whitespace();
        fn next<'a, T: FromStr>(
            words: &mut impl Iterator<Item = &'a str>,
            what: &str,
        ) -> Result<T, String> {
            let word =
                words.next().ok_or_else(|| format!("the file ends where {what} should be"))?;
            word.parse().map_err(|_| format!("{what}: '{word}' is not a number"))
        }
        let [num_cameras, num_points, num_observations] = [
            next::<usize>(&mut words, "the number of cameras")?,
            next(&mut words, "the number of points")?,
            next(&mut words, "the number of observations")?,
        ];
        let mut observations = Vec::new();
        for _ in 0..num_observations {
            let (camera, point) = (next(&mut words, "a camera")?, next(&mut words, "a point")?);
            if camera >= num_cameras || point >= num_points {
                return Err(format!(
                    "camera {camera} of {num_cameras} sees point {point} of {num_points}"
                ));
            }
            let pixel = Vector2::new(next(&mut words, "x")?, next(&mut words, "y")?);
            observations.push(Observation { camera, point, pixel });
        }
        let mut vector = |what| -> Result<Vector3<f64>, String> {
            Ok(Vector3::new(
                next(&mut words, what)?,
                next(&mut words, what)?,
                next(&mut words, what)?,
            ))
        };
        let (mut poses, mut intrinsics, mut points) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..num_cameras {
            poses.push(Rigid3::from_axis_angle(vector("a rotation")?, vector("a translation")?));
            intrinsics.push(vector("f, k1, k2")?);
        }
        for _ in 0..num_points {
            points.push(vector("a point")?);
        }
        if let Some(word) = words.next() {
            return Err(format!("'{word}' follows the last of {num_points} points"));
        }
        Ok(Self { observations, poses, intrinsics, points })
    }

    /// Formats a file.
    pub(crate) fn to_text(&self) -> String {
        let counts = [self.poses.len(), self.points.len(), self.observations.len()]
            .map(|count| count.to_string());
        let mut text = counts.join(" ") + "\n";
        // Writing to a string cannot fail.
        for Observation { camera, point, pixel } in &self.observations {
            let _ = writeln!(text, "{camera} {point} {:e} {:e}", pixel.x, pixel.y);
        }
        let cameras = self.poses.iter().zip(&self.intrinsics);
        let parameters = cameras.flat_map(|(pose, intrinsics)| {
            [so3::log(&pose.rotation), pose.translation, *intrinsics]
        });
        for number in parameters.chain(self.points.iter().copied()).flat_map(<[f64; 3]>::from) {
            let _ = writeln!(text, "{number:e}");
        }
        text
    }

    /// Builds the problem with cameras kept and points eliminated.
    pub(crate) fn problem(
        &self,
        derivatives: Derivatives,
    ) -> Result<(Problem, Keys), tiepoint_ba::Error> {
        let mut problem = Problem::new();
        let cameras: Vec<_> = (0u32..)
            .zip(self.poses.iter().zip(&self.intrinsics))
            .map(|(i, (pose, intrinsics))| {
                (
                    problem.add_parameter(*pose, EliminationOrder::At(i)),
                    problem.add_parameter(*intrinsics, EliminationOrder::At(i)),
                )
            })
            .collect();
        let points: Vec<_> = self.points.iter().map(|point| problem.add_landmark(*point)).collect();
        for Observation { camera, point, pixel } in &self.observations {
            let (pose, intrinsics) = cameras[*camera];
            let (keys, factor) = ((pose, intrinsics, points[*point]), Snavely { pixel: *pixel });
            match derivatives {
                Derivatives::ByHand => {
                    problem.add(keys, factor, Loss::Trivial)?;
                }
                Derivatives::ByDualNumbers => {
                    problem.add(keys, AutoDiff(SnavelyResidual(factor)), Loss::Trivial)?;
                }
            }
        }
        Ok((problem, Keys { cameras, points }))
    }

    /// Copies the solution from `problem`.
    pub(crate) fn update(&mut self, problem: &Problem, keys: &Keys) {
        self.poses = keys.cameras.iter().map(|camera| problem.get(camera.0)).collect();
        self.intrinsics = keys.cameras.iter().map(|camera| problem.get(camera.1)).collect();
        self.points = keys.points.iter().map(|point| problem.get(*point)).collect();
    }
}
