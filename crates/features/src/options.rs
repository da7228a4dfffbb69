//! What can be chosen.

use crate::Error;

/// How histograms become the 128 numbers of a descriptor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Normalization {
    /// RootSIFT (Arandjelović & Zisserman 2012): divided by the sum, then the square root.
    /// Euclidean distance then compares histograms by the Hellinger kernel, which matches better.
    #[default]
    RootL1,
    /// Lowe 2004: divided by the Euclidean norm.
    L2,
}

/// How [`Options::max_features`] is meant. Either way the coarsest features are kept: those with
/// the strongest response at any scale were measured to be worth much less (see
/// `bench/sift_sfm.py`). Fine octaves that cannot contribute are not even computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Limit {
    /// As COLMAP does: levels of the scale space are taken from the coarsest down, and the one in
    /// which the number of keypoints exceeds the limit is the last one. Gives up to half as many
    /// features more than the limit says, because that level is complete and a keypoint with two
    /// orientations counts once.
    #[default]
    WholeLevels,
    /// That many features and no more; within the last level those with the strongest response.
    Exact,
}

/// DSP-SIFT (Dong & Soatto, "Domain-size pooling in local descriptors", CVPR 2015): a descriptor is
/// the mean of several, measured in windows of different size around the same keypoint. It matches
/// better where scale is uncertain, and takes some twenty times as long as a plain one. Keypoints
/// that are copies of others are left out. The defaults are COLMAP's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DomainSizes {
    /// Smallest window, relative to that of a plain descriptor. Above 0.
    pub min: f32,
    /// End of the sizes, which is not one of them, relative to a plain descriptor. Above `min`, at
    /// most 8.
    pub max: f32,
    /// Number of sizes, evenly spread. 1 to 64.
    pub count: usize,
}

impl Default for DomainSizes {
    fn default() -> Self {
        DomainSizes { min: 1.0 / 6.0, max: 3.0, count: 10 }
    }
}

impl DomainSizes {
    /// The sizes, ascending.
    pub(crate) fn sizes(self) -> impl Iterator<Item = f32> {
        let step = (self.max - self.min) / self.count as f32;
        (0..self.count).map(move |i| self.min + i as f32 * step)
    }
}

/// What to extract. The defaults are COLMAP's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Octave of the finest scale: −1 doubles the image, 0 starts at its own resolution, 1 at half
    /// of it. −1 to 8.
    pub first_octave: i32,
    /// Number of octaves, from `first_octave` on; fewer where the image becomes too small. 1 to 16.
    pub octaves: usize,
    /// Scales per octave at which extrema are looked for. 1 to 8.
    pub levels: usize,
    /// Smallest absolute difference of Gaussians at an extremum, where black is 0 and white is 1.
    pub peak_threshold: f32,
    /// Largest ratio of the principal curvatures at an extremum: above it, it lies on an edge. At
    /// least 1.
    pub edge_threshold: f32,
    /// Number of features, as `limit` counts them.
    pub max_features: usize,
    /// How `max_features` is meant.
    pub limit: Limit,
    /// Number of dominant orientations per keypoint, at most; each gives a feature. 1 to 4.
    pub max_orientations: usize,
    /// Whether the orientation is measured, or zero for every keypoint.
    pub orientation: Orientation,
    /// How descriptors are normalised.
    pub normalization: Normalization,
    /// Over which window sizes descriptors are pooled; none for plain SIFT.
    pub domain_sizes: Option<DomainSizes>,
}

/// Whether descriptors turn with the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Orientation {
    /// Along the dominant gradient directions: descriptors do not change when the image is rotated.
    #[default]
    Dominant,
    /// Along +x for every keypoint: more distinctive and faster, for cameras that stay upright.
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
    /// The largest window of a descriptor, relative to that of a plain one.
    pub(crate) fn largest_size(&self) -> f32 {
        self.domain_sizes.map_or(1.0, |sizes| sizes.max)
    }

    /// Whether every option is inside of its range.
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
