//! Reprojection error with a lens field: the smooth static displacement of pixels that a lens model
//! leaves.

use nalgebra::{SMatrix, SVector, Vector2, Vector3};
use tiepoint_geometry::{CameraModel, Rigid3};

use super::reprojection::Reprojection;
use crate::factor::{Factor, Linear, Refs};

/// Basis functions along x and y: uniform cubic B-splines on the image.
const NODES: [usize; 2] = [8, 4];
const COEFFICIENTS: usize = 2 * NODES[0] * NODES[1];

/// Coefficients of a lens field in pixels: the displacements along x of 8 x 4 uniform cubic
/// B-splines on the image, row by row, then those along y. Equal coefficients are a shift.
pub type LensField = SVector<f64, COEFFICIENTS>;

/// Reprojection error with a lens field, which displaces projections. Variables: camera parameters,
/// `cam_from_world`, coefficients, `point_in_world`. The field is taken at the measured pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldReprojection<M> {
    without: Reprojection<M>,
    /// First basis function along x and y that is not zero at the pixel, and the four values.
    first: [usize; 2],
    values: [[f64; 4]; 2],
}

impl<M: CameraModel> FieldReprojection<M> {
    /// An observation at `pixel` of an image of `size` pixels.
    pub fn new(pixel: Vector2<f64>, sigma_px: f64, size: [u32; 2]) -> Self {
        let (mut first, mut values) = ([0; 2], [[0.0; 4]; 2]);
        for axis in 0..2 {
            let intervals = (NODES[axis] - 3) as f64;
            let at = (pixel[axis] / f64::from(size[axis])).clamp(0.0, 1.0) * intervals;
            let interval = at.floor().min(intervals - 1.0);
            first[axis] = interval as usize;
            values[axis] = cubic_b_splines(at - interval);
        }
        Self { without: Reprojection::new(pixel, sigma_px), first, values }
    }

    /// Derivative of the residual with respect to the coefficients.
    fn d_field(&self) -> SMatrix<f64, 2, COEFFICIENTS> {
        let mut d_field = SMatrix::zeros();
        for (j, along_y) in self.values[1].iter().enumerate() {
            for (i, along_x) in self.values[0].iter().enumerate() {
                let node = (self.first[1] + j) * NODES[0] + self.first[0] + i;
                let value = along_x * along_y / self.without.sigma_px;
                d_field[(0, node)] = value;
                d_field[(1, COEFFICIENTS / 2 + node)] = value;
            }
        }
        d_field
    }
}

impl<M: CameraModel> Factor<2> for FieldReprojection<M> {
    type Vars = (M::Params, Rigid3, LensField, Vector3<f64>);

    fn linearize(
        &self,
        (params, cam_from_world, field, point): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 2>> {
        let (residual, (d_params, d_pose, d_point)) =
            self.without.linearize((params, cam_from_world, point))?;
        let d_field = self.d_field();
        Some((residual + d_field * field, (d_params, d_pose, d_field, d_point)))
    }
}

/// The four uniform cubic B-splines of an interval, at 0 to 1 of it.
fn cubic_b_splines(at: f64) -> [f64; 4] {
    let (rest, square, cube) = (1.0 - at, at * at, at * at * at);
    [
        rest.powi(3),
        3.0 * cube - 6.0 * square + 4.0,
        -3.0 * cube + 3.0 * square + 3.0 * at + 1.0,
        cube,
    ]
    .map(|value| value / 6.0)
}
