//! Files of COLMAP's dense workspaces.

use std::fs;

use tiepoint_io::dense::{DenseMap, FusedPly, FusedVisibility};
use tiepoint_io::ply;

/// The layout that COLMAP's `read_write_dense.py` reads: x runs fastest, then y, then channels.
#[test]
fn maps_have_the_layout_of_colmap() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map.bin");
    let values: Vec<f32> = (0..24).map(|value| value as f32 / 7.0).collect();
    let map = DenseMap { width: 4, height: 3, channels: 2, values };
    map.write(&path).unwrap();
    let bytes = fs::read(&path).unwrap();
    let numbers = bytes.strip_prefix(b"4&3&2&").unwrap();
    assert_eq!(numbers.len(), 96);
    let at = |x: usize, y: usize, channel: usize| {
        let offset = 4 * ((channel * 3 + y) * 4 + x);
        f32::from_le_bytes(numbers[offset..offset + 4].try_into().unwrap())
    };
    assert_eq!((at(1, 0, 0), at(0, 1, 0), at(0, 0, 1)), (1.0 / 7.0, 4.0 / 7.0, 12.0 / 7.0));
    assert_eq!(DenseMap::read(&path).unwrap(), map);
}

#[test]
fn damaged_maps_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map.bin");
    for bytes in [
        &b""[..],
        b"4&3",
        b"4&3&1&",
        b"4&3&1&too short",
        b"-1&3&1&",
        b"x&3&1&",
        b"99999999999&1&1&",
        b"4294967295&4294967295&4294967295&",
        b"1&1&1&12345",
    ] {
        fs::write(&path, bytes).unwrap();
        let error = DenseMap::read(&path).unwrap_err().to_string();
        assert!(error.contains("map.bin"), "{error}");
    }
}

#[test]
fn fused_points_have_normals_colours_and_images() {
    let dir = tempfile::tempdir().unwrap();
    let (path, vis) = (dir.path().join("fused.ply"), dir.path().join("fused.ply.vis"));
    let mut points = FusedPly::create(&path, true).unwrap();
    let mut images = FusedVisibility::create(&vis).unwrap();
    for index in 0..3u8 {
        let x = f32::from(index);
        points.push([x, 2.5, -1.0], [0.0, 0.6, 0.8], [index, 20, 30], 0.25 * x).unwrap();
        images.push(&[u32::from(index), 7][..usize::from(index).min(2)]).unwrap();
    }
    assert_eq!(points.finish().unwrap(), 3);
    images.finish().unwrap();
    let read = ply::read(&path).unwrap();
    assert_eq!(read.len(), 3);
    assert_eq!(read[2].xyz.as_slice(), [2.0, 2.5, -1.0]);
    assert_eq!(read[2].color, [2, 20, 30]);
    let text = fs::read(&path).unwrap();
    let header = String::from_utf8_lossy(&text[..text.len() - 3 * 31]).into_owned();
    assert!(header.contains("element vertex 3\n") && header.contains("float nz\n"), "{header}");
    assert!(header.ends_with("property float confidence\nend_header\n"), "{header}");
    assert_eq!(text[text.len() - 4..], 0.5f32.to_le_bytes());
    let mut expected = 3u64.to_le_bytes().to_vec();
    for number in [0u32, 1, 1, 2, 2, 7] {
        expected.extend(number.to_le_bytes());
    }
    assert_eq!(fs::read(&vis).unwrap(), expected);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2, "the records are gone");
    // As COLMAP writes it.
    let path = dir.path().join("plain.ply");
    let mut points = FusedPly::create(&path, false).unwrap();
    points.push([1.0, 2.5, -1.0], [0.0, 0.6, 0.8], [7, 20, 30], 0.25).unwrap();
    points.finish().unwrap();
    assert_eq!(ply::read(&path).unwrap()[0].color, [7, 20, 30]);
    let bytes = fs::read(&path).unwrap();
    assert_eq!(bytes[bytes.len() - 3..], [7, 20, 30]);
    assert!(!String::from_utf8_lossy(&bytes).contains("confidence"));
}
