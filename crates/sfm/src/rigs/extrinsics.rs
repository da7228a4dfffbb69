//! A camera beside the first one of a rig: how it is mounted, and how firmly.

use tiepoint_ba::Factor;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{SMatrix, Vector3, Vector6};
use tiepoint_geometry::numeric::median;
use tiepoint_rig::{Clock, RelativePose, SynchronousExtrinsics};
use tiepoint_scene::{ImageId, Reconstruction};

use super::autocorrelation_time::autocorrelation_time;
use super::rig_sensor::{ReferencedImage, RigSensor};

/// A camera's mounting beside the first one, and how firmly it holds.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RigExtrinsics {
    /// Which cameras, and the other one's clock; that is adjusted where it is free.
    pub rig_sensor: RigSensor,
    /// Where the two are held to each other.
    pub referenced_images: Vec<ReferencedImage>,
    /// The calibration to begin with; it is adjusted.
    pub right_from_left: Rigid3,
    /// How firmly.
    pub constraint: RigConstraint,
    /// At these of the moments the model had the camera elsewhere, for want of matches with the
    /// first one.
    pub(crate) closed: Vec<Closed>,
}

/// How firmly a mounting holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RigConstraint {
    /// Up to standard deviations.
    Soft {
        /// Of each coordinate of the centre, in baselines, or in the unit of cameras that see
        /// nothing in common.
        sigma_translation: f64,
        /// Of each component of the rotation, in radians.
        sigma_rotation_rad: f64,
    },
    /// Exactly: the right camera's pose is the left one's, moved by the calibration.
    Rigid,
}

impl RigConstraint {
    pub(super) fn soft(sigmas: (f64, f64)) -> Self {
        Self::Soft { sigma_translation: sigmas.0, sigma_rotation_rad: sigmas.1 }
    }

    /// With standard deviations that many times as large.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        match self {
            Self::Soft { sigma_translation, sigma_rotation_rad } => {
                Self::soft((factor * sigma_translation, factor * sigma_rotation_rad))
            }
            Self::Rigid => Self::Rigid,
        }
    }
}

/// Rotation (radians, R ← Exp(δ) R), translation (units of the model), offset (seconds), drift.
pub type ExtrinsicsCovariance = SMatrix<f64, 8, 8>;

/// An image that was brought back, and its partner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Closed {
    pub(crate) right: ImageId,
    pub(crate) left: ImageId,
}

impl Closed {
    pub(crate) fn new(referenced: &ReferencedImage, clock: &Clock) -> Self {
        Self { right: referenced.right, left: referenced.nearest_left(clock) }
    }
}

/// Cameras are held when their relative poses end within this many standard deviations of the
/// mounting. Where clocks disagree or a mount gives, they do not follow, and the firmest deviations
/// at which they did are kept. With 3 a mount that swings passed, and pulled the clock by 6 ms.
const MAX_LEFT: f64 = 2.0;
/// The motion tells nothing of a camera's place along a direction when it leaves a standard
/// deviation of more than this share of the unit: what the models have drifted apart would decide
/// it.
const MAX_PLACE_SD: f64 = 0.1;

impl RigExtrinsics {
    /// With standard deviations that many times as large, also of what is doubtful about its
    /// moments.
    pub(crate) fn scaled(&self, factor: f64) -> Self {
        let mut scaled = Self { constraint: self.constraint.scaled(factor), ..self.clone() };
        scaled
            .referenced_images
            .iter_mut()
            .for_each(|referenced| referenced.scale_perturbations(factor));
        scaled
    }

    /// What is left between the cameras at each moment, in standard deviations: of the translation,
    /// then of the rotation; none of cameras that are held exactly.
    fn left(&self, model: &Reconstruction) -> Vec<Vector6<f64>> {
        let RigConstraint::Soft { sigma_translation, sigma_rotation_rad } = self.constraint else {
            return Vec::new();
        };
        let mounted = SynchronousExtrinsics {
            sigma_translation,
            sigma_rotation_rad,
            assumed_baseline: self.rig_sensor.assumed_baseline,
        };
        let left_over = |referenced: &ReferencedImage| {
            let left = referenced.left_from_world(model, &self.rig_sensor.clock)?;
            let right = model.image(referenced.right).cam_from_world()?;
            let residual = mounted.residual((&left, right, &self.right_from_left))?;
            Some(referenced.whitening(&mounted, &left, &self.right_from_left) * residual)
        };
        self.referenced_images.iter().filter_map(left_over).collect()
    }

