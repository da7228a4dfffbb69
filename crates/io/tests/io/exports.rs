//! Exports: parsed by independent readers, the projections of the points equal those of our
//! cameras.
#![allow(clippy::unwrap_used)]

use tiepoint_geometry::nalgebra::{
    Matrix3, Matrix4, Quaternion, UnitQuaternion, Vector2, Vector3, Vector4,
};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
use tiepoint_io::{gltf, nerfstudio, openmvs, ply};
use tiepoint_scene::{Camera, CameraId, Image, Keypoint, Observation, Reconstruction, Track};

use crate::common::{RigKind, random_model};

/// Error in pixels of a dozen products of numbers up to 1000; OpenMVS stores points and their depth
/// as f32.
const TOLERANCE_PX: f64 = 1e-6;

/// A reader of OpenMVS scenes after Interface.h, version 7.
struct Mvs<'a>(&'a [u8]);

impl Mvs<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (head, tail) = self.0.split_first_chunk().unwrap();
        self.0 = tail;
        *head
    }
    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }
    fn u64(&mut self) -> usize {
        u64::from_le_bytes(self.take()) as usize
    }
    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }
    fn string(&mut self) -> String {
        let bytes: Vec<u8> = (0..self.u64()).map(|_| self.take::<1>()[0]).collect();
        String::from_utf8(bytes).unwrap()
    }
    fn matrix(&mut self) -> Matrix3<f64> {
        let values: Vec<f64> = (0..9).map(|_| self.f64()).collect();
        Matrix3::from_row_slice(&values)
    }
    fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.f64(), self.f64(), self.f64())
    }
    fn single(&mut self) -> Vector3<f64> {
        Vector3::from([(); 3].map(|()| f64::from(f32::from_le_bytes(self.take()))))
    }
}

/// K, R, C of a camera on its platform; R, C of the platform's poses.
type Platform =
    (Vec<(Matrix3<f64>, Matrix3<f64>, Vector3<f64>)>, Vec<(Matrix3<f64>, Vector3<f64>)>);

/// The PINHOLE camera of the same focal lengths and principal point.
fn pinhole(intrinsics: &Intrinsics) -> Intrinsics {
    let ([fx, fy], centre) = (intrinsics.focal_lengths_px(), intrinsics.principal_point());
    Intrinsics::new(CameraModelKind::Pinhole, &[fx, fy, centre.x, centre.y]).unwrap()
}

#[test]
fn openmvs_scenes_project_points_to_the_same_pixels() {
    let mut model = random_model(12, RigKind::SeveralCameras);
    let cameras: Vec<CameraId> = model.cameras().map(|(id, _)| id).collect();
    for id in cameras {
        let camera = model.camera_mut(id);
        camera.intrinsics = pinhole(&camera.intrinsics);
    }
    // The reference sensor needs no pose.
    model.rigs[0].sensors[0].cam_from_rig = None;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.mvs");
    openmvs::write(&path, &model, "undistorted").unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let mut mvs = Mvs(&bytes);
    assert_eq!((&mvs.take::<4>(), mvs.u32(), mvs.u32()), (b"MVSI", 7, 0));
    let platforms: Vec<Platform> = (0..mvs.u64())
        .map(|_| {
            mvs.string();
            let cameras = (0..mvs.u64()).map(|_| {
                let _name_and_band = (mvs.string(), mvs.string());
                assert_eq!((mvs.u32(), mvs.u32()), (640, 480));
                (mvs.matrix(), mvs.matrix(), mvs.vector())
            });
            let cameras = cameras.collect();
            (cameras, (0..mvs.u64()).map(|_| (mvs.matrix(), mvs.vector())).collect())
        })
        .collect();
    assert_eq!(platforms.len(), 2, "the rig, and the camera that rides alone");
    assert_eq!(platforms[0].1.len(), model.frames.len());
    let images: Vec<(String, [usize; 3], u32)> = (0..mvs.u64())
        .map(|_| {
            let (name, mask) = (mvs.string(), mvs.string());
            let place = [(); 3].map(|()| mvs.u32() as usize);
            let id = mvs.u32();
            assert_eq!((mask.as_str(), mvs.take::<12>(), mvs.u64()), ("", [0; 12], 0));
            (name, place, id)
        })
        .collect();
    assert_eq!(images.len(), model.num_registered());
    assert_eq!(mvs.u64(), model.num_tracks());
    let mut compared = 0;
    for (_, track) in model.tracks() {
        let point = mvs.single();
        assert!((point - track.xyz).norm() < 1e-5);
        let views: Vec<u32> = (0..mvs.u64()).map(|_| (mvs.u32(), mvs.u32()).0).collect();
        assert_eq!(views.len(), track.observations.len());
        for view in views {
            let (name, [platform, camera, pose], id) = &images[view as usize];
            let image = model.image(tiepoint_scene::ImageId(*id));
            assert_eq!(*name, format!("undistorted/{}", image.name));
            let (k, r, c) = platforms[*platform].0[*camera];
            let (r_platform, c_platform) = platforms[*platform].1[*pose];
            // Interface.h: R = camera.R · pose.R, C = pose.Rᵀ camera.C + pose.C
            let theirs = r * r_platform * (point - (r_platform.transpose() * c + c_platform));
            let ours = *image.cam_from_world().unwrap() * point;
            assert!((theirs - ours).norm() < 1e-9);
            if let Some(pixel) = model.camera(image.camera).intrinsics.project(&ours) {
                let theirs = k * theirs / theirs.z;
                assert!(
                    (theirs.xy() + Vector2::repeat(0.5) - pixel).norm()
                        < TOLERANCE_PX * (1.0 + pixel.norm())
                );
                compared += 1;
            }
        }
    }
    assert!(compared > 5);
    assert_eq!((mvs.u64(), mvs.u64()), (0, model.num_tracks()));
    for (_, track) in model.tracks() {
        let [b, g, r] = mvs.take();
        assert_eq!([r, g, b], track.color);
    }
    assert_eq!([mvs.u64(), mvs.u64(), mvs.u64()], [0; 3]);
    let transform: Vec<f64> = (0..16).map(|_| mvs.f64()).collect();
    assert_eq!(Matrix4::from_row_slice(&transform), Matrix4::identity());
    assert_eq!(
        (mvs.matrix(), mvs.vector(), mvs.vector()),
        (Matrix3::identity(), Vector3::zeros(), Vector3::zeros())
    );
    assert!(mvs.0.is_empty());
}

