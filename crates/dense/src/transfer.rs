//! Transfer of pixels with inverse depths from one image to another.

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Matrix3;

use crate::pinhole::PosedPinhole;
use crate::rows::{RowTime, RowTimes};

/// Transfer of a pixel with an inverse depth to another image (Hartley & Zisserman, Eq. 9.7):
/// x' ~ infinite_homography · x + epipole · (1/z), for pixel indices.
#[derive(Clone, Debug)]
pub(crate) struct Transfer {
    still: Homography,
    /// If one of the shutters rolls.
    rows: Option<Box<RowTransfer>>,
}

/// A homography for each inverse depth, or its derivative.
#[derive(Clone, Copy, Debug)]
struct Homography {
    /// K' R K⁻¹, by columns.
    columns: [[f32; 3]; 3],
    /// K' t.
    epipole: [f32; 3],
}

impl Homography {
    fn new(from: &PosedPinhole, to: &PosedPinhole, to_from: &Rigid3) -> Self {
        let rotation = to_from.rotation.to_rotation_matrix().into_inner();
        let ([fx, fy], [cx, cy]) = (from.focal, from.centre.map(|centre| centre - 0.5));
        let inverse = Matrix3::new(1.0 / fx, 0.0, -cx / fx, 0.0, 1.0 / fy, -cy / fy, 0.0, 0.0, 1.0);
        let homography = to.index_matrix() * rotation * inverse;
        let epipole = to.index_matrix() * to_from.translation;
        let column = |index: usize| std::array::from_fn(|row| homography[(row, index)] as f32);
        Self {
            columns: std::array::from_fn(column),
            epipole: std::array::from_fn(|row| epipole[row] as f32),
        }
    }

    /// The transferred pixel at infinity, homogeneous.
    #[inline(always)]
    fn at_infinity(&self, x: f32, y: f32) -> [f32; 3] {
        let [a, b, c] = &self.columns;
        [a[0] * x + b[0] * y + c[0], a[1] * x + b[1] * y + c[1], a[2] * x + b[2] * y + c[2]]
    }

    /// The transferred pixel, homogeneous, from that at infinity.
    #[inline(always)]
    fn at(&self, at_infinity: &[f32; 3], inverse_depth: f32) -> [f32; 3] {
        added(at_infinity, &self.epipole, inverse_depth)
    }

    /// Its derivatives by x and y on a plane of this slope.
    #[inline(always)]
    fn derivatives(&self, [a, b]: [f32; 2]) -> [[f32; 3]; 2] {
        [added(&self.columns[0], &self.epipole, a), added(&self.columns[1], &self.epipole, b)]
    }
}

/// a + b · factor.
#[inline(always)]
fn added(a: &[f32; 3], b: &[f32; 3], factor: f32) -> [f32; 3] {
    [a[0] + b[0] * factor, a[1] + b[1] * factor, a[2] + b[2] * factor]
}

#[inline(always)]
fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A transferred patch: the homogeneous place of its centre, and the derivatives by x and y.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transferred {
    pub(crate) centre: [f32; 3],
    pub(crate) derivatives: [[f32; 3]; 2],
}

impl Transfer {
    pub(crate) fn new(from: &PosedPinhole, to: &PosedPinhole) -> Self {
        let to_from = to.cam_from_world * from.cam_from_world.inverse();
        Self { still: Homography::new(from, to, &to_from), rows: RowTransfer::new(from, to) }
    }

    /// The transferred pixel at infinity, homogeneous, at the times of the middle rows.
    #[inline(always)]
    pub(crate) fn at_infinity(&self, x: f32, y: f32) -> [f32; 3] {
        self.still.at_infinity(x, y)
    }

    /// The transferred pixel, homogeneous, from that at infinity, at the times of the middle rows.
    #[inline(always)]
    pub(crate) fn at(&self, at_infinity: &[f32; 3], inverse_depth: f32) -> [f32; 3] {
        self.still.at(at_infinity, inverse_depth)
    }

    /// The transferred pixel, homogeneous.
    #[inline(always)]
    pub(crate) fn place(&self, x: f32, y: f32, inverse_depth: f32) -> [f32; 3] {
        match &self.rows {
            None => self.at(&self.at_infinity(x, y), inverse_depth),
            Some(rows) => rows.patch(&self.still, x, y, inverse_depth, [0.0; 2]).centre,
        }
    }

