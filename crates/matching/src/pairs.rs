//! Selection of the image pairs to match.
//!
//! A pair is `(i, j)` with `i < j`, indices of images. Every function returns sorted pairs without
//! duplicates.

use std::fmt;
use std::str::FromStr;

use crate::error::Error;

/// Two images to match, the lower index first.
pub type Pair = (u32, u32);

/// The rule of the pair selection. Its text forms are `auto`, `exhaustive`, `sequential:20`,
/// `sequential:20+thin`, `sequential:20+ends`, `sequential:20+loops:10` and `similar:30`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairSelection {
    /// All pairs of few images. Of more, the neighbours in sequences and the images that
    /// [`InvertedIndex`](crate::retrieval::InvertedIndex) finds similar: see
    /// [`auto_pairs`](crate::auto_pairs()).
    Auto,
    /// All pairs of images.
    Exhaustive,
    /// Each image with its neighbours in time, of its own camera and of all other cameras.
    Sequential {
        /// Distance of the farthest neighbours before and after the image.
        overlap: u32,
        /// Whether the neighbours thin out with their distance: of 20 these are 1, 2, 3, 4, 6, 8,
        /// 12 and 16 images away. Else each is a neighbour.
        is_thinned: bool,
        /// For drives that return to their start: whether the first `overlap` images of every
        /// camera are also matched with the last `overlap` images of every camera.
        is_closed: bool,
        /// Number of similar images with which each image is matched too, for loop closures; 0 for
        /// none. [`RetrievalIndex::pairs`](crate::retrieval::RetrievalIndex::pairs) retrieves them.
        loops: u32,
    },
    /// Each image with the most similar images, independent of their order.
    Similar {
        /// Number of similar images per image.
        count: u32,
    },
}

/// Neighbours before and after an image if no number is given, as in COLMAP.
const DEFAULT_OVERLAP: u32 = 10;

impl FromStr for PairSelection {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let unknown = || Error::PairSelection(text.to_owned());
        // Digits only: `parse` would accept "+5".
        let count = |digits: &str| match digits.parse() {
            Ok(count) if count > 0 && digits.bytes().all(|c| c.is_ascii_digit()) => Ok(count),
            _ => Err(unknown()),
        };
        match text {
            "auto" => return Ok(PairSelection::Auto),
            "exhaustive" => return Ok(PairSelection::Exhaustive),
            "sequential" => {
                return Ok(PairSelection::sequential(DEFAULT_OVERLAP));
            }
            _ => {}
        }
        if let Some(digits) = text.strip_prefix("similar:") {
            return Ok(PairSelection::Similar { count: count(digits)? });
        }
        let rest = text.strip_prefix("sequential:").ok_or_else(unknown)?;
        let (rest, loops) = match rest.split_once("+loops:") {
            Some((rest, digits)) => (rest, count(digits)?),
            None => (rest, 0),
        };
        let without = |text, suffix| match str::strip_suffix(text, suffix) {
            Some(rest) => (rest, true),
            None => (text, false),
        };
        let (rest, is_closed) = without(rest, "+ends");
        let (overlap, is_thinned) = without(rest, "+thin");
        let overlap = count(overlap)?;
        Ok(PairSelection::Sequential { overlap, is_thinned, is_closed, loops })
    }
}

impl fmt::Display for PairSelection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            PairSelection::Auto => f.write_str("auto"),
            PairSelection::Exhaustive => f.write_str("exhaustive"),
            PairSelection::Sequential { overlap, is_thinned, is_closed, loops } => {
                write!(f, "sequential:{overlap}")?;
                if is_thinned {
                    f.write_str("+thin")?;
                }
                if is_closed {
                    f.write_str("+ends")?;
                }
                if loops > 0 {
                    write!(f, "+loops:{loops}")?;
                }
                Ok(())
            }
            PairSelection::Similar { count } => write!(f, "similar:{count}"),
        }
    }
}

impl PairSelection {
    /// Each image with a number of neighbours before and after it.
    pub fn sequential(overlap: u32) -> Self {
        PairSelection::Sequential { overlap, is_thinned: false, is_closed: false, loops: 0 }
    }

    /// Number of similar images by [`RetrievalIndex`](crate::retrieval::RetrievalIndex) with which
    /// each image is matched, in addition to [`pairs`](Self::pairs).
    pub fn similar(self) -> u32 {
        match self {
            PairSelection::Auto | PairSelection::Exhaustive => 0,
            PairSelection::Sequential { loops, .. } => loops,
            PairSelection::Similar { count } => count,
        }
    }