fn one_camera(kind: CameraModelKind, params: &[f64]) -> Reconstruction {
    let mut model = Reconstruction::default();
    let intrinsics = Intrinsics::new(kind, params).unwrap();
    let camera =
        model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
    for (index, axis_angle) in
        [Vector3::new(0.1, 0.2, 0.3), Vector3::new(-0.2, 0.1, 0.0)].into_iter().enumerate()
    {
        let pose = Rigid3::from_axis_angle(axis_angle, Vector3::new(0.5, -0.2, 4.0 + index as f64));
        let pixel = intrinsics.project(&(pose * Vector3::new(0.3, 0.4, 0.5))).unwrap();
        let keypoint = Keypoint { pixel, scale_px: 1.0 };
        let image = model.add_image(Image::new(format!("{index}.jpg"), camera, vec![keypoint]));
        model.register(image, pose);
    }
    let observations =
        model.registered().map(|(image, ..)| Observation { image, keypoint: 0 }).collect();
    model.add_track(Track::new(Vector3::new(0.3, 0.4, 0.5), observations));
    model
}

const RADIAL: (CameraModelKind, &[f64]) =
    (CameraModelKind::Radial, &[500.0, 320.5, 239.5, -0.1, 0.02]);

#[test]
fn openmvs_refuses_distortion() {
    let model = one_camera(RADIAL.0, RADIAL.1);
    let dir = tempfile::tempdir().unwrap();
    let error = openmvs::write(&dir.path().join("scene.mvs"), &model, "").unwrap_err().to_string();
    assert!(error.contains("the camera of 0.jpg is a RADIAL: undistort first"), "{error}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn nerfstudio_cameras_project_points_to_the_same_pixels() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("transforms.json");
    for (kind, params, name) in [
        (RADIAL.0, RADIAL.1, "OPENCV"),
        (
            CameraModelKind::Opencv,
            &[500.0, 510.0, 320.5, 239.5, -0.1, 0.02, 0.003, -0.004],
            "OPENCV",
        ),
        (CameraModelKind::SimpleRadial, &[500.0, 320.5, 239.5, -0.1], "OPENCV"),
        (
            CameraModelKind::FullOpencv,
            &[500.0, 510.0, 320.5, 239.5, -0.1, 0.02, 0.003, -0.004, 0.05, 0.0, 0.0, 0.0],
            "OPENCV",
        ),
        (
            CameraModelKind::OpencvFisheye,
            &[300.0, 301.0, 320.5, 239.5, 0.1, -0.02, 0.003, 0.004],
            "OPENCV_FISHEYE",
        ),
    ] {
        let model = one_camera(kind, params);
        nerfstudio::write(&path, &model, "images", Some("points.ply")).unwrap();
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(
            (json["camera_model"].as_str(), json["ply_file_path"].as_str()),
            (Some(name), Some("points.ply"))
        );
        let frames = json["frames"].as_array().unwrap();
        assert_eq!(frames.len(), 2);
        for (frame, (_, image, _)) in frames.iter().zip(model.registered()) {
            assert_eq!(frame["file_path"], format!("images/{}", image.name));
            let number = |name: &str| frame.get(name).map_or(0.0, |value| value.as_f64().unwrap());
            let values: Vec<f64> = frame["transform_matrix"]
                .as_array()
                .unwrap()
                .iter()
                .flat_map(|row| row.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()))
                .collect();
            let point = Matrix4::from_row_slice(&values).try_inverse().unwrap()
                * Vector4::new(0.3, 0.4, 0.5, 1.0);
            // The camera looks along −z with y up; formulas of OpenCV.
            let (x, y) = (point.x / -point.z, -point.y / -point.z);
            let (k1, k2, k3, k4) = (number("k1"), number("k2"), number("k3"), number("k4"));
            let (p1, p2) = (number("p1"), number("p2"));
            let r2 = x * x + y * y;
            let distorted = if name == "OPENCV" {
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                Vector2::new(
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                )
            } else {
                let theta = r2.sqrt().atan();
                let t2 = theta * theta;
                Vector2::new(x, y)
                    * (theta / r2.sqrt())
                    * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            };
            let pixel = Vector2::new(
                number("fl_x") * distorted.x + number("cx"),
                number("fl_y") * distorted.y + number("cy"),
            );
            assert!((pixel - image.keypoints[0].pixel).norm() < TOLERANCE_PX, "{name}");
            assert_eq!((number("w"), number("h")), (640.0, 480.0));
        }
    }
}

