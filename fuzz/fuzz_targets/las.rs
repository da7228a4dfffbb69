//! LAS and LAZ clouds.
#![no_main]

use libfuzzer_sys::fuzz_target;

use std::sync::Once;

use tiepoint_fuzz::file;
use tiepoint_io::las;

static QUIET: Once = Once::new();

fuzz_target!(|data: &[u8]| {
    // The reader catches the panics of the decompressor, and the fuzzer would take them for
    // crashes.
    QUIET.call_once(|| std::panic::set_hook(Box::new(|_| {})));
    let _ = las::read(&file("cloud.laz", data));
});
