//! The part of `report.json` on rigs.

use serde::{Deserialize, Serialize};
use tiepoint_sfm::rig::{RelativePose, RelativePoseStatistics, paper, relative_pose_statistics};
use tiepoint_sfm::rigs::{
    CalibratedCamera, CalibratedRig, ConstraintLimit, RigConstraint, RigPair, RigPairs,
    relative_poses, rig_pairs,
};
use tiepoint_sfm::scene::{CameraId, ImagePair, Reconstruction};
use tiepoint_sfm::{MappedModel, RigMode};

use crate::workspace::image_names::stream_of;
use crate::workspace::rig_file::{ConstraintKind, RigFile};

/// Relative poses and extrinsics of two or more cameras with synchronous images.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct RigReport {
    /// The value of `--rig`: off, paper, soft, rigid or auto; known with `--rig-calibration`.
    pub mode: String,
    /// Relative-pose statistics of the first camera with each other one.
    pub cameras: Vec<RigCameraReport>,
    /// With `--rig paper`: the constraint in the units of this model.
    pub paper: Option<PaperReport>,
    /// With soft, rigid and auto: the estimated extrinsics.
    pub extrinsics: Option<ExtrinsicsReport>,
}

/// The rig extrinsics of a model, and the constraint that was chosen.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct ExtrinsicsReport {
    /// The chosen constraint: soft, rigid, or `None` for off.
    pub chosen: Option<ConstraintKind>,
    /// The reason for the choice, in one sentence.
    pub reason: String,
    /// With soft: standard deviation of each coordinate of the centre, as a fraction of the
    /// baseline; the largest of a camera.
    pub sigma_translation: Option<f64>,
    /// With soft: standard deviation of each component of the rotation vector, in degrees.
    pub sigma_rotation_deg: Option<f64>,
    /// Reprojection error of held-out tracks without a rig constraint, in pixels.
    pub held_out_error_off_px: f64,
    /// Reprojection error of held-out tracks with the chosen constraint, in pixels.
    pub held_out_error_px: f64,
    /// Standard deviation of the relative change from the one error to the other, over parts of the
    /// drive.
    #[serde(default)]
    pub held_out_change_sd: Option<f64>,
    /// Folders of the cameras that permit no constraint although others do.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unconstrained: Vec<String>,
    /// Image pairs of one frame whose relative pose contradicts the extrinsics, both in the model
    /// and by their own matches.
    pub bad_pairs: Vec<[String; 2]>,
    /// A repaired split of the model, if there was one.
    #[serde(default)]
    pub split: Option<SplitReport>,
    /// Extrinsics and time offsets, as in `rig.json`.
    pub rig: Option<RigFile>,
}

/// A repaired split: images without matches to the other cameras had wrong poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct SplitReport {
    /// Number of images that were moved to the poses that the extrinsics give.
    pub images: usize,
    /// Number of pairs with these images that matched afterwards. If it is 0, only the extrinsics
    /// determine their poses.
    pub pairs_matched_again: usize,
}

/// Smallest baseline relative to the distance of the cameras from the origin: rounding errors are a
/// millionth of it.
const MIN_BASELINE: f64 = 1e-9;

/// Statistics of the relative pose of two cameras over all frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct RigCameraReport {
    /// Folders of the two cameras.
    pub names: [String; 2],
    /// N_t: number of frames with an image of both cameras, or, with unsynchronised cameras, with
    /// an image of the second and a (synchronous or interpolated) reference pose.
    pub pairs: usize,
    /// N_p: number of these frames with both poses; with estimated extrinsics, number of the frames
    /// that they constrain.
    pub reconstructed_pairs: usize,
    /// Median distance of the two cameras, in units of the model.
    pub median_baseline: f64,
    /// Standard deviation of the distance over its mean.
    pub relative_baseline_sd: f64,
    /// Root mean square distance of the second camera's centre from its mean, in the frame of the
    /// first camera, over the mean distance.
    pub relative_translation_rms: f64,
    /// Root mean square angle between the relative rotations and their mean, in degrees.
    pub rotation_rms_deg: f64,
    /// Mean distance in the second half of the drive over that in the first half: 1 without scale
    /// drift, and without a baseline.
    pub second_over_first_half: f64,
    /// With a soft constraint: standard deviation of each coordinate of the centre, as a fraction
    /// of the baseline.
    #[serde(default)]
    pub sigma_translation: Option<f64>,
    /// With a soft constraint: standard deviation of each component of the rotation vector, in
    /// degrees.
    #[serde(default)]
    pub sigma_rotation_deg: Option<f64>,
}

