//! Two-view geometry: essential and fundamental matrices, calibrated homographies, and their
//! decomposition into relative poses. Conventions: y₂ᵀ E y₁ = 0, x₂ᵀ F x₁ = 0, x₂ ~ H x₁; see
//! CONVENTIONS.md.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};

use crate::{Rigid3, so3};

/// The essential matrix E = \[t\]ₓ R.
pub fn essential_from_pose(cam2_from_cam1: &Rigid3) -> Matrix3<f64> {
    so3::hat(&cam2_from_cam1.translation) * cam2_from_cam1.rotation.to_rotation_matrix().matrix()
}

/// The fundamental matrix F = K₂⁻ᵀ E K₁⁻¹; `None` if a calibration matrix is singular.
pub fn fundamental_from_essential(
    essential: &Matrix3<f64>,
    k1: &Matrix3<f64>,
    k2: &Matrix3<f64>,
) -> Option<Matrix3<f64>> {
    Some(k2.try_inverse()?.transpose() * essential * k1.try_inverse()?)
}

/// The epipoles in the first and second image, where F e₁ = 0 and Fᵀ e₂ = 0; `None` if one is at
/// infinity.
pub fn epipoles(fundamental: &Matrix3<f64>) -> Option<[Vector2<f64>; 2]> {
    let svd = fundamental.svd(true, true);
    let last = svd.singular_values.imin();
    let first = svd.v_t?.row(last).transpose();
    let second = svd.u?.column(last).into_owned();
    let pixel = |point: Vector3<f64>| {
        let pixel = point.xy() / point.z;
        pixel.iter().all(|value| value.is_finite()).then_some(pixel)
    };
    Some([pixel(first)?, pixel(second)?])
}

/// The matrix E = K₂ᵀ F K₁. Its two largest singular values are not made equal.
pub fn essential_from_fundamental(
    fundamental: &Matrix3<f64>,
    k1: &Matrix3<f64>,
    k2: &Matrix3<f64>,
) -> Matrix3<f64> {
    k2.transpose() * fundamental * k1
}

/// The squared Sampson error of a correspondence: to first order the sum, over both images, of the
/// squared distances to the nearest pair with x₂ᵀ F x₁ = 0 (Hartley and Zisserman 2004,
/// equation 11.9). Its unit is the squared unit of the points.
pub fn squared_sampson_error(
    fundamental: &Matrix3<f64>,
    x1: &Vector2<f64>,
    x2: &Vector2<f64>,
) -> f64 {
    let (x1, x2) = (x1.push(1.0), x2.push(1.0));
    let (line2, line1) = (fundamental * x1, fundamental.tr_mul(&x2));
    let product = x2.dot(&line2);
    product * product / (line1.xy().norm_squared() + line2.xy().norm_squared())
}

/// The four poses `cam2_from_cam1`, with translations of length one, of the essential matrix that
/// is nearest to `essential`; `None` if the rank of `essential` is below two.
pub fn decompose_essential(essential: &Matrix3<f64>) -> Option<[Rigid3; 4]> {
    let svd = essential.try_svd(true, true, f64::EPSILON, 0)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let weakest = svd.singular_values.imin();
    if svd.singular_values.iter().filter(|s| **s > f64::EPSILON * svd.singular_values.max()).count()
        < 2
    {
        return None;
    }
    let mut singular = Vector3::repeat(1.0);
    singular[weakest] = 0.0;
    Some(poses_of_exact_essential(&(u * Matrix3::from_diagonal(&singular) * v_t)))
}

/// The four poses of an exact essential matrix of norm √2, without a singular value decomposition
/// (Horn 1990, "Recovering baseline and orientation from essential matrix"): with E = \[t\]ₓR and
/// |t| = 1, the cofactor matrix of E is ttᵀR and \[t\]ₓE = (ttᵀ − I) R, so R = cof(E) − \[t\]ₓE.
pub(crate) fn poses_of_exact_essential(essential: &Matrix3<f64>) -> [Rigid3; 4] {
    let columns = [essential.column(0), essential.column(1), essential.column(2)];
    let cofactors = [
        columns[1].cross(&columns[2]),
        columns[2].cross(&columns[0]),
        columns[0].cross(&columns[1]),
    ];
    // Each cofactor column is t times an entry of tᵀR.
    let t = cofactors.iter().fold(Vector3::zeros(), |best: Vector3<f64>, c| {
        if c.norm_squared() > best.norm_squared() { *c } else { best }
    });
    let t = t.normalize();
    let cofactors = Matrix3::from_columns(&cofactors);
    let product = so3::hat(&t) * essential;
    let rotation = |m: Matrix3<f64>| {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m))
    };
    let (r1, r2) = (rotation(cofactors - product), rotation(cofactors + product));
    [Rigid3::new(r1, t), Rigid3::new(r1, -t), Rigid3::new(r2, t), Rigid3::new(r2, -t)]
}

