//! The pairs that a selection gives for a workspace, without matching them.
//!
//! ```text
//! cargo run --release -p tiepoint-pipeline --example choose -- WORKSPACE SELECTION FILE
//! ```
//!
//! Writes the pairs of names into FILE, one line each, and prints the selection, the number of
//! pairs, the seconds and the peak memory in MiB as JSON.

#![allow(clippy::print_stdout)]

use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

use tiepoint_io::database::Database;
use tiepoint_pipeline::Workspace;
use tiepoint_pipeline::stages::choose_pairs;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [workspace, selection, file] = &arguments[..] else {
        return Err("usage: choose WORKSPACE SELECTION FILE".into());
    };
    let opened = Workspace::open(Path::new(workspace))?;
    let start = Instant::now();
    let chosen = choose_pairs(&opened, selection.parse()?, 0)?;
    let seconds = start.elapsed().as_secs_f64();
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("0");
    let peak_kib: f64 = peak.split_whitespace().next().map_or(Ok(0.0), str::parse)?;
    let images = Database::open(&opened.database())?.read_images()?;
    let mut text = String::new();
    for pair in &chosen.pairs {
        let name = |image: tiepoint_sfm::scene::ImageId| &images[image.index()].name;
        writeln!(text, "{},{}", name(pair.a), name(pair.b))?;
    }
    std::fs::write(file, text)?;
    let report = serde_json::json!({
        "selection": chosen.selection,
        "pairs": chosen.pairs.len(),
        "seconds": seconds,
        "peak_mib": peak_kib / 1024.0,
    });
    println!("{report}");
    Ok(())
}
