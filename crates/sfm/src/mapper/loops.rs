//! Loop closure of a mapped model.

use rayon::prelude::*;
use tiepoint_scene::ImagePair;

use super::known_rigs::restore_frames;
use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use crate::Error;
use crate::event::{Event, Watch, notify};
use crate::loop_closure::{
    ClassifiedPairs, CovisibilityGraph, LoopConstraint, MIN_PAIRS, classify_pairs, consistent_set,
    distribute_drift, is_closed, merge_matched_points,
};

/// Maximum number of closures. One open loop can hide another.
const MAX_CLOSURES: usize = 3;

impl Refiner<'_> {
    /// Closes loops that drift left open ([`crate::loop_closure`]).
    pub(super) fn close_loops(&mut self, watch: &mut Watch) -> Result<(), Error> {
        for _ in 0..MAX_CLOSURES {
            let ClassifiedPairs { open_loop, covisibility } =
                classify_pairs(self.input.graph, &self.solution.model);
            let loop_constraints = self.loop_constraints(&open_loop, &covisibility);
            if loop_constraints.len() < MIN_PAIRS {
                break;
            }
            let open_loop: Vec<ImagePair> =
                loop_constraints.iter().map(|loop_constraint| loop_constraint.pair).collect();
            // On failure drift is not the cause. With wrong pairs or a wrong lens model, the
            // closure may leave nothing to adjust.
            let closed = self.transaction(|refiner| {
                let before = refiner.solution.model.clone();
                refiner.close_loop(&covisibility, &loop_constraints, watch)?;
                let after = &refiner.solution.model;
                let is_closed = is_closed(refiner.input.graph, after, &before, &open_loop);
                // Pairs of two places that look alike also agree with each other.
                if is_closed && refiner.other_place().is_none() {
                    Ok(())
                } else {
                    Err(Error::LoopNotClosed { pairs: open_loop.len() })
                }
            })?;
            if closed.is_err() {
                break;
            }
            self.solution.num_loop_pairs += open_loop.len();
            notify(watch, &Event::LoopClosed { num_pairs: open_loop.len() })?;
        }
        Ok(())
    }

    /// Estimates the relative similarities of open-loop pairs.
    fn loop_constraints(
        &self,
        open_loop: &[ImagePair],
        covisibility: &CovisibilityGraph,
    ) -> Vec<LoopConstraint> {
        let (input, model) = (self.input, &self.solution.model);
        let loop_constraint = |pair: &ImagePair| {
            let seed = input.seed_of(&[pair.a.0.into(), pair.b.0.into()]);
            LoopConstraint::new(model, *pair, input.graph.pairs().get(pair)?, seed)
        };
        let loop_constraints: Vec<LoopConstraint> =
            open_loop.par_iter().filter_map(loop_constraint).collect();
        consistent_set(model, &loop_constraints, covisibility)
    }

    /// Distributes the drift, merges the matched points and refines the model.
    fn close_loop(
        &mut self,
        covisibility: &CovisibilityGraph,
        loop_constraints: &[LoopConstraint],
        watch: &mut Watch,
    ) -> Result<(), Error> {
        // The images are moved one by one.
        let frames = std::mem::take(&mut self.solution.model.frames);
        distribute_drift(&mut self.solution.model, covisibility, loop_constraints)?;
        restore_frames(&mut self.solution.model, frames);
        merge_matched_points(
            self.input.graph,
            &mut self.solution.model,
            loop_constraints.iter().map(|loop_constraint| loop_constraint.pair),
        );
        self.refine_globally(&RefinementSchedule::AFTER_LOOP_CLOSURE, watch)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::ops::ControlFlow;

    use tiepoint_scene::{ImageId, Match, TwoView, TwoViewKind};
    use tiepoint_synth::MatchOptions;

    use super::*;
    use crate::mapper::growth::Growth;
    use crate::mapper::input::Input;
    use crate::mapper::test_scene::scene;
    use crate::options::MapperOptions;
    use tiepoint_adjust::RefineIntrinsics;

    /// All pairs get wrong matches. No closure succeeds, and the model stays unchanged.
    #[test]
    fn a_loop_that_cannot_be_closed_leaves_the_model_as_it_was() {
        let scene = scene();
        let graph = scene.graph(&MatchOptions::default());
        let options = MapperOptions { refine: RefineIntrinsics::NONE, ..MapperOptions::default() };
        let blank = scene.without_poses();
        let input = Input::of_trial(&graph, &blank, &options);
        let refiner = Refiner::new(input, blank.clone(), Vec::new());
        let mut growth = Growth::new(refiner, BTreeSet::new());
        let watch = &mut |_: &Event| ControlFlow::Continue(());
        let candidates = growth.candidates();
        growth.initialise(&candidates, watch).expect("an easy scene");
        growth.grow(watch).expect("an easy scene");
        let model = growth.model().clone();

        let seen = |id: ImageId| -> Vec<u32> {
            (0..).zip(model.image(id).points()).filter_map(|(k, point)| point.map(|_| k)).collect()
        };
        let wrong = graph.pairs().keys().map(|&pair| {
            // The matches are in reverse order.
            let (a, b) = (seen(pair.a).into_iter(), seen(pair.b).into_iter().rev());
            let matches = a.zip(b).map(|(a, b)| Match { a, b }).collect();
            (pair, TwoView { kind: TwoViewKind::Uncalibrated, matches, ..TwoView::default() })
        });
        let graph = graph.extended(wrong);
        let input = Input::of_trial(&graph, &blank, &options);
        let mut refiner = Refiner::new(input, model.clone(), Vec::new());
        assert!(!classify_pairs(&graph, &model).open_loop.is_empty());
        refiner.close_loops(watch).expect("no reason to end the run");
        assert!(refiner.solution.model == model);
    }
}