    /// The pairs that follow from the order and times of the images. Pairs of similar images are
    /// not included; [`Auto`](Self::Auto) has none, because all its pairs depend on similarity.
    pub fn pairs(self, cameras: &[Sequence]) -> Vec<Pair> {
        let mut pairs = Vec::new();
        match self {
            PairSelection::Exhaustive => {
                let images: Vec<u32> =
                    cameras.iter().flat_map(|camera| camera.images.iter().copied()).collect();
                for (k, &i) in images.iter().enumerate() {
                    pairs.extend(images[k + 1..].iter().map(|&j| (i, j)));
                }
            }
            PairSelection::Auto | PairSelection::Similar { .. } => {}
            PairSelection::Sequential { overlap, is_thinned, is_closed, .. } => {
                let overlap = overlap as usize;
                // Thinned distances are 0, 2ⁿ and 3 · 2ⁿ.
                let odd = |distance: usize| distance >> distance.trailing_zeros();
                let is_taken =
                    |distance| !is_thinned || distance == 0 || matches!(odd(distance), 1 | 3);
                for (from, to) in
                    cameras.iter().flat_map(|from| cameras.iter().map(move |to| (from, to)))
                {
                    push_neighbours(&mut pairs, from, to, overlap, is_taken);
                    if is_closed {
                        let first = &from.images[..overlap.min(from.images.len())];
                        let last = &to.images[to.images.len().saturating_sub(overlap)..];
                        pairs.extend(first.iter().flat_map(|&i| last.iter().map(move |&j| (i, j))));
                    }
                }
            }
        }
        normalise(pairs)
    }
}

/// The images of a camera in order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequence {
    images: Vec<u32>,
    /// Times of the images in seconds; empty if unknown.
    times_s: Vec<f64>,
}

impl Sequence {
    /// The images of one camera in their order, without times. Two images of different cameras
    /// count as simultaneous if they have equal positions in their sequences.
    pub fn new(images: Vec<u32>) -> Self {
        Sequence { images, times_s: Vec::new() }
    }

    /// Images with their times in seconds, in ascending order, on a roughly synchronised clock.
    ///
    /// # Errors
    /// [`Error::TimeCount`] if the numbers of images and times differ; [`Error::TimeOrder`] if a
    /// time is not finite or before the previous time.
    pub fn with_times(images: Vec<u32>, times_s: Vec<f64>) -> Result<Self, Error> {
        if images.len() != times_s.len() {
            return Err(Error::TimeCount { images: images.len(), times: times_s.len() });
        }
        for (index, &time_s) in times_s.iter().enumerate() {
            if !time_s.is_finite() || (index > 0 && time_s < times_s[index - 1]) {
                return Err(Error::TimeOrder { index, time_s });
            }
        }
        Ok(Sequence { images, times_s })
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.images.len()
    }

    /// Whether there are no images.
    pub fn is_empty(&self) -> bool {
        self.images.is_empty()
    }

    /// The images.
    pub(crate) fn images(&self) -> &[u32] {
        &self.images
    }

    /// The times of the images; empty if unknown.
    pub(crate) fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// The median of the intervals of consecutive images, 0 for fewer than two times.
    pub(crate) fn median_interval_s(&self) -> f64 {
        let mut intervals: Vec<f64> =
            self.times_s.windows(2).map(|times_s| times_s[1] - times_s[0]).collect();
        let middle = intervals.len() / 2;
        match intervals.is_empty() {
            true => 0.0,
            false => *intervals.select_nth_unstable_by(middle, f64::total_cmp).1,
        }
    }

    /// Position of the image nearest in time, the earlier one of two equally near images.
    pub(crate) fn position_at(&self, time_s: f64) -> usize {
        let after = self.times_s.partition_point(|&t| t < time_s);
        match (after.checked_sub(1), self.times_s.get(after)) {
            (Some(before), Some(&t)) if time_s - self.times_s[before] > t - time_s => after,
            (Some(before), _) => before,
            (None, _) => after,
        }
    }
}

/// Pairs each image of `from` with the simultaneous image of `to`, and with those of the `overlap`
/// images before and after it whose distance is taken.
fn push_neighbours(
    pairs: &mut Vec<Pair>,
    from: &Sequence,
    to: &Sequence,
    overlap: usize,
    is_taken: impl Fn(usize) -> bool,
) {
    let by_time = from.times_s.len() == from.images.len() && to.times_s.len() == to.images.len();
    let is_same_camera = std::ptr::eq(from, to);
    for (position, &image) in from.images.iter().enumerate() {
        let centre = if by_time && !is_same_camera {
            to.position_at(from.times_s[position])
        } else {
            position
        };
        let first = centre.saturating_sub(overlap).min(to.images.len());
        let last = centre.saturating_add(overlap).saturating_add(1).min(to.images.len());
        let taken = (first..last).filter(|other| is_taken(centre.abs_diff(*other)));
        pairs.extend(taken.map(|other| (image, to.images[other])));
    }
}

/// Sorts pairs, with the lower index first, and removes duplicates and pairs of equal indices.
pub(crate) fn normalise(mut pairs: Vec<Pair>) -> Vec<Pair> {
    pairs.retain(|(i, j)| i != j);
    for (i, j) in &mut pairs {
        (*i, *j) = (*i.min(j), *i.max(j));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

#[cfg(test)]
mod tests;
