//! The table of the page on cameras.

use tiepoint_pipeline::sfm::scene::{CameraId, Reconstruction};
use tiepoint_pipeline::workspace::{CameraReport, ModelReport};

use crate::{Table, TableRow};

/// Rows at most: photos may have a camera each.
const MAX_CAMERAS: usize = 20;

/// Camera model, size, number of images and focal length of the cameras that images with a pose
/// have. `name` gives the name of a camera.
pub(super) fn camera_table(
    model: &Reconstruction,
    report: Option<&ModelReport>,
    name: impl Fn(CameraId) -> String,
) -> Option<Table> {
    let registered = model.registered_cameras();
    let rows = registered.iter().take(MAX_CAMERAS).map(|&id| {
        let reports = report.map_or(&[][..], |report| &report.cameras);
        let number = model.original_ids.camera(id);
        (name(id), facts(model, id, reports.iter().find(|it| u64::from(it.id) == number)))
    });
    let rows: Vec<TableRow> = rows.collect();
    let head = ["camera model", "size, px", "images", "focal length, px"].map(str::to_owned);
    let caption = match registered.len() {
        0..=MAX_CAMERAS => "Cameras".to_owned(),
        count => format!("Cameras: the first {MAX_CAMERAS} of {count}"),
    };
    (!rows.is_empty()).then(|| Table { caption, ..Table::of_columns(&head, rows) })
}

/// The row of a camera.
fn facts(model: &Reconstruction, id: CameraId, report: Option<&CameraReport>) -> Vec<String> {
    let camera = model.camera(id);
    let kind = camera.intrinsics.kind();
    let images = model.registered().filter(|(_, image, _)| image.camera == id).count();
    let focal = |&index: &usize| {
        let value = camera.intrinsics.params()[index];
        let sd = report.and_then(|it| it.params_sd.get(index)).filter(|sd| **sd > 0.0);
        sd.map_or(format!("{value:.2}"), |sd| format!("{value:.2} ± {sd:.2}"))
    };
    let focals: Vec<String> = kind.focal_indices().iter().map(focal).collect();
    vec![
        kind.name().to_owned(),
        format!("{} × {}", camera.width, camera.height),
        images.to_string(),
        focals.join(", "),
    ]
}

#[cfg(test)]
mod tests {
    use tiepoint_pipeline::eval::geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_pipeline::sfm::scene::{Camera, Image};

    use super::*;

    fn model_of(num_cameras: usize) -> Reconstruction {
        let mut model = Reconstruction::default();
        for index in 0..num_cameras {
            let params = [500.0, 501.0, 320.0, 240.0];
            let intrinsics = Intrinsics::new(CameraModelKind::Pinhole, &params).unwrap();
            let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: false };
            let camera = model.add_camera(camera);
            let image = model.add_image(Image::new(format!("{index}.jpg"), camera, Vec::new()));
            model.register(image, Rigid3::identity());
        }
        model
    }

    #[test]
    fn focal_lengths_have_their_deviations_and_cameras_beyond_the_first_are_counted() {
        let model = model_of(MAX_CAMERAS + 1);
        let text = r#"{"id": 1, "model": "PINHOLE", "width": 640, "height": 480,
            "params": [500, 501, 320, 240], "params_sd": [0.5, 0, 0, 0]}"#;
        let camera: CameraReport = serde_json::from_str(text).unwrap();
        let report = ModelReport { cameras: vec![camera], ..ModelReport::default() };
        let table = camera_table(&model, Some(&report), |id| format!("c{}", id.0)).unwrap();
        let first = ["PINHOLE", "640 × 480", "1", "500.00 ± 0.50, 501.00"].map(str::to_owned);
        assert_eq!(table.rows[0], ("c0".to_owned(), first.to_vec()));
        assert_eq!(table.rows.len(), MAX_CAMERAS);
        assert!(table.caption.ends_with("the first 20 of 21"), "{}", table.caption);
        assert_eq!(camera_table(&Reconstruction::default(), None, |_| String::new()), None);
    }
}
