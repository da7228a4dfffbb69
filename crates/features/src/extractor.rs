//! The trait of feature extractors, and SIFT as one.

use std::error;
use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::options::{DomainSizes, Limit, Normalization, Orientation};
use crate::{DescriptorFormat, Error, Features, GrayView, Options, Sift};

/// Detects and describes keypoints. Several threads use an extractor at the same time.
pub trait Extractor: fmt::Debug + Send + Sync {
    /// A name that tells it from other extractors, in lower case.
    fn name(&self) -> &str;

    /// Its options as texts by key: all that changes its results. Results are kept as long as name
    /// and options are the same.
    fn options(&self) -> Vec<(&'static str, String)>;

    /// Kind and dimension of the descriptors.
    fn format(&self) -> DescriptorFormat;

    /// Memory that the extraction of an image of this size takes, in bytes.
    fn memory_bytes(&self, width: u32, height: u32) -> u64;

    /// Extracts the features of an image, where its mask is not 0. The same pixels give the same
    /// features, on any thread.
    ///
    /// # Errors
    /// The image cannot be processed; the message says why.
    fn extract(
        &self,
        image: &GrayView<'_>,
        mask: Option<&GrayView<'_>>,
    ) -> Result<Features, Box<dyn error::Error + Send + Sync>>;
}

/// SIFT as an [`Extractor`]: a pool of [`Sift`], one for each image that is processed at a time.
#[derive(Default)]
pub struct SiftExtractor {
    options: Options,
    idle: Mutex<Vec<Sift>>,
}

impl SiftExtractor {
    /// Memory in bytes per pixel.
    const BYTES_PER_PIXEL: u64 = 16;
    /// Its name as an extractor.
    pub const NAME: &str = "sift";

    /// An extractor with these options.
    ///
    /// # Errors
    /// [`Error::Option`] if an option is out of its range.
    pub fn new(options: Options) -> Result<Self, Error> {
        options.validate()?;
        Ok(Self { options, idle: Mutex::default() })
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Sift>> {
        // The list stays valid when a thread panics while it holds the lock.
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Debug for SiftExtractor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("SiftExtractor").field(&self.options).finish()
    }
}

impl Extractor for SiftExtractor {
    fn name(&self) -> &str {
        Self::NAME
    }

    /// Workspaces on disk have these texts, so that keys and values are written out here instead of
    /// being derived from names of fields and types. A new option does not compile without a key.
    fn options(&self) -> Vec<(&'static str, String)> {
        let Options {
            first_octave,
            octaves,
            levels,
            peak_threshold,
            edge_threshold,
            max_features,
            limit,
            max_orientations,
            orientation,
            normalization,
            domain_sizes,
        } = self.options;
        let limit = match limit {
            Limit::WholeLevels => "whole_levels",
            Limit::Exact => "exact",
        };
        let orientation = match orientation {
            Orientation::Dominant => "dominant",
            Orientation::Upright => "upright",
        };
        let normalization = match normalization {
            Normalization::RootL1 => "root_l1",
            Normalization::L2 => "l2",
        };
        let mut texts = vec![
            ("first_octave", first_octave.to_string()),
            ("octaves", octaves.to_string()),
            ("levels", levels.to_string()),
            ("peak_threshold", peak_threshold.to_string()),
            ("edge_threshold", edge_threshold.to_string()),
            ("max_features", max_features.to_string()),
            ("limit", limit.to_owned()),
            ("max_orientations", max_orientations.to_string()),
            ("orientation", orientation.to_owned()),
            ("normalization", normalization.to_owned()),
        ];
        if let Some(DomainSizes { min, max, count }) = domain_sizes {
            texts.extend([
                ("domain_sizes.min", min.to_string()),
                ("domain_sizes.max", max.to_string()),
                ("domain_sizes.count", count.to_string()),
            ]);
        }
        texts
    }

    fn format(&self) -> DescriptorFormat {
        DescriptorFormat::SIFT
    }

    fn memory_bytes(&self, width: u32, height: u32) -> u64 {
        Self::BYTES_PER_PIXEL * u64::from(width) * u64::from(height)
    }

    fn extract(
        &self,
        image: &GrayView<'_>,
        mask: Option<&GrayView<'_>>,
    ) -> Result<Features, Box<dyn error::Error + Send + Sync>> {
        let idle = self.idle().pop();
        let mut sift = idle.map_or_else(|| Sift::new(self.options), Ok)?;
        let features = sift.extract(image, mask)?;
        self.idle().push(sift);
        Ok(features)
    }
}
