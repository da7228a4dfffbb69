//! Converts a COLMAP model to text or binary: `convert_model FROM TO text|binary`.
#![allow(clippy::print_stdout)]

use std::path::Path;

use tiepoint_io::colmap::{Format, read_model, write_model};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [from, to, format] = &arguments[..] else {
        return Err("usage: convert_model FROM TO text|binary".into());
    };
    let format = match format.as_str() {
        "text" => Format::Text,
        "binary" => Format::Binary,
        other => return Err(format!("`{other}` is neither text nor binary").into()),
    };
    let model = read_model(Path::new(from))?;
    write_model(Path::new(to), &model, format)?;
    println!(
        "{} cameras, {} rigs, {} frames, {} images, {} points, {} observations",
        model.cameras().count(),
        model.rigs.len(),
        model.frames.len(),
        model.num_registered(),
        model.num_tracks(),
        model.num_observations()
    );
    Ok(())
}
