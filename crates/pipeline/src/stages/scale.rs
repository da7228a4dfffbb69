//! Metric scale of a model from the known distance of its first two cameras.
//!
//! The baseline in model units is that of the estimated rig extrinsics. Without extrinsics it is
//! that of the robust mean of the relative poses over all frames, which come from times, motion or
//! names ([`tiepoint_sfm::rigs::sensor_pairs`]). Each model of a workspace is scaled by its own
//! baseline.

use tiepoint_sfm::MappedModel;
use tiepoint_sfm::geometry::Sim3;
use tiepoint_sfm::geometry::nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tiepoint_sfm::geometry::numeric::median;
use tiepoint_sfm::rig::{RelativePose, robust_average};
use tiepoint_sfm::rigs::{
    CalibratedCamera, ExtrinsicsCovariance, ReferencedImage, SensorPair, sensor_pairs,
};
use tiepoint_sfm::scene::Reconstruction;

use crate::workspace::image_names::stream_of;
use crate::workspace::report::ScaleReport;

/// Minimum number of frames for a mean relative pose.
const MIN_FRAMES: usize = 2;

/// Scales each model and its rig extrinsics, so that its first two cameras are `baseline_m` apart.
/// A model without extrinsics uses the clocks of the largest model that has some. `has_positions`:
/// they may scale a model that the baseline does not.
pub(crate) fn scale_to_baseline(
    models: &mut [MappedModel],
    baseline_m: f64,
    has_positions: bool,
) -> Vec<ScaleReport> {
    let calibrated =
        models.iter().filter_map(|model| model.rig.as_ref()).find(|rig| !rig.cameras.is_empty());
    let known: Vec<SensorPair> = calibrated
        .map_or(Vec::new(), |rig| rig.cameras.iter().map(|camera| camera.sensor_pair).collect());
    let unscaled =
        if has_positions { "the baseline sets no scale" } else { "the model was not scaled" };
    let scaled = models.iter_mut().map(|model| {
        scale_model(model, &known, baseline_m).unwrap_or_else(|why| ScaleReport {
            baseline_m,
            factor: None,
            reason: format!("{unscaled}, because {why}"),
        })
    });
    scaled.collect()
}

/// An error is the end of "because …".
fn scale_model(
    model: &mut MappedModel,
    known: &[SensorPair],
    baseline_m: f64,
) -> Result<ScaleReport, String> {
    let MappedModel { reconstruction, rig, row_poses, .. } = model;
    let baseline = match rig.as_ref().and_then(|rig| rig.cameras.first()) {
        Some(camera) => Ok(extrinsics_baseline(reconstruction, camera)),
        None => mean_baseline(reconstruction, known),
    };
    let (units, source) = baseline?;
    let factor = baseline_m / units;
    if !factor.is_normal() {
        return Err("the two cameras are at the same position".to_owned());
    }
    let (rotation, translation) = (UnitQuaternion::identity(), Vector3::zeros());
    reconstruction.transform(&Sim3 { scale: factor, rotation, translation });
    row_poses.values_mut().for_each(|rows| rows.velocity_in_world *= factor);
    let cameras = rig.iter_mut().flat_map(|rig| &mut rig.cameras);
    cameras.enumerate().for_each(|(k, camera)| scale_extrinsics(camera, factor, k == 0));
    Ok(ScaleReport {
        baseline_m,
        factor: Some(factor),
        reason: format!("{source} is {baseline_m} m long"),
    })
}

/// A baseline in units of the model, and its source in words.
type Baseline = (f64, String);

/// The baseline of estimated rig extrinsics.
fn extrinsics_baseline(model: &Reconstruction, camera: &CalibratedCamera) -> Baseline {
    let [reference, other] = [camera.sensor_pair.reference, camera.sensor_pair.other]
        .map(|camera| stream_of(model, camera));
    (
        camera.cam_from_rig.translation.norm(),
        format!("the baseline from {reference} to {other} in the rig extrinsics"),
    )
}

