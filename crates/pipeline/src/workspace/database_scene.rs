//! The scene of a database.

use tiepoint_io::database::Database;
use tiepoint_sfm::convert::keypoint;
use tiepoint_sfm::scene::{Image, ImageId, Reconstruction};

use crate::Error;

/// The scene of a database without poses. Cameras and images have the order of the database.
///
/// # Errors
///
/// The database cannot be read.
pub fn read_scene(database: &Database) -> Result<Reconstruction, Error> {
    let mut scene = Reconstruction::default();
    for camera in database.read_cameras()? {
        scene.add_camera(camera);
    }
    for (index, image) in database.read_images()?.into_iter().enumerate() {
        let keypoints = database.read_keypoints(ImageId::from_index(index))?;
        let keypoints = keypoints.iter().map(keypoint).collect();
        scene.add_image(Image::new(image.name, image.camera, keypoints));
    }
    Ok(scene)
}