/// λ of Huang, Elhashash & Qin 2022 (Eq. 2), which depends on the unit of length.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct PaperReport {
    /// The initial pair: its distance is the unit of length. The gauge fixes the pose of the first
    /// image and one coordinate of the second.
    pub unit_images: [String; 2],
    /// Final distance of the initial pair, in units of the model.
    pub unit_distance: f64,
    /// λ while mapping, when all pairs are reconstructed.
    pub lambda: f64,
    /// λ as a standard deviation of the translation between consecutive frames, in units of the
    /// model.
    pub sigma_translation: f64,
    /// `sigma_translation` over the median baseline; `None` for cameras with one centre.
    pub relative_sigma_translation: Option<f64>,
    /// λ as a standard deviation of the rotation between consecutive frames, in degrees.
    pub sigma_rotation_deg: f64,
    /// Image pairs that Eq. (4) classifies as incorrectly estimated in the final model: λ_i = 500,
    /// not 250.
    pub bad_pairs: Vec<[String; 2]>,
}

impl ExtrinsicsReport {
    /// The change of the error of held-out tracks by the constraint, with its standard deviation.
    pub fn held_out_change(&self) -> Option<String> {
        let sd = 100.0 * self.held_out_change_sd?;
        let percent = 100.0 * (self.held_out_error_px / self.held_out_error_off_px - 1.0);
        // Not "-0.0".
        let percent = (10.0 * percent).round() / 10.0 + 0.0;
        Some(format!("{percent:+.1} ± {sd:.1} %"))
    }
}

impl RigReport {
    /// The report on the rig of a model; `None` for a single camera. `metres_per_unit` is the
    /// length of the unit that the model had while mapping; 1 if the model was not scaled.
    /// `is_known`: the extrinsics come from a file, and `mode` has no effect.
    pub(crate) fn new(
        mode: RigMode,
        is_known: bool,
        mapped: &MappedModel,
        metres_per_unit: f64,
    ) -> Option<Self> {
        let MappedModel { reconstruction: model, initial_pair, rig, .. } = mapped;
        let rigs = rig_pairs(model);
        let series: Vec<(&RigPairs, Vec<(RigPair, RelativePose)>)> =
            rigs.iter().map(|rig| (rig, relative_poses(model, &rig.pairs))).collect();
        let calibrated = rig.as_ref().map_or(&[][..], |rig| &rig.cameras);
        let mut cameras: Vec<RigCameraReport> =
            calibrated.iter().filter_map(|camera| calibrated_camera(model, camera)).collect();
        // Without estimated time offsets, the images nearest in time form a frame.
        let is_uncalibrated =
            |rig: &RigPairs| calibrated.iter().all(|camera| camera.sensor_pair.other != rig.other);
        cameras.extend(
            series
                .iter()
                .filter(|(rig, _)| is_uncalibrated(rig))
                .filter_map(|(rig, poses)| uncalibrated_camera(model, rig, poses)),
        );
        let mode_name = match mode {
            _ if is_known => "known",
            mode => mode.name(),
        };
        let paper = match mode {
            RigMode::Paper if !is_known => initial_pair
                .and_then(|pair| paper_report(model, &series, &cameras, pair, metres_per_unit)),
            _ => None,
        };
        let extrinsics = rig.as_ref().map(|rig| extrinsics_report(mode, model, rig));
        (!cameras.is_empty()).then(|| Self {
            mode: mode_name.to_owned(),
            cameras,
            paper,
            extrinsics,
        })
    }
}

/// Statistics of two cameras without estimated extrinsics, over the frames with both poses.
fn uncalibrated_camera(
    model: &Reconstruction,
    rig: &RigPairs,
    poses: &[(RigPair, RelativePose)],
) -> Option<RigCameraReport> {
    let relative: Vec<RelativePose> = poses.iter().map(|(_, pose)| *pose).collect();
    Some(camera_report(
        model,
        [rig.reference, rig.other],
        rig.pairs.len(),
        &relative_pose_statistics(&relative)?,
    ))
}

/// Statistics of a camera with estimated extrinsics, over the frames that they constrain.
fn calibrated_camera(model: &Reconstruction, camera: &CalibratedCamera) -> Option<RigCameraReport> {
    let cameras = [camera.sensor_pair.reference, camera.sensor_pair.other];
    let report = camera_report(model, cameras, camera.num_referenced_images, &camera.statistics?);
    let (sigma_translation, sigma_rotation_deg) = sigmas(Some(camera.constraint)).unzip();
    Some(RigCameraReport { sigma_translation, sigma_rotation_deg, ..report })
}

