//! Copies a COLMAP database of any version to one of version 4.2: `copy_database FROM TO`.
#![allow(clippy::print_stdout)]

use std::path::Path;

use tiepoint_io::database::Database;
use tiepoint_scene::ImageId;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [from, to] = &arguments[..] else { return Err("usage: copy_database FROM TO".into()) };
    let from = Database::open(Path::new(from))?;
    let mut to = Database::create(Path::new(to))?;
    to.write_cameras(&from.read_cameras()?)?;
    to.write_images(&from.read_images()?)?;
    let (rigs, frames) = from.read_rigs()?;
    to.write_rigs(&rigs, &frames)?;
    for image in (0..from.num_images()).map(ImageId::from_index) {
        to.write_features([(image, &from.read_features(image)?)])?;
    }
    let (matches, two_views) = (from.read_matches()?, from.read_two_views()?);
    to.write_matches(matches.iter().map(|(pair, matches)| (*pair, &matches[..])))?;
    to.write_two_views(two_views.iter().map(|(pair, two_view)| (*pair, two_view)))?;
    println!(
        "{} images, {} pairs, {} two-view geometries",
        to.num_images(),
        matches.len(),
        two_views.len()
    );
    to.close()?;
    from.close()?;
    Ok(())
}
