//! Lenses: a distorted lens of an action camera, the ideal pinhole, and both with a lens field.
//!
//! The action lens has a radial profile with even and odd powers of the angle θ from the optical
//! axis (as the lens maps that GoPro publishes), then decentring distortion (Brown 1966) on the
//! fisheye plane, then a principal point off the image centre. With m(θ) = θ (1 + a₁θ + a₂θ² + a₃θ³
//! + a₄θ⁴) and (u, v) the point at distance m in the direction of the ray,
//!
//! u' = u + p₁ (m² + 2u²) + 2 p₂ uv,  v' = v + p₂ (m² + 2v²) + 2 p₁ uv,  pixel = c + f (u', v').
//!
//! No camera model of COLMAP has the coefficients aⱼ of odd index (even powers of θ), and only
//! THIN_PRISM_FISHEYE has decentring on that plane: an estimator is left with a residual, as with a
//! real lens.

use tiepoint_geometry::nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rng};

use crate::lens_field::LensField;

/// Step at which the Newton iterations end (in radians, or units of the fisheye plane), and the
/// most iterations.
const NEWTON_TOLERANCE: f64 = 1e-14;
const NEWTON_ITERATIONS: usize = 30;
/// Number of pixels in a row and in a column to which the nearest intrinsics are fitted.
const GRID: usize = 40;

/// The lens of an action camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActionLens {
    /// Focal length on the axis, in pixels.
    pub focal_px: f64,
    /// a₁ to a₄ of the radial profile, per radian, per radian², …
    pub radial: [f64; 4],
    /// p₁ and p₂, per radian.
    pub decentring: [f64; 2],
    /// Principal point, in pixels.
    pub principal_point: Vector2<f64>,
    /// Rays at a larger angle to the axis, in radians, are not imaged.
    pub max_angle_rad: f64,
}

/// A projection between rays and pixels.
#[derive(Clone, Debug, PartialEq)]
pub enum Lens {
    /// An ideal pinhole: pixel = f (x/z, y/z) + c.
    Pinhole {
        /// Focal length, in pixels.
        focal_px: f64,
        /// Principal point, in pixels.
        principal_point: Vector2<f64>,
    },
    /// The lens of an action camera.
    Action(ActionLens),
    /// A lens whose pixels a field displaces.
    WithField {
        /// The lens without the field.
        lens: Box<Lens>,
        /// The displacement at the pixels of that lens.
        field: LensField,
    },
}

impl ActionLens {
    /// A random lens for an image size, in pixels: the nominal values of a product with
    /// manufacturing tolerances. The horizontal field of view is about 94°, as the wide setting of
    /// a GoPro at 4:3.
    pub fn sample(width: u32, height: u32, rng: &mut Rng) -> Self {
        let (width, height) = (f64::from(width), f64::from(height));
        let mut scattered = |value: f64, sigma: f64| value + sigma * rng.normal();
        Self {
            focal_px: 0.60 * width * scattered(1.0, 0.004),
            radial: [
                scattered(-0.012, 0.002),
                scattered(0.060, 0.005),
                scattered(-0.050, 0.004),
                scattered(-0.022, 0.003),
            ],
            decentring: [scattered(0.0, 0.0008), scattered(0.0, 0.0008)],
            principal_point: Vector2::new(
                width * scattered(0.5, 0.005),
                height * scattered(0.5, 0.005),
            ),
            max_angle_rad: 1.2,
        }
    }

    /// m(θ) and its derivative, θ in radians.
    fn radius(&self, angle: f64) -> (f64, f64) {
        let [a1, a2, a3, a4] = self.radial;
        let value = angle * (1.0 + angle * (a1 + angle * (a2 + angle * (a3 + angle * a4))));
        let slope =
            1.0 + angle * (2.0 * a1 + angle * (3.0 * a2 + angle * (4.0 * a3 + angle * 5.0 * a4)));
        (value, slope)
    }

