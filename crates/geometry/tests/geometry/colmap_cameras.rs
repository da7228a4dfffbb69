//! Camera models against COLMAP's (`data/make_colmap_cameras.py`).

use nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{CameraModelKind, Intrinsics};

const REFERENCE: &str = include_str!("../data/colmap_cameras.txt");

/// Both programs evaluate the same formulas in double precision.
const MAX_ERROR_PX: f64 = 1e-9;
/// COLMAP ends the inversion of a distortion at a step of 1e-5, whose square remains as an error;
/// here relative to the focal length of 800 px.
const MAX_INVERSION_ERROR_PX: f64 = 1e-6;

/// The rows with a tag and a model: parameters, then further numbers.
fn rows(tag: &str, kind: CameraModelKind) -> Vec<(Intrinsics, Vec<f64>)> {
    let prefix = format!("{tag} {} ", kind.name());
    let rows: Vec<_> = REFERENCE
        .lines()
        .filter_map(|line| line.strip_prefix(&prefix))
        .map(|row| {
            let numbers: Vec<f64> = row.split(' ').map(|v| v.parse().expect("a number")).collect();
            let (params, rest) = numbers.split_at(kind.num_params());
            (Intrinsics::new(kind, params).expect("valid"), rest.to_vec())
        })
        .collect();
    assert!(!rows.is_empty(), "no row {prefix}");
    rows
}

#[test]
fn all_models_have_colmaps_ids_names_and_parameters() {
    let rows: Vec<_> = REFERENCE.lines().filter_map(|line| line.strip_prefix("model ")).collect();
    assert_eq!(rows.len(), CameraModelKind::ALL.len());
    for row in rows {
        let words: Vec<_> = row.split(' ').collect();
        let kind = CameraModelKind::from_name(words[1]).expect("a known model");
        assert_eq!(kind.colmap_id().to_string(), words[0], "{kind:?}");
        assert_eq!(kind.param_names(), &words[2..], "{kind:?}");
    }
}

#[test]
fn projections_and_rays_are_colmaps() {
    let mut behind = 0;
    for &kind in CameraModelKind::ALL {
        for (camera, row) in rows("project", kind) {
            let (point, pixel) =
                (Vector3::from_column_slice(&row[..3]), Vector2::from_column_slice(&row[3..]));
            behind += usize::from(point.z < 0.0);
            let projected = camera.project(&point).expect("seen");
            assert!((projected - pixel).norm() < MAX_ERROR_PX, "{kind:?}: {projected} {pixel}");
            let ray = camera.unproject(&pixel).expect("a ray");
            let again = camera.project(&ray).expect("seen");
            assert!((again - pixel).norm() < MAX_ERROR_PX, "{kind:?}: {again} {pixel}");
            assert!((ray - point.normalize()).norm() < 1e-12, "{kind:?}: {ray} {point}");
        }
        for (camera, row) in rows("ray", kind) {
            let (pixel, theirs) =
                (Vector2::from_column_slice(&row[..2]), Vector3::from_column_slice(&row[2..]));
            let again = camera.project(&theirs).expect("seen");
            assert!(
                (again - pixel).norm() < MAX_INVERSION_ERROR_PX,
                "{kind:?}: {} px",
                (again - pixel).norm()
            );
        }
    }
    assert!(behind > 0, "no point is behind a camera");
}
