//! Lookup of images by name.
#![allow(clippy::unwrap_used)]

use tiepoint_synth::{Drive, DriveOptions};

#[test]
fn every_image_is_found_by_its_name() {
    let drive =
        Drive::new(&DriveOptions { effects: "clocks".parse().unwrap(), ..Default::default() })
            .unwrap();
    for (index, camera) in drive.cameras().iter().enumerate() {
        assert!(camera.exposures.len() > 10);
        for exposure in &camera.exposures {
            assert_eq!(drive.find(&exposure.name), Some((index, exposure)));
        }
    }
    assert_eq!(drive.find("left/999999.png"), None);
    assert_eq!(drive.find("000000.png"), None);
}