    /// The transferred patch of a plane around the pixel (x, y), whose place at infinity is given.
    #[inline(always)]
    pub(crate) fn patch(
        &self,
        at_infinity: &[f32; 3],
        [x, y]: [f32; 2],
        inverse_depth: f32,
        slope: [f32; 2],
    ) -> Transferred {
        match &self.rows {
            None => Transferred {
                centre: self.at(at_infinity, inverse_depth),
                derivatives: self.still.derivatives(slope),
            },
            Some(rows) => rows.patch(&self.still, x, y, inverse_depth, slope),
        }
    }

    /// Squared derivative of a transferred pixel, of this homogeneous place, by the inverse depth.
    #[inline(always)]
    pub(crate) fn squared_parallax(&self, [x, y, z]: &[f32; 3]) -> f32 {
        let e = &self.still.epipole;
        let inverse = 1.0 / z;
        let (u, v) = (x * inverse, y * inverse);
        let (du, dv) = ((e[0] - e[2] * u) * inverse, (e[1] - e[2] * v) * inverse);
        du * du + dv * dv
    }
}

/// What rolling shutters change of a [`Transfer`]. The homography is linear in the times of the
/// pixel and of its place: at 1 rad/s over a readout of 16 ms, quadratic terms are 1/60 of a pixel
/// for a focal length of 500 pixels.
#[derive(Clone, Debug)]
struct RowTransfer {
    from: Rolling,
    to: Rolling,
}

/// The derivative of the homography by the time of one of the images, and that time.
#[derive(Clone, Debug)]
struct Rolling {
    change: Homography,
    /// `None` without a rolling shutter.
    times: Option<RowTimes>,
}

impl Rolling {
    /// `at`: the homography for a time of the image.
    fn new(camera: &PosedPinhole, at: impl Fn(f64) -> Homography) -> Self {
        let (first, last) = (at(-0.5), at(0.5));
        let change = |one: [f32; 3], other: [f32; 3]| added(&other, &one, -1.0);
        Self {
            change: Homography {
                columns: std::array::from_fn(|k| change(first.columns[k], last.columns[k])),
                epipole: change(first.epipole, last.epipole),
            },
            times: camera.rows.as_ref().map(|rows| rows.times.clone()),
        }
    }

    #[inline(always)]
    fn time(&self, x: f32, y: f32) -> RowTime {
        self.times.as_ref().map_or_else(RowTime::default, |times| times.at(x, y))
    }
}

impl RowTransfer {
    fn new(from: &PosedPinhole, to: &PosedPinhole) -> Option<Box<Self>> {
        if from.rows.is_none() && to.rows.is_none() {
            return None;
        }
        let of = |source: &Rigid3, target: &Rigid3| {
            Homography::new(from, to, &(*target * source.inverse()))
        };
        Some(Box::new(Self {
            from: Rolling::new(from, |time| of(&from.at_time(time), &to.cam_from_world)),
            to: Rolling::new(to, |time| of(&from.cam_from_world, &to.at_time(time))),
        }))
    }

    /// The patch of a plane around the pixel (x, y). Its place depends on the time there: one
    /// Newton step from the place at the time of the middle row.
    #[inline(always)]
    fn patch(
        &self,
        still: &Homography,
        x: f32,
        y: f32,
        inverse_depth: f32,
        slope: [f32; 2],
    ) -> Transferred {
        let at = |part: &Homography| part.at(&part.at_infinity(x, y), inverse_depth);
        let own = self.from.time(x, y);
        let (by_own, by_there) = (at(&self.from.change), at(&self.to.change));
        let middle = added(&at(still), &by_own, own.time);
        let inverse = 1.0 / middle[2];
        let (u, v) = (middle[0] * inverse, middle[1] * inverse);
        let RowTime { time, slope: [du, dv] } = self.to.time(u, v);
        // The derivative of the time there by the homogeneous place.
        let by_place = [du * inverse, dv * inverse, -(du * u + dv * v) * inverse];
        let gain = 1.0 / (1.0 - dot(&by_place, &by_there));
        let time = time * gain;
        let (own_slopes, there_slopes) =
            (self.from.change.derivatives(slope), self.to.change.derivatives(slope));
        let mut derivatives = still.derivatives(slope);
        for (axis, derivative) in derivatives.iter_mut().enumerate() {
            *derivative = added(derivative, &own_slopes[axis], own.time);
            *derivative = added(derivative, &by_own, own.slope[axis]);
            *derivative = added(derivative, &there_slopes[axis], time);
            let time_slope = gain * dot(&by_place, derivative);
            *derivative = added(derivative, &by_there, time_slope);
        }
        Transferred { centre: added(&middle, &by_there, time), derivatives }
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::{Vector2, Vector3};
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rng, RowPoses};
    use tiepoint_scene::Camera;