    /// Whether the cameras follow in translation, and in rotation: half of the moments are within a
    /// few standard deviations.
    pub(super) fn follows(&self, model: &Reconstruction) -> [bool; 2] {
        let left = self.left(model);
        [0, 3].map(|first| {
            let mut norms: Vec<f64> =
                left.iter().map(|r| r.fixed_rows::<3>(first).norm()).collect();
            median(&mut norms).is_none_or(|norm| norm <= MAX_LEFT * MEDIAN_OF_THREE)
        })
    }

    /// With standard deviations so large that moments count as if what is left at one told nothing
    /// of the next: what a mount that swings leaves goes on from moment to moment, and n of them
    /// tell less than n would.
    pub(crate) fn as_if_independent(&self, model: &Reconstruction) -> Self {
        let RigConstraint::Soft { sigma_translation, sigma_rotation_rad } = self.constraint else {
            return self.clone();
        };
        let left = self.left(model);
        let [translation, rotation] = [0, 3].map(|first| {
            let series: Vec<Vector3<f64>> =
                left.iter().map(|r| r.fixed_rows::<3>(first).into_owned()).collect();
            autocorrelation_time(&series).sqrt()
        });
        let constraint =
            RigConstraint::soft((translation * sigma_translation, rotation * sigma_rotation_rad));
        Self { constraint, ..self.clone() }
    }

    /// Moves the further camera to where a calibration has it, at every moment.
    pub(super) fn place(&self, model: &mut Reconstruction, right_from_left: &Rigid3) {
        for referenced in &self.referenced_images {
            if let Some(left) = referenced.left_from_world(model, &self.rig_sensor.clock) {
                model.register(referenced.right, *right_from_left * left);
            }
        }
    }

    /// The direction of the camera's centre, in the first camera's frame, that the motion does not
    /// tell.
    pub(super) fn unobservable_direction(
        &self,
        covariance: &ExtrinsicsCovariance,
    ) -> Option<Vector3<f64>> {
        let assumed_baseline = self.rig_sensor.assumed_baseline?;
        // c = -Rᵀ t; what the rotation adds is less by the baseline over a radian.
        let rotation = self.right_from_left.rotation.to_rotation_matrix().into_inner();
        let of_centre = rotation.transpose() * covariance.fixed_view::<3, 3>(3, 3) * rotation;
        let eigen = of_centre.symmetric_eigen();
        let (index, variance) = eigen.eigenvalues.argmax();
        (variance.max(0.0).sqrt() > MAX_PLACE_SD * assumed_baseline).then(|| {
            let direction = eigen.eigenvectors.column(index);
            // Of the two signs, that of its largest part.
            direction * direction[direction.iamax()].signum()
        })
    }

    /// Along the direction that the motion does not tell, a place is known by what was believed
    /// beforehand.
    pub(super) fn with_belief(&self, mut covariance: ExtrinsicsCovariance) -> ExtrinsicsCovariance {
        if let RigSensor {
            assumed_baseline: Some(assumed_baseline),
            unobservable_direction: Some(unobservable_direction),
            ..
        } = self.rig_sensor
        {
            let along = self.right_from_left.rotation * unobservable_direction * assumed_baseline;
            let mut of_place = covariance.fixed_view_mut::<3, 3>(3, 3);
            of_place += along * along.transpose();
        }
        covariance
    }
}

/// The relative poses at those of some moments where both cameras have one.
pub(super) fn relative_poses(
    model: &Reconstruction,
    referenced_images: &[ReferencedImage],
    clock: &Clock,
) -> Vec<RelativePose> {
    referenced_images
        .iter()
        .filter_map(|referenced| referenced.relative_pose(model, clock))
        .collect()
}

/// Distance of the centres in baselines, and angle.
pub(super) fn deviation(a: &RelativePose, b: &RelativePose, baseline: f64) -> (f64, f64) {
    let (distance, angle) = a.distance_and_angle(b);
    (distance / baseline.max(f64::MIN_POSITIVE), angle)
}

/// Medians of the deviations as standard deviations of a component.
pub(super) fn spread_of(
    poses: &[RelativePose],
    average: &RelativePose,
    assumed_baseline: Option<f64>,
) -> (f64, f64) {
    let baseline = assumed_baseline.unwrap_or_else(|| average.translation.norm());
    let (mut ts, mut rs): (Vec<f64>, Vec<f64>) =
        poses.iter().map(|pose| deviation(pose, average, baseline)).unzip();
    let sigma = |norms: &mut [f64]| median(norms).unwrap_or(0.0) / MEDIAN_OF_THREE;
    (sigma(&mut ts), sigma(&mut rs))
}

/// The median length of a vector of three unit normals.
const MEDIAN_OF_THREE: f64 = 1.538;