fn camera_report(
    model: &Reconstruction,
    cameras: [CameraId; 2],
    pairs: usize,
    statistics: &RelativePoseStatistics,
) -> RigCameraReport {
    // Cameras with one centre, as of a known rig, have baselines of rounding errors.
    let extent = model.registered().map(|(_, _, pose)| pose.origin_in_a().norm());
    let has_baseline = statistics.mean_baseline > MIN_BASELINE * extent.fold(0.0, f64::max);
    let to_baseline = |value: f64, without: f64| if has_baseline { value } else { without };
    let mean = statistics.mean_baseline;
    RigCameraReport {
        names: cameras.map(|camera| stream_of(model, camera)),
        pairs,
        reconstructed_pairs: statistics.count,
        median_baseline: to_baseline(statistics.median_baseline, 0.0),
        relative_baseline_sd: to_baseline(statistics.sd_baseline / mean, 0.0),
        relative_translation_rms: to_baseline(statistics.rms_translation / mean, 0.0),
        rotation_rms_deg: statistics.rms_rotation_rad.to_degrees(),
        second_over_first_half: to_baseline(statistics.second_over_first_half, 1.0),
        sigma_translation: None,
        sigma_rotation_deg: None,
    }
}

/// The standard deviations of a soft constraint: of the centre in baselines, and of the rotation in
/// degrees.
fn sigmas(constraint: Option<RigConstraint>) -> Option<(f64, f64)> {
    match constraint? {
        RigConstraint::Soft { sigma_translation, sigma_rotation_rad } => {
            Some((sigma_translation, sigma_rotation_rad.to_degrees()))
        }
        RigConstraint::Rigid => None,
    }
}

fn extrinsics_report(
    mode: RigMode,
    model: &Reconstruction,
    rig: &CalibratedRig,
) -> ExtrinsicsReport {
    let CalibratedRig { constraint, error_off_px, error_px, limit, .. } = *rig;
    let name = |image| model.image(image).name.clone();
    let (sigma_translation, sigma_rotation_deg) = sigmas(constraint).unzip();
    let errors = format!("{error_off_px:.3} px without and {error_px:.3} px with it");
    let reason = match (mode, constraint) {
        (RigMode::Auto, None) => {
            "even a weak rig constraint would increase the error of held-out tracks".to_owned()
        }
        (RigMode::Auto, Some(RigConstraint::Rigid)) => {
            format!("exact extrinsics fit held-out tracks as well as weaker ones: {errors}")
        }
        (_, Some(RigConstraint::Soft { sigma_rotation_rad, .. })) => {
            soft_reason(limit, sigma_rotation_rad, &errors)
        }
        _ => format!("as asked for; error of held-out tracks {errors}"),
    };
    ExtrinsicsReport {
        chosen: constraint.map(ConstraintKind::from),
        reason,
        sigma_translation,
        sigma_rotation_deg,
        held_out_error_off_px: error_off_px,
        held_out_error_px: error_px,
        held_out_change_sd: rig.held_out_change.map(|change| change.sd),
        unconstrained: rig.unconstrained.iter().map(|camera| stream_of(model, *camera)).collect(),
        bad_pairs: rig
            .bad_pairs
            .iter()
            .map(|pair| [name(pair.reference), name(pair.other)])
            .collect(),
        split: rig.split.map(|split| SplitReport {
            images: split.num_images,
            pairs_matched_again: split.num_rematched_pairs,
        }),
        // `bad_pairs` of this report has them.
        rig: RigFile::new(model, rig).map(|file| RigFile { bad_pairs: Vec::new(), ..file }),
    }
}

/// Why a constraint is soft, and not tighter.
fn soft_reason(limit: Option<ConstraintLimit>, sigma_rotation_rad: f64, errors: &str) -> String {
    let held_out = format!("error of held-out tracks {errors}");
    match limit {
        Some(ConstraintLimit::HeldOutError { error_px }) => format!(
            "with smaller sigmas the error of held-out tracks would be {error_px:.3} px: {errors}"
        ),
        Some(ConstraintLimit::Residuals) => {
            format!("the relative poses scatter more than smaller sigmas allow; {held_out}")
        }
        Some(ConstraintLimit::FlexibleRotation) => format!(
            "the images contradict a sigma of rotation below {:.3}°, as of a mount that bends, or \
            of a lens that the camera model does not describe; {held_out}",
            sigma_rotation_rad.to_degrees()
        ),
        Some(ConstraintLimit::Unsynchronised) => format!(
            "the cameras are not triggered together, as rigid frames would need; {held_out}"
        ),
        Some(ConstraintLimit::RigidIsWorse { error_px }) => format!(
            "with exact extrinsics the error of held-out tracks would be {error_px:.3} px: {errors}"
        ),
        Some(ConstraintLimit::Smallest) => {
            format!("the sigmas are the smallest, as good as exact extrinsics; {held_out}")
        }
        None => held_out,
    }
}

