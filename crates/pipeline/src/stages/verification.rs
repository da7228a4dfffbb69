//! Verification of a pair in the stages: the seed of a pair, and matches of keypoints that exist.

use tiepoint_sfm::geometry::Rng;
use tiepoint_sfm::scene::{ImageId, ImagePair, Match, TwoView};
use tiepoint_sfm::{ImageObservations, VerifyOptions, verify_pair};

/// Verifies the matches of a pair. Each pair has a random stream of its own, so that the geometry
/// does not depend on the order in which pairs are verified.
pub(crate) fn verify<'a>(
    pair: ImagePair,
    image: impl Fn(ImageId) -> ImageObservations<'a>,
    matches: &[Match],
    options: &VerifyOptions,
    seed: u64,
) -> TwoView {
    let seed = Rng::stream(seed, &[u64::from(pair.a.0), u64::from(pair.b.0)]).next_u64();
    verify_pair(image(pair.a), image(pair.b), matches, options, seed)
}

/// The matches of keypoints that both images have. `num_keypoints`: number of keypoints of an
/// image. Databases of other programs may have further ones.
pub(crate) fn of_keypoints(
    pair: ImagePair,
    mut matches: Vec<Match>,
    num_keypoints: impl Fn(ImageId) -> usize,
) -> Vec<Match> {
    let has = |image, keypoint: u32| (keypoint as usize) < num_keypoints(image);
    matches.retain(|m| has(pair.a, m.a) && has(pair.b, m.b));
    matches
}