/// The baseline of the robust mean of the relative poses; an error is the end of "because …".
fn mean_baseline(model: &Reconstruction, known: &[SensorPair]) -> Result<Baseline, String> {
    let found = if known.is_empty() { sensor_pairs(model) } else { Vec::new() };
    let sensor_pair = known.iter().chain(&found).next().ok_or("there is only one camera")?;
    let [reference, other] =
        [sensor_pair.reference, sensor_pair.other].map(|camera| stream_of(model, camera));
    let images = sensor_pair.referenced_images(model);
    let pose = |image: &ReferencedImage| image.relative_pose(model, &sensor_pair.clock);
    let poses: Vec<RelativePose> = images.iter().filter_map(pose).collect();
    let count = poses.len();
    let too_few = || {
        format!(
            "{reference} and {other} have poses at {count} common frames, and {MIN_FRAMES} are \
            needed"
        )
    };
    let average = robust_average(&poses).filter(|_| count >= MIN_FRAMES).ok_or_else(too_few)?;
    let units = average.translation.norm();
    let mut deviations: Vec<f64> =
        poses.iter().map(|pose| (pose.translation - average.translation).norm()).collect();
    let deviation = median(&mut deviations).unwrap_or(f64::INFINITY);
    if deviation > units {
        return Err(format!(
            "the position of {other} relative to {reference} has a median deviation of \
            {deviation:.3} units, more than their distance of {units:.3}"
        ));
    }
    Ok((
        units,
        format!("the baseline from {reference} to {other} in the mean of {count} relative poses"),
    ))
}

