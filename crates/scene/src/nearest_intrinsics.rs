//! The closest intrinsics of another camera model.

use tiepoint_geometry::nalgebra::{DMatrix, DVector, Vector2, Vector3};
use tiepoint_geometry::{CameraModel, CameraModelKind, Intrinsics, with_camera_model};

/// Number of pixels in a row and in a column whose rays are projected.
const GRID: usize = 20;
/// Gauss-Newton steps. Polynomial models are linear in their distortion: one step is exact.
const STEPS: usize = 5;

/// The intrinsics of another camera model with the same focal length and principal point that
/// project the rays of a `width` × `height` image closest to their pixels, in the least-squares
/// sense. Prism parameters, which act like a rotation, are zero. `None` if hardly any pixel has a
/// ray.
pub fn nearest_intrinsics(
    from: &Intrinsics,
    kind: CameraModelKind,
    width: u32,
    height: u32,
) -> Option<Intrinsics> {
    let mut found = Intrinsics::centred(kind, from.mean_focal_px(), width, height);
    if let &[x, y] = kind.focal_indices() {
        let focal_px = from.focal_lengths_px();
        (found.params_mut()[x], found.params_mut()[y]) = (focal_px[0], focal_px[1]);
    }
    for (&index, value) in kind.principal_point_indices().iter().zip(&from.principal_point()) {
        found.params_mut()[index] = *value;
    }
    let free = kind.distortion_indices();
    let at = |index: usize, size: u32| (index as f64 + 0.5) / GRID as f64 * f64::from(size);
    let pixels = (0..GRID * GRID).map(|i| Vector2::new(at(i % GRID, width), at(i / GRID, height)));
    let rays: Vec<_> = pixels.filter_map(|pixel| Some((pixel, from.unproject(&pixel)?))).collect();
    if rays.len() < GRID {
        return None;
    }
    for _ in 0..STEPS {
        let mut normal = DMatrix::zeros(free.len(), free.len());
        let mut right = DVector::zeros(free.len());
        for (pixel, ray) in &rays {
            let Some((off, jacobian)) = linearise(&found, pixel, ray, &free) else { continue };
            normal += jacobian.transpose() * &jacobian;
            right += jacobian.transpose() * off;
        }
        let step = normal.cholesky()?.solve(&right);
        for (&index, step) in free.iter().zip(step.iter()) {
            found.params_mut()[index] += step;
        }
    }
    found.params().iter().all(|value| value.is_finite()).then_some(found)
}

/// What a projection is off by, and its derivatives with respect to some parameters.
fn linearise(
    intrinsics: &Intrinsics,
    pixel: &Vector2<f64>,
    ray: &Vector3<f64>,
    free: &[usize],
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    with_camera_model!(intrinsics, M, params => {
        let projection = M::project_with_jacobian(params, ray)?;
        let d_params = projection.d_params.as_slice();
        let jacobian =
            DMatrix::from_fn(2, free.len(), |row, column| d_params[2 * free[column] + row]);
        let off = pixel - projection.pixel;
        Some((DVector::from_column_slice(off.as_slice()), jacobian))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest distance in pixels, and relative error of exact parameters.
    const MAX_DISTANCE_PX: f64 = 0.1;
    const TOLERANCE: f64 = 1e-9;

    #[test]
    fn a_model_that_has_the_lens_has_its_parameters() {
        let simple = [500.0, 322.0, 236.0, -0.1];
        let simple = Intrinsics::new(CameraModelKind::SimpleRadial, &simple).unwrap();
        for (kind, expected) in [
            (CameraModelKind::SimpleRadial, &[500.0, 322.0, 236.0, -0.1][..]),
            (CameraModelKind::Radial, &[500.0, 322.0, 236.0, -0.1, 0.0]),
            (CameraModelKind::Opencv, &[500.0, 500.0, 322.0, 236.0, -0.1, 0.0, 0.0, 0.0]),
        ] {
            let found = nearest_intrinsics(&simple, kind, 640, 480).expect("pixels have rays");
            for (found, expected) in found.params().iter().zip(expected) {
                assert!((found - expected).abs() < TOLERANCE * expected.abs().max(1.0));
            }
        }
    }

    #[test]
    fn a_fisheye_is_near_a_perspective_lens() {
        let simple = [500.0, 322.0, 236.0, -0.1];
        let simple = Intrinsics::new(CameraModelKind::SimpleRadial, &simple).unwrap();
        let found = nearest_intrinsics(&simple, CameraModelKind::OpencvFisheye, 640, 480);
        let found = found.expect("pixels have rays");
        for pixel in [[0.0, 0.0], [640.0, 0.0], [10.0, 470.0], [320.0, 240.0], [400.0, 100.0]] {
            let pixel = Vector2::from(pixel);
            let ray = simple.unproject(&pixel).expect("a mild distortion");
            let distance_px = (found.project(&ray).expect("a ray ahead") - pixel).norm();
            assert!(distance_px < MAX_DISTANCE_PX, "{distance_px} px at {pixel:?}");
        }
    }

    #[test]
    fn a_lens_without_rays_has_none() {
        // The radial distortion folds all pixels but those of the centre.
        let folded = [500.0, 320.0, 240.0, -1e6];
        let folded = Intrinsics::new(CameraModelKind::SimpleRadial, &folded).unwrap();
        assert_eq!(nearest_intrinsics(&folded, CameraModelKind::Radial, 640, 480), None);
    }
}
