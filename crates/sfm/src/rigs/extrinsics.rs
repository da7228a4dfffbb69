//! Extrinsics of a camera relative to the reference camera, and the constraint on the relative
//! poses.

use tiepoint_ba::Factor;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{SMatrix, Vector3, Vector6};
use tiepoint_geometry::numeric::median;
use tiepoint_rig::{Clock, RelativePose, SynchronousExtrinsics};
use tiepoint_scene::{ImageId, Reconstruction};

use super::autocorrelation_time::autocorrelation_time;
use super::sensor_pair::{ReferencedImage, SensorPair};

/// Extrinsics of a camera relative to the reference camera, with the images that they constrain.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RigExtrinsics {
    /// The cameras and the clock, which is estimated if its state says so.
    pub sensor_pair: SensorPair,
    /// The constrained images.
    pub referenced_images: Vec<ReferencedImage>,
    /// Extrinsics: initial value, and estimate after an adjustment.
    pub cam_from_rig: Rigid3,
    /// Constraint on the relative poses.
    pub constraint: RigConstraint,
    /// Those of the images that belong to a split of the model.
    pub(crate) split_images: Vec<SplitImage>,
}

/// Constraint of the relative poses of two cameras to their extrinsics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RigConstraint {
    /// A residual per image.
    Soft {
        /// Standard deviation of each coordinate of the centre, in baselines, or in units of
        /// [`SensorPair::assumed_baseline`] if that is set.
        sigma_translation: f64,
        /// Standard deviation of each component of the rotation, in radians.
        sigma_rotation_rad: f64,
    },
    /// The other camera's pose is composed of the reference camera's pose and the extrinsics. It is
    /// no variable of its own.
    Rigid,
}

impl RigConstraint {
    pub(super) fn soft(sigmas: (f64, f64)) -> Self {
        Self::Soft { sigma_translation: sigmas.0, sigma_rotation_rad: sigmas.1 }
    }

    /// Multiplies the standard deviations by `factor`.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        match self {
            Self::Soft { sigma_translation, sigma_rotation_rad } => {
                Self::soft((factor * sigma_translation, factor * sigma_rotation_rad))
            }
            Self::Rigid => Self::Rigid,
        }
    }
}

/// Covariance of the extrinsics and the clock. Order: rotation (radians, R ← Exp(δ) R), translation
/// (units of the model), offset (seconds), drift (no unit).
pub type ExtrinsicsCovariance = SMatrix<f64, 8, 8>;

/// An image of a split, and the nearest image of the reference camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct SplitImage {
    pub(crate) image: ImageId,
    pub(crate) reference: ImageId,
}

impl SplitImage {
    pub(crate) fn new(referenced: &ReferencedImage, clock: &Clock) -> Self {
        Self { image: referenced.image, reference: referenced.nearest_reference(clock) }
    }
}

/// A soft constraint is consistent if the median residual is within this many standard deviations.
/// Wrong clocks and flexible mounts are not consistent at small standard deviations. With a value
/// of 3, the constraint of a swinging mount passed and changed the clock offset by 6 ms.
const MAX_MEDIAN_RESIDUAL: f64 = 2.0;
/// A direction of the centre is unobservable if its standard deviation is larger than this fraction
/// of the assumed baseline. Drift of the models would dominate the estimate.
const MAX_CENTRE_SD: f64 = 0.1;

impl RigExtrinsics {
    /// Multiplies the standard deviations of the constraint and of the interpolated poses by
    /// `factor`.
    pub(crate) fn scaled(&self, factor: f64) -> Self {
        let mut scaled = Self { constraint: self.constraint.scaled(factor), ..self.clone() };
        scaled
            .referenced_images
            .iter_mut()
            .for_each(|referenced| referenced.scale_perturbations(factor));
        scaled
    }

    /// Whitened residuals of the constrained images: translation, then rotation. Empty for a rigid
    /// constraint.
    fn whitened_residuals(&self, model: &Reconstruction) -> Vec<Vector6<f64>> {
        let RigConstraint::Soft { sigma_translation, sigma_rotation_rad } = self.constraint else {
            return Vec::new();
        };
        let synchronous = SynchronousExtrinsics {
            sigma_translation,
            sigma_rotation_rad,
            assumed_baseline: self.sensor_pair.assumed_baseline,
        };
        let whitened = |referenced: &ReferencedImage| {
            let reference = referenced.rig_from_world(model, &self.sensor_pair.clock)?;
            let cam = model.image(referenced.image).cam_from_world()?;
            let residual = synchronous.residual((&reference, cam, &self.cam_from_rig))?;
            Some(referenced.whitening(&synchronous, &reference, &self.cam_from_rig) * residual)
        };
        self.referenced_images.iter().filter_map(whitened).collect()
    }

