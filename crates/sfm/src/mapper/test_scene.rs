use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene};

const IMAGES: usize = 8;
const OBSERVATIONS: usize = 200;

/// The beginning of a street, which is easy to map.
pub(super) fn scene() -> FeatureScene {
    let mut drive =
        Drive::new(&DriveOptions { rate_hz: 4.0, ..DriveOptions::default() }).expect("a drive");
    drive.keep_first(IMAGES);
    let features =
        FeatureOptions { observations: 2 * IMAGES * OBSERVATIONS, ..FeatureOptions::default() };
    FeatureScene::new(&drive, &features).expect("sound options")
}