/// Scales extrinsics and their covariance. The first baseline is given (`has_given_length`), so
/// that its length gets zero variance.
pub(crate) fn scale_extrinsics(camera: &mut CalibratedCamera, factor: f64, has_given_length: bool) {
    let translation = camera.cam_from_rig.translation;
    camera.cam_from_rig.translation *= factor;
    camera.sensor_pair.assumed_baseline =
        camera.sensor_pair.assumed_baseline.map(|length| factor * length);
    if let Some(covariance) = &mut camera.covariance {
        let projection = match translation.try_normalize(0.0) {
            Some(direction) if has_given_length => {
                Matrix3::identity() - direction * direction.transpose()
            }
            _ => Matrix3::identity(),
        };
        let mut jacobian = ExtrinsicsCovariance::identity();
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&(projection * factor));
        *covariance = jacobian * *covariance * jacobian.transpose();
    }
    if let Some(statistics) = &mut camera.statistics {
        statistics.median_baseline *= factor;
        statistics.mean_baseline *= factor;
        statistics.sd_baseline *= factor;
        statistics.rms_translation *= factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_sfm::rig::RelativePoseStatistics;
    use tiepoint_sfm::rigs::{CalibratedRig, RigConstraint};
    use tiepoint_sfm::scene::{Camera, CameraId, Image, ImageId, ImagePair, Track};

    /// Far above rounding errors.
    const EPSILON: f64 = 1e-12;
    const BASELINE_M: f64 = 0.62;
    /// Distance of the cameras, in units of the model.
    const BASELINE: f64 = 2.0;

    /// Two cameras with poses at frames one unit apart. The second camera is at x = `BASELINE` +
    /// `jitter(frame)`.
    fn model(frames: u32, jitter: impl Fn(u32) -> f64) -> Reconstruction {
        let mut model = Reconstruction::default();
        for (folder, x) in [("left", 0.0), ("right", BASELINE)] {
            let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
            let camera = model.add_camera(Camera {
                intrinsics,
                width: 640,
                height: 480,
                has_focal_prior: true,
            });
            for frame in 0..frames {
                let image = model.add_image(Image::new(
                    format!("{folder}/{frame:03}.png"),
                    camera,
                    Vec::new(),
                ));
                let x = if x > 0.0 { x + jitter(frame) } else { 0.0 };
                let centre = Vector3::new(x, 0.0, f64::from(frame));
                model.register(image, Rigid3::new(UnitQuaternion::identity(), -centre));
            }
        }
        model.add_track(Track::new(Vector3::new(1.0, 2.0, 3.0), Vec::new()));
        model
    }

    fn calibrated_camera() -> CalibratedCamera {
        CalibratedCamera {
            sensor_pair: SensorPair::synchronised(CameraId(0), CameraId(1)),
            cam_from_rig: Rigid3::new(
                UnitQuaternion::identity(),
                Vector3::new(-BASELINE, 0.0, 0.0),
            ),
            covariance: Some(ExtrinsicsCovariance::identity()),
            constraint: RigConstraint::Rigid,
            num_referenced_images: 5,
            statistics: Some(RelativePoseStatistics {
                count: 5,
                median_baseline: BASELINE,
                mean_baseline: BASELINE,
                sd_baseline: 0.2,
                rms_translation: 0.1,
                rms_rotation_rad: 0.01,
                second_over_first_half: 1.0,
            }),
        }
    }

    fn scale(model: &Reconstruction, cameras: Vec<CalibratedCamera>) -> (MappedModel, ScaleReport) {
        let rig = CalibratedRig {
            constraint: cameras.first().map(|camera| camera.constraint),
            cameras,
            bad_pairs: Vec::new(),
            split: None,
            error_off_px: 1.0,
            error_px: 1.0,
            held_out_change: None,
            unconstrained: Vec::new(),
            limit: None,
        };
        let mut models = [MappedModel {
            reconstruction: model.clone(),
            initial_pair: ImagePair::new(ImageId(0), ImageId(1)),
            is_in_frame_of_terms: false,
            rig: Some(rig),
            calibration_evidence: BTreeMap::new(),
            intrinsics_sds: BTreeMap::new(),
            shutters: Vec::new(),
            row_poses: BTreeMap::new(),
            num_loop_pairs: 0,
            other_places: Vec::new(),
            failures: Vec::new(),
        }];
        let report = scale_to_baseline(&mut models, BASELINE_M, false).remove(0);
        let [model] = models;
        (model, report)
    }

    #[test]
    fn model_and_extrinsics_are_scaled_to_the_given_baseline() {
        let (scaled, report) = scale(&model(5, |_| 0.0), vec![calibrated_camera()]);
        let factor = BASELINE_M / BASELINE;
        assert!((report.factor.unwrap() - factor).abs() < EPSILON);
        assert_eq!(
            report.reason,
            "the baseline from left to right in the rig extrinsics is 0.62 m long"
        );
        let (_, track) = scaled.reconstruction.tracks().next().unwrap();
        assert!((track.xyz - Vector3::new(1.0, 2.0, 3.0) * factor).norm() < EPSILON);
        let last = scaled.reconstruction.registered().last().unwrap().2.origin_in_a();
        assert!((last - Vector3::new(BASELINE, 0.0, 4.0) * factor).norm() < EPSILON);
        let camera = &scaled.rig.unwrap().cameras[0];
        assert!((camera.cam_from_rig.translation.norm() - BASELINE_M).abs() < EPSILON);
        assert!((camera.statistics.unwrap().median_baseline - BASELINE_M).abs() < EPSILON);
        assert!((camera.statistics.unwrap().rms_rotation_rad - 0.01).abs() < EPSILON);
        // The length has no variance now; the direction has that of before; rotation and clock are
        // unchanged.
        let covariance = camera.covariance.unwrap();
        let expected = [1.0, 1.0, 1.0, 0.0, factor * factor, factor * factor, 1.0, 1.0];
        expected.iter().enumerate().for_each(|(k, value)| {
            assert!((covariance[(k, k)] - value).abs() < EPSILON, "{k}: {covariance}");
        });
    }

    #[test]
    fn without_extrinsics_the_robust_mean_determines_the_scale() {
        let jitter = |frame| if frame == 3 { 50.0 } else { 0.0 };
        let (_, report) = scale(&model(9, jitter), Vec::new());
        // Weiszfeld's iteration leaves an error from the one outlier in nine.
        assert!(
            (report.factor.unwrap() / (BASELINE_M / BASELINE) - 1.0).abs() < 1e-6,
            "{report:?}"
        );
        assert!(
            report.reason.contains("from left to right in the mean of 9 relative poses"),
            "{report:?}"
        );
    }

    #[test]
    fn model_without_a_known_baseline_is_not_scaled_and_the_report_says_why() {
        let lone = {
            let mut lone = Reconstruction::default();
            let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
            lone.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
            lone
        };
        for (model, part) in [
            (lone, "only one camera"),
            (model(1, |_| 0.0), "at 1 common frames"),
            (model(5, |frame| 10.0 * (f64::from(frame) - 2.0)), "median deviation of"),
            (model(5, |_| -BASELINE), "at the same position"),
        ] {
            let (same, report) = scale(&model, Vec::new());
            assert_eq!(report.factor, None, "{report:?}");
            assert!(
                report.reason.starts_with("the model was not scaled, because ")
                    && report.reason.contains(part),
                "{report:?}"
            );
            assert!(
                same.reconstruction.registered().zip(model.registered()).all(|(a, b)| a.2 == b.2)
            );
        }
    }
}
