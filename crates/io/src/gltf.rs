//! Binary glTF 2.0 (`.glb`): point clouds and cameras for viewers of 3D models.
//!
//! glTF has y up, and its cameras look along −z with y up. The node `tiepoint` rotates the frame of
//! the model, so that the mean up direction of the images becomes y; below it, positions are those
//! of the model. Only if one of them is so large that single precision would cost millimetres, the
//! whole units of the mean camera centre are subtracted from all. `extras` of the node hold that
//! origin: position in the model = inverse(rotation) · position in glTF + origin.
//!
//! Every image is a node with its name, its pose, its frustum (lines) and, if a perspective camera
//! can show its field of view, a camera. Colours are linear, as glTF wants them.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use serde::Serialize;
use serde_json::{Map, Value, json};
use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector2, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::{Rigid3, so3};
use tiepoint_scene::{Camera, CameraId, Reconstruction};

use crate::atomic::write_atomic;
use crate::ply::Vertex;
use crate::{Error, Result};

const MAGIC: &[u8; 4] = b"glTF";
const VERSION: u32 = 2;
const JSON_CHUNK: &[u8; 4] = b"JSON";
const BIN_CHUNK: &[u8; 4] = b"BIN\0";
// Numbers of glTF: targets of buffers, types of components, modes of primitives.
const ARRAY_BUFFER: u32 = 34_962;
const ELEMENT_ARRAY_BUFFER: u32 = 34_963;
const UNSIGNED_SHORT: u32 = 5123;
const FLOAT: u32 = 5126;
const POINTS: u32 = 0;
const LINES: u32 = 1;
/// The extension by which materials need no light.
const UNLIT: &str = "KHR_materials_unlit";
/// Coordinates beyond this are stored relative to an origin: single precision is worse than 0.5 mm.
const MAX_COORDINATE: f64 = 8192.0;
/// Depth of a frustum over the median distance of consecutive images.
const FRUSTUM_DEPTH: f64 = 0.5;
/// Wider images have no perspective camera.
const MAX_FIELD_OF_VIEW: f64 = 170.0 * std::f64::consts::PI / 180.0;
/// The edges of a frustum: its centre is vertex 0, the corners of the image are 1 to 4.
const EDGES: [u16; 16] = [0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1];
const FRUSTUM_COLORS: [[f64; 3]; 4] =
    [[1.0, 0.15, 0.11], [0.11, 0.57, 1.0], [1.0, 0.65, 0.11], [0.33, 1.0, 0.25]];

/// The JSON part; `asset` comes first, where the program looks for its mark.
#[derive(Serialize)]
struct Document {
    asset: Value,
    scene: usize,
    scenes: Value,
    #[serde(flatten)]
    arrays: BTreeMap<&'static str, Vec<Value>>,
}

impl Document {
    /// Adds an element to an array and returns its index.
    fn add(&mut self, array: &'static str, element: Value) -> usize {
        let elements = self.arrays.entry(array).or_default();
        elements.push(element);
        elements.len() - 1
    }

    /// Adds a part of the binary buffer from `offset`, and what it holds. Returns the accessor.
    fn accessor(&mut self, offset: usize, bytes: usize, target: u32, mut holds: Value) -> usize {
        let view =
            json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes, "target": target });
        holds["bufferView"] = json!(self.add("bufferViews", view));
        self.add("accessors", holds)
    }
}

