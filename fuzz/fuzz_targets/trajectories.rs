//! Trajectories of TUM, KITTI and EuRoC; what is read can be written.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{file, folder};
use tiepoint_io::trajectory::{
    TimedPose, read_euroc, read_kitti, read_tum, write_euroc, write_kitti, write_tum,
};

fuzz_target!(|data: &[u8]| {
    let timed = |poses: Vec<TimedPose>| {
        assert!(poses.iter().all(|pose| pose.time_s.is_finite()));
        assert!(poses.iter().all(|pose| (pose.cam_from_world.rotation.norm() - 1.0).abs() < 1e-6));
        let path = folder().join("out.txt");
        write_tum(&path, &poses).expect("TUM holds any pose");
        let _ = write_euroc(&path, &poses);
    };
    if let Ok(poses) = read_tum(&file("poses.txt", data)) {
        timed(poses);
    }
    if let Ok(poses) = read_euroc(&file("poses.txt", data)) {
        timed(poses);
    }
    if let Ok(poses) = read_kitti(&file("poses.txt", data)) {
        write_kitti(&folder().join("out.txt"), &poses).expect("KITTI holds any pose");
    }
});
