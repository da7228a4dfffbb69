//! The size of a model, from one distance that is known: that of the first camera and the one that
//! rides beside it.
//!
//! Images do not tell how large the world is. Where the two cameras were held to a mounting, its
//! length is that distance; else it is the robust mean of their relative poses at the moments that
//! times, motion or names give ([`tiepoint_sfm::rig_sensors`]). Either comes from the finished
//! model, so every model of a workspace is of the same scale as far as it can see both cameras.

use serde::{Deserialize, Serialize};
use tiepoint_sfm::geometry::Sim3;
use tiepoint_sfm::geometry::nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tiepoint_sfm::geometry::numeric::median;
use tiepoint_sfm::rig::{RelativePose, robust_average};
use tiepoint_sfm::scene::Reconstruction;
use tiepoint_sfm::{
    CalibratedCamera, ExtrinsicsCovariance, MappedModel, ReferencedImage, RigSensor, rig_sensors,
};

use crate::image_names::folder_of;

/// What a known distance of two cameras made of a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScaleReport {
    /// The distance that was given, in metres.
    pub baseline_m: f64,
    /// What every length was multiplied by; lengths are in metres now. `None` where the model keeps
    /// its own unit.
    pub factor: Option<f64>,
    /// What the factor comes from, or why there is none, in one sentence.
    pub why: String,
}

/// Fewer moments are no measurement.
const MIN_MOMENTS: usize = 2;

/// Scales each model so that its first camera and the next are `baseline_m` apart, with its
/// mountings. Where a model has none, the clocks of the largest one that has serve it.
pub(crate) fn scale_to_baseline(models: &mut [MappedModel], baseline_m: f64) -> Vec<ScaleReport> {
    let mounted =
        models.iter().filter_map(|model| model.rig.as_ref()).find(|rig| !rig.cameras.is_empty());
    let known: Vec<RigSensor> = mounted
        .map_or(Vec::new(), |rig| rig.cameras.iter().map(|camera| camera.rig_sensor).collect());
    models.iter_mut().map(|model| scale_model(model, &known, baseline_m)).collect()
}

fn scale_model(model: &mut MappedModel, known: &[RigSensor], baseline_m: f64) -> ScaleReport {
    let MappedModel { reconstruction, rig, row_poses, .. } = model;
    let found = match rig.as_ref().and_then(|rig| rig.cameras.first()) {
        Some(camera) => length_of_mounting(reconstruction, camera),
        None => length_of_pairs(reconstruction, known),
    };
    let scaled = found.and_then(|(units, what)| {
        let factor = baseline_m / units;
        if factor.is_normal() {
            Ok((factor, what))
        } else {
            Err("the two cameras are at one place".to_owned())
        }
    });
    let (factor, what) = match scaled {
        Ok(scaled) => scaled,
        Err(why) => {
            let why = format!("nothing was scaled, since {why}");
            return ScaleReport { baseline_m, factor: None, why };
        }
    };
    let (rotation, translation) = (UnitQuaternion::identity(), Vector3::zeros());
    reconstruction.transform(&Sim3 { scale: factor, rotation, translation });
    row_poses.values_mut().for_each(|rows| rows.velocity_in_world *= factor);
    let cameras = rig.iter_mut().flat_map(|rig| &mut rig.cameras);
    cameras.enumerate().for_each(|(k, camera)| scale_mounting(camera, factor, k == 0));
    ScaleReport { baseline_m, factor: Some(factor), why: format!("{what} is {baseline_m} m long") }
}

/// A length in units of the model, and of what.
type Length = (f64, String);

fn length_of_mounting(model: &Reconstruction, camera: &CalibratedCamera) -> Result<Length, String> {
    let [left, right] =
        [camera.rig_sensor.left, camera.rig_sensor.right].map(|camera| folder_of(model, camera));
    Ok((
        camera.right_from_left.translation.norm(),
        format!("the mounting of {right} beside {left}"),
    ))
}

