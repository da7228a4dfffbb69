//! COLMAP's database: all that can be read of it.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::file;
use tiepoint_io::database::{Database, read_stage_rows};
use tiepoint_io::scene::ImageId;

fuzz_target!(|data: &[u8]| {
    let path = file("database.db", data);
    let _ = read_stage_rows(&path);
    let Ok(db) = Database::open(&path) else { return };
    let _ = (db.stage_rows(), db.read_cameras(), db.read_images(), db.read_rigs());
    let _ = (db.keypoint_counts(), db.matched_pairs(), db.match_counts(), db.inlier_counts());
    for index in 0..db.num_images().min(8) {
        let _ = db.read_features(ImageId::from_index(index));
    }
    let _ = (db.read_matches(), db.read_two_views());
    let _ = db.close();
});
