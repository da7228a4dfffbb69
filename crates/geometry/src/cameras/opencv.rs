//! OpenCV's perspective camera with two radial and two tangential coefficients (Brown 1966): with
//! (u, v) = (x/z, y/z), r² = u² + v² and g = 1 + k₁ r² + k₂ r⁴, u' = g u + 2 p₁ u v + p₂ (r² +
//! 2u²), v' = g v + 2 p₂ u v + p₁ (r² + 2v²), pixel = (fx u' + cx, fy v' + cy).

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};

use super::model::{CameraModel, MIN_DEPTH, Projection, perspective_chain};
use super::undistort::undistort;

/// Two focal lengths and Brown's distortion: fx, fy, cx, cy, k1, k2, p1, p2.
#[derive(Clone, Copy, Debug, Default)]
pub struct Opencv;

/// The distorted point of the plane z = 1.
fn distort(params: &SVector<f64, 8>, uv: &Vector2<f64>) -> Vector2<f64> {
    let [k1, k2, p1, p2] = [params[4], params[5], params[6], params[7]];
    let (u, v) = (uv.x, uv.y);
    let r2 = u * u + v * v;
    let g = 1.0 + r2 * (k1 + r2 * k2);
    let cross = 2.0 * u * v;
    Vector2::new(
        g * u + p1 * cross + p2 * (r2 + 2.0 * u * u),
        g * v + p2 * cross + p1 * (r2 + 2.0 * v * v),
    )
}

/// The Jacobian of [`distort`] with respect to (u, v), which is symmetric.
fn d_distort(params: &SVector<f64, 8>, uv: &Vector2<f64>) -> Matrix2<f64> {
    let [k1, k2, p1, p2] = [params[4], params[5], params[6], params[7]];
    let (u, v) = (uv.x, uv.y);
    let r2 = u * u + v * v;
    let g = 1.0 + r2 * (k1 + r2 * k2);
    let dg = 2.0 * (k1 + 2.0 * k2 * r2);
    let off_diagonal = dg * u * v + 2.0 * (p1 * u + p2 * v);
    Matrix2::new(
        g + dg * u * u + 2.0 * p1 * v + 6.0 * p2 * u,
        off_diagonal,
        off_diagonal,
        g + dg * v * v + 2.0 * p2 * u + 6.0 * p1 * v,
    )
}

impl CameraModel for Opencv {
    type Params = SVector<f64, 8>;
    const NAME: &'static str = "OPENCV";
    const COLMAP_ID: i32 = 4;
    const PARAM_NAMES: &'static [&'static str] = &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point_in_cam.z < MIN_DEPTH {
            return None;
        }
        let distorted = distort(params, &(point_in_cam.xy() / point_in_cam.z));
        Some(Vector2::new(params[0] * distorted.x + params[2], params[1] * distorted.y + params[3]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        if point_in_cam.z < MIN_DEPTH {
            return None;
        }
        let [fx, fy, cx, cy] = [params[0], params[1], params[2], params[3]];
        let inv_z = 1.0 / point_in_cam.z;
        let uv = point_in_cam.xy() * inv_z;
        let distorted = distort(params, &uv);
        let focal = Matrix2::new(fx, 0.0, 0.0, fy);
        let (u, v) = (uv.x, uv.y);
        let r2 = u * u + v * v;
        let cross = 2.0 * u * v;
        #[rustfmt::skip]
        let d_params = SMatrix::<f64, 2, 8>::from_row_slice(&[
            distorted.x, 0.0, 1.0, 0.0, fx * u * r2, fx * u * r2 * r2,
            fx * cross, fx * (r2 + 2.0 * u * u),
            0.0, distorted.y, 0.0, 1.0, fy * v * r2, fy * v * r2 * r2,
            fy * (r2 + 2.0 * v * v), fy * cross,
        ]);
        Some(Projection {
            pixel: Vector2::new(fx * distorted.x + cx, fy * distorted.y + cy),
            d_point: perspective_chain(&(focal * d_distort(params, &uv)), &uv, inv_z),
            d_params,
        })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let distorted =
            Vector2::new((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1]);
        let uv = undistort(distorted, |uv| (distort(params, uv), d_distort(params, uv)))?;
        Some(uv.push(1.0).normalize())
    }
}
