//! Photos in memory to a model, without files and database: `cargo run --release -p tiepoint-sfm
//! --example photos -- *.jpg`. Without arguments it renders photos of a street.
#![allow(clippy::print_stdout, reason = "an example shows its result")]

use std::io::Cursor;

use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics};
use tiepoint_sfm::matching::{features, match_features};
use tiepoint_sfm::scene::{
    Camera, CameraId, CorrespondenceGraph, Image, ImageId, ImagePair, Match, Reconstruction,
};
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions, verify_pair};
use tiepoint_sfm::{Mapper, MapperOptions, convert};
use tiepoint_synth::{Drive, DriveOptions, image};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut jpegs = std::env::args().skip(1).map(std::fs::read).collect::<Result<Vec<_>, _>>()?;
    if jpegs.is_empty() {
        let drive = Drive::new(&DriveOptions { rate_hz: 4.0, ..DriveOptions::default() })?;
        for exposure in &drive.cameras()[0].exposures[..8] {
            let mut jpeg = Cursor::new(Vec::new());
            let photo = drive.render(0, exposure, &drive.renderer(0));
            photo.write_to(&mut jpeg, image::ImageFormat::Jpeg)?;
            jpegs.push(jpeg.into_inner());
        }
    }
    // The photos are of one camera, whose focal length is estimated.
    let (mut scene, mut descriptors) = (Reconstruction::default(), Vec::new());
    for (index, jpeg) in jpegs.iter().enumerate() {
        let photo = image::load_from_memory(jpeg)?.into_luma8();
        let (width, height) = photo.dimensions();
        if index == 0 {
            let guess_px = 1.2 * f64::from(width.max(height));
            let kind = CameraModelKind::SimpleRadial;
            let intrinsics = Intrinsics::centred(kind, guess_px, width, height);
            scene.add_camera(Camera { intrinsics, width, height, has_focal_prior: false });
        }
        let view = features::GrayView::new(photo.as_raw(), width as usize, height as usize);
        let found = features::extract(&view, &features::Options::default())?;
        let keypoints = found.keypoints.iter().map(convert::keypoint).collect();
        scene.add_image(Image::new(format!("{index}.jpg"), CameraId(0), keypoints));
        descriptors.push(found.descriptors);
    }
    let mut pairs = Vec::new();
    for (a, b) in (0..jpegs.len()).flat_map(|b| (0..b).map(move |a| (a, b))) {
        let found = match_features(&descriptors[a], &descriptors[b], &Default::default());
        let found: Vec<Match> = found.iter().map(convert::matched).collect();
        let [a, b] = [a, b].map(ImageId::from_index);
        let [one, other] = [a, b].map(|id| ImageObservations::new(&scene, id));
        let two_view = verify_pair(one, other, &found, &VerifyOptions::default(), 0);
        pairs.extend(ImagePair::new(a, b).map(|pair| (pair, two_view)));
    }
    let counts: Vec<usize> = scene.images().map(|(_, image)| image.keypoints.len()).collect();
    let graph = CorrespondenceGraph::new(&counts, pairs);
    for model in Mapper::new(&graph, &scene).run(&MapperOptions::default())? {
        let model = &model.reconstruction;
        let (images, error_px) = (model.num_registered(), model.mean_reprojection_error_px());
        println!("{images} images, {} points, {error_px:.2} px", model.num_tracks());
    }
    Ok(())
}
