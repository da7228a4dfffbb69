//! Extrinsics of the cameras on the vehicle.

use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector3};
use tiepoint_geometry::{Rigid3, Rng};

/// Standard deviation of the misalignment about each axis, in radians (1.5 degrees): cameras of
/// uncalibrated rigs are not exactly parallel.
const MISALIGNMENT_RAD: f64 = 0.026;
/// Centre of the roof in the vehicle frame (right, down, forward from the road under the rear
/// axle), in metres.
const ROOF_M: [f64; 3] = [0.0, -1.55, 1.1];

/// View direction of a camera, as in the experiments of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewDirection {
    /// Forward.
    Front,
    /// Forward right, 45°.
    FrontRight,
    /// To the right, 90°.
    Right,
    /// Backward.
    Rear,
    /// To the left, 90°.
    Left,
}

impl ViewDirection {
    /// All directions.
    pub const ALL: [ViewDirection; 5] =
        [Self::Front, Self::FrontRight, Self::Right, Self::Rear, Self::Left];

    /// The name, which is also the name of the folder of the camera.
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::FrontRight => "front-right",
            Self::Right => "right",
            Self::Rear => "rear",
            Self::Left => "left",
        }
    }

    /// Yaw of the viewing direction relative to forward, clockwise from above, in radians.
    pub fn yaw_rad(self) -> f64 {
        let degrees: f64 = match self {
            Self::Front => 0.0,
            Self::FrontRight => 45.0,
            Self::Right => 90.0,
            Self::Rear => 180.0,
            Self::Left => -90.0,
        };
        degrees.to_radians()
    }

    /// Position on the roof in the vehicle frame, in metres.
    fn position_m(self) -> Vector3<f64> {
        let [x, y, z] = ROOF_M;
        match self {
            Self::Front => Vector3::new(x, y, z + 0.8),
            Self::FrontRight => Vector3::new(x + 0.55, y, z + 0.6),
            Self::Right => Vector3::new(x + 0.6, y, z),
            Self::Rear => Vector3::new(x, y, z - 0.8),
            Self::Left => Vector3::new(x - 0.6, y, z),
        }
    }
}

/// A camera with its extrinsics.
#[derive(Clone, Debug, PartialEq)]
pub struct Mount {
    /// Name of the camera and of its folder.
    pub name: String,
    /// Extrinsics, in metres; the vehicle frame is right, down, forward from the road under the
    /// rear axle.
    pub cam_from_vehicle: Rigid3,
}

impl Mount {
    /// A camera at a position in the vehicle frame (metres), rotated by `yaw_rad` clockwise from
    /// forward and `pitch_rad` upwards.
    pub fn at(
        name: impl Into<String>,
        position_m: Vector3<f64>,
        yaw_rad: f64,
        pitch_rad: f64,
    ) -> Self {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw_rad)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), pitch_rad);
        Self { name: name.into(), cam_from_vehicle: Rigid3::new(rotation, position_m).inverse() }
    }

    /// The aligned camera of a direction.
    pub fn facing(direction: ViewDirection) -> Self {
        Self::at(direction.name(), direction.position_m(), direction.yaw_rad(), 0.0)
    }

    /// A stereo pair with parallel axes and a baseline of `baseline_m`: `left` and `right` of the
    /// view direction. The pair looks forward with [`ViewDirection::Front`]; with
    /// [`ViewDirection::Right`] it looks sideways, and one camera is in front of the other
    /// (Experiment II of the paper).
    pub fn stereo(direction: ViewDirection, baseline_m: f64) -> [Self; 2] {
        let middle = Self::facing(direction).cam_from_vehicle;
        [("left", -0.5), ("right", 0.5)].map(|(name, side)| {
            let shift = Vector3::new(-side * baseline_m, 0.0, 0.0);
            let cam_from_vehicle = Rigid3::new(middle.rotation, middle.translation + shift);
            Self { name: name.to_owned(), cam_from_vehicle }
        })
    }

    /// The cameras moved together so that the mean of their positions is the origin of the vehicle.
    pub(crate) fn centred(mounts: &[Self]) -> Vec<Self> {
        let positions = mounts.iter().map(|mount| mount.cam_from_vehicle.origin_in_a());
        let mean = positions.sum::<Vector3<f64>>() / mounts.len() as f64;
        let moved = |mount: &Self| {
            let shift = Rigid3::new(UnitQuaternion::identity(), mean);
            Self { name: mount.name.clone(), cam_from_vehicle: mount.cam_from_vehicle * shift }
        };
        mounts.iter().map(moved).collect()
    }

    /// The camera with a random misalignment: rotated about its centre by about 1.5 degrees about
    /// each axis.
    pub fn misaligned(&self, rng: &mut Rng) -> Self {
        let turn = Vector3::from_fn(|_, _| MISALIGNMENT_RAD * rng.normal());
        let cam_from_vehicle =
            Rigid3::from_axis_angle(turn, Vector3::zeros()) * self.cam_from_vehicle;
        Self { name: self.name.clone(), cam_from_vehicle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOLERANCE: f64 = 1e-12;

    #[test]
    fn viewing_directions_match_their_names() {
        for (direction, axis) in [
            (ViewDirection::Front, Vector3::z()),
            (ViewDirection::Right, Vector3::x()),
            (ViewDirection::Rear, -Vector3::z()),
            (ViewDirection::Left, -Vector3::x()),
            (ViewDirection::FrontRight, Vector3::new(1.0, 0.0, 1.0).normalize()),
        ] {
            let vehicle_from_cam = Mount::facing(direction).cam_from_vehicle.inverse();
            assert!(
                (vehicle_from_cam.rotation * Vector3::z() - axis).norm() < TOLERANCE,
                "{direction:?}"
            );
            assert!(
                (vehicle_from_cam.rotation * Vector3::y() - Vector3::y()).norm() < TOLERANCE,
                "{direction:?}"
            );
        }
    }

    #[test]
    fn pitch_is_upwards_and_misalignment_preserves_the_centre() {
        let mount = Mount::at("up", Vector3::new(1.0, 2.0, 3.0), 0.4, 0.1);
        let view = mount.cam_from_vehicle.inverse().rotation * Vector3::z();
        assert!((view.y + 0.1f64.sin()).abs() < TOLERANCE, "{view}");
        let turned = mount.misaligned(&mut Rng::stream(1, &[]));
        assert!(
            (turned.cam_from_vehicle.origin_in_a() - Vector3::new(1.0, 2.0, 3.0)).norm()
                < TOLERANCE
        );
        assert!(turned.cam_from_vehicle.rotation.angle_to(&mount.cam_from_vehicle.rotation) > 1e-3);
    }

    #[test]
    fn baseline_of_a_stereo_pair_points_right() {
        for direction in ViewDirection::ALL {
            let [left, right] = Mount::stereo(direction, 0.5);
            let right_from_left = right.cam_from_vehicle * left.cam_from_vehicle.inverse();
            let centre = right_from_left.origin_in_a();
            assert!(
                (centre - Vector3::new(0.5, 0.0, 0.0)).norm() < TOLERANCE,
                "{direction:?}: {centre}"
            );
        }
    }
}
