//! Kalibr's `camchain.yaml` of a rig, with time offsets.
//!
//! `T_cn_cnm1` is cam_n_from_cam_{n−1}. Kalibr has no time offsets between cameras;
//! `timeshift_cam0` follows its `timeshift_cam_imu`: time of cam0 = time of this camera +
//! timeshift. Kalibr has the centre of the first pixel at (0, 0), COLMAP at (0.5, 0.5).

use std::fmt::Write;

use tiepoint_sfm::geometry::nalgebra::{Matrix4, Vector2};
use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Rigid3};
use tiepoint_sfm::scene::{Camera, Reconstruction};

use crate::workspace::image_names::camera_of_stream;
use crate::workspace::rig_file::{RigCamera, RigFile};

/// Pixel coordinates of COLMAP minus those of Kalibr.
const PIXEL_CENTRE_OFFSET_PX: f64 = 0.5;

/// The text of `camchain.yaml` for the rig of a model, and the number of its cameras.
///
/// # Errors
///
/// The name of a camera of the rig that the model lacks.
pub(crate) fn camchain<'a>(
    model: &Reconstruction,
    rig: &'a RigFile,
) -> Result<(String, usize), &'a str> {
    let find = |name: &'a str| -> Result<&Camera, &'a str> {
        camera_of_stream(model, name).map(|(_, camera)| camera).ok_or(name)
    };
    let mut yaml = String::new();
    let mut before = Rigid3::identity();
    let all = std::iter::once((rig.reference.as_str(), None));
    for (index, (name, camera)) in
        all.chain(rig.cameras.iter().map(|c| (c.name.as_str(), Some(c)))).enumerate()
    {
        let lens = find(name)?;
        let pose = camera.map_or_else(Rigid3::identity, RigCamera::cam_from_rig);
        // Writing to a string does not fail.
        let _ = writeln!(
            yaml,
            "cam{index}:\n  rostopic: {}\n  resolution: [{}, {}]",
            yaml_text(&format!("/{name}")),
            lens.width,
            lens.height
        );
        yaml += &intrinsics_lines(&lens.intrinsics);
        if let Some(camera) = camera {
            yaml += &extrinsics_lines(&(pose * before.inverse()), camera);
        }
        before = pose;
    }
    Ok((yaml, rig.cameras.len() + 1))
}

/// A string in YAML, quoted as in JSON if it has special characters.
fn yaml_text(text: &str) -> String {
    let is_plain = text.chars().all(|c| c.is_alphanumeric() || matches!(c, '/' | '_' | '-' | '.'));
    if is_plain { text.to_owned() } else { serde_json::Value::from(text).to_string() }
}

/// `T_cn_cnm1` (`pose`) and the time offset of a camera, if images have times.
fn extrinsics_lines(pose: &Rigid3, camera: &RigCamera) -> String {
    let mut matrix = Matrix4::identity();
    matrix.fixed_view_mut::<3, 4>(0, 0).copy_from(&pose.to_matrix());
    let mut text = String::from("  T_cn_cnm1:\n");
    for row in matrix.row_iter() {
        let numbers: Vec<String> = row.iter().map(f64::to_string).collect();
        let _ = writeln!(text, "  - [{}]", numbers.join(", "));
    }
    // An offset in frames is no time.
    if camera.clock.assumed_frame_s.is_none() {
        let _ = writeln!(text, "  timeshift_cam0: {}", camera.clock.offset_s);
    }
    text
}

