//! Mapping with measured positions of the cameras, as from a satellite receiver: `cargo run
//! --release -p tiepoint-sfm --example position_priors`.
#![allow(clippy::print_stdout, reason = "an example shows its result")]

use tiepoint_sfm::adjust::Term;
use tiepoint_sfm::adjust::{Error, TermContext, TermFrame, Variables};
use tiepoint_sfm::ba::factors::Prior;
use tiepoint_sfm::geometry::{Loss, Rigid3, Rng, nalgebra::Vector3};
use tiepoint_sfm::scene::{ImageId, Reconstruction};
use tiepoint_sfm::{Mapper, MapperOptions};
use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions};

/// Measured centres of the cameras and their standard deviations along each axis, in metres.
pub(crate) struct Positions(pub(crate) Vec<(ImageId, Vector3<f64>, f64)>);

impl Positions {
    /// The centres of the registered images, and the measured ones.
    pub(crate) fn pairs(&self, model: &Reconstruction) -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
        let centre = |image| Some(model.image(image).cam_from_world()?.origin_in_a());
        self.0.iter().filter_map(|(image, measured, _)| Some((centre(*image)?, *measured))).unzip()
    }
}

impl Term for Positions {
    fn frame(&self, model: &Reconstruction) -> TermFrame {
        let (found, measured) = self.pairs(model);
        let largest = self.0.iter().map(|(.., sigma_m)| *sigma_m).fold(0.0, f64::max);
        TermFrame::of_points(&found, &measured, largest)
    }

    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        for (image, pose) in variables.poses().to_vec() {
            let Some((_, measured, sigma_m)) = self.0.iter().find(|(id, ..)| *id == image) else {
                continue;
            };
            let [any, sigma] = [f64::INFINITY, sigma_m / context.noise];
            let mean = Rigid3::from_axis_angle(Vector3::zeros(), -measured);
            let prior = Prior::new(mean, &[any, any, any, sigma, sigma, sigma])?;
            variables.problem_mut().add(pose, prior, Loss::Cauchy(3.0))?;
        }
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut drive = Drive::new(&DriveOptions { rate_hz: 4.0, ..DriveOptions::default() })?;
    drive.keep_first(10);
    let street = FeatureScene::new(&drive, &FeatureOptions::default())?;
    let mut rng = Rng::stream(1, &[]);
    let mut measure = |pose: &Rigid3| pose.origin_in_a().map(|metres| metres + 0.05 * rng.normal());
    let truth = street.truth().registered();
    let mut positions = Positions(truth.map(|(id, _, pose)| (id, measure(pose), 0.05)).collect());
    let (graph, scene) = (street.graph(&MatchOptions::default()), street.without_poses());
    let models = Mapper::new(&graph, &scene).term(&mut positions).run(&MapperOptions::default())?;
    let (found, measured) = positions.pairs(&models[0].reconstruction);
    let squares = found.iter().zip(&measured).map(|(a, b)| (a - b).norm_squared());
    println!("rms distance: {:.3} m", (squares.sum::<f64>() / found.len() as f64).sqrt());
    Ok(())
}
