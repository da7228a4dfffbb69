//! BAL problems; what is a reconstruction is a valid one.
#![no_main]

use libfuzzer_sys::fuzz_target;

use tiepoint_fuzz::file;
use tiepoint_io::bal::Bal;

fuzz_target!(|data: &[u8]| {
    let Ok(bal) = Bal::read(&file("bal.txt", data)) else { return };
    if let Ok(model) = bal.to_reconstruction() {
        model.validate().expect("what is read is valid");
        let _ = Bal::from_reconstruction(&model);
    }
});
