//! LAS and LAZ: round trips.
#![cfg(feature = "las")]
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_io::las;
use tiepoint_io::ply::Vertex;

/// Half of the resolution of the file, and the rounding of coordinates of some millions.
const TOLERANCE: f64 = 0.6e-4;

fn cloud(seed: u64, count: usize) -> Vec<Vertex> {
    let mut rng = Rng::stream(seed, &[]);
    // UTM coordinates of a site of 100 m.
    let place = Vector3::new(461_000.0, 5_428_000.0, 110.0);
    let point = |_| Vertex {
        xyz: place + Vector3::new(rng.normal(), rng.normal(), rng.normal()) * 100.0,
        color: [rng.below(256) as u8, rng.below(256) as u8, 255],
    };
    (0..count).map(point).collect()
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 8,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn clouds_are_read_as_written(seed: u64, count in 0..2000usize) {
        let dir = tempfile::tempdir().unwrap();
        let vertices = cloud(seed, count);
        let mut sizes = Vec::new();
        for name in ["cloud.las", "cloud.laz"] {
            let path = dir.path().join(name);
            las::write(&path, &vertices).unwrap();
            let read = las::read(&path).unwrap();
            prop_assert_eq!(read.len(), count);
            for (read, written) in read.iter().zip(&vertices) {
                prop_assert!((read.xyz - written.xyz).amax() < TOLERANCE);
                prop_assert_eq!(read.color, written.color);
            }
            sizes.push(std::fs::metadata(&path).unwrap().len());
        }
        prop_assert!(count < 1000 || sizes[1] < sizes[0]);
    }
}

#[test]
fn errors_name_damaged_files() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("cloud.las");
    assert!(las::read(&path).unwrap_err().to_string().contains("cloud.las"));
    las::write(&path, &cloud(1, 100)).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for length in [0, 50, 300, bytes.len() - 10] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(las::read(&path).unwrap_err().to_string().contains("cloud.las"), "{length} bytes");
    }
}
