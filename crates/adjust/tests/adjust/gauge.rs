//! What fixes the gauge: held poses, or terms.

use tiepoint_adjust::ba::factors::Prior;
use tiepoint_adjust::{
    AdjustOptions, Error, Gauge, RefineIntrinsics, Scope, Term, TermContext, Variables, adjust,
    keep_going,
};
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{CameraModelKind, Loss, Rigid3, Sim3};
use tiepoint_scene::{ImageId, Reconstruction};

use crate::common::{camera, scene};

const NUM_IMAGES: usize = 4;
/// Standard deviation of a measured position, in metres.
const SIGMA_M: f64 = 0.01;

/// The measured centres of the images.
struct Positions(Vec<Vector3<f64>>);

impl Term for Positions {
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        for (image, pose) in variables.poses().to_vec() {
            let mean = Rigid3::from_axis_angle(Vector3::zeros(), -self.0[image.index()]);
            let (any, sigma) = (f64::INFINITY, SIGMA_M / context.noise);
            let prior = Prior::new(mean, &[any, any, any, sigma, sigma, sigma])?;
            variables.problem_mut().add(pose, prior, Loss::Trivial)?;
        }
        Ok(())
    }
}

fn model() -> Reconstruction {
    let lens = camera(CameraModelKind::Pinhole, &[500.0, 500.0, 320.0, 240.0], [640, 480]);
    scene(&[lens], NUM_IMAGES, 0.5)
}

fn adjusted(gauge: Gauge, terms: &mut [&mut dyn Term]) -> (Reconstruction, f64) {
    let mut model = model();
    let options = AdjustOptions {
        refine: RefineIntrinsics::NONE,
        gauge,
        function_tolerance: 1e-12,
        ..AdjustOptions::default()
    };
    let summary = adjust(&mut model, &Scope::Global, &options, terms, &mut keep_going).unwrap();
    (model, summary.final_cost)
}

fn pose(model: &Reconstruction, image: usize) -> Rigid3 {
    *model.image(ImageId::from_index(image)).cam_from_world().unwrap()
}

fn centres(model: &Reconstruction) -> Vec<Vector3<f64>> {
    model.registered().map(|(.., pose)| pose.origin_in_a()).collect()
}

/// The cost of images alone is the same in all frames, to the tolerance of the adjustments.
const MAX_COST_DIFFERENCE: f64 = 1e-6;

#[test]
fn without_a_term_a_free_gauge_costs_nothing_and_holds_nothing() {
    let (held, cost_held) = adjusted(Gauge::FirstAndFarthest, &mut []);
    let (free, cost_free) = adjusted(Gauge::FixedByTerms, &mut []);
    assert!((cost_free / cost_held - 1.0).abs() < MAX_COST_DIFFERENCE, "{cost_free} {cost_held}");
    assert_eq!(pose(&held, 0), pose(&model(), 0));
    assert!((0..NUM_IMAGES).all(|image| pose(&free, image) != pose(&model(), image)));
}

/// Measurements without noise of a model with noise: a fraction of the errors of the poses, which
/// are some millimetres.
const MAX_DISTANCE_M: f64 = 5e-3;

#[test]
fn positions_fix_the_gauge() {
    // A millimetre and a thousandth of a radian and of the scale from the model's frame.
    let near = Sim3 {
        scale: 1.001,
        translation: Vector3::repeat(1e-3),
        rotation: Rigid3::from_axis_angle(Vector3::repeat(1e-3), Vector3::zeros()).rotation,
    };
    let mut measured = model();
    measured.transform(&near);
    let mut positions = Positions(centres(&measured));
    let (found, _) = adjusted(Gauge::FixedByTerms, &mut [&mut positions]);
    let distance = |(a, b): (&Vector3<f64>, &Vector3<f64>)| (a - b).norm();
    let far = centres(&found).iter().zip(&positions.0).map(distance).fold(0.0, f64::max);
    assert!(far < MAX_DISTANCE_M, "{far}");
    assert!((0..NUM_IMAGES).all(|image| pose(&found, image) != pose(&model(), image)));
}
