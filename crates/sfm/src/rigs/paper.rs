//! The baseline constraint of Huang, Elhashash & Qin 2022 as a term of an adjustment.

use std::collections::BTreeMap;

use tiepoint_adjust::{Error, Term, TermContext, Variables};
use tiepoint_ba::{EliminationOrder, Key};
use tiepoint_geometry::{Loss, Rigid3};
use tiepoint_rig::{Baseline, RelativePose, paper};
use tiepoint_scene::{ImageId, Reconstruction};

use super::pairs::{RigPair, RigPairs, relative_poses};

/// Equality of the relative poses of two consecutive pairs: cost ½ w ‖p_i − p_{i+1}‖².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaselineLink {
    /// Pair i.
    pub now: RigPair,
    /// Pair i + 1.
    pub next: RigPair,
    /// Weight w.
    pub weight: f64,
    /// Relative pose that selects the branch of the axis-angle vectors.
    pub near: RelativePose,
}

impl BaselineLink {
    /// The images in the order of [`tiepoint_rig::Baseline`]'s variables.
    pub(crate) fn images(&self) -> [ImageId; 4] {
        [self.now.reference, self.now.other, self.next.reference, self.next.other]
    }
}

/// The weights of the links: Eq. 2 during mapping, Eq. 4 in the last adjustment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkWeights {
    /// Those of [`growing_links`].
    Growing,
    /// Those of [`final_links`].
    Final,
}

/// The links of consecutive pairs as a term of an adjustment. Links without a variable image are
/// skipped. Images of a link that are in no other term are constant.
#[derive(Clone, Copy, Debug)]
pub struct BaselineTerm<'a> {
    /// The pairs of each rig.
    pub rigs: &'a [RigPairs],
    /// The weights.
    pub weights: LinkWeights,
}

impl Term for BaselineTerm<'_> {
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        let mut keys: BTreeMap<ImageId, Key<Rigid3>> = variables.poses().iter().copied().collect();
        let links = match self.weights {
            LinkWeights::Growing => growing_links(context.model, self.rigs),
            LinkWeights::Final => final_links(context.model, self.rigs),
        };
        for link in links {
            let images = link.images();
            if !images
                .iter()
                .any(|image| context.scope.is_variable(*image) && keys.contains_key(image))
            {
                continue;
            }
            let key_of = |image: ImageId| -> Option<Key<Rigid3>> {
                if let Some(&key) = keys.get(&image) {
                    return Some(key);
                }
                let key = variables.problem_mut().add_parameter(
                    *context.model.image(image).cam_from_world()?,
                    EliminationOrder::At(image.0),
                );
                variables.problem_mut().fix(key);
                keys.insert(image, key);
                Some(key)
            };
            let [a, b, c, d] = images.map(key_of);
            let (Some(a), Some(b), Some(c), Some(d)) = (a, b, c, d) else { continue };
            variables.problem_mut().add(
                (a, b, c, d),
                Baseline::with_weight(link.weight, link.near),
                Loss::Trivial,
            )?;
        }
        Ok(())
    }
}

/// The links of Huang, Elhashash & Qin 2022 during mapping, with the weight λ N_p/N_t (Eq. 2).
pub fn growing_links(model: &Reconstruction, rigs: &[RigPairs]) -> Vec<BaselineLink> {
    links(model, rigs, |poses, total| {
        vec![paper::growing_weight(poses.len(), total); poses.len().saturating_sub(1)]
    })
}

/// The links of the last adjustment, weighted by the deviation of the relative poses from their
/// mean (Eq. 4).
pub fn final_links(model: &Reconstruction, rigs: &[RigPairs]) -> Vec<BaselineLink> {
    links(model, rigs, |poses, _| paper::final_link_weights(poses))
}

/// Links consecutive pairs with two registered images. `weights` gets the relative poses and the
/// number of all pairs.
fn links(
    model: &Reconstruction,
    rigs: &[RigPairs],
    weights: impl Fn(&[RelativePose], usize) -> Vec<f64>,
) -> Vec<BaselineLink> {
    let mut links = Vec::new();
    for rig in rigs {
        let (pairs, poses): (Vec<RigPair>, Vec<RelativePose>) =
            relative_poses(model, &rig.pairs).into_iter().unzip();
        let Some(&near) = poses.first() else { continue };
        let weights = weights(&poses, rig.pairs.len());
        links.extend(pairs.windows(2).zip(weights).map(|(w, weight)| BaselineLink {
            now: w[0],
            next: w[1],
            weight,
            near,
        }));
    }
    links
}