/// The cheirality constraint: whether both depths are positive where the two rays are nearest to
/// each other. `ray1` is in camera 1 and `ray2` in camera 2, both of any length.
pub fn rays_meet_in_front(
    ray1: &Vector3<f64>,
    ray2: &Vector3<f64>,
    cam2_from_cam1: &Rigid3,
) -> bool {
    // Minimise |λ₁ R y₁ + t − λ₂ y₂|²; both depths times the positive |y₁|²|y₂|² − (R y₁·y₂)².
    let rotated = cam2_from_cam1.rotation * ray1;
    let t = &cam2_from_cam1.translation;
    let (cosine, along1, along2) = (rotated.dot(ray2), rotated.dot(t), ray2.dot(t));
    cosine * along2 > along1 * ray2.norm_squared()
        && along2 * rotated.norm_squared() > cosine * along1
}

/// The pose `cam2_from_cam1` of an essential matrix that has the most points in front of both
/// cameras, and the number of these points. `rays1[i]` and `rays2[i]` are corresponding rays in
/// their cameras. `None` if the rank of `essential` is below two.
pub fn pose_from_essential(
    essential: &Matrix3<f64>,
    rays1: &[Vector3<f64>],
    rays2: &[Vector3<f64>],
) -> Option<(Rigid3, usize)> {
    let num_in_front = |pose: &Rigid3| {
        rays1.iter().zip(rays2).filter(|(ray1, ray2)| rays_meet_in_front(ray1, ray2, pose)).count()
    };
    let poses = decompose_essential(essential)?;
    // The first of poses with equal counts, so that the result is deterministic.
    poses
        .iter()
        .map(|pose| (*pose, num_in_front(pose)))
        .reduce(|best, next| if next.1 > best.1 { next } else { best })
}

/// A relative pose and a plane: the decomposition of a homography.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneMotion {
    /// The relative pose. Its translation is in units of the distance of camera 1 to the plane.
    pub cam2_from_cam1: Rigid3,
    /// Unit normal of the plane in camera 1, pointing away from the camera: n·X = 1 for points X of
    /// the plane, in units of the distance to the plane.
    pub normal_in_cam1: Vector3<f64>,
}

/// Squared singular values that differ by less than this, relative to the middle one, count as
/// equal.
const EQUAL_SINGULAR_VALUES: f64 = 1e-9;

/// Decomposes a calibrated homography H ~ R + t nᵀ (Ma, Soatto, Košecká, Sastry 2004, "An
/// invitation to 3-D vision", section 5.3.3). There are four solutions, of which two have any given
/// point behind the camera. A pure rotation gives one solution with zero translation.
pub fn decompose_homography(homography: &Matrix3<f64>) -> ArrayVec<PlaneMotion, 4> {
    let mut motions = ArrayVec::new();
    let determinant = homography.determinant();
    let Some(svd) = homography.try_svd(false, true, f64::EPSILON, 0) else { return motions };
    let Some(v_t) = svd.v_t else { return motions };
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| svd.singular_values[j].total_cmp(&svd.singular_values[i]));
    let middle = svd.singular_values[order[1]];
    // Scale: the middle singular value is one. Sign: depths stay positive.
    let h = homography / middle.copysign(determinant);
    if !h.iter().all(|v| v.is_finite()) {
        return motions;
    }
    let [s1, s3] = [order[0], order[2]].map(|i| (svd.singular_values[i] / middle).powi(2));
    let [v1, v2, v3] = order.map(|i| v_t.row(i).transpose());
    if s1 - s3 < EQUAL_SINGULAR_VALUES {
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&h));
        let cam2_from_cam1 = Rigid3::new(rotation, Vector3::zeros());
        motions.push(PlaneMotion { cam2_from_cam1, normal_in_cam1: Vector3::z() });
        return motions;
    }
    // H preserves the length of the vectors in the plane of v₂ and u.
    let (a, b) = ((1.0 - s3).max(0.0).sqrt(), (s1 - 1.0).max(0.0).sqrt());
    for u in [(v1 * a + v3 * b) / (s1 - s3).sqrt(), (v1 * a - v3 * b) / (s1 - s3).sqrt()] {
        let normal = v2.cross(&u);
        let basis = Matrix3::from_columns(&[v2, u, normal]);
        let (hv2, hu) = (h * v2, h * u);
        let image = Matrix3::from_columns(&[hv2, hu, hv2.cross(&hu)]);
        let matrix = image * basis.transpose();
        let translation = (h - matrix) * normal;
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
        for sign in [1.0, -1.0] {
            motions.push(PlaneMotion {
                cam2_from_cam1: Rigid3::new(rotation, translation * sign),
                normal_in_cam1: normal * sign,
            });
        }
    }
    motions
}
