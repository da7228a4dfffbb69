//! Options of feature extraction.

use crate::Error;

/// Normalisation of the 128 histogram values of a descriptor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Normalization {
    /// RootSIFT (Arandjelović & Zisserman 2012): the square root of the L1-normalised histogram.
    /// The Euclidean distance of descriptors then corresponds to the Hellinger kernel of
    /// histograms, which gives better matches.
    #[default]
    RootL1,
    /// Lowe 2004: the L2-normalised histogram.
    L2,
}

/// How [`Options::max_features`] limits the features. Both limits keep the features of the coarsest
/// scales. The features of the strongest response over all scales gave much worse results (measured
/// by `bench/sift_sfm.py`). The doubled octave is not computed if it cannot contribute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Limit {
    /// As in COLMAP: levels of the scale space are added from coarse to fine until the number of
    /// keypoints exceeds the limit. The number of features can exceed the limit by up to a half,
    /// because the last level is complete and a keypoint with two orientations counts once.
    #[default]
    WholeLevels,
    /// At most `max_features` features. In the last level, those of the strongest response.
    Exact,
}

/// Window sizes of DSP-SIFT (Dong & Soatto, "Domain-size pooling in local descriptors", CVPR 2015).
///
/// A descriptor is the mean of the descriptors of several window sizes around the keypoint. It
/// matches better if the scale is uncertain, and takes about twenty times as long. Duplicate
/// keypoints are removed. The defaults are those of COLMAP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DomainSizes {
    /// Smallest window size, relative to the window of a SIFT descriptor. Above 0.
    pub min: f32,
    /// Exclusive upper end of the window sizes, relative to the window of a SIFT descriptor. Above
    /// `min`, at most 8.
    pub max: f32,
    /// Number of equally spaced sizes. 1 to 64.
    pub count: usize,
}

impl Default for DomainSizes {
    fn default() -> Self {
        DomainSizes { min: 1.0 / 6.0, max: 3.0, count: 10 }
    }
}

impl DomainSizes {
    /// The window sizes in ascending order.
    pub(crate) fn sizes(self) -> impl Iterator<Item = f32> {
        let step = (self.max - self.min) / self.count as f32;
        (0..self.count).map(move |i| self.min + i as f32 * step)
    }
}

/// Options of feature extraction. The defaults are those of COLMAP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// First octave: −1 is the image at double resolution, 0 at its own, 1 at half resolution.
    /// −1 to 8.
    pub first_octave: i32,
    /// Number of octaves from `first_octave` on, fewer for small images. 1 to 16.
    pub octaves: usize,
    /// Number of levels per octave in which extrema are detected. 1 to 8.
    pub levels: usize,
    /// Minimum absolute value of the difference of Gaussians at an extremum, with black = 0 and
    /// white = 1.
    pub peak_threshold: f32,
    /// Maximum ratio of the principal curvatures at an extremum. Extrema of larger ratios are on
    /// edges. At least 1.
    pub edge_threshold: f32,
    /// Limit on the number of features, applied as `limit` says.
    pub max_features: usize,
    /// How `max_features` limits the features.
    pub limit: Limit,
    /// Maximum number of dominant orientations per keypoint; each gives a feature. 1 to 4.
    pub max_orientations: usize,
    /// How keypoint orientations are assigned.
    pub orientation: Orientation,
    /// Normalisation of the descriptors.
    pub normalization: Normalization,
    /// Window sizes of DSP-SIFT; `None` for SIFT.
    pub domain_sizes: Option<DomainSizes>,
}

/// Orientation assignment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Orientation {
    /// The dominant gradient directions: descriptors are invariant to image rotation.
    #[default]
    Dominant,
    /// Zero for all keypoints, for cameras that stay upright: more distinctive and faster.
    Upright,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            first_octave: -1,
            octaves: 4,
            levels: 3,
            peak_threshold: 0.02 / 3.0,
            edge_threshold: 10.0,
            max_features: 8192,
            limit: Limit::default(),
            max_orientations: 2,
            orientation: Orientation::default(),
            normalization: Normalization::default(),
            domain_sizes: None,
        }
    }
}

impl Options {
    /// The largest window size of a descriptor, relative to the window of a SIFT descriptor.
    pub(crate) fn largest_size(&self) -> f32 {
        self.domain_sizes.map_or(1.0, |sizes| sizes.max)
    }

    /// Checks that every option is in its range.
    ///
    /// # Errors
    /// [`Error::Option`] with the first option that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        let check = |name, value: f64, ok: bool, range| {
            if ok { Ok(()) } else { Err(Error::Option { name, value, range }) }
        };
        let (octaves, levels, orientations) = (self.octaves, self.levels, self.max_orientations);
        check(
            "first_octave",
            self.first_octave.into(),
            (-1..=8).contains(&self.first_octave),
            "-1 to 8",
        )?;
        check("octaves", octaves as f64, (1..=16).contains(&octaves), "1 to 16")?;
        check("levels", levels as f64, (1..=8).contains(&levels), "1 to 8")?;
        check("max_orientations", orientations as f64, (1..=4).contains(&orientations), "1 to 4")?;
        let (peak, edge) = (self.peak_threshold, self.edge_threshold);
        check(
            "peak_threshold",
            peak.into(),
            peak.is_finite() && peak >= 0.0,
            "finite and at least 0",
        )?;
        check(
            "edge_threshold",
            edge.into(),
            edge.is_finite() && edge >= 1.0,
            "finite and at least 1",
        )?;
        let Some(DomainSizes { min, max, count }) = self.domain_sizes else { return Ok(()) };
        check("domain_sizes.min", min.into(), min > 0.0, "above 0")?;
        check(
            "domain_sizes.max",
            max.into(),
            max > min && max <= 8.0,
            "above the smallest and at most 8",
        )?;
        check("domain_sizes.count", count as f64, (1..=64).contains(&count), "1 to 64")
    }
}
