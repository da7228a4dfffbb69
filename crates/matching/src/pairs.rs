//! Which images to match with which.
//!
//! A pair is `(i, j)` with `i < j`, indices into the caller's list of images. Every function
//! returns pairs sorted and without duplicates.

use std::fmt;
use std::str::FromStr;

use crate::error::Error;

/// Two images to match, the lower index first.
pub type Pair = (u32, u32);

/// A way to select pairs, as users write it: `exhaustive`, `sequential:20`, `sequential:20+ends`,
/// `sequential:20+loops:10`, `similar:30`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairSelection {
    /// Every image with every other.
    Exhaustive,
    /// Each image with its neighbours in time, of its own camera and of every other.
    Sequential {
        /// How many neighbours before and after.
        reach: u32,
        /// What else is matched.
        ends: Ends,
        /// How many images that look most alike each image is matched with beside its neighbours; 0
        /// for none. They are found by what is in the images: [`Bank::pairs`](crate::Bank::pairs).
        loops: u32,
    },
    /// Each image with those that look most alike, whatever the order.
    Similar {
        /// How many.
        count: u32,
    },
}

/// Whether the images at the beginning of a sequence are matched with those at its end, for a drive
/// that comes back to where it began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ends {
    /// They are not.
    Open,
    /// The first `reach` images of every camera are matched with the last `reach` of every camera.
    Closed,
}

impl FromStr for PairSelection {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let unknown = || Error::PairSelection(text.to_owned());
        // Digits only: `parse` alone would take "+5".
        let count = |digits: &str| match digits.parse() {
            Ok(count) if count > 0 && digits.bytes().all(|c| c.is_ascii_digit()) => Ok(count),
            _ => Err(unknown()),
        };
        if text == "exhaustive" {
            return Ok(PairSelection::Exhaustive);
        }
        if let Some(digits) = text.strip_prefix("similar:") {
            return Ok(PairSelection::Similar { count: count(digits)? });
        }
        let rest = text.strip_prefix("sequential:").ok_or_else(unknown)?;
        let (rest, loops) = match rest.split_once("+loops:") {
            Some((rest, digits)) => (rest, count(digits)?),
            None => (rest, 0),
        };
        let (reach, ends) = match rest.strip_suffix("+ends") {
            Some(reach) => (reach, Ends::Closed),
            None => (rest, Ends::Open),
        };
        Ok(PairSelection::Sequential { reach: count(reach)?, ends, loops })
    }
}

impl fmt::Display for PairSelection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            PairSelection::Exhaustive => f.write_str("exhaustive"),
            PairSelection::Sequential { reach, ends, loops } => {
                write!(f, "sequential:{reach}")?;
                if ends == Ends::Closed {
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
    /// How many images that look alike each is to be matched with beside the [`pairs`](Self::pairs)
    /// that order and time alone give.
    pub fn similar(self) -> u32 {
        match self {
            PairSelection::Exhaustive => 0,
            PairSelection::Sequential { loops, .. } => loops,
            PairSelection::Similar { count } => count,
        }
    }

    /// The pairs among the images of these cameras, as far as order and time give them.
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
            PairSelection::Similar { .. } => {}
            PairSelection::Sequential { reach, ends, .. } => {
                let reach = reach as usize;
                for (from, to) in
                    cameras.iter().flat_map(|from| cameras.iter().map(move |to| (from, to)))
                {
                    push_neighbours(&mut pairs, from, to, reach);
                    if ends == Ends::Closed {
                        let first = &from.images[..reach.min(from.images.len())];
                        let last = &to.images[to.images.len().saturating_sub(reach)..];
                        pairs.extend(first.iter().flat_map(|&i| last.iter().map(move |&j| (i, j))));
                    }
                }
            }
        }
        normalise(pairs)
    }
}

/// Images of one camera in the order in which they were taken.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequence {
    images: Vec<u32>,
    /// As long as `images`, or empty.
    times_s: Vec<f64>,
}

impl Sequence {
    /// Images whose times are not known: across cameras, equal positions belong together.
    pub fn new(images: Vec<u32>) -> Self {
        Sequence { images, times_s: Vec::new() }
    }

    /// Images with their times in seconds, ascending, on a clock that the cameras roughly share.
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

    /// Position of the image nearest in time, the earlier of two that are equally near.
    fn position_at(&self, time_s: f64) -> usize {
        let after = self.times_s.partition_point(|&t| t < time_s);
        match (after.checked_sub(1), self.times_s.get(after)) {
            (Some(before), Some(&t)) if time_s - self.times_s[before] > t - time_s => after,
            (Some(before), _) => before,
            (None, _) => after,
        }
    }
}

/// Pairs each image of `from` with the `reach` images of `to` before and after the one that belongs
/// to it.
fn push_neighbours(pairs: &mut Vec<Pair>, from: &Sequence, to: &Sequence, reach: usize) {
    let by_time = from.times_s.len() == from.images.len() && to.times_s.len() == to.images.len();
    let is_same_camera = std::ptr::eq(from, to);
    for (position, &image) in from.images.iter().enumerate() {
        let centre = if by_time && !is_same_camera {
            to.position_at(from.times_s[position])
        } else {
            position
        };
        let first = centre.saturating_sub(reach).min(to.images.len());
        let last = centre.saturating_add(reach).saturating_add(1).min(to.images.len());
        pairs.extend(to.images[first..last].iter().map(|&other| (image, other)));
    }
}

/// A list of pairs that came from elsewhere, sorted, the lower index first, without duplicates and
/// without pairs of an image with itself; an error if one names an image that does not exist.
pub fn listed_pairs(list: &[Pair], images: u32) -> Result<Vec<Pair>, Error> {
    match list.iter().find(|&&(a, b)| a >= images || b >= images) {
        Some(&(a, b)) => Err(Error::PairRange { a, b, images }),
        None => Ok(normalise(list.to_vec())),
    }
}

/// Sorted, the lower index first, each once.
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