/// Writes the registered images of a model and clouds with their names. The points of the model are
/// not written unless they are among the clouds. Points whose coordinates exceed single precision
/// are left out. Returns the number of points.
///
/// # Errors
///
/// If the model is not valid, if a pose exceeds single precision or the file would exceed 4 GB, and
/// if it cannot be written.
pub fn write(path: &Path, model: &Reconstruction, clouds: &[(&str, &[Vertex])]) -> Result<usize> {
    model.validate().map_err(|cause| Error::Model { path: path.to_owned(), cause })?;
    let origin = origin(model, clouds);
    let rotations = model.registered().map(|(.., pose)| &pose.rotation);
    let rotation = so3::upright(rotations, &Vector3::y());
    let mut document = Document {
        asset: json!({ "generator": "tiepoint", "version": "2.0" }),
        scene: 0,
        scenes: json!([{ "nodes": [0] }]),
        arrays: BTreeMap::new(),
    };
    let root = document.add("nodes", Value::Null);
    let (mut children, mut binary, mut num_points) = (Vec::new(), Vec::new(), 0);
    for (name, vertices) in clouds {
        let cloud = Cloud::new(vertices, &origin);
        num_points += cloud.positions.len();
        children.extend(cloud.add_to(&mut document, &mut binary, name));
    }
    children.extend(add_cameras(path, model, &origin, &mut document, &mut binary)?);
    document.arrays.get_mut("nodes").expect("the root is one")[root] = json!({
        "name": "tiepoint",
        "rotation": rotation.coords.as_slice(),
        "extras": { "origin": origin.as_slice() },
    });
    if !children.is_empty() {
        document.arrays.get_mut("nodes").expect("the root is one")[root]["children"] =
            json!(children);
    }
    if !binary.is_empty() {
        document.add("buffers", json!({ "byteLength": binary.len() }));
    }
    if document.arrays.contains_key("materials") {
        document.add("extensionsUsed", json!(UNLIT));
    }
    write_glb(path, &document, binary)?;
    Ok(num_points)
}

/// The two chunks of a file, each padded to four bytes.
fn write_glb(path: &Path, document: &Document, mut binary: Vec<u8>) -> Result<()> {
    let mut text = serde_json::to_vec(document).expect("our own types are JSON: string keys");
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let chunks: Vec<(&[u8; 4], &Vec<u8>)> = [(JSON_CHUNK, &text), (BIN_CHUNK, &binary)]
        .into_iter()
        .filter(|(_, bytes)| !bytes.is_empty())
        .collect();
    let total = 12 + chunks.iter().map(|(_, bytes)| 8 + bytes.len()).sum::<usize>();
    let total = u32::try_from(total).map_err(|_| {
        Error::content(path, "a glTF file has at most 4 GB: export fewer points, or use ply")
    })?;
    write_atomic(path, |file| {
        file.write_all(MAGIC)?;
        file.write_all(&VERSION.to_le_bytes())?;
        file.write_all(&total.to_le_bytes())?;
        for (kind, bytes) in &chunks {
            file.write_all(&(bytes.len() as u32).to_le_bytes())?;
            file.write_all(*kind)?;
            file.write_all(bytes)?;
        }
        Ok(())
    })
}

/// The point that is subtracted from all positions.
fn origin(model: &Reconstruction, clouds: &[(&str, &[Vertex])]) -> Vector3<f64> {
    let centres = || model.registered().map(|(.., pose)| pose.origin_in_a());
    let points = clouds.iter().flat_map(|(_, vertices)| vertices.iter());
    // A majority of far points is required, because single points may be outliers.
    let (mut far, mut all) = (0, 0);
    for position in points.map(|vertex| vertex.xyz) {
        all += 1;
        far += usize::from(position.amax() > MAX_COORDINATE);
    }
    let is_far = centres().any(|centre| centre.amax() > MAX_COORDINATE) || 2 * far > all;
    let count = centres().count();
    if !is_far || count == 0 {
        return Vector3::zeros();
    }
    let mean: Vector3<f64> = centres().sum::<Vector3<f64>>() / count as f64;
    mean.map(f64::round)
}

/// Positions and linear colours, as they are stored.
struct Cloud {
    positions: Vec<[f32; 3]>,
    colors: Vec<[u8; 3]>,
}