/// That of the robust mean of the relative poses.
fn length_of_pairs(model: &Reconstruction, known: &[RigSensor]) -> Result<Length, String> {
    let found = if known.is_empty() { rig_sensors(model) } else { Vec::new() };
    let rig_sensor = known.iter().chain(&found).next().ok_or("there is only one camera")?;
    let [left, right] = [rig_sensor.left, rig_sensor.right].map(|camera| folder_of(model, camera));
    let moments = rig_sensor.referenced_images(model);
    let pose = |moment: &ReferencedImage| moment.relative_pose(model, &rig_sensor.clock);
    let poses: Vec<RelativePose> = moments.iter().filter_map(pose).collect();
    let count = poses.len();
    let too_few = || {
        format!(
            "{left} and {right} have poses at {count} common moments, and {MIN_MOMENTS} are needed"
        )
    };
    let average = robust_average(&poses).filter(|_| count >= MIN_MOMENTS).ok_or_else(too_few)?;
    let units = average.translation.norm();
    let mut deviations: Vec<f64> =
        poses.iter().map(|pose| (pose.translation - average.translation).norm()).collect();
    let typical = median(&mut deviations).unwrap_or(f64::INFINITY);
    if typical > units {
        return Err(format!(
            "the place of {right} beside {left} scatters by {typical:.3} units, which is more \
            than their distance of {units:.3}"
        ));
    }
    Ok((units, format!("the mean of {count} relative poses of {right} and {left}")))
}

