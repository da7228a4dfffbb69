//! Pairs in the stages: the result of a matcher, the seed of a pair, and matches of keypoints that
//! exist.

use tiepoint_sfm::convert::matched;
use tiepoint_sfm::geometry::Rng;
use tiepoint_sfm::matching::{self, PreparedImages};
use tiepoint_sfm::scene::{ImageId, ImagePair, Match, TwoView};
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions, verify_pair};

use crate::Error;

/// The matches of each pair. `num_keypoints`: number of keypoints of an image.
///
/// # Errors
///
/// The matcher fails, does not give a list for each pair, or names a keypoint that does not exist.
pub(crate) fn match_pairs(
    images: &dyn PreparedImages,
    pairs: &[ImagePair],
    num_keypoints: impl Fn(ImageId) -> usize,
) -> Result<Vec<Vec<Match>>, Error> {
    let numbers: Vec<(u32, u32)> = pairs.iter().map(|pair| (pair.a.0, pair.b.0)).collect();
    let found = images.match_pairs(&numbers).map_err(Error::Method)?;
    if found.len() != pairs.len() {
        return Err(Error::InvalidMatches { pairs: pairs.len(), lists: found.len() });
    }
    let of_pair = |(pair, found): (&ImagePair, Vec<matching::Match>)| {
        let matches: Vec<Match> = found.iter().map(matched).collect();
        let counts = [pair.a, pair.b].map(&num_keypoints);
        match matches.iter().find(|m| m.a as usize >= counts[0] || m.b as usize >= counts[1]) {
            None => Ok(matches),
            Some(&Match { a, b }) => Err(Error::InvalidMatch { keypoints: [a, b], counts }),
        }
    };
    pairs.iter().zip(found).map(of_pair).collect()
}

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