impl Cloud {
    fn new(vertices: &[Vertex], origin: &Vector3<f64>) -> Self {
        let (mut positions, mut colors) = (Vec::new(), Vec::new());
        for vertex in vertices {
            let position: [f32; 3] = (vertex.xyz - origin).map(|value| value as f32).into();
            if position.iter().all(|value| value.is_finite()) {
                positions.push(position);
                colors.push(vertex.color);
            }
        }
        Self { positions, colors }
    }

    /// Adds a node with the points; none without points. Returns its index.
    fn add_to(&self, document: &mut Document, binary: &mut Vec<u8>, name: &str) -> Option<usize> {
        if self.positions.is_empty() {
            return None;
        }
        let position = add_positions(document, binary, &self.positions);
        let start = binary.len();
        let linear = linear_colors();
        for color in &self.colors {
            let channels = color.map(|channel| linear[usize::from(channel)]);
            // Elements must begin at multiples of four bytes, so that there is an alpha.
            for channel in channels.into_iter().chain([u16::MAX]) {
                binary.extend(channel.to_le_bytes());
            }
        }
        let color = document.accessor(
            start,
            binary.len() - start,
            ARRAY_BUFFER,
            json!({
                "componentType": UNSIGNED_SHORT, "normalized": true, "type": "VEC4",
                "count": self.colors.len(),
            }),
        );
        let material = unlit(document, name, [1.0; 3]);
        let mesh = document.add(
            "meshes",
            json!({
                "name": name,
                "primitives": [{
                    "attributes": { "POSITION": position, "COLOR_0": color },
                    "mode": POINTS,
                    "material": material,
                }],
            }),
        );
        Some(document.add("nodes", json!({ "name": name, "mesh": mesh })))
    }
}

/// Adds positions with their bounds, which glTF wants. Returns their accessor.
fn add_positions(document: &mut Document, binary: &mut Vec<u8>, positions: &[[f32; 3]]) -> usize {
    let start = binary.len();
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for position in positions {
        for axis in 0..3 {
            min[axis] = min[axis].min(position[axis]);
            max[axis] = max[axis].max(position[axis]);
            binary.extend(position[axis].to_le_bytes());
        }
    }
    // As doubles, which are the exact values of the floats.
    let (min, max) = (min.map(f64::from), max.map(f64::from));
    document.accessor(
        start,
        binary.len() - start,
        ARRAY_BUFFER,
        json!({
            "componentType": FLOAT, "type": "VEC3", "count": positions.len(),
            "min": min, "max": max,
        }),
    )
}

/// A material whose colour does not depend on light. Returns its index.
fn unlit(document: &mut Document, name: &str, [r, g, b]: [f64; 3]) -> usize {
    document.add(
        "materials",
        json!({
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0,
            },
            "extensions": { UNLIT: {} },
        }),
    )
}

/// Linear values, of 16 bits, of sRGB colours (IEC 61966-2-1).
fn linear_colors() -> [u16; 256] {
    std::array::from_fn(|value| {
        let share = value as f64 / 255.0;
        let linear =
            if share <= 0.04045 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) };
        (linear * f64::from(u16::MAX)).round() as u16
    })
}

