//! Control points as a term of bundle adjustments.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_adjust::{Error, Mark, Term, TermContext, Variables};
use tiepoint_ba::factors::Prior;
use tiepoint_ba::{Key, Problem};
use tiepoint_geometry::Loss;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_scene::ImageId;

/// A control point in an adjustment.
#[derive(Clone, Debug)]
pub(super) struct ControlLandmark {
    /// Where it is before the adjustment; after it, where it is then.
    pub(super) xyz: Vector3<f64>,
    /// Its measured coordinates with their standard deviations, in metres; `None` if only its marks
    /// take part.
    pub(super) measured: Option<(Vector3<f64>, Vector3<f64>)>,
    /// The images in which it is marked, with the pixels.
    pub(super) marks: Vec<(ImageId, Vector2<f64>)>,
    /// Standard deviation of the coordinates of a mark, in pixels.
    pub(super) mark_sigma_px: f64,
}

/// Control points as landmarks: each with a reprojection error for each mark, and a prior on its
/// position.
pub(super) struct ControlTerm {
    pub(super) landmarks: Vec<ControlLandmark>,
    /// Scale of a Cauchy loss in standard deviations, of marks and positions; else it is squared.
    loss_scale: Option<f64>,
    /// The variables of the landmarks; `None` for those without two marks in the problem.
    pub(super) keys: Vec<Option<Key<Vector3<f64>>>>,
    marks: BTreeMap<ImageId, Vec<Mark>>,
}

impl ControlTerm {
    pub(super) fn new(landmarks: Vec<ControlLandmark>, loss_scale: Option<f64>) -> Self {
        Self { landmarks, loss_scale, keys: Vec::new(), marks: BTreeMap::new() }
    }
}

impl Term for ControlTerm {
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        self.keys.clear();
        self.marks.clear();
        let own = variables.poses().iter().map(|(image, _)| *image);
        let composed = variables.composed_poses().iter().map(|(image, _)| *image);
        let posed: BTreeSet<ImageId> = own.chain(composed).collect();
        let noise = context.noise;
        let loss = self.loss_scale.map_or(Loss::Trivial, |scale| Loss::Cauchy(scale * noise));
        for landmark in &self.landmarks {
            let marks = landmark.marks.iter().filter(|(image, _)| posed.contains(image));
            if marks.clone().count() < 2 {
                self.keys.push(None);
                continue;
            }
            let problem = variables.problem_mut();
            let point = problem.add_landmark(landmark.xyz);
            if let Some((mean, sigmas_m)) = landmark.measured {
                let prior = Prior::new(mean, &(sigmas_m / noise).into())?;
                problem.add(point, prior, loss)?;
            }
            for &(image, pixel) in marks {
                let sigma_px = landmark.mark_sigma_px / noise;
                self.marks.entry(image).or_default().push(Mark { point, pixel, sigma_px, loss });
            }
            self.keys.push(Some(point));
        }
        Ok(())
    }

    fn marks_of(&self, image: ImageId) -> &[Mark] {
        self.marks.get(&image).map_or(&[], Vec::as_slice)
    }

    fn read(&mut self, problem: &Problem) {
        for (landmark, key) in self.landmarks.iter_mut().zip(&self.keys) {
            if let Some(key) = key {
                landmark.xyz = problem.get(*key);
            }
        }
    }
}
