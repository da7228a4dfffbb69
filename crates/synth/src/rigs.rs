//! Where cameras sit on the vehicle.

use std::str::FromStr;

use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector3};
use tiepoint_geometry::{Rigid3, Rng};

use crate::Error;

/// How inexactly a camera is fixed: 1.5 degrees about each axis. Rigs that nobody calibrated are
/// not exactly parallel.
const MISALIGNMENT_RAD: f64 = 0.026;
/// Middle of the roof in the vehicle's frame (right, down, forward of the rear axle on the road),
/// in metres.
const ROOF_M: [f64; 3] = [0.0, -1.55, 1.1];

/// The paper's mountings: which way a camera looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mounting {
    /// Ahead.
    Front,
    /// Half right.
    FrontRight,
    /// At right angles to the right.
    Right,
    /// Behind.
    Rear,
    /// At right angles to the left.
    Left,
}

impl Mounting {
    /// All of them.
    pub const ALL: [Mounting; 5] =
        [Self::Front, Self::FrontRight, Self::Right, Self::Rear, Self::Left];

    /// Its name, also that of the camera's folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::FrontRight => "front-right",
            Self::Right => "right",
            Self::Rear => "rear",
            Self::Left => "left",
        }
    }

    /// Angle of the view from straight ahead, clockwise seen from above, in radians.
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

    /// Where on the roof it sits, in the vehicle's frame.
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

impl FromStr for Mounting {
    type Err = Error;
    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|mounting| mounting.name() == name).ok_or_else(|| {
            Error::UnknownName {
                what: "mounting",
                name: name.to_owned(),
                known: Self::ALL.map(Self::name).join(", "),
            }
        })
    }
}

/// A camera's place on the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Mount {
    /// Name of the camera, and of its folder.
    pub name: String,
    /// Its pose; the vehicle's frame is right, down, forward from the road under the rear axle.
    pub cam_from_vehicle: Rigid3,
}

impl Mount {
    /// At a position of the vehicle's frame (metres), looking `yaw_rad` clockwise from ahead and
    /// `pitch_rad` upwards.
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

    /// One of the paper's, exactly aligned.
    pub fn of(mounting: Mounting) -> Self {
        Self::at(mounting.name(), mounting.position_m(), mounting.yaw_rad(), 0.0)
    }

    /// Two cameras that look the same way, `baseline_m` apart: `left` and `right` of the direction
    /// of view, which is ahead with [`Mounting::Front`] and sideways, one camera in front of the
    /// other, with [`Mounting::Right`] (the paper's Experiment II).
    pub fn stereo(mounting: Mounting, baseline_m: f64) -> [Self; 2] {
        let middle = Self::of(mounting).cam_from_vehicle;
        [("left", -0.5), ("right", 0.5)].map(|(name, side)| {
            let shift = Vector3::new(-side * baseline_m, 0.0, 0.0);
            let cam_from_vehicle = Rigid3::new(middle.rotation, middle.translation + shift);
            Self { name: name.to_owned(), cam_from_vehicle }
        })
    }

    /// As hands would have fixed it: turned by about 1.5 degrees about each axis, about its own
    /// centre.
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
    fn cameras_look_where_their_names_say() {
        for (mounting, axis) in [
            (Mounting::Front, Vector3::z()),
            (Mounting::Right, Vector3::x()),
            (Mounting::Rear, -Vector3::z()),
            (Mounting::Left, -Vector3::x()),
            (Mounting::FrontRight, Vector3::new(1.0, 0.0, 1.0).normalize()),
        ] {
            let vehicle_from_cam = Mount::of(mounting).cam_from_vehicle.inverse();
            assert!(
                (vehicle_from_cam.rotation * Vector3::z() - axis).norm() < TOLERANCE,
                "{mounting:?}"
            );
            assert!(
                (vehicle_from_cam.rotation * Vector3::y() - Vector3::y()).norm() < TOLERANCE,
                "{mounting:?}"
            );
            assert_eq!(mounting.name().parse::<Mounting>().unwrap(), mounting);
        }
        assert!("roof".parse::<Mounting>().is_err());
    }

    #[test]
    fn pitch_is_upwards_and_misalignment_keeps_the_centre() {
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
    fn a_stereo_pair_has_its_baseline_to_the_right() {
        for mounting in Mounting::ALL {
            let [left, right] = Mount::stereo(mounting, 0.5);
            let right_from_left = right.cam_from_vehicle * left.cam_from_vehicle.inverse();
            let centre = right_from_left.origin_in_a();
            assert!(
                (centre - Vector3::new(0.5, 0.0, 0.0)).norm() < TOLERANCE,
                "{mounting:?}: {centre}"
            );
        }
    }
}
