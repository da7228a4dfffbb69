//! What an adjustment refuses: too little to adjust, and terms that break their contract.

use tiepoint_adjust::{
    AdjustOptions, Error, Scope, Term, TermContext, Variables, adjust, keep_going,
};
use tiepoint_geometry::CameraModelKind;
use tiepoint_scene::{ImageId, Reconstruction};

use crate::common::{camera, scene};

fn model() -> Reconstruction {
    let lens = camera(CameraModelKind::Pinhole, &[500.0, 500.0, 320.0, 240.0], [640, 480]);
    scene(&[lens], 3, 0.5)
}

fn adjusted(model: &mut Reconstruction, term: &mut dyn Term) -> Result<(), Error> {
    let options = AdjustOptions::default();
    adjust(model, &Scope::Global, &options, &mut [term], &mut keep_going).map(|_| ())
}

/// Names an image whose pose it does not compose.
struct NamesOnly;

impl Term for NamesOnly {
    fn composed_images(&mut self, posed: &[ImageId]) -> Vec<ImageId> {
        vec![posed[0]]
    }

    fn add(&mut self, _: &TermContext, _: &mut Variables) -> Result<(), Error> {
        Ok(())
    }
}

/// Composes the pose of an image that it did not name.
struct ComposesOnly;

impl Term for ComposesOnly {
    fn add(&mut self, _: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        let [(image, first), (_, second)] = [variables.poses()[0], variables.poses()[1]];
        variables.compose_pose(image, first, second);
        Ok(())
    }
}

/// Has an error of its own.
struct Fails;

impl Term for Fails {
    fn add(&mut self, _: &TermContext, _: &mut Variables) -> Result<(), Error> {
        Err(Error::Term("no odometry at 12.5 s".into()))
    }
}

#[test]
fn a_term_that_breaks_its_contract_is_an_error_and_leaves_the_model() {
    let before = model();
    let mut model = before.clone();
    for term in [&mut NamesOnly as &mut dyn Term, &mut ComposesOnly] {
        let error = adjusted(&mut model, term).unwrap_err();
        assert!(matches!(error, Error::ComposedPoses), "{error}");
    }
    let error = adjusted(&mut model, &mut Fails).unwrap_err();
    assert_eq!(error.to_string(), "no odometry at 12.5 s");
    assert_eq!(model, before);
}

#[test]
fn a_single_image_is_nothing_to_adjust() {
    let mut model = model();
    model.deregister(ImageId(1));
    model.deregister(ImageId(2));
    let options = AdjustOptions::default();
    let error = adjust(&mut model, &Scope::Global, &options, &mut [], &mut keep_going);
    assert!(matches!(error, Err(Error::NothingToAdjust { .. })), "{error:?}");
}
