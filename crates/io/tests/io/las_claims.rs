//! LAS and LAZ files of a few kilobytes that claim gigabytes are refused without large allocations.
#![cfg(feature = "las")]

use las::point::Format;
use las::{Builder, Color, Point, Writer};
use std::io::Cursor;
use std::path::Path;
use tiepoint_io::las::read;

/// Offsets in the public header of LAS 1.4.
const DATA_OFFSET: usize = 96;
const RECORD_BYTES: usize = 105;
const LEGACY_POINTS: usize = 107;
const FIRST_EXTENDED: usize = 235;
const POINTS: usize = 247;

/// A file of points in a row, as other programs write it.
fn file(format: u8, compressed: bool, extra: u16, count: usize) -> Vec<u8> {
    let mut builder = Builder::from((1, 4));
    builder.point_format = Format::new(format).unwrap();
    builder.point_format.is_compressed = compressed;
    builder.point_format.extra_bytes = extra;
    let header = builder.into_header().unwrap();
    let mut writer = Writer::new(Cursor::new(Vec::new()), header).unwrap();
    let has_color = Format::new(format).unwrap().has_color;
    for k in 0..count {
        let gps_time = Format::new(format).unwrap().has_gps_time.then_some(k as f64);
        writer
            .write_point(Point {
                x: k as f64,
                y: (k * k % 97) as f64,
                color: has_color.then_some(Color { red: k as u16, green: 1, blue: 2 }),
                nir: Format::new(format).unwrap().has_nir.then_some(7),
                gps_time,
                extra_bytes: vec![k as u8; usize::from(extra)],
                ..Default::default()
            })
            .unwrap();
    }
    writer.into_inner().unwrap().into_inner()
}

fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}

fn data_offset(bytes: &[u8]) -> usize {
    u32::from_le_bytes(bytes[DATA_OFFSET..DATA_OFFSET + 4].try_into().unwrap()) as usize
}

fn refused(dir: &Path, bytes: &[u8], message: &str) {
    let path = dir.join("cloud.laz");
    std::fs::write(&path, bytes).unwrap();
    let error = read(&path).unwrap_err().to_string();
    assert!(error.contains("cloud.laz") && error.contains(message), "{error}");
}

#[test]
fn clouds_of_every_format_are_read() {
    let dir = tempfile::tempdir().unwrap();
    for (format, compressed, extra) in [
        (0, true, 0),
        (1, true, 3),
        (2, true, 0),
        (3, true, 1),
        (6, true, 0),
        (7, true, 2),
        (8, true, 0),
        (3, false, 5),
        (8, false, 0),
    ] {
        let path = dir.path().join("cloud.laz");
        std::fs::write(&path, file(format, compressed, extra, 300)).unwrap();
        let points = read(&path).unwrap_or_else(|error| panic!("format {format}: {error}"));
        assert_eq!(points.len(), 300);
        assert_eq!(points[299].xyz.x, 299.0, "format {format}");
    }
}

#[test]
fn more_points_than_bytes_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    for (compressed, message) in
        [(false, "announces 4000000000 points of 36 bytes"), (true, "4000000000 points")]
    {
        let mut bytes = file(7, compressed, 0, 100);
        put(&mut bytes, LEGACY_POINTS, &[0; 4]);
        put(&mut bytes, POINTS, &4_000_000_000u64.to_le_bytes());
        refused(dir.path(), &bytes, message);
    }
    // Records of 65,535 bytes: 2¹⁶ of them at a time were 4 GB.
    let mut bytes = file(7, false, 0, 100);
    put(&mut bytes, RECORD_BYTES, &u16::MAX.to_le_bytes());
    refused(dir.path(), &bytes, "100 points of 65535 bytes");
}

#[test]
fn layers_longer_than_the_file_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut bytes = file(7, true, 0, 100);
    // After the offset of the chunk table, the first point and the number of points follow the
    // lengths of ten layers.
    let sizes = data_offset(&bytes) + 8 + 36 + 4;
    (0..10).for_each(|layer| put(&mut bytes, sizes + 4 * layer, &u32::MAX.to_le_bytes()));
    refused(dir.path(), &bytes, "claims 42949672950 bytes");
}

#[test]
fn table_of_more_chunks_than_bytes_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    for format in [3, 7] {
        let mut bytes = file(format, true, 0, 100);
        let at = data_offset(&bytes);
        let table = i64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
        put(&mut bytes, table + 4, &u32::MAX.to_le_bytes());
        refused(dir.path(), &bytes, "announces 4294967295 chunks");
    }
}

#[test]
fn extended_record_longer_than_the_file_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut bytes = file(7, false, 0, 100);
    let end = bytes.len() as u64;
    bytes.extend([0; 60]);
    put(&mut bytes, end as usize + 20, &(1u64 << 40).to_le_bytes());
    put(&mut bytes, FIRST_EXTENDED, &end.to_le_bytes());
    put(&mut bytes, FIRST_EXTENDED + 8, &1u32.to_le_bytes());
    refused(dir.path(), &bytes, "extended record");
}

#[test]
fn laszip_record_with_other_items_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let good = file(3, true, 1, 100);
    let at = good.windows(14).position(|w| w == b"laszip encoded").unwrap() - 2 + 54 + 34;
    // The second item becomes 65,535 bytes; all items vanish; the compressor is another.
    for (place, value) in
        [(at + 6, [0, 0, 0xFF, 0xFF]), (at - 2, [0, 0, 0, 0]), (at - 34, [3, 0, 0, 0])]
    {
        let mut bytes = good.clone();
        put(&mut bytes, place, &value);
        refused(dir.path(), &bytes, "compression");
    }
}