    /// Applies the decentring distortion: the point and the 2 × 2 Jacobian.
    fn decentre(&self, point: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let ([p1, p2], [u, v]) = (self.decentring, [point.x, point.y]);
        let m2 = u * u + v * v;
        let shift = Vector2::new(
            p1 * (m2 + 2.0 * u * u) + 2.0 * p2 * u * v,
            p2 * (m2 + 2.0 * v * v) + 2.0 * p1 * u * v,
        );
        let mixed = 2.0 * (p1 * v + p2 * u);
        let jacobian = Matrix2::new(
            1.0 + 6.0 * p1 * u + 2.0 * p2 * v,
            mixed,
            mixed,
            1.0 + 6.0 * p2 * v + 2.0 * p1 * u,
        );
        (point + shift, jacobian)
    }

    fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let off_axis = point.xy().norm();
        let angle = off_axis.atan2(point.z);
        // The comparison also rejects NaN.
        if angle > self.max_angle_rad || angle.is_nan() || point.norm_squared() == 0.0 {
            return None;
        }
        let direction = if off_axis > 0.0 { point.xy() / off_axis } else { Vector2::zeros() };
        let (decentred, _) = self.decentre(direction * self.radius(angle).0);
        Some(self.principal_point + decentred * self.focal_px)
    }

    fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let decentred = (pixel - self.principal_point) / self.focal_px;
        let mut point = decentred;
        for _ in 0..NEWTON_ITERATIONS {
            let (value, jacobian) = self.decentre(point);
            let step = jacobian.try_inverse()? * (decentred - value);
            point += step;
            if step.norm() < NEWTON_TOLERANCE {
                break;
            }
        }
        let radius = point.norm();
        let mut angle = radius.min(self.max_angle_rad);
        for _ in 0..NEWTON_ITERATIONS {
            let (value, slope) = self.radius(angle);
            let step = (radius - value) / slope;
            angle += step;
            if step.abs() < NEWTON_TOLERANCE {
                break;
            }
        }
        if !(0.0..=self.max_angle_rad).contains(&angle) {
            return None;
        }
        let (sin, cos) = angle.sin_cos();
        let off_axis = if radius > 0.0 { point * (sin / radius) } else { Vector2::zeros() };
        Some(Vector3::new(off_axis.x, off_axis.y, cos))
    }
}

impl Lens {
    /// An ideal pinhole with the principal point in the centre of the image.
    pub fn pinhole(focal_px: f64, width: u32, height: u32) -> Self {
        let principal_point = Vector2::new(f64::from(width) / 2.0, f64::from(height) / 2.0);
        Self::Pinhole { focal_px, principal_point }
    }

    /// The lens with a random field of `rms_px` over an image of `width` × `height` pixels.
    pub fn with_field(self, rms_px: f64, width: u32, height: u32, rng: &mut Rng) -> Self {
        let field = LensField::sample(rms_px, width, height, rng);
        Self::WithField { lens: Box::new(self), field }
    }

    /// Projects a point in the camera frame; `None` if the lens does not image it. The pixel may
    /// lie outside of the image.
    pub fn project(&self, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        match self {
            Self::Pinhole { focal_px, principal_point } => (point_in_cam.z > 1e-9)
                .then(|| point_in_cam.xy() * (focal_px / point_in_cam.z) + principal_point),
            Self::Action(lens) => lens.project(point_in_cam),
            Self::WithField { lens, field } => {
                lens.project(point_in_cam).map(|pixel| pixel + field.at(&pixel))
            }
        }
    }

