//! The trait of matchers.

use std::error::Error;
use std::fmt;

use tiepoint_features::Features;

use crate::matches::Match;
use crate::pairs::Pair;

/// Matches the features of image pairs. It prepares each image once and then takes pairs in
/// batches, so that it may run on a GPU.
pub trait Matcher: fmt::Debug + Send + Sync {
    /// A name that tells it from other matchers, in lower case.
    fn name(&self) -> &str;

    /// Its options as texts by key: all that changes its results. Results are kept as long as name
    /// and options are the same.
    fn options(&self) -> Vec<(&'static str, String)>;

    /// Most pairs that [`PreparedImages::match_pairs`] gets at a time. With 1, several threads call
    /// it at the same time, each with a pair. By default it gets all pairs of a tile of images:
    /// 16,384 in `tiepoint-pipeline`. Progress is reported after each batch.
    fn pairs_per_batch(&self) -> usize {
        usize::MAX
    }

    /// An empty set of images.
    fn images(&self) -> Box<dyn PreparedImages>;
}

/// The images that a [`Matcher`] has in memory, by numbers of the caller.
pub trait PreparedImages: Send + Sync {
    /// Adds images.
    ///
    /// # Errors
    /// The images cannot be prepared; the message says why.
    fn insert(&mut self, images: &[(u32, &Features)]) -> Result<(), Box<dyn Error + Send + Sync>>;

    /// Removes the images that are not needed.
    fn retain(&mut self, is_needed: &dyn Fn(u32) -> bool);

    /// The matches of each pair, in the order of `pairs`. They do not depend on the other pairs.
    ///
    /// # Errors
    /// The pairs cannot be matched; the message says why.
    ///
    /// # Panics
    /// If an image was not added.
    fn match_pairs(&self, pairs: &[Pair]) -> Result<Vec<Vec<Match>>, Box<dyn Error + Send + Sync>>;
}
