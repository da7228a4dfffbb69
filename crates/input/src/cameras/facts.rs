//! Calibration of the cameras beside their initial intrinsics. The record of the feature stage
//! holds it for mapping: it follows from the photos and the options of the stage.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{CameraId, Reconstruction};

/// Prefix of the keys.
pub const FOUND: &str = "found.";
const PORTRAIT_LANDSCAPE_PAIRS: &str = "found.portrait_landscape_pairs";

/// Calibration of the cameras beside their intrinsics.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CalibrationFacts {
    /// Cameras with known intrinsics.
    pub calibrated: BTreeSet<CameraId>,
    /// Cameras of one lens whose images have portrait and landscape format. A pair has equal radial
    /// distortion, and the fx of the one is the fy of the other.
    pub portrait_landscape_pairs: Vec<[CameraId; 2]>,
}

impl CalibrationFacts {
    /// Key of the cameras with known intrinsics.
    pub const CALIBRATED: &str = "found.calibrated";

    /// Keys and values for the record; nothing for cameras of which nothing is known.
    pub fn texts(&self) -> Vec<(&'static str, String)> {
        let calibrated: Vec<String> =
            self.calibrated.iter().map(|camera| camera.0.to_string()).collect();
        let pairs: Vec<String> = self
            .portrait_landscape_pairs
            .iter()
            .map(|[one, other]| format!("{}-{}", one.0, other.0))
            .collect();
        let mut texts = vec![
            (Self::CALIBRATED, calibrated.join(",")),
            (PORTRAIT_LANDSCAPE_PAIRS, pairs.join(",")),
        ];
        texts.retain(|(_, value)| !value.is_empty());
        texts
    }

    /// From a record, given by its values.
    pub fn read<'a>(value: impl Fn(&str) -> Option<&'a str>) -> Self {
        let words = |key| value(key).unwrap_or("").split(',').filter(|word| !word.is_empty());
        let id = |word: &str| word.parse().ok().map(CameraId);
        let pair = |word: &str| {
            let (one, other) = word.split_once('-')?;
            Some([id(one)?, id(other)?])
        };
        Self {
            calibrated: words(Self::CALIBRATED).filter_map(id).collect(),
            portrait_landscape_pairs: words(PORTRAIT_LANDSCAPE_PAIRS).filter_map(pair).collect(),
        }
    }

    /// Adds the facts to a model of the workspace. The cameras are those of the database, whose ids
    /// count from 1. The model may have fewer, and a damaged record may name others.
    pub fn add_to(self, model: &mut Reconstruction) {
        let ids: BTreeMap<u64, CameraId> = model
            .cameras()
            .map(|(camera, _)| (model.original_ids.camera(camera), camera))
            .collect();
        let there = |camera: &CameraId| ids.get(&(camera.index() as u64 + 1)).copied();
        let pairs = self.portrait_landscape_pairs.iter().filter(|[one, other]| one != other);
        let pairs = pairs.filter_map(|[one, other]| Some([there(one)?, there(other)?]));
        let (calibrated, pairs) =
            (self.calibrated.iter().filter_map(there).collect(), pairs.collect());
        (model.calibrated, model.portrait_landscape_pairs) = (calibrated, pairs);
    }
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Intrinsics};
    use tiepoint_scene::{Camera, OriginalIds};

    use super::*;

    #[test]
    fn facts_survive_the_record() {
        let facts = CalibrationFacts {
            calibrated: [CameraId(0), CameraId(12)].into(),
            portrait_landscape_pairs: vec![[CameraId(1), CameraId(2)], [CameraId(3), CameraId(5)]],
        };
        let texts = facts.texts();
        let value =
            |key: &str| texts.iter().find(|(own, _)| *own == key).map(|(_, value)| value.as_str());
        assert_eq!(CalibrationFacts::read(value), facts);
        assert!(texts.iter().all(|(key, _)| key.starts_with(FOUND)));
        assert_eq!(CalibrationFacts::default().texts(), []);
        assert_eq!(CalibrationFacts::read(|_| Some("1,x,-3,9-")).calibrated, [CameraId(1)].into());
        let mut model = Reconstruction::default();
        facts.add_to(&mut model);
        assert_eq!(model, Reconstruction::default(), "it has no cameras");
    }

    #[test]
    fn facts_go_to_the_cameras_with_the_same_ids() {
        let facts = CalibrationFacts {
            calibrated: [CameraId(0), CameraId(3)].into(),
            portrait_landscape_pairs: vec![[CameraId(1), CameraId(2)], [CameraId(2), CameraId(3)]],
        };
        // Cameras 3 and 4 of the database, which counts from 1.
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::Pinhole, 500.0, 640, 480);
        for _ in 0..2 {
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        }
        model.original_ids = OriginalIds::new(vec![3, 4], vec![], vec![]);
        facts.add_to(&mut model);
        assert_eq!(model.calibrated, [CameraId(1)].into());
        assert_eq!(model.portrait_landscape_pairs, [[CameraId(0), CameraId(1)]]);
    }
}
