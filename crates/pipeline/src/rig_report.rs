//! What the report says about cameras that ride together.

use serde::{Deserialize, Serialize};
use tiepoint_sfm::rig::{RelativePose, paper, spread};
use tiepoint_sfm::scene::{ImageId, Reconstruction};
use tiepoint_sfm::{RigPair, RigPairs, RigTerm, relative_poses, rig_pairs};

use crate::rig_over_time::folder_of;

/// Two or more cameras that took images at the same moments.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RigReport {
    /// What held them to each other: off or paper.
    pub mode: String,
    /// The first camera with each other one.
    pub cameras: Vec<RigCameraReport>,
    /// With `--rig paper`: what the constraint meant in this model.
    pub paper: Option<PaperReport>,
}

/// How constant the relative pose of two cameras is, without any truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RigCameraReport {
    /// Their folders.
    pub names: [String; 2],
    /// N_t: moments at which both took an image.
    pub pairs: usize,
    /// N_p: those with both poses.
    pub reconstructed_pairs: usize,
    /// Distance of the two, in units of the model.
    pub median_baseline: f64,
    /// Standard deviation of the distance over its mean.
    pub relative_baseline_sd: f64,
    /// Root mean square distance of the second camera from its mean place, over the mean distance.
    pub relative_translation_rms: f64,
    /// Root mean square angle from the mean rotation.
    pub rotation_rms_deg: f64,
    /// Mean distance in the second half of the drive over that in the first half: 1 where the scale does not drift.
    pub second_over_first_half: f64,
}

/// The constraint of Huang, Elhashash & Qin 2022 has a unit: what it was, and how strong λ is in it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PaperReport {
    /// The images whose distance is one unit; the pose of the first one and this distance were held.
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
    /// Pairs that Eq. (4) took for incorrectly estimated, as it sees the final model; they weigh 500 and not 250.
    pub bad_pairs: Vec<[String; 2]>,
}

impl RigReport {
    /// `None` for a lone camera. `began` has the initial pairs of all models.
    pub(crate) fn new(term: RigTerm, model: &Reconstruction, began: &[(ImageId, ImageId)]) -> Option<Self> {
        let rigs = rig_pairs(model);
        let series: Vec<(&RigPairs, Vec<(RigPair, RelativePose)>)> =
            rigs.iter().map(|rig| (rig, relative_poses(model, rig))).collect();
        let cameras: Vec<RigCameraReport> =
            series.iter().filter_map(|(rig, poses)| camera(model, rig, poses)).collect();
        let (mode, paper) = match term {
            RigTerm::Off => ("off", None),
            RigTerm::Paper => ("paper", paper_report(model, &series, &cameras, began)),
        };
        (!cameras.is_empty()).then(|| Self { mode: mode.to_owned(), cameras, paper })
    }
}

fn camera(
    model: &Reconstruction,
    rig: &RigPairs,
    poses: &[(RigPair, RelativePose)],
) -> Option<RigCameraReport> {
    let relative: Vec<RelativePose> = poses.iter().map(|(_, pose)| *pose).collect();
    let spread = spread(&relative)?;
    Some(RigCameraReport {
        names: [rig.left, rig.right].map(|camera| folder_of(model, camera)),
        pairs: rig.pairs.len(),
        reconstructed_pairs: poses.len(),
        median_baseline: spread.median_baseline,
        relative_baseline_sd: spread.sd_baseline / spread.mean_baseline,
        relative_translation_rms: spread.rms_translation / spread.mean_baseline,
        rotation_rms_deg: spread.rms_rotation_rad.to_degrees(),
        second_over_first_half: spread.second_over_first_half,
    })
}

fn paper_report(
    model: &Reconstruction,
    series: &[(&RigPairs, Vec<(RigPair, RelativePose)>)],
    cameras: &[RigCameraReport],
    began: &[(ImageId, ImageId)],
) -> Option<PaperReport> {
    let pose = |image| model.image(image).cam_from_world();
    let both = |&(a, b): &(ImageId, ImageId)| Some((a, b, pose(a)?.origin_in_a(), pose(b)?.origin_in_a()));
    let (a, b, centre_a, centre_b) = began.iter().find_map(both)?;
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
        sigma_translation: sigmas.translation,
        relative_sigma_translation: sigmas.translation / cameras.first()?.median_baseline,
        sigma_rotation_deg: sigmas.rotation_rad.to_degrees(),
        bad_pairs,
    })
}
