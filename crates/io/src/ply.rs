//! PLY files (Turk 1994): points with colours. Written as binary little-endian; read in all three
//! encodings, other elements and properties are skipped.

use std::io::Write;
use std::path::Path;

use tiepoint_geometry::crs::Crs;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::Reconstruction;

use crate::atomic::write_atomic;
use crate::binary::Reader;
use crate::text::excerpt::Excerpt;
use crate::{Error, Result};

/// A point with its colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Position, in units of the file.
    pub xyz: Vector3<f64>,
    /// Red, green, blue; grey in files without colours.
    pub color: [u8; 3],
}

const GREY: [u8; 3] = [128; 3];
/// The first comment.
const GENERATOR: &str = "tiepoint";
/// Colour of camera centres.
const RED: [u8; 3] = [255, 0, 0];
/// Detail of a cloud that a file keeps, as a share of its size: a hundredth of a pixel in an image
/// of 5,000 pixels that shows all of it. Clouds whose mean is within 16 times their size of the
/// origin are in single precision; half or double of it changes this distance to 8 or 33.
const MIN_DETAIL: f64 = 2e-6;
/// Longest line of a header, in bytes.
const MAX_HEADER_LINE_BYTES: u64 = 1 << 12;
/// Most properties of an element; a header with more is invalid.
const MAX_PROPERTIES: usize = 256;

/// The points of a reconstruction, in the order of their ids.
pub fn points(model: &Reconstruction) -> Vec<Vertex> {
    model.tracks().map(|(_, track)| Vertex { xyz: track.xyz, color: track.color }).collect()
}

/// The centres of the registered cameras, in red.
pub fn camera_centres(model: &Reconstruction) -> Vec<Vertex> {
    model.registered().map(|(.., pose)| Vertex { xyz: pose.origin_in_a(), color: RED }).collect()
}

/// Writes points, binary little-endian, in single precision where that holds the cloud: every
/// reader takes it. Clouds far from the origin, as in UTM coordinates, have double precision.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write(path: &Path, vertices: &[Vertex]) -> Result<()> {
    write_with(path, vertices, &[GENERATOR], is_far_from_origin(vertices))
}

/// Writes points whose coordinates are in a system, which a comment states, in double precision.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write_in(path: &Path, vertices: &[Vertex], crs: Crs, has_heights: bool) -> Result<()> {
    write_with(path, vertices, &[GENERATOR, &crs.in_words(has_heights)], true)
}

fn write_with(path: &Path, vertices: &[Vertex], comments: &[&str], is_double: bool) -> Result<()> {
    write_atomic(path, |file| {
        let count = vertices.len() as u64;
        let real = if is_double { "double" } else { "float" };
        file.write_all(header(comments, count, real, &["x", "y", "z"], &[]).as_bytes())?;
        vertices.iter().try_for_each(|vertex| {
            vertex.xyz.iter().try_for_each(|value| match is_double {
                true => file.write_all(&value.to_le_bytes()),
                false => file.write_all(&(*value as f32).to_le_bytes()),
            })?;
            file.write_all(&vertex.color)
        })
    })
}

/// Whether single precision would merge points that differ by [`MIN_DETAIL`] of the cloud's size:
/// the root mean square distance from its mean, which single far points hardly change.
fn is_far_from_origin(vertices: &[Vertex]) -> bool {
    let finite = || vertices.iter().filter(|vertex| vertex.xyz.iter().all(|x| x.is_finite()));
    let count = finite().count().max(1) as f64;
    let mean = finite().map(|vertex| vertex.xyz).sum::<Vector3<f64>>() / count;
    let variance = finite().map(|vertex| (vertex.xyz - mean).norm_squared()).sum::<f64>() / count;
    let spacing = mean.amax() * f64::from(f32::EPSILON);
    spacing > MIN_DETAIL * variance.sqrt()
}

