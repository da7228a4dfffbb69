//! Renders images of a drive with all effects, and writes them with the ground truth.
//!
//! cargo run --release -p tiepoint-synth --example write_drive -- FOLDER [EFFECTS] [SEED]
//!
//! EFFECTS: `none`, `all`, or names joined by `+`, as in `lens+clocks`.
#![allow(clippy::print_stdout)]

use std::path::Path;

use tiepoint_synth::{
    Drive, DriveOptions, Effects, LidarOptions, Mount, ViewDirection, reference_cloud,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(arguments.first().map_or("drive", String::as_str));
    let effects: Effects = arguments.get(1).map_or("all", String::as_str).parse()?;
    let seed = arguments.get(2).map_or(Ok(1), |seed| seed.parse())?;
    let options = DriveOptions {
        seed,
        mounts: ViewDirection::ALL.map(Mount::facing).to_vec(),
        width: 1000,
        height: 750,
        effects,
        ..DriveOptions::default()
    };
    let drive = Drive::new(&options)?;
    println!(
        "{:.0} m of street, {} quads, {:.1} s of driving",
        drive.route().length_m(),
        drive.world().num_quads(),
        drive.trajectory().duration_s()
    );
    drive.write_tables(folder)?;
    for (index, camera) in drive.cameras().iter().enumerate() {
        let renderer = drive.renderer(index);
        // Four images, evenly spaced over the drive.
        let step = (camera.exposures.len() / 4).max(1);
        for exposure in camera.exposures.iter().skip(step / 2).step_by(step) {
            drive.write_image(folder, index, exposure, &renderer)?;
            println!(
                "{}: true time {:.3} s, stamped {:.3} s",
                exposure.name, exposure.time_s, exposure.stamp_s
            );
        }
    }
    let scanner = LidarOptions { every_turns: 10, ..LidarOptions::default() };
    let cloud = reference_cloud(&drive, &scanner)?;
    println!("a laser scanner sees {} points", cloud.len());
    Ok(())
}
