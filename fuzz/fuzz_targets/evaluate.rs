//! `evaluate poses` with true poses of each format, and `evaluate cloud`.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::{files, folder, write, write_model};
use tiepoint_pipeline::eval::geometry::Sim3;
use tiepoint_pipeline::eval::{Alignment, find_alignment};
use tiepoint_pipeline::evaluation::{
    Truth, TruthFormat, evaluate_cloud, evaluate_poses, read_cloud,
};
use tiepoint_pipeline::workspace::LocatedModel;

/// A time of its own for each image.
const TIMES: &str = "image,seconds\nleft/000000.png,0\nright/000002.png,0.5\n\
    left/000001.png,1\nright/000003.png,1.5\n";

fuzz_target!(|data: &[u8]| {
    let Some((&which, data)) = data.split_first() else { return };
    let dir = folder();
    let model = dir.join("ws/sparse/0");
    write_model(&model);
    let truth = dir.join("truth");
    let format = match which % 5 {
        0 => {
            write(&truth, data);
            TruthFormat::Kitti
        }
        1 => {
            write(&truth, data);
            write(&dir.join("ws/timestamps.csv"), TIMES.as_bytes());
            TruthFormat::Tum
        }
        2 => {
            files(&truth, &["000000.png.camera", "000001.png.camera", "000002.png.camera"], data);
            TruthFormat::Strecha
        }
        3 => {
            files(&truth, &["cameras.txt", "images.txt", "points3D.txt"], data);
            TruthFormat::Colmap
        }
        _ => {
            write(&dir.join("cloud.ply"), data);
            let reference = read_cloud(&model).expect("the model is right");
            let Ok(cloud) = read_cloud(&dir.join("cloud.ply")) else { return };
            let found =
                find_alignment(&cloud, &reference).map(|start| (start, Alignment::Similarity));
            let rigid = (Sim3::identity(), Alignment::Rigid);
            for (start, alignment) in
                [found, Some(rigid), Some((Sim3::identity(), Alignment::None))]
                    .into_iter()
                    .flatten()
            {
                let _ = evaluate_cloud(&cloud, &reference, &start, alignment);
            }
            return;
        }
    };
    let model = LocatedModel::open(&model).expect("the model is right");
    let _ = evaluate_poses(&model, &Truth { format, path: truth }, Some(""));
});