/// The header of a binary little-endian file of vertices: `before` of the type `real`, then red,
/// green and blue, then `after` in single precision.
pub(crate) fn header(
    comments: &[&str],
    count: u64,
    real: &str,
    before: &[&str],
    after: &[&str],
) -> String {
    let mut header = "ply\nformat binary_little_endian 1.0\n".to_owned();
    for comment in comments {
        header += &format!("comment {comment}\n");
    }
    header += &format!("element vertex {count}\n");
    for name in before {
        header += &format!("property {real} {name}\n");
    }
    for name in ["red", "green", "blue"] {
        header += &format!("property uchar {name}\n");
    }
    for name in after {
        header += &format!("property float {name}\n");
    }
    header + "end_header\n"
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// The value of `self.bytes()` little-endian bytes.
    fn value(self, b: [u8; 8]) -> f64 {
        match self {
            Self::I8 => f64::from(i8::from_le_bytes([b[0]])),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I32 => f64::from(i32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

/// The meaning of a property of a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Xyz(usize),
    Color(usize),
    Other,
}

struct Property {
    /// The type of the length of a list; `None` for a scalar property.
    length: Option<Scalar>,
    scalar: Scalar,
    role: Role,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

/// Reads the vertices of a file. Points that are not finite are left out: scanners write them for
/// beams without an echo.
///
/// # Errors
///
/// If the file cannot be read, violates the format, or has no vertices with x, y and z.
pub fn read(path: &Path) -> Result<Vec<Vertex>> {
    let mut file = Reader::open(path)?;
    let (encoding, elements) = read_header(&mut file)?;
    let Some(vertex_index) = elements.iter().position(|element| element.name == "vertex") else {
        return Err(file.error("the header names no element `vertex`"));
    };
    for axis in 0..3 {
        if !elements[vertex_index]
            .properties
            .iter()
            .any(|p| p.role == Role::Xyz(axis) && p.length.is_none())
        {
            return Err(file.error(format!("a vertex has no property `{}`", ["x", "y", "z"][axis])));
        }
    }
    let mut words = Vec::new();
    let mut vertices: Vec<Vertex> = Vec::new();
    for element in &elements[..=vertex_index] {
        // In text, a value takes at least two characters.
        let min_bytes: u64 =
            element.properties.iter().map(|p| p.length.unwrap_or(p.scalar).bytes() as u64).sum();
        let min_bytes = if encoding == Encoding::Ascii {
            2 * element.properties.len() as u64
        } else {
            min_bytes
        };
        let slack = u64::from(encoding == Encoding::Ascii);
        let count = element.count;
        if count.checked_mul(min_bytes).is_none_or(|bytes| bytes > file.remaining() + slack) {
            let left = file.remaining();
            return Err(file.error(format!(
                "{count} × {} are announced, but {left} bytes follow",
                Excerpt(&element.name)
            )));
        }
        let is_vertex = element.name == "vertex";
        if is_vertex {
            vertices = file.list(count as usize)?;
        }
        for _ in 0..count {
            let mut vertex = Vertex { xyz: Vector3::zeros(), color: GREY };
            let mut next = |file: &mut Reader, scalar: Scalar| match encoding {
                Encoding::Ascii => next_word(file, &mut words, scalar),
                _ => next_value(file, encoding, scalar),
            };
            for property in &element.properties {
                if let Some(length) = property.length {
                    let length = next(&mut file, length)?;
                    if length < 0.0 || length > file.remaining() as f64 {
                        return Err(file.error(format!("a list of length {length}")));
                    }
                    for _ in 0..length as u64 {
                        next(&mut file, property.scalar)?;
                    }
                    continue;
                }
                let value = next(&mut file, property.scalar)?;
                match property.role {
                    Role::Xyz(axis) => vertex.xyz[axis] = value,
                    Role::Color(channel) => vertex.color[channel] = color(property.scalar, value),
                    Role::Other => {}
                }
            }
            if is_vertex && vertex.xyz.iter().all(|value| value.is_finite()) {
                vertices.push(vertex);
            }
        }
    }
    Ok(vertices)
}

/// A colour value as a byte: bytes unchanged, the high byte of shorts, floats from 0 to 1.
fn color(scalar: Scalar, value: f64) -> u8 {
    match scalar {
        Scalar::F32 | Scalar::F64 => (255.0 * value).round() as u8,
        Scalar::U16 => (value / 256.0) as u8,
        _ => value as u8,
    }
}

fn read_header(file: &mut Reader) -> Result<(Encoding, Vec<Element>)> {
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    if file.line(MAX_HEADER_LINE_BYTES)?.trim_end() != "ply" {
        return Err(Error::content(file.path(), "is no PLY file"));
    }
    loop {
        let line = file.line(MAX_HEADER_LINE_BYTES)?;
        let bad =
            |file: &Reader| file.error(format!("the header says `{}`", Excerpt(line.trim_end())));
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            ["end_header"] => break,
            ["format", name, _] => {
                encoding = Some(match name {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    _ => return Err(bad(file)),
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad(file))?;
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            ["property", ref kind @ .., name] => {
                let (length, scalar) = match kind {
                    [scalar] => (None, Scalar::from_name(scalar)),
                    ["list", length, scalar] => {
                        (Scalar::from_name(length), Scalar::from_name(scalar))
                    }
                    _ => (None, None),
                };
                let is_list = kind.len() == 3;
                let length = length.filter(|length| length.is_integer());
                let (Some(scalar), Some(element), true) =
                    (scalar, elements.last_mut(), is_list == length.is_some())
                else {
                    return Err(bad(file));
                };
                let role = match name {
                    "x" | "y" | "z" => Role::Xyz(usize::from(name.as_bytes()[0] - b'x')),
                    "red" | "diffuse_red" | "r" => Role::Color(0),
                    "green" | "diffuse_green" | "g" => Role::Color(1),
                    "blue" | "diffuse_blue" | "b" => Role::Color(2),
                    _ => Role::Other,
                };
                element.properties.push(Property { length, scalar, role });
                if element.properties.len() > MAX_PROPERTIES {
                    return Err(bad(file));
                }
            }
            [] | ["comment" | "obj_info", ..] => {}
            _ => return Err(bad(file)),
        }
    }
    // An element without properties takes no bytes, however large its count.
    elements.retain(|element| !element.properties.is_empty() || element.name == "vertex");
    encoding
        .map(|encoding| (encoding, elements))
        .ok_or_else(|| file.error("the header names no format"))
}

fn next_value(file: &mut Reader, encoding: Encoding, scalar: Scalar) -> Result<f64> {
    let mut bytes = [0; 8];
    let count = scalar.bytes();
    file.fill(&mut bytes[..count], "a property")?;
    if encoding == Encoding::Big {
        bytes[..count].reverse();
    }
    Ok(scalar.value(bytes))
}

/// The next word of a text file as a number.
fn next_word(file: &mut Reader, word: &mut Vec<u8>, scalar: Scalar) -> Result<f64> {
    word.clear();
    while file.remaining() > 0 {
        match file.u8("a property")? {
            byte if !byte.is_ascii_whitespace() => word.push(byte),
            _ if word.is_empty() => {}
            _ => break,
        }
        if word.len() > 64 {
            return Err(file.error("a number is longer than 64 characters"));
        }
    }
    let text = std::str::from_utf8(word).ok();
    let value = text.and_then(|text| text.parse().ok());
    // `nan` is a float but not an integer.
    value.filter(|value: &f64| value.is_finite() || !scalar.is_integer()).ok_or_else(|| {
        file.error(format!("`{}` is no number", Excerpt(&String::from_utf8_lossy(word))))
    })
}