    /// The unit ray of a pixel in the camera frame; `None` if no ray is imaged there.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        match self {
            Self::Pinhole { focal_px, principal_point } => {
                Some(((pixel - principal_point) / *focal_px).push(1.0).normalize())
            }
            Self::Action(lens) => lens.unproject(pixel),
            Self::WithField { lens, field } => lens.unproject(&field.undo(pixel)?),
        }
    }

    /// Focal length on the axis, in pixels.
    pub fn focal_px(&self) -> f64 {
        match self {
            Self::Pinhole { focal_px, .. } => *focal_px,
            Self::Action(lens) => lens.focal_px,
            Self::WithField { lens, .. } => lens.focal_px(),
        }
    }

    /// Principal point, in pixels.
    pub fn principal_point(&self) -> Vector2<f64> {
        match self {
            Self::Pinhole { principal_point, .. } => *principal_point,
            Self::Action(lens) => lens.principal_point,
            Self::WithField { lens, .. } => lens.principal_point(),
        }
    }

    /// PINHOLE intrinsics with the same focal length and principal point: exact for a pinhole,
    /// correct only at the axis for the action lens, without the field.
    pub fn paraxial_intrinsics(&self) -> Intrinsics {
        let (focal, centre) = (self.focal_px(), self.principal_point());
        Intrinsics::new(CameraModelKind::Pinhole, &[focal, focal, centre.x, centre.y])
            .expect("a lens has a finite, positive focal length")
    }

    /// The nearest intrinsics that COLMAP has, for images of a size in pixels: those of the pinhole
    /// are exact; for the action lens the distortion of THIN_PRISM_FISHEYE with the same focal
    /// length and principal point, which differs least in squared pixels on a grid over the image.
    /// The field is left out.
    pub fn nearest_intrinsics(&self, width: u32, height: u32) -> Intrinsics {
        match self {
            Self::Pinhole { .. } => return self.paraxial_intrinsics(),
            Self::WithField { lens, .. } => return lens.nearest_intrinsics(width, height),
            Self::Action(_) => {}
        }
        let (f, c) = (self.focal_px(), self.principal_point());
        let at = |index: usize, size: u32| (index as f64 + 0.5) / GRID as f64 * f64::from(size);
        let pixels =
            (0..GRID * GRID).map(|i| Vector2::new(at(i % GRID, width), at(i / GRID, height)));
        // The distortion is linear in its coefficients: J k = d, with normal equations.
        let mut normal = SMatrix::<f64, 8, 8>::zeros();
        let mut right = SVector::<f64, 8>::zeros();
        for pixel in pixels {
            let Some(ray) = self.unproject(&pixel) else { continue };
            let radius = ray.xy().norm();
            let angle = radius.atan2(ray.z);
            let w = if radius > 0.0 { ray.xy() * (angle / radius) } else { ray.xy() };
            let (u, v, rho2) = (w.x, w.y, w.norm_squared());
            let rows = [(u, 2.0 * u * v, rho2 + 2.0 * u * u), (v, rho2 + 2.0 * v * v, 2.0 * u * v)];
            for (axis, (value, p1, p2)) in rows.into_iter().enumerate() {
                let radial = [1, 2, 3, 4].map(|power| value * rho2.powi(power));
                let mut prism = [0.0; 2];
                prism[axis] = rho2;
                let row = SVector::<f64, 8>::from([
                    radial[0], radial[1], p1, p2, radial[2], radial[3], prism[0], prism[1],
                ]);
                let off = (pixel[axis] - c[axis]) / f - value;
                normal += row * row.transpose();
                right += row * off;
            }
        }
        let distortion =
            normal.cholesky().map_or_else(SVector::zeros, |factor| factor.solve(&right));
        let mut params = vec![f, f, c.x, c.y];
        params.extend(distortion.iter());
        Intrinsics::new(CameraModelKind::ThinPrismFisheye, &params)
            .expect("a lens has a finite, positive focal length")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tiepoint_geometry::Rng;

    const SIZE: (u32, u32) = (2000, 1500);
    /// Tolerance of round trips through Newton iterations in double precision, in pixels and in
    /// radians.
    const PIXEL_TOLERANCE: f64 = 1e-9;
    const RAY_TOLERANCE: f64 = 1e-12;

    fn lenses() -> impl Strategy<Value = Lens> {
        let without = prop_oneof![
            (300.0..2000.0f64).prop_map(|focal| Lens::pinhole(focal, SIZE.0, SIZE.1)),
            (0u64..1000).prop_map(|seed| {
                Lens::Action(ActionLens::sample(SIZE.0, SIZE.1, &mut Rng::stream(seed, &[])))
            }),
        ];
        (without, prop::option::of(0u64..1000)).prop_map(|(lens, field)| match field {
            None => lens,
            Some(seed) => lens.with_field(0.15, SIZE.0, SIZE.1, &mut Rng::stream(seed, &[])),
        })
    }

    proptest! {
        #[test]
        fn pixel_to_ray_to_pixel(
            lens in lenses(),
            x in 0.0..2000.0,
            y in 0.0..1500.0,
            depth in 0.1..1000.0,
        ) {
            let pixel = Vector2::new(x, y);
            let ray = lens.unproject(&pixel).expect("every pixel of the sensor sees");
            prop_assert!((ray.norm() - 1.0).abs() < RAY_TOLERANCE);
            let back = lens.project(&(ray * depth)).expect("what a pixel sees is imaged");
            prop_assert!((back - pixel).norm() < PIXEL_TOLERANCE, "{pixel} became {back}");
        }

        #[test]
        fn ray_to_pixel_to_ray(lens in lenses(), x in -0.7..0.7f64, y in -0.7..0.7f64) {
            let ray = Vector3::new(x, y, 1.0).normalize();
            let back = lens.unproject(&lens.project(&ray).expect("in front")).expect("imaged");
            prop_assert!((back - ray).norm() < RAY_TOLERANCE, "{ray} became {back}");
        }
    }

    #[test]
    fn points_behind_the_camera_are_not_imaged() {
        let action = Lens::Action(ActionLens::sample(SIZE.0, SIZE.1, &mut Rng::stream(1, &[])));
        for lens in [Lens::pinhole(900.0, SIZE.0, SIZE.1), action] {
            for point in
                [Vector3::new(0.1, 0.2, -1.0), Vector3::zeros(), Vector3::new(1.0, 0.0, f64::NAN)]
            {
                assert_eq!(lens.project(&point), None);
            }
        }
    }

    #[test]
    fn field_of_view_is_that_of_a_gopro() {
        let lens = Lens::Action(ActionLens::sample(SIZE.0, SIZE.1, &mut Rng::stream(1, &[])));
        let edge = |x: f64| lens.unproject(&Vector2::new(x, 750.0)).unwrap();
        let degrees = edge(0.0).angle(&edge(2000.0)).to_degrees();
        assert!((90.0..98.0).contains(&degrees), "{degrees}");
    }

    /// Largest and mean distance to the action lens over images 400 pixels wide: THIN_PRISM_FISHEYE
    /// has no even powers of the angle. Of 100 lenses, 0.44 px in a corner, and 0.016 px.
    const NEAREST_LARGEST_PX: f64 = 0.5;
    const NEAREST_MEAN_PX: f64 = 0.02;

    #[test]
    fn nearest_intrinsics_are_near_the_lens() {
        let (width, height) = (400, 300);
        let mut errors = Vec::new();
        for seed in 0..100 {
            let lens = ActionLens::sample(width, height, &mut Rng::stream(seed, &[]));
            let lens = Lens::Action(lens);
            let intrinsics = lens.nearest_intrinsics(width, height);
            for (x, y) in (0..=40).flat_map(|x| (0..=30).map(move |y| (x, y))) {
                let pixel = Vector2::new(f64::from(x), f64::from(y)) * 10.0;
                let ray = lens.unproject(&pixel).unwrap();
                errors.push((intrinsics.project(&ray).unwrap() - pixel).norm());
            }
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let largest = errors.into_iter().fold(0.0, f64::max);
        assert!(mean < NEAREST_MEAN_PX && largest < NEAREST_LARGEST_PX, "{mean} {largest} px");
    }
}
