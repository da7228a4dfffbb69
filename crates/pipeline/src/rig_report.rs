//! What the report says about cameras that ride together.

use serde::{Deserialize, Serialize};
use tiepoint_sfm::rig::{RelativePose, RelativePoseStatistics, paper, relative_pose_statistics};
use tiepoint_sfm::scene::{CameraId, ImagePair, Reconstruction};
use tiepoint_sfm::{
    CalibratedCamera, CalibratedRig, MappedModel, RigConstraint, RigPair, RigPairs, RigTerm,
    relative_poses, rig_pairs,
};

use crate::image_names::folder_of;
use crate::rig_file::RigFile;

/// Two or more cameras that took images at the same moments.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RigReport {
    /// What was asked to hold them to each other: off, paper, soft, hard or auto.
    pub mode: String,
    /// The first camera with each other one.
    pub cameras: Vec<RigCameraReport>,
    /// With `--rig paper`: what the constraint meant in this model.
    pub paper: Option<PaperReport>,
    /// With soft, hard and auto: what came of it.
    pub mounting: Option<MountingReport>,
}

/// How firmly the cameras were held to one mounting in the end, and why.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MountingReport {
    /// off, soft or hard.
    pub chosen: String,
    /// The reason, in one sentence.
    pub why: String,
    /// Of soft: standard deviation of each coordinate of the centre, as a share of the baseline.
    pub sigma_translation: Option<f64>,
    /// Of soft: standard deviation of each component of the rotation.
    pub sigma_rotation_deg: Option<f64>,
    /// Error of tracks that took no part, without any mounting.
    pub held_out_error_off_px: f64,
    /// The same in the end.
    pub held_out_error_px: f64,
    /// Images of one moment that agree with the mounting neither in the model nor by their own
    /// matches.
    pub bad_pairs: Vec<[String; 2]>,
    /// Where images without matches with their partners stood elsewhere: how many were brought
    /// back.
    #[serde(default)]
    pub split: Option<SplitReport>,
    /// The calibration with the clocks, as in `rig.json`.
    pub rig: Option<RigFile>,
}

/// A split of the model that the mounting closed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SplitReport {
    /// Images that were brought back to where their mounting has them.
    pub images: usize,
    /// Pairs with them that matched when they were matched again; with none, nothing but the
    /// mounting holds these images.
    pub pairs_matched_again: usize,
}

/// How constant the relative pose of two cameras is, without any truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RigCameraReport {
    /// Their folders.
    pub names: [String; 2],
    /// N_t: moments at which both took an image, or at which the first camera's place is known
    /// where the other took one.
    pub pairs: usize,
    /// N_p: those with both poses; of cameras that are held to a mounting, those at which they are.
    pub reconstructed_pairs: usize,
    /// Distance of the two, in units of the model.
    pub median_baseline: f64,
    /// Standard deviation of the distance over its mean.
    pub relative_baseline_sd: f64,
    /// Root mean square distance of the second camera from its mean place, over the mean distance.
    pub relative_translation_rms: f64,
    /// Root mean square angle from the mean rotation.
    pub rotation_rms_deg: f64,
    /// Mean distance in the second half of the drive over that in the first half: 1 where the scale
    /// does not drift.
    pub second_over_first_half: f64,
}

/// The constraint of Huang, Elhashash & Qin 2022 has a unit: what it was, and how strong λ is in
/// it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PaperReport {
    /// The images whose distance is one unit; the pose of the first one and this distance were
    /// held.
    pub unit_images: [String; 2],
    /// Their distance now, in units: only one coordinate of it is held.
    pub unit_distance: f64,
    /// λ while mapping, of a complete model.
    pub lambda: f64,
    /// The same as a standard deviation between consecutive moments, in units of the model.
    pub sigma_translation: f64,
    /// The same over the median distance of the cameras.
    pub relative_sigma_translation: f64,
    /// The same of the rotation.
    pub sigma_rotation_deg: f64,
    /// Pairs that Eq. (4) took for incorrectly estimated, as it sees the final model; they weigh
    /// 500 and not 250.
    pub bad_pairs: Vec<[String; 2]>,
}

impl RigReport {
    /// `None` for a lone camera.
    /// `factor` is what the lengths of the model were multiplied by after mapping.
    pub(crate) fn new(term: RigTerm, mapped: &MappedModel, factor: f64) -> Option<Self> {
        let MappedModel { reconstruction: model, initial_pair, rig, .. } = mapped;
        let rigs = rig_pairs(model);
        let series: Vec<(&RigPairs, Vec<(RigPair, RelativePose)>)> =
            rigs.iter().map(|rig| (rig, relative_poses(model, &rig.pairs))).collect();
        let mounted = rig.as_ref().map_or(&[][..], |rig| &rig.cameras);
        let mut cameras: Vec<RigCameraReport> =
            mounted.iter().filter_map(|mounted| mounted_camera(model, mounted)).collect();
        // Where clocks are not known, images nearest in time count as of one moment.
        let is_left =
            |rig: &RigPairs| mounted.iter().all(|mounted| mounted.sensor_pair.right != rig.right);
        cameras.extend(
            series
                .iter()
                .filter(|(rig, _)| is_left(rig))
                .filter_map(|(rig, poses)| camera(model, rig, poses)),
        );
        let mode = match term {
            RigTerm::Off => "off",
            RigTerm::Paper => "paper",
            RigTerm::Soft => "soft",
            RigTerm::Hard => "hard",
            RigTerm::Auto => "auto",
        };
        let paper = match term {
            RigTerm::Paper => paper_report(model, &series, &cameras, *initial_pair, factor),
            _ => None,
        };
        let mounting = rig.as_ref().map(|rig| mounting_report(term, model, rig));
        (!cameras.is_empty()).then(|| Self { mode: mode.to_owned(), cameras, paper, mounting })
    }
}

