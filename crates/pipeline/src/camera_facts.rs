//! What is known of the cameras beside their initial intrinsics. The record of the feature stage
//! holds it for mapping: it follows from the photos and the options of the stage.

use std::collections::BTreeSet;

use tiepoint_sfm::scene::{CameraId, Reconstruction};

/// What the keys begin with.
pub(crate) const FOUND: &str = "found.";
const TURNED: &str = "found.turned";

/// What is known of the cameras.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct CameraFacts {
    /// Cameras with known intrinsics.
    pub(crate) calibrated: BTreeSet<CameraId>,
    /// Cameras of one lens whose images are turned against each other. A pair has equal radial
    /// distortion, and the fx of the one is the fy of the other.
    pub(crate) turned: Vec<[CameraId; 2]>,
}

impl CameraFacts {
    /// Key of the cameras with known intrinsics.
    pub(crate) const CALIBRATED: &str = "found.calibrated";

    /// Keys and values for the record; nothing for cameras of which nothing is known.
    pub(crate) fn texts(&self) -> Vec<(&'static str, String)> {
        let calibrated: Vec<String> =
            self.calibrated.iter().map(|camera| camera.0.to_string()).collect();
        let turned: Vec<String> =
            self.turned.iter().map(|[one, other]| format!("{}-{}", one.0, other.0)).collect();
        let mut texts = vec![(Self::CALIBRATED, calibrated.join(",")), (TURNED, turned.join(","))];
        texts.retain(|(_, value)| !value.is_empty());
        texts
    }

    /// From a record, given by its values.
    pub(crate) fn read<'a>(value: impl Fn(&str) -> Option<&'a str>) -> Self {
        let words = |key| value(key).unwrap_or("").split(',').filter(|word| !word.is_empty());
        let id = |word: &str| word.parse().ok().map(CameraId);
        let pair = |word: &str| {
            let (one, other) = word.split_once('-')?;
            Some([id(one)?, id(other)?])
        };
        Self {
            calibrated: words(Self::CALIBRATED).filter_map(id).collect(),
            turned: words(TURNED).filter_map(pair).collect(),
        }
    }

    /// Adds the facts to a model. A damaged record may name cameras that the model does not have.
    pub(crate) fn add_to(mut self, model: &mut Reconstruction) {
        let exists = |camera: &CameraId| camera.index() < model.num_cameras();
        self.calibrated.retain(exists);
        self.turned.retain(|[one, other]| exists(one) && exists(other) && one != other);
        (model.calibrated, model.turned) = (self.calibrated, self.turned);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_survive_the_record() {
        let facts = CameraFacts {
            calibrated: [CameraId(0), CameraId(12)].into(),
            turned: vec![[CameraId(1), CameraId(2)], [CameraId(3), CameraId(5)]],
        };
        let texts = facts.texts();
        let value =
            |key: &str| texts.iter().find(|(own, _)| *own == key).map(|(_, value)| value.as_str());
        assert_eq!(CameraFacts::read(value), facts);
        assert!(texts.iter().all(|(key, _)| key.starts_with(FOUND)));
        assert_eq!(CameraFacts::default().texts(), []);
        assert_eq!(CameraFacts::read(|_| Some("1,x,-3,9-")).calibrated, [CameraId(1)].into());
        let mut model = Reconstruction::default();
        facts.add_to(&mut model);
        assert_eq!(model, Reconstruction::default(), "it has no cameras");
    }
}
