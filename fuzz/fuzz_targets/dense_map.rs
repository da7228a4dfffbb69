//! Depth and normal maps of COLMAP.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::file;
use tiepoint_io::dense::DenseMap;

fuzz_target!(|data: &[u8]| {
    if let Ok(map) = DenseMap::read(&file("map.bin", data)) {
        let DenseMap { width, height, channels, values } = map;
        assert_eq!(
            values.len() as u128,
            [width, height, channels].map(|n| n as u128).iter().product()
        );
    }
});