fn camera(
    model: &Reconstruction,
    rig: &RigPairs,
    poses: &[(RigPair, RelativePose)],
) -> Option<RigCameraReport> {
    let relative: Vec<RelativePose> = poses.iter().map(|(_, pose)| *pose).collect();
    Some(camera_report(
        model,
        [rig.left, rig.right],
        rig.pairs.len(),
        &relative_pose_statistics(&relative)?,
    ))
}

/// With its clock: the moments at which it is held.
fn mounted_camera(model: &Reconstruction, mounted: &CalibratedCamera) -> Option<RigCameraReport> {
    let cameras = [mounted.sensor_pair.left, mounted.sensor_pair.right];
    Some(camera_report(model, cameras, mounted.num_referenced_images, &mounted.statistics?))
}

fn camera_report(
    model: &Reconstruction,
    cameras: [CameraId; 2],
    pairs: usize,
    statistics: &RelativePoseStatistics,
) -> RigCameraReport {
    RigCameraReport {
        names: cameras.map(|camera| folder_of(model, camera)),
        pairs,
        reconstructed_pairs: statistics.count,
        median_baseline: statistics.median_baseline,
        relative_baseline_sd: statistics.sd_baseline / statistics.mean_baseline,
        relative_translation_rms: statistics.rms_translation / statistics.mean_baseline,
        rotation_rms_deg: statistics.rms_rotation_rad.to_degrees(),
        second_over_first_half: statistics.second_over_first_half,
    }
}

fn mounting_report(term: RigTerm, model: &Reconstruction, rig: &CalibratedRig) -> MountingReport {
    let CalibratedRig { constraint, error_off_px, error_px, .. } = *rig;
    let name = |image| model.image(image).name.clone();
    let (chosen, sigmas) = match constraint {
        None => ("off", None),
        Some(RigConstraint::Soft { sigma_translation, sigma_rotation_rad, .. }) => {
            ("soft", Some((sigma_translation, sigma_rotation_rad.to_degrees())))
        }
        Some(RigConstraint::Rigid) => ("hard", None),
    };
    let errors = format!("{error_off_px:.3} px without and {error_px:.3} px with it");
    let why = match (term, constraint) {
        (RigTerm::Auto, None) => {
            "cameras held to one mounting would explain tracks that took no part worse, even \
            loosely"
                .to_owned()
        }
        (RigTerm::Auto, Some(RigConstraint::Rigid)) => {
            format!("a rigid rig explains tracks that took no part as well as any: {errors}")
        }
        (_, Some(RigConstraint::Soft { .. })) => {
            format!("this is as firmly as tracks that took no part allow: {errors}")
        }
        _ => format!("it was asked for; tracks that took no part are off by {errors}"),
    };
    MountingReport {
        chosen: chosen.to_owned(),
        why,
        sigma_translation: sigmas.map(|sigmas| sigmas.0),
        sigma_rotation_deg: sigmas.map(|sigmas| sigmas.1),
        held_out_error_off_px: error_off_px,
        held_out_error_px: error_px,
        bad_pairs: rig.bad_pairs.iter().map(|pair| [name(pair.left), name(pair.right)]).collect(),
        split: rig.split.map(|split| SplitReport {
            images: split.num_images,
            pairs_matched_again: split.num_rematched_pairs,
        }),
        // The pairs stand above already.
        rig: RigFile::new(model, rig).map(|file| RigFile { bad_pairs: None, ..file }),
    }
}

fn paper_report(
    model: &Reconstruction,
    series: &[(&RigPairs, Vec<(RigPair, RelativePose)>)],
    cameras: &[RigCameraReport],
    ImagePair { a, b }: ImagePair,
    factor: f64,
) -> Option<PaperReport> {
    let centre = |image| Some(model.image(image).cam_from_world()?.origin_in_a());
    let (centre_a, centre_b) = (centre(a)?, centre(b)?);
    let name = |image| model.image(image).name.clone();
    let sigmas = paper::sigmas(paper::LAMBDA);
    let mut bad_pairs = Vec::new();
    for (_, poses) in series {
        let relative: Vec<RelativePose> = poses.iter().map(|(_, pose)| *pose).collect();
        let Some(average) = paper::average(&relative) else { continue };
        let bad = poses.iter().filter(|(_, pose)| paper::is_bad(pose, &average));
        bad_pairs.extend(bad.map(|(pair, _)| [name(pair.left), name(pair.right)]));
    }
    Some(PaperReport {
        unit_images: [name(a), name(b)],
        unit_distance: (centre_a - centre_b).norm(),
        lambda: paper::LAMBDA,
        sigma_translation: factor * sigmas.translation,
        relative_sigma_translation: factor * sigmas.translation / cameras.first()?.median_baseline,
        sigma_rotation_deg: sigmas.rotation_rad.to_degrees(),
        bad_pairs,
    })
}
