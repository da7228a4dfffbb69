//! The page of a model with its truth.
#![allow(clippy::unwrap_used)]

#[path = "../../pipeline/tests/common/true_model.rs"]
mod true_model;

use tiepoint_pipeline::eval::geometry::Sim3;
use tiepoint_pipeline::eval::geometry::nalgebra::Vector3;
use tiepoint_report::{CameraError, ReportModel, ReportSection, Table, report_html};

use true_model::{TOLERANCE_M, drive, truth_with_points};

#[test]
fn report_shows_models_side_by_side_and_escapes_names() {
    let drive = drive("none");
    let model = truth_with_points(&drive);
    // All centres are 1 m off horizontally and 2 m too low.
    let error = Vector3::new(0.6, 0.8, -2.0);
    let errors = model.registered().map(|(_, image, pose)| CameraError {
        camera: image.camera.index(),
        estimated_centre: pose.origin_in_a() + error,
        true_centre: pose.origin_in_a(),
    });
    let camera_errors: Vec<CameraError> = errors.collect();
    let report_model = ReportModel {
        name: "off",
        model: &model,
        world_from_model: Some(Sim3::identity()),
        rig: None,
        report: None,
        camera_errors: &camera_errors,
        cloud_errors: &[],
        dense: None,
        photos: None,
    };
    let other = ReportModel { name: "</script>paper", ..report_model };
    let rows = vec![("ATE".to_owned(), vec!["1 m".to_owned(), "2 m".to_owned()])];
    let table = Table::of_columns(&["off".to_owned(), "paper".to_owned()], rows);
    let section = ReportSection {
        heading: "open",
        note: "a note",
        alerts: &[],
        tables: &[table],
        models: &[report_model, other],
    };
    let page = report_html("a drive", &[section], vec![("rig.json", "{}".to_owned())]);
    assert_eq!(page.matches("</script>").count(), 2, "the template's own");
    let data = page.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let data: serde_json::Value = serde_json::from_str(data).unwrap();
    assert_eq!(data["files"][0], serde_json::json!(["rig.json", "{}"]));
    let data = &data["sections"][0];
    assert_eq!([&data["heading"], &data["note"]], ["open", "a note"]);
    assert_eq!(data["tables"][0]["rows"][0], serde_json::json!(["ATE", ["1 m", "2 m"]]));
    let trajectory = &data["models"][0]["trajectory"];
    let series = |name: &str| -> Vec<f64> {
        trajectory[name].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
    };
    assert_eq!(series("truth").len(), 3 * 30, "of the first camera");
    // Up is the mean up direction of the cameras: the pitch of the vehicle changes it by 1 %.
    assert!(series("horizontal").iter().all(|m| (m - 1.0).abs() < 0.02), "{trajectory}");
    assert!(series("vertical").iter().all(|m| (m + 2.0).abs() < 0.02), "{trajectory}");
    assert!(series("path_length").windows(2).all(|pair| pair[0] < pair[1]), "{trajectory}");
    assert_eq!(data["models"][1]["name"], "</script>paper");
    for shown in data["models"].as_array().unwrap() {
        assert_eq!(shown["points_shown"], shown["num_points"]);
        // Four characters of base64 are three bytes; a position has six bytes.
        let count = shown["num_points"].as_u64().unwrap() as usize;
        assert_eq!(shown["points"].as_str().unwrap().len(), (6 * count).div_ceil(3) * 4);
        assert_eq!(shown["cameras"][0]["corners"].as_array().unwrap().len(), 15 * 30);
        assert_eq!(shown["errors"]["counts"][0], 2 * count, "the truth has no reprojection error");
        assert_eq!(shown["track_lengths"]["counts"][0], count);
        let baselines = shown["rigs"][0]["baselines"].as_array().unwrap();
        assert!(baselines.iter().all(|b| (b.as_f64().unwrap() - 0.5).abs() < TOLERANCE_M));
    }
    // Every point is common to the two images of one frame.
    let matrix = &data["models"][0]["covisibility"];
    assert_eq!(matrix["side"], 60);
    let total: u64 = matrix["counts"].as_array().unwrap().iter().map(|c| c.as_u64().unwrap()).sum();
    assert_eq!(total, 2 * model.num_tracks() as u64);
}
