//! The built-in matcher: nearest neighbours that pass the ratio test, the maximum angle and the
//! cross check.

use std::collections::BTreeMap;
use std::error::Error as StdError;

use rayon::prelude::*;
use tiepoint_features::{Descriptors, Features, Keypoint};

use crate::any_kind::AnyKind;
use crate::error::Error;
use crate::forest::{Checks, ForestOptions};
use crate::match_sift::match_prepared;
use crate::matcher::{Matcher, PreparedImages};
use crate::matches::Match;
use crate::options::{Method, Options, PreemptiveMatching};
use crate::pairs::Pair;
use crate::prepared::{Prepared, largest};

/// The built-in [`Matcher`]. SIFT descriptors are compared by kernels of their own, on all
/// instruction sets of the CPU; others in a plain loop over all pairs of descriptors.
#[derive(Clone, Debug, Default)]
pub struct NearestNeighbours {
    options: Options,
}

impl NearestNeighbours {
    /// Its name as a matcher.
    pub const NAME: &str = "nearest_neighbours";

    /// A matcher with these options.
    ///
    /// # Errors
    /// [`Error::Option`] if an option is out of its range.
    pub fn new(options: Options) -> Result<Self, Error> {
        options.validate()?;
        Ok(Self { options })
    }
}

impl Matcher for NearestNeighbours {
    fn name(&self) -> &str {
        Self::NAME
    }

    /// Workspaces on disk have these texts, so that keys and values are written out here instead of
    /// being derived from names of fields and types. A new option does not compile without a key.
    fn options(&self) -> Vec<(&'static str, String)> {
        let Options { max_ratio, max_angle_rad, mutual, method, preempt } = &self.options;
        let checks = |checks: &Checks| match checks {
            Checks::Total(checks) => format!("total:{checks}"),
            Checks::PerTree(checks) => format!("per_tree:{checks}"),
        };
        let method = match method {
            Method::BruteForce => "brute_force".to_owned(),
            Method::Forest(number) => format!("forest:{}", checks(number)),
            Method::Cheapest(number) => format!("cheapest:{}", checks(number)),
        };
        let mut texts = vec![("mutual", mutual.to_string()), ("method", method)];
        texts.extend(max_ratio.map(|ratio| ("max_ratio", ratio.to_string())));
        texts.extend(max_angle_rad.map(|angle| ("max_angle_rad", angle.to_string())));
        texts.extend(preempt.as_ref().map(|PreemptiveMatching { min_matches }| {
            ("preempt.min_matches", min_matches.to_string())
        }));
        texts
    }

    fn pairs_per_batch(&self) -> usize {
        1
    }

    fn images(&self) -> Box<dyn PreparedImages> {
        Box::new(Images { options: self.options.clone(), images: BTreeMap::new() })
    }
}

struct Images {
    options: Options,
    images: BTreeMap<u32, PreparedImage>,
}

impl PreparedImages for Images {
    fn insert(
        &mut self,
        images: &[(u32, &Features)],
    ) -> Result<(), Box<dyn StdError + Send + Sync>> {
        let prepare = |(id, Features { keypoints, descriptors }): &(u32, &Features)| {
            (*id, PreparedImage::new(descriptors, keypoints, &self.options))
        };
        let prepared: Vec<(u32, PreparedImage)> = images.par_iter().map(prepare).collect();
        self.images.extend(prepared);
        Ok(())
    }

    fn retain(&mut self, is_needed: &dyn Fn(u32) -> bool) {
        self.images.retain(|id, _| is_needed(*id));
    }

    fn match_pairs(
        &self,
        pairs: &[Pair],
    ) -> Result<Vec<Vec<Match>>, Box<dyn StdError + Send + Sync>> {
        let matches = |(a, b): &Pair| self.images[a].matches(&self.images[b], &self.options);
        Ok(pairs.par_iter().map(matches).collect())
    }
}

/// Matches the descriptors of two images. Matches are in ascending order of `a`. Descriptors of
/// different formats have none. For images of several pairs, use [`NearestNeighbours`].
pub fn match_features(a: &Descriptors, b: &Descriptors, options: &Options) -> Vec<Match> {
    let options = Options { preempt: None, ..options.clone() };
    let [a, b] = [a, b].map(|descriptors| PreparedImage::new(descriptors, &[], &options));
    a.matches(&b, &options)
}

/// The descriptors of an image, ready to be matched.
enum PreparedImage {
    Sift(Prepared),
    Other(AnyKind),
}

impl PreparedImage {
    fn new(descriptors: &Descriptors, keypoints: &[Keypoint], options: &Options) -> Self {
        let num_leading = options.preempt.map(|_| PreemptiveMatching::NUM_LEADING);
        let keypoints = &keypoints[..keypoints.len().min(descriptors.len())];
        let Some(sift) = descriptors.as_sift() else {
            let leading = num_leading.map(|count| descriptors.select(&largest(keypoints, count)));
            return Self::Other(AnyKind::new(descriptors.clone(), leading));
        };
        let mut prepared = match num_leading {
            Some(count) => Prepared::with_leading(sift, &largest(keypoints, count)),
            None => Prepared::new(sift),
        };
        if options.method.uses_forest(sift.len()) {
            prepared.grow_forest(&ForestOptions::default());
        }
        Self::Sift(prepared)
    }

    fn matches(&self, other: &Self, options: &Options) -> Vec<Match> {
        match (self, other) {
            (Self::Sift(a), Self::Sift(b)) => match_prepared(a, b, options),
            (Self::Other(a), Self::Other(b)) => a.matches(b, options),
            _ => Vec::new(),
        }
    }
}
