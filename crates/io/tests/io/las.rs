//! LAS and LAZ: round trips.
#![cfg(feature = "las")]
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use tiepoint_geometry::Rng;
use tiepoint_geometry::crs::Crs;
use tiepoint_geometry::geodesy::{Geodetic, LocalFrame};
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

/// The dense cloud of a site in coordinates of a system, which the file states.
#[test]
fn systems_are_stated_and_millimetres_kept() {
    let dir = tempfile::tempdir().unwrap();
    let frame = LocalFrame::new(Geodetic {
        latitude_deg: 48.1374,
        longitude_deg: 11.5755,
        height_m: 519.0,
    });
    let mut rng = Rng::stream(7, &[]);
    let local: Vec<Vector3<f64>> =
        (0..500).map(|_| Vector3::new(rng.normal(), rng.normal(), rng.normal()) * 1000.0).collect();
    for (epsg, keyword) in
        [(32632, "COMPD_CS["), (25832, "COMPD_CS["), (4979, "COMPD_CS["), (4978, "GEOCCS[")]
    {
        let crs = Crs::from_epsg(epsg).unwrap();
        let vertex = |local: &Vector3<f64>| Vertex {
            xyz: crs.project(&frame.to_geodetic(local)),
            color: [1, 2, 3],
        };
        let vertices: Vec<Vertex> = local.iter().map(vertex).collect();
        let path = dir.path().join("cloud.laz");
        las::write_in(&path, &vertices, crs, true).unwrap();
        let reader = ::las::Reader::from_path(&path).unwrap();
        let header = reader.header();
        assert!(header.has_wkt_crs());
        let wkt = String::from_utf8(header.get_wkt_crs_bytes().unwrap().to_vec()).unwrap();
        assert!(wkt.starts_with(keyword) && wkt.ends_with("]\0"), "{wkt}");
        let code = if epsg == 4979 { 4326 } else { epsg };
        assert!(wkt.contains(&format!("AUTHORITY[\"EPSG\",\"{code}\"]]")), "{wkt}");
        for (found, local) in las::read(&path).unwrap().iter().zip(&local) {
            let there = match crs {
                Crs::Geographic { .. } => Geodetic {
                    longitude_deg: found.xyz.x,
                    latitude_deg: found.xyz.y,
                    height_m: found.xyz.z,
                },
                Crs::Geocentric => Geodetic::from_ecef(&found.xyz),
                Crs::Utm { zone, .. } => zone.unproject(&found.xyz),
            };
            let difference_m = (frame.to_local(&there) - local).norm();
            // Half of the resolution in each coordinate.
            assert!(difference_m < 2.0 * TOLERANCE, "{crs}: {difference_m}");
        }
        las::write(&path, &vertices).unwrap();
        assert!(!::las::Reader::from_path(&path).unwrap().header().has_wkt_crs());
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