/// Camera model, intrinsics and distortion in Kalibr's convention.
fn intrinsics_lines(intrinsics: &Intrinsics) -> String {
    let p = intrinsics.params();
    let [fx, fy] = intrinsics.focal_lengths_px();
    let centre = intrinsics.principal_point() - Vector2::repeat(PIXEL_CENTRE_OFFSET_PX);
    let plane = format!("{fx}, {fy}, {}, {}", centre.x, centre.y);
    let (model, distortion) = match intrinsics.kind() {
        CameraModelKind::SimplePinhole | CameraModelKind::Pinhole => ("radtan", vec![0.0; 4]),
        CameraModelKind::SimpleRadial => ("radtan", vec![p[3], 0.0, 0.0, 0.0]),
        CameraModelKind::Radial => ("radtan", vec![p[3], p[4], 0.0, 0.0]),
        CameraModelKind::Opencv => ("radtan", p[4..8].to_vec()),
        CameraModelKind::OpencvFisheye => ("equidistant", p[4..8].to_vec()),
        CameraModelKind::SimpleFisheye | CameraModelKind::Fisheye => ("equidistant", vec![0.0; 4]),
        CameraModelKind::SimpleRadialFisheye => ("equidistant", vec![p[3], 0.0, 0.0, 0.0]),
        CameraModelKind::RadialFisheye => ("equidistant", vec![p[3], p[4], 0.0, 0.0]),
        CameraModelKind::Fov => ("fov", vec![p[4]]),
        CameraModelKind::Eucm => {
            return format!(
                "  camera_model: eucm\n  intrinsics: [{}, {}, {plane}]\n  distortion_model: \
                 none\n  distortion_coeffs: []\n",
                p[4], p[5],
            );
        }
        // Kalibr does not have these models. A comment keeps the parameters.
        CameraModelKind::FullOpencv
        | CameraModelKind::ThinPrismFisheye
        | CameraModelKind::RadTanThinPrismFisheye
        | CameraModelKind::SimpleDivision
        | CameraModelKind::Division
        | CameraModelKind::Equirectangular => {
            let params: Vec<String> = p.iter().map(f64::to_string).collect();
            return format!("  # {}: {}\n", intrinsics.kind().name(), params.join(", "));
        }
    };
    let distortion: Vec<String> = distortion.iter().map(f64::to_string).collect();
    format!(
        "  camera_model: pinhole\n  intrinsics: [{plane}]\n  distortion_model: {model}\n  \
         distortion_coeffs: [{}]\n",
        distortion.join(", "),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workspace::rig_file::RigClock;
    use tiepoint_sfm::scene::Image;

    #[test]
    fn special_characters_of_names_are_quoted() {
        assert_eq!(yaml_text("/cam_0/left-é.1"), "/cam_0/left-é.1");
        assert_eq!(yaml_text("/a\n  evil: 1"), r#""/a\n  evil: 1""#);
    }

    #[test]
    fn camchain_has_intrinsics_extrinsics_and_time_offsets() {
        let mut model = Reconstruction::default();
        let names = ["left", "right", "rear"];
        for name in names {
            let radial =
                Intrinsics::new(CameraModelKind::SimpleRadial, &[500.0, 320.5, 240.5, -0.1])
                    .unwrap();
            let prism = Intrinsics::centred(CameraModelKind::ThinPrismFisheye, 500.0, 640, 480);
            let intrinsics = if name == "rear" { prism } else { radial };
            let camera = model.add_camera(Camera {
                intrinsics,
                width: 640,
                height: 480,
                has_focal_prior: true,
            });
            model.add_image(Image::new(format!("{name}/0.png"), camera, Vec::new()));
        }
        let camera = |name: &str, x: f64, offset_s: f64| RigCamera {
            name: name.to_owned(),
            rotation_wxyz: [1.0, 0.0, 0.0, 0.0],
            translation: [x, 0.0, 0.0],
            clock: RigClock { offset_s, ..RigClock::default() },
            ..RigCamera::default()
        };
        let rig = RigFile {
            bad_pairs: Vec::new(),
            reference: "left".to_owned(),
            cameras: vec![camera("right", -0.5, 0.25), camera("rear", -0.5, -1.0)],
        };
        assert_eq!(camchain(&Reconstruction::default(), &rig), Err("left"));
        let (text, count) = camchain(&model, &rig).unwrap();
        assert_eq!(count, 3);
        let first = "cam0:\n  rostopic: /left\n  resolution: [640, 480]\n  camera_model: \
        pinhole\n  intrinsics: [500, 500, 320, 240]\n  \
                     distortion_model: radtan\n  distortion_coeffs: [-0.1, 0, 0, 0]\ncam1:\n";
        assert!(text.starts_with(first), "{text}");
        assert!(text.contains("  T_cn_cnm1:\n  - [1, 0, 0, -0.5]\n"), "{text}");
        let last = "cam2:\n  rostopic: /rear\n  resolution: [640, 480]\n  # THIN_PRISM_FISHEYE: \
        500, 500, 320, 240, 0, 0, 0, 0, 0, 0, 0, 0\n  T_cn_cnm1:\n";
        assert!(text.contains(last), "{text}");
        // Relative to the previous camera, not to the first.
        assert!(
            text.ends_with(
                "  - [1, 0, 0, 0]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, \
        0, 1]\n  timeshift_cam0: -1\n"
            ),
            "{text}"
        );
        let mut numbered = rig.clone();
        for camera in &mut numbered.cameras {
            camera.clock.assumed_frame_s = Some(0.1);
        }
        let (numbered, _) = camchain(&model, &numbered).unwrap();
        let timed = text.lines().filter(|line| !line.contains("timeshift"));
        assert!(numbered.lines().eq(timed), "{numbered}");
    }
}
