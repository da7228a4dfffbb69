//! What a rendered world says about a model of it.

use tiepoint_pipeline::eval::Sighting;
use tiepoint_pipeline::eval::geometry::nalgebra::Vector2;
use tiepoint_pipeline::sfm::scene::Image;
use tiepoint_synth::Drive;

/// What an image of a drive truly sees at a pixel, through the true lens, shutter and clock.
pub(crate) fn sighting(drive: &Drive, image: &Image, pixel: &Vector2<f64>) -> Sighting {
    let (camera, exposure) = drive.find(&image.name).expect("the images are those of the drive");
    let camera_in_world = drive.row_pose(camera, exposure.time_s, pixel.y).world_from_cam.translation;
    let surface = drive.surface_at(camera, exposure.time_s, pixel).filter(|surface| !surface.is_moving);
    Sighting { camera_in_world, surface_in_world: surface.map(|surface| surface.point_in_world) }
}