/// The part of the report on the paper's constraint: its unit of length, its weight as standard
/// deviations, and the pairs that it classifies as bad.
fn paper_report(
    model: &Reconstruction,
    series: &[(&RigPairs, Vec<(RigPair, RelativePose)>)],
    cameras: &[RigCameraReport],
    ImagePair { a, b }: ImagePair,
    metres_per_unit: f64,
) -> Option<PaperReport> {
    let centre = |image| Some(model.image(image).cam_from_world()?.origin_in_a());
    let (centre_a, centre_b) = (centre(a)?, centre(b)?);
    let name = |image| model.image(image).name.clone();
    let sigmas = paper::sigmas(paper::LAMBDA);
    let sigma_translation = metres_per_unit * sigmas.translation;
    let mut bad_pairs = Vec::new();
    for (_, poses) in series {
        let relative: Vec<RelativePose> = poses.iter().map(|(_, pose)| *pose).collect();
        let Some(average) = paper::average(&relative) else { continue };
        let bad = poses.iter().filter(|(_, pose)| paper::is_bad(pose, &average));
        bad_pairs.extend(bad.map(|(pair, _)| [name(pair.reference), name(pair.other)]));
    }
    Some(PaperReport {
        unit_images: [name(a), name(b)],
        unit_distance: (centre_a - centre_b).norm(),
        lambda: paper::LAMBDA,
        sigma_translation,
        relative_sigma_translation: Some(sigma_translation / cameras.first()?.median_baseline)
            .filter(|relative| relative.is_finite()),
        sigma_rotation_deg: sigmas.rotation_rad.to_degrees(),
        bad_pairs,
    })
}

#[cfg(test)]
mod tests {
    use tiepoint_sfm::geometry::nalgebra::{UnitQuaternion, Vector3};
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_sfm::scene::{Camera, Image};

    use super::*;

    #[test]
    fn each_limit_has_its_own_reason() {
        let errors = "0.520 px without and 0.519 px with it";
        let limits = [
            ConstraintLimit::HeldOutError { error_px: 0.61 },
            ConstraintLimit::Residuals,
            ConstraintLimit::FlexibleRotation,
            ConstraintLimit::Unsynchronised,
            ConstraintLimit::RigidIsWorse { error_px: 0.58 },
            ConstraintLimit::Smallest,
        ];
        let reasons: Vec<String> =
            limits.iter().map(|limit| soft_reason(Some(*limit), 0.001, errors)).collect();
        assert!(reasons.iter().all(|reason| reason.ends_with(errors)), "{reasons:#?}");
        assert!(reasons[0].contains("0.610 px") && reasons[4].contains("0.580 px"), "{reasons:#?}");
        assert!(reasons[2].contains("below 0.057°"), "{reasons:#?}");
        // Only two say that the error would increase: it decreased in the others.
        let increases = |reason: &&String| reason.contains("would be");
        assert_eq!(reasons.iter().filter(increases).count(), 2, "{reasons:#?}");
        let mut distinct = reasons.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), limits.len());
    }

    /// A known rig whose cameras have one centre, a hundred units from the origin: 1e-9 of that is
    /// 1e-7.
    #[test]
    fn cameras_with_one_centre_have_finite_statistics() {
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::Pinhole, 500.0, 640, 480);
        let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: false };
        let cameras = [0, 1].map(|_| model.add_camera(camera));
        for camera in cameras {
            let image = model.add_image(Image::new(format!("{camera:?}/1.png"), camera, vec![]));
            let translation = 100.0 * Vector3::x();
            model.register(image, Rigid3::new(UnitQuaternion::identity(), translation));
        }
        for (mean_baseline, expected) in [(0.0, 0.0), (0.9e-7, 0.0), (1.1e-7, 1.0)] {
            let statistics = RelativePoseStatistics {
                count: 2,
                median_baseline: mean_baseline,
                mean_baseline,
                sd_baseline: mean_baseline,
                rms_translation: mean_baseline,
                rms_rotation_rad: 0.0,
                second_over_first_half: mean_baseline / mean_baseline,
            };
            let report = camera_report(&model, cameras, 2, &statistics);
            assert_eq!(report.relative_translation_rms, expected);
            assert_eq!(report.second_over_first_half, 1.0);
        }
    }
}
