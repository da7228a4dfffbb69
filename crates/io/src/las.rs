//! LAS and LAZ files (ASPRS 1.0 to 1.4): clouds of laser scanners and georeferenced clouds, read
//! and written with the package `las`.

mod claims;
mod wkt;

use std::fs::File;
use std::io::{BufReader, Cursor, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use las::point::Format;
use las::{Builder, Color, Point, PointData, Reader, Transform, Vector, Writer};
use tiepoint_geometry::crs::Crs;
use tiepoint_geometry::nalgebra::Vector3;

use crate::atomic::write_atomic;
use crate::ply::Vertex;
use crate::{Error, Result};

/// Bytes of points that are read at a time.
const CHUNK_BYTES: u64 = 1 << 21;
/// Coordinates are integer multiples of this, in units of the cloud (metres): finer than the
/// resolution of scanners.
const RESOLUTION: f64 = 1e-4;
/// The same in degrees: 0.11 mm of latitude. A file holds 2.1 degrees.
const RESOLUTION_DEG: f64 = 1e-9;
const GREY: [u8; 3] = [128; 3];

fn error(path: &Path) -> impl Fn(las::Error) -> Error {
    move |cause| Error::content(path, cause.to_string())
}

/// Reads the points of a LAS or LAZ file; points without a colour are grey.
///
/// # Errors
///
/// If the file cannot be read, claims more than its length can hold, or is damaged.
pub fn read(path: &Path) -> Result<Vec<Vertex>> {
    let file = File::open(path).map_err(Error::io(path))?;
    let claims = claims::Claims::new(BufReader::new(file)).map_err(Error::io(path))?;
    let (announced, record_bytes) = claims.check().map_err(|what| Error::content(path, what))?;
    // The decompressor panics on some damaged files.
    catch_unwind(AssertUnwindSafe(|| read_announced(path, announced, record_bytes)))
        .unwrap_or_else(|_| Err(Error::content(path, "its compressed points are damaged")))
}

fn read_announced(path: &Path, announced: u64, record_bytes: u64) -> Result<Vec<Vertex>> {
    let mut reader = Reader::from_path(path).map_err(error(path))?;
    let mut vertices = Vec::new();
    while (vertices.len() as u64) < announced {
        let points: PointData =
            reader.read_points((CHUNK_BYTES / record_bytes).max(1)).map_err(error(path))?;
        let before = vertices.len();
        for point in points.points() {
            vertices.push(vertex(&point.map_err(error(path))?));
        }
        if vertices.len() == before {
            let what = format!("announces {announced} points, but ends after {before}");
            return Err(Error::content(path, what));
        }
    }
    Ok(vertices)
}

/// A vertex from a point. Colours have 16 bits; many writers use only the lower 8, which are then
/// kept as they are.
fn vertex(point: &Point) -> Vertex {
    let color = point.color.map_or(GREY, |Color { red, green, blue }| {
        let shift = if red.max(green).max(blue) > 255 { 8 } else { 0 };
        [red, green, blue].map(|value| (value >> shift) as u8)
    });
    Vertex { xyz: Vector3::new(point.x, point.y, point.z), color }
}

/// Writes a LAS file, or a LAZ file if the extension is `laz`: version 1.4, with colours;
/// coordinates are rounded to 0.1 mm.
///
/// # Errors
///
/// If a coordinate does not fit the format, and if the file cannot be written.
pub fn write(path: &Path, vertices: &[Vertex]) -> Result<()> {
    write_with(path, vertices, RESOLUTION, None)
}

/// [`write()`] of coordinates in a system, which the file states (as WKT, OGC 01-009). Without
/// `has_heights` it states no system of the heights.
///
/// # Errors
///
/// As there.
pub fn write_in(path: &Path, vertices: &[Vertex], crs: Crs, has_heights: bool) -> Result<()> {
    let horizontal = match crs {
        Crs::Geographic { .. } => RESOLUTION_DEG,
        Crs::Geocentric | Crs::Utm { .. } => RESOLUTION,
    };
    write_with(path, vertices, horizontal, Some(wkt::wkt(crs, has_heights)))
}

/// `horizontal`: resolution of x and y.
fn write_with(
    path: &Path,
    vertices: &[Vertex],
    horizontal: f64,
    wkt: Option<String>,
) -> Result<()> {
    let is_compressed =
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("laz"));
    let mut least = vertices.first().map_or_else(Vector3::zeros, |vertex| vertex.xyz);
    for vertex in vertices {
        least = least.inf(&vertex.xyz);
    }
    let scales = [horizontal, horizontal, RESOLUTION];
    let transform = |axis: usize| Transform { scale: scales[axis], offset: least[axis].floor() };
    let mut builder = Builder::from((1, 4));
    builder.point_format = Format::new(2).map_err(error(path))?;
    builder.point_format.is_compressed = is_compressed;
    builder.transforms = Vector { x: transform(0), y: transform(1), z: transform(2) };
    builder.generating_software = "tiepoint".to_owned();
    // No date, so that equal clouds give equal files.
    builder.date = None;
    let mut header = builder.into_header().map_err(error(path))?;
    if let Some(wkt) = wkt {
        // The specification wants a zero at its end.
        header.set_wkt_crs([wkt.as_bytes(), &[0]].concat()).map_err(error(path))?;
    }
    let mut writer = Writer::new(Cursor::new(Vec::new()), header).map_err(error(path))?;
    for Vertex { xyz, color } in vertices {
        // 257 · 255 = 65535.
        let [red, green, blue] = color.map(|value| 257 * u16::from(value));
        let point = Point {
            x: xyz.x,
            y: xyz.y,
            z: xyz.z,
            color: Some(Color { red, green, blue }),
            ..Default::default()
        };
        writer.write_point(point).map_err(error(path))?;
    }
    let bytes = writer.into_inner().map_err(error(path))?;
    write_atomic(path, |file| file.write_all(bytes.get_ref()))
}
