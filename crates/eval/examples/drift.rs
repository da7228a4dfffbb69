//! ATE and RPE of a trajectory: `drift MODEL TRUTH`, two files in the KITTI format (12 numbers per
//! line: the rows of world_from_cam).
#![allow(clippy::print_stdout)]

use tiepoint_eval::{Alignment, Statistics, compare_poses, pairs_by_path, relative_motion_errors};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

fn read(path: &str) -> Result<Vec<Rigid3>, Box<dyn std::error::Error>> {
    let mut poses = Vec::new();
    for line in std::fs::read_to_string(path)?.lines() {
        let v: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let [a, b, c, x, d, e, f, y, g, h, i, z] = v[..] else {
            return Err("a line is not 12 numbers".into());
        };
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::new(a, b, c, d, e, f, g, h, i));
        poses.push(
            Rigid3::new(UnitQuaternion::from_rotation_matrix(&rotation), Vector3::new(x, y, z))
                .inverse(),
        );
    }
    Ok(poses)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, truth] = &arguments[..] else { return Err("usage: drift MODEL TRUTH".into()) };
    let (model, truth) = (read(model)?, read(truth)?);
    let poses: Vec<_> = model.iter().copied().map(Some).collect();
    for alignment in [Alignment::Rigid, Alignment::Similarity] {
        let comparison =
            compare_poses(&poses, &truth, alignment).ok_or("the cameras are on a line")?;
        let errors: Vec<f64> = comparison.centre_errors.into_iter().flatten().collect();
        let errors = Statistics::of(&errors).ok_or("there are no poses")?;
        println!(
            "ATE after {alignment:?} alignment: rmse {:.3} m, max {:.3} m",
            errors.rmse, errors.max
        );
    }
    let centres: Vec<_> = truth.iter().map(Rigid3::origin_in_a).collect();
    for length in [100.0, 200.0, 400.0, 800.0] {
        let errors = relative_motion_errors(&model, &truth, &pairs_by_path(&centres, length));
        let translations: Vec<f64> = errors.iter().map(|error| error.translation).collect();
        let rotations: Vec<f64> =
            errors.iter().map(|error| error.rotation_rad.to_degrees()).collect();
        if let (Some(t), Some(r)) = (Statistics::of(&translations), Statistics::of(&rotations)) {
            println!(
                "RPE over {length:.0} m: {:.2} %, {:.4} deg/m",
                100.0 * t.mean / length,
                r.mean / length
            );
        }
    }
    Ok(())
}