#[test]
fn nerfstudio_has_no_rational_distortion() {
    let params = [500.0, 510.0, 320.5, 239.5, -0.1, 0.02, 0.0, 0.0, 0.05, 0.0, 0.0, 0.1];
    let model = one_camera(CameraModelKind::FullOpencv, &params);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("transforms.json");
    let error = nerfstudio::write(&path, &model, "images", None).unwrap_err().to_string();
    assert!(error.contains("knows no camera model FULL_OPENCV"), "{error}");
}

/// The JSON part and the binary part of a file of binary glTF, by the layout of its specification.
fn glb_parts(bytes: &[u8]) -> (serde_json::Value, Vec<u8>) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (b"glTF".as_slice(), 2, bytes.len()));
    let json_bytes = word(12);
    assert_eq!((&bytes[16..20], json_bytes % 4), (b"JSON".as_slice(), 0));
    let at = 20 + json_bytes;
    assert_eq!((&bytes[at + 4..at + 8], word(at) % 4), (b"BIN\0".as_slice(), 0));
    assert_eq!(at + 8 + word(at), bytes.len());
    (serde_json::from_slice(&bytes[20..at]).unwrap(), bytes[at + 8..].to_vec())
}

#[test]
fn gltf_has_the_points_and_cameras_of_the_model() {
    let model = random_model(5, RigKind::SeveralCameras);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.glb");
    let dense = [
        ply::Vertex { xyz: Vector3::new(1.0, 2.0, 3.0), color: [0, 188, 255] },
        ply::Vertex { xyz: Vector3::new(1e300, 0.0, 0.0), color: [0; 3] },
    ];
    let sparse = ply::points(&model);
    let count = gltf::write(&path, &model, &[("points", &sparse), ("dense", &dense)]).unwrap();
    assert_eq!(count, model.num_tracks() + 1, "one exceeds single precision");
    let (json, binary) = glb_parts(&std::fs::read(&path).unwrap());
    assert_eq!(json["buffers"], serde_json::json!([{ "byteLength": binary.len() }]));
    let index = |value: &serde_json::Value| value.as_u64().unwrap() as usize;
    let bytes = |accessor: &serde_json::Value| {
        let view = &json["bufferViews"][index(&accessor["bufferView"])];
        let (start, length) = (index(&view["byteOffset"]), index(&view["byteLength"]));
        assert_eq!(start % 4, 0);
        binary[start..start + length].to_vec()
    };
    let positions = |accessor: &serde_json::Value| -> Vec<Vector3<f64>> {
        let bytes = bytes(accessor);
        let values: Vec<f64> =
            bytes.as_chunks().0.iter().map(|value| f64::from(f32::from_le_bytes(*value))).collect();
        assert_eq!(values.len(), 3 * index(&accessor["count"]));
        for axis in 0..3 {
            // Not exact as doubles: serde_json reads fast.
            let bound = |name: &str| accessor[name][axis].as_f64().unwrap() as f32;
            let values = || values.iter().skip(axis).step_by(3).map(|value| *value as f32);
            assert_eq!(bound("min"), values().fold(f32::INFINITY, f32::min));
            assert_eq!(bound("max"), values().fold(f32::NEG_INFINITY, f32::max));
        }
        values.as_chunks().0.iter().map(|xyz: &[f64; 3]| Vector3::from(*xyz)).collect()
    };
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
    };
    let node = |name: &str| {
        let nodes = json["nodes"].as_array().unwrap();
        nodes.iter().find(|node| node["name"] == name).unwrap()
    };
    let primitive =
        |node: &serde_json::Value| json["meshes"][index(&node["mesh"])]["primitives"][0].clone();
    let attribute = |name: &str, attribute: &str| {
        let primitive = primitive(node(name));
        assert_eq!(primitive["mode"], 0, "points");
        json["accessors"][index(&primitive["attributes"][attribute])].clone()
    };
    let found = positions(&attribute("points", "POSITION"));
    assert_eq!(found.len(), model.num_tracks());
    for ((_, track), found) in model.tracks().zip(&found) {
        assert!((track.xyz - found).amax() <= 1e-6 * track.xyz.amax(), "{found}");
    }
    // Half of the light is the value 188 of sRGB.
    let colors = bytes(&attribute("dense", "COLOR_0"));
    let colors: Vec<u16> = colors.as_chunks().0.iter().map(|c| u16::from_le_bytes(*c)).collect();
    assert_eq!((colors[0], colors[2], colors[3]), (0, u16::MAX, u16::MAX));
    assert!((f64::from(colors[1]) / 65535.0 - 0.5).abs() < 0.01, "{colors:?}");

    // The mean up direction of the images is y.
    let quaternion = |value: &serde_json::Value| {
        let [x, y, z, w] = numbers(value).try_into().unwrap();
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
    };
    let gltf_from_model = quaternion(&node("tiepoint")["rotation"]);
    let up: Vector3<f64> =
        model.registered().map(|(.., pose)| pose.rotation.inverse() * -Vector3::y()).sum();
    assert!((gltf_from_model * up.normalize() - Vector3::y()).norm() < 1e-9);
    assert_eq!(numbers(&node("tiepoint")["extras"]["origin"]), [0.0; 3]);
    assert_eq!(node("cameras")["children"].as_array().unwrap().len(), model.num_registered());
    for (_, image, pose) in model.registered() {
        let found = node(&image.name);
        let centre = Vector3::from_vec(numbers(&found["translation"]));
        assert!((centre - pose.origin_in_a()).norm() < 1e-9);
        // glTF's cameras look along -z with y up.
        let ahead = quaternion(&found["rotation"]) * -Vector3::z();
        assert!((ahead - pose.rotation.inverse() * Vector3::z()).norm() < 1e-9);
        let above = quaternion(&found["rotation"]) * Vector3::y();
        assert!((above - pose.rotation.inverse() * -Vector3::y()).norm() < 1e-9);
        // The corners of the frustum are where the camera sees those of the image.
        let primitive = primitive(found);
        assert_eq!(primitive["mode"], 1, "lines");
        let corners = positions(&json["accessors"][index(&primitive["attributes"]["POSITION"])]);
        assert_eq!(corners[0], Vector3::zeros());
        let camera = model.camera(image.camera);
        let Some(ray) = camera.intrinsics.unproject(&Vector2::new(640.0, 480.0)) else { continue };
        let corner = Vector3::new(corners[3].x, -corners[3].y, -corners[3].z);
        assert!(corner.normalize().dot(&ray.normalize()) > 1.0 - 1e-9, "{corner} {ray}");
    }
    let pinhole = far_pinhole_model();
    gltf::write(&path, &pinhole, &[]).unwrap();
    let (json, _) = glb_parts(&std::fs::read(&path).unwrap());
    let lens = &json["cameras"][0]["perspective"];
    assert!((lens["yfov"].as_f64().unwrap() - 2.0 * (240.0_f64 / 500.0).atan()).abs() < 1e-9);
    assert!((lens["aspectRatio"].as_f64().unwrap() - 4.0 / 3.0).abs() < 1e-9);
    // Far from the origin, as in UTM coordinates, positions are relative to whole units.
    let origin = &json["nodes"][0]["extras"]["origin"];
    assert_eq!(numbers(origin), [400_000.0, 5_000_000.0, 100.0]);
    let centre = numbers(&json["nodes"][1]["translation"]);
    assert!((Vector3::from_vec(centre) - Vector3::new(0.25, 0.0, 0.0)).norm() < 1e-6);
}

/// One image of a pinhole camera of 500 px, far from the origin.
fn far_pinhole_model() -> Reconstruction {
    let mut model = Reconstruction::default();
    let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
    let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: false };
    let camera = model.add_camera(camera);
    let image = model.add_image(Image::new("a.jpg", camera, vec![]));
    let centre = Vector3::new(400_000.25, 5_000_000.0, 100.0);
    model.register(image, Rigid3 { translation: -centre, ..Rigid3::identity() });
    model
}