    /// Whether the median residuals of translation and of rotation are within
    /// [`MAX_MEDIAN_RESIDUAL`].
    pub(super) fn residuals_consistent(&self, model: &Reconstruction) -> [bool; 2] {
        let residuals = self.whitened_residuals(model);
        [0, 3].map(|first| {
            let mut norms: Vec<f64> =
                residuals.iter().map(|r| r.fixed_rows::<3>(first).norm()).collect();
            median(&mut norms).is_none_or(|norm| norm <= MAX_MEDIAN_RESIDUAL * MEDIAN_OF_THREE)
        })
    }

    /// Increases the standard deviations by the square root of the residuals' autocorrelation time.
    /// The residuals of a swinging mount are correlated in time, so n images carry less information
    /// than n independent ones.
    pub(crate) fn with_autocorrelation(&self, model: &Reconstruction) -> Self {
        let RigConstraint::Soft { sigma_translation, sigma_rotation_rad } = self.constraint else {
            return self.clone();
        };
        let residuals = self.whitened_residuals(model);
        let [translation, rotation] = [0, 3].map(|first| {
            let series: Vec<Vector3<f64>> =
                residuals.iter().map(|r| r.fixed_rows::<3>(first).into_owned()).collect();
            autocorrelation_time(&series).sqrt()
        });
        let constraint =
            RigConstraint::soft((translation * sigma_translation, rotation * sigma_rotation_rad));
        Self { constraint, ..self.clone() }
    }

    /// Registers each constrained image at `cam_from_rig` relative to the reference camera.
    pub(super) fn register_images(&self, model: &mut Reconstruction, cam_from_rig: &Rigid3) {
        for referenced in &self.referenced_images {
            if let Some(reference) = referenced.rig_from_world(model, &self.sensor_pair.clock) {
                model.register(referenced.image, *cam_from_rig * reference);
            }
        }
    }

    /// Returns the direction of the camera's centre, in the reference camera's frame, that the
    /// motion does not determine; `None` if all directions are determined.
    pub(super) fn unobservable_direction(
        &self,
        covariance: &ExtrinsicsCovariance,
    ) -> Option<Vector3<f64>> {
        let assumed_baseline = self.sensor_pair.assumed_baseline?;
        // c = -Rᵀ t. The part of the rotation's covariance is smaller by the baseline over a radian
        // and is left out.
        let rotation = self.cam_from_rig.rotation.to_rotation_matrix().into_inner();
        let of_centre = rotation.transpose() * covariance.fixed_view::<3, 3>(3, 3) * rotation;
        let eigen = of_centre.symmetric_eigen();
        let (index, variance) = eigen.eigenvalues.argmax();
        (variance.max(0.0).sqrt() > MAX_CENTRE_SD * assumed_baseline).then(|| {
            let direction = eigen.eigenvectors.column(index);
            // The sign is chosen so that the largest component is positive.
            direction * direction[direction.iamax()].signum()
        })
    }

    /// Adds the variance of the prior along the unobservable direction.
    pub(super) fn with_prior_variance(
        &self,
        mut covariance: ExtrinsicsCovariance,
    ) -> ExtrinsicsCovariance {
        if let SensorPair {
            assumed_baseline: Some(assumed_baseline),
            unobservable_direction: Some(unobservable_direction),
            ..
        } = self.sensor_pair
        {
            let along = self.cam_from_rig.rotation * unobservable_direction * assumed_baseline;
            let mut of_place = covariance.fixed_view_mut::<3, 3>(3, 3);
            of_place += along * along.transpose();
        }
        covariance
    }
}

/// Returns the relative poses of the images for which both cameras have a pose.
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

/// Returns the distance of the centres in baselines and the angle of the relative rotation in
/// radians.
pub(super) fn deviation(a: &RelativePose, b: &RelativePose, baseline: f64) -> (f64, f64) {
    let (distance, angle) = a.distance_and_angle(b);
    (distance / baseline.max(f64::MIN_POSITIVE), angle)
}

/// Robust standard deviations of a component of translation (in baselines) and of rotation
/// (radians), from the medians of the deviations.
pub(super) fn robust_sigmas(
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

/// Median norm of a vector of three standard normal variables.
const MEDIAN_OF_THREE: f64 = 1.538;