/// A mounting in the new unit. The length of the first one is given, so nothing is doubtful about
/// it any more.
fn scale_mounting(camera: &mut CalibratedCamera, factor: f64, has_given_length: bool) {
    let translation = camera.right_from_left.translation;
    camera.right_from_left.translation *= factor;
    camera.rig_sensor.assumed_baseline =
        camera.rig_sensor.assumed_baseline.map(|length| factor * length);
    if let Some(covariance) = &mut camera.covariance {
        let across = match translation.try_normalize(0.0) {
            Some(along) if has_given_length => Matrix3::identity() - along * along.transpose(),
            _ => Matrix3::identity(),
        };
        let mut change = ExtrinsicsCovariance::identity();
        change.fixed_view_mut::<3, 3>(3, 3).copy_from(&(across * factor));
        *covariance = change * *covariance * change.transpose();
    }
    if let Some(spread) = &mut camera.statistics {
        spread.median_baseline *= factor;
        spread.mean_baseline *= factor;
        spread.sd_baseline *= factor;
        spread.rms_translation *= factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_sfm::rig::{Clock, RelativePoseStatistics};
    use tiepoint_sfm::scene::{Camera, CameraId, Image, ImageId, ImagePair, Track};
    use tiepoint_sfm::{CalibratedRig, ClockState, RigConstraint};

    /// Far above rounding.
    const EPSILON: f64 = 1e-12;
    const ASKED_M: f64 = 0.62;
    /// Distance of the cameras, in units.
    const APART: f64 = 2.0;

    /// Two cameras at moments one unit apart, the second one aside by `APART` and what `jitter`
    /// says.
    fn model(moments: u32, jitter: impl Fn(u32) -> f64) -> Reconstruction {
        let mut model = Reconstruction::default();
        for (folder, aside) in [("left", 0.0), ("right", APART)] {
            let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
            let camera = model.add_camera(Camera {
                intrinsics,
                width: 640,
                height: 480,
                has_focal_prior: true,
            });
            for moment in 0..moments {
                let image = model.add_image(Image::new(
                    format!("{folder}/{moment:03}.png"),
                    camera,
                    Vec::new(),
                ));
                let aside = if aside > 0.0 { aside + jitter(moment) } else { 0.0 };
                let centre = Vector3::new(aside, 0.0, f64::from(moment));
                model.register(image, Rigid3::new(UnitQuaternion::identity(), -centre));
            }
        }
        model.add_track(Track::new(Vector3::new(1.0, 2.0, 3.0), Vec::new()));
        model
    }

    fn mounted() -> CalibratedCamera {
        CalibratedCamera {
            rig_sensor: RigSensor {
                left: CameraId(0),
                right: CameraId(1),
                clock: Clock::default(),
                clock_state: ClockState::Synchronised,
                assumed_baseline: None,
                unobservable_direction: None,
            },
            right_from_left: Rigid3::new(
                UnitQuaternion::identity(),
                Vector3::new(-APART, 0.0, 0.0),
            ),
            covariance: Some(ExtrinsicsCovariance::identity()),
            constraint: RigConstraint::Rigid,
            num_referenced_images: 5,
            statistics: Some(RelativePoseStatistics {
                count: 5,
                median_baseline: APART,
                mean_baseline: APART,
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
        };
        let mut models = [MappedModel {
            reconstruction: model.clone(),
            initial_pair: ImagePair::new(ImageId(0), ImageId(1)).unwrap(),
            rig: Some(rig),
            shutters: Vec::new(),
            row_poses: BTreeMap::new(),
            num_loop_pairs: 0,
            failures: Vec::new(),
        }];
        let report = scale_to_baseline(&mut models, ASKED_M).remove(0);
        let [model] = models;
        (model, report)
    }

    #[test]
    fn a_mounting_gets_the_length_that_was_given_and_everything_with_it() {
        let (scaled, report) = scale(&model(5, |_| 0.0), vec![mounted()]);
        let factor = ASKED_M / APART;
        assert!((report.factor.unwrap() - factor).abs() < EPSILON);
        assert_eq!(report.why, "the mounting of right beside left is 0.62 m long");
        let (_, track) = scaled.reconstruction.tracks().next().unwrap();
        assert!((track.xyz - Vector3::new(1.0, 2.0, 3.0) * factor).norm() < EPSILON);
        let last = scaled.reconstruction.registered().last().unwrap().2.origin_in_a();
        assert!((last - Vector3::new(APART, 0.0, 4.0) * factor).norm() < EPSILON);
        let camera = &scaled.rig.unwrap().cameras[0];
        assert!((camera.right_from_left.translation.norm() - ASKED_M).abs() < EPSILON);
        assert!((camera.statistics.unwrap().median_baseline - ASKED_M).abs() < EPSILON);
        assert!((camera.statistics.unwrap().rms_rotation_rad - 0.01).abs() < EPSILON);
        // Its length is certain now, its direction as doubtful as before; rotation and clock are
        // not touched.
        let covariance = camera.covariance.unwrap();
        let expected = [1.0, 1.0, 1.0, 0.0, factor * factor, factor * factor, 1.0, 1.0];
        expected.iter().enumerate().for_each(|(k, value)| {
            assert!((covariance[(k, k)] - value).abs() < EPSILON, "{k}: {covariance}");
        });
    }

    #[test]
    fn without_a_mounting_the_pairs_tell_and_one_wrong_pair_changes_nothing() {
        let jitter = |moment| if moment == 3 { 50.0 } else { 0.0 };
        let (_, report) = scale(&model(9, jitter), Vec::new());
        // What Weiszfeld's iteration leaves of one pair in nine.
        assert!((report.factor.unwrap() / (ASKED_M / APART) - 1.0).abs() < 1e-6, "{report:?}");
        assert!(
            report.why.starts_with("the mean of 9 relative poses of right and left"),
            "{report:?}"
        );
    }

    #[test]
    fn what_tells_no_length_leaves_the_model_and_says_why() {
        let lone = {
            let mut lone = Reconstruction::default();
            let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
            lone.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
            lone
        };
        for (model, part) in [
            (lone, "only one camera"),
            (model(1, |_| 0.0), "at 1 common moments"),
            (model(5, |moment| 10.0 * (f64::from(moment) - 2.0)), "scatters by"),
            (model(5, |_| -APART), "at one place"),
        ] {
            let (same, report) = scale(&model, Vec::new());
            assert_eq!(report.factor, None, "{report:?}");
            assert!(
                report.why.starts_with("nothing was scaled, since ") && report.why.contains(part),
                "{report:?}"
            );
            assert!(
                same.reconstruction.registered().zip(model.registered()).all(|(a, b)| a.2 == b.2)
            );
        }
    }
}
