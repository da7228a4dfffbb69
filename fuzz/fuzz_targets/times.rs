//! Times of images: CSV; positions of images, tracks, and similarities. What is read comes back
//! when it is written.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{file, folder};
use tiepoint_io::{control_points, gpx, position_priors, positions, similarity, timestamps};

fuzz_target!(|data: &[u8]| {
    if let Ok(positions) = positions::read(&file("positions.txt", data)) {
        assert!(positions.iter().all(|(name, xyz)| {
            !name.is_empty() && xyz.iter().all(|coordinate| coordinate.is_finite())
        }));
    }
    if let Ok(positions) = position_priors::read(&file("positions.csv", data)) {
        assert!(
            positions
                .iter()
                .all(|(name, position)| { !name.is_empty() && position.place.validate().is_ok() })
        );
    }
    for track in [
        position_priors::read_track(&file("track.csv", data)),
        gpx::read(&file("track.gpx", data)),
    ] {
        let positions = track.iter().flat_map(|track| track.positions());
        positions.for_each(|position| assert!(position.place.validate().is_ok()));
    }
    if let Ok(points) = control_points::read(&file("gcp_list.txt", data)) {
        assert!(
            points
                .iter()
                .all(|point| { point.place.validate().is_ok() && !point.marks.is_empty() })
        );
        let sigmas = points.iter().filter_map(|point| point.sigmas_m).flatten();
        assert!(sigmas.chain(points.iter().filter_map(|p| p.mark_sigma_px)).all(|s| s > 0.0));
    }
    if let Ok(transform) = similarity::read(&file("transform.txt", data)) {
        let path = folder().join("transform.txt");
        similarity::write(&path, &transform).expect("it can be written");
        assert_eq!(similarity::read(&path).expect("what was written can be read"), transform);
    }
    let Ok(times) = timestamps::read(&file("times.csv", data)) else { return };
    let path = folder().join("times.csv");
    timestamps::write(&path, times.iter().map(|(name, time_s)| (name.as_str(), *time_s)))
        .expect("it can be written");
    assert_eq!(timestamps::read(&path).expect("what was written can be read"), times);
});