    use super::*;
    use crate::rows::PixelPoses;
    use crate::undistort::{UndistortOptions, Undistortion, undistort_camera};

    /// An image whose photo has distortion, from a moving camera.
    fn image(rng: &mut Rng, has_rows: bool) -> (PosedPinhole, Undistortion, RowPoses) {
        let mut vector = |size: f64| Vector3::from_fn(|_, _| size * (2.0 * rng.uniform() - 1.0));
        let intrinsics =
            Intrinsics::new(CameraModelKind::Radial, &[500.0, 322.0, 237.0, -0.25, 0.05]).unwrap();
        let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
        let pinhole = undistort_camera(&camera, &UndistortOptions::default()).unwrap();
        let undistortion = Undistortion::new(&camera, &pinhole);
        let pose = Rigid3::from_axis_angle(vector(0.1), vector(1.0));
        // A drive on a bad road.
        let rows = RowPoses {
            velocity_in_world: vector(10.0),
            angular_velocity_rad_s: vector(0.5),
            readout_s: 0.016,
            height_px: 480.0,
        };
        let mut posed = PosedPinhole::new(&pinhole, &pose).unwrap();
        posed.rows = has_rows.then(|| PixelPoses::new(rows, &undistortion));
        (posed, undistortion, rows)
    }

    /// The exact pose of a pixel index.
    fn pose(image: &(PosedPinhole, Undistortion, RowPoses), x: f64, y: f64) -> Rigid3 {
        let (posed, undistortion, rows) = image;
        let source = undistortion.source(&Vector2::new(x + 0.5, y + 0.5)).unwrap();
        match posed.rows {
            None => posed.cam_from_world,
            Some(_) => rows.cam_from_world(&posed.cam_from_world, source.y),
        }
    }

    /// Of quadratic terms: 0.87 rad/s, the longest angular velocity here, over half of the readout,
    /// squared and times the focal length, is 1/40 of a pixel. The rest is of the one Newton step.
    const MAX_ERROR_PX: f64 = 0.05;

    /// The slow twin: exact poses, the pixel in the other image by iteration to the end.
    #[test]
    fn places_are_those_of_exact_row_poses() {
        let mut rng = Rng::stream(5, &[]);
        let (mut worst, mut moved) = (0.0f64, 0.0f64);
        for round in 0..60 {
            let from = image(&mut rng, round % 3 != 0);
            let to = image(&mut rng, round % 3 != 1);
            let transfer = Transfer::new(&from.0, &to.0);
            for _ in 0..100 {
                let (x, y) = (20.0 + 600.0 * rng.uniform(), 20.0 + 440.0 * rng.uniform());
                let inverse_depth = 1.0 / (6.0 + 20.0 * rng.uniform());
                let slope = [0, 1].map(|_| 1e-4 * (2.0 * rng.uniform() - 1.0));
                let slow = |dx: f64, dy: f64| {
                    let depth = 1.0 / (inverse_depth + slope[0] * dx + slope[1] * dy);
                    let point =
                        pose(&from, x + dx, y + dy).inverse() * from.0.point(x + dx, y + dy, depth);
                    let mut place = to.0.project(&(to.0.cam_from_world * point))?;
                    for _ in 0..20 {
                        if !(0.0..640.0).contains(&place.x) || !(0.0..480.0).contains(&place.y) {
                            return None;
                        }
                        place = to.0.project(&(pose(&to, place.x, place.y) * point))?;
                    }
                    Some(place)
                };
                let (u, v) = (x as f32, y as f32);
                let Transferred { centre, derivatives: [dx, dy] } = transfer.patch(
                    &transfer.at_infinity(u, v),
                    [u, v],
                    inverse_depth as f32,
                    slope.map(|slope| slope as f32),
                );
                assert_eq!(centre, transfer.place(u, v, inverse_depth as f32));
                let pixel = |[x, y, z]: [f32; 3]| Vector2::new((x / z).into(), (y / z).into());
                for (p, q) in [(0.0, 0.0), (3.0, 0.0), (0.0, 3.0), (-3.0, -3.0)] {
                    let Some(exact) = slow(p, q) else { continue };
                    let place = added(&added(&centre, &dx, p as f32), &dy, q as f32);
                    worst = worst.max((pixel(place) - exact).norm());
                    let still = transfer.at(&transfer.at_infinity(u, v), inverse_depth as f32);
                    moved = moved.max((pixel(still) - exact).norm());
                }
            }
        }
        assert!(worst < MAX_ERROR_PX && moved > 5.0, "{worst} {moved}");
    }
}