/// Adds a node `cameras` with a node for each registered image; none without images. Returns its
/// index.
fn add_cameras(
    path: &Path,
    model: &Reconstruction,
    origin: &Vector3<f64>,
    document: &mut Document,
    binary: &mut Vec<u8>,
) -> Result<Option<usize>> {
    let centres: Vec<Vector3<f64>> =
        model.registered().map(|(.., pose)| pose.origin_in_a()).collect();
    let steps = centres.windows(2).map(|pair| (pair[1] - pair[0]).norm());
    let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
    let depth = FRUSTUM_DEPTH * median(&mut steps).unwrap_or(1.0);
    // The camera looks along −z with y up.
    let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let mut lenses: BTreeMap<CameraId, Map<String, Value>> = BTreeMap::new();
    let mut children = Vec::new();
    for (_, image, cam_from_world) in model.registered() {
        let camera = model.camera(image.camera);
        let lens = lenses
            .entry(image.camera)
            .or_insert_with(|| add_lens(document, binary, image.camera, camera, depth));
        let mut node = lens.clone();
        let world_from_cam: Rigid3 = cam_from_world.inverse();
        let translation = world_from_cam.translation - origin;
        if translation.iter().any(|value| !(*value as f32).is_finite()) {
            let what = format!("the position of {} exceeds the numbers of glTF", image.name);
            return Err(Error::content(path, what));
        }
        let rotation = UnitQuaternion::new_normalize((world_from_cam.rotation * flip).into_inner());
        node.insert("name".to_owned(), json!(image.name));
        node.insert("translation".to_owned(), json!(translation.as_slice()));
        node.insert("rotation".to_owned(), json!(rotation.coords.as_slice()));
        children.push(document.add("nodes", Value::Object(node)));
    }
    let is_empty = children.is_empty();
    let node = json!({ "name": "cameras", "children": children });
    Ok((!is_empty).then(|| document.add("nodes", node)))
}

/// Adds the frustum and the perspective camera that all images of a camera share. Returns their
/// members of a node.
fn add_lens(
    document: &mut Document,
    binary: &mut Vec<u8>,
    id: CameraId,
    camera: &Camera,
    depth: f64,
) -> Map<String, Value> {
    let name = format!("camera {}", id.0);
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)].map(|(x, y)| {
        let ray = camera.intrinsics.unproject(&Vector2::new(x, y)).unwrap_or_else(Vector3::z);
        let corner = ray * (depth / ray.z.abs().max(0.2));
        [corner.x as f32, -corner.y as f32, -corner.z as f32]
    });
    let positions: Vec<[f32; 3]> = std::iter::once([0.0; 3]).chain(corners).collect();
    let position = add_positions(document, binary, &positions);
    let start = binary.len();
    binary.extend(EDGES.iter().flat_map(|index| index.to_le_bytes()));
    let indices = document.accessor(
        start,
        binary.len() - start,
        ELEMENT_ARRAY_BUFFER,
        json!({ "componentType": UNSIGNED_SHORT, "type": "SCALAR", "count": EDGES.len() }),
    );
    let color = FRUSTUM_COLORS[id.index() % FRUSTUM_COLORS.len()];
    let material = unlit(document, &name, color);
    let mesh = document.add(
        "meshes",
        json!({
            "name": name,
            "primitives": [{
                "attributes": { "POSITION": position },
                "indices": indices,
                "mode": LINES,
                "material": material,
            }],
        }),
    );
    let mut node = Map::from_iter([("mesh".to_owned(), json!(mesh))]);
    if let Some([across, up]) = fields_of_view(camera) {
        let perspective = json!({
            "yfov": up,
            "aspectRatio": (0.5 * across).tan() / (0.5 * up).tan(),
            "znear": 0.05 * depth,
        });
        let camera = json!({ "name": name, "type": "perspective", "perspective": perspective });
        node.insert("camera".to_owned(), json!(document.add("cameras", camera)));
    }
    node
}

/// Angles between the middles of the left and right edge and of the top and bottom edge of the
/// images of a camera; `None` if a perspective camera cannot have them.
fn fields_of_view(camera: &Camera) -> Option<[f64; 2]> {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let ray = |x, y| {
        let ray = camera.intrinsics.unproject(&Vector2::new(x, y))?;
        // A ray from behind has an angle of more than 180° between both edges.
        (ray.z > 0.0).then_some(ray)
    };
    let between = |one: Vector3<f64>, other: Vector3<f64>| one.angle(&other);
    let across = between(ray(0.0, 0.5 * height)?, ray(width, 0.5 * height)?);
    let up = between(ray(0.5 * width, 0.0)?, ray(0.5 * width, height)?);
    let is_possible = |angle: &f64| *angle > 0.0 && *angle < MAX_FIELD_OF_VIEW;
    [across, up].iter().all(is_possible).then_some([across, up])
}
