#![doc = include_str!("../README.md")]

mod bands;
mod blur;
mod buffer;
mod describe;
mod descriptor;
mod descriptor_format;
mod descriptors;
mod duplicates;
mod error;
mod extractor;
mod extrema;
mod gradient;
mod octave;
mod options;
mod orientation;
mod scale_space;
mod sift;
mod simd;
mod source;
#[cfg(test)]
mod tests;
mod types;
mod view;

pub use descriptor_format::{DescriptorFormat, DescriptorKind, SiftDescriptor};
pub use descriptors::{DescriptorEntries, Descriptors};
pub use error::Error;
pub use extractor::{Extractor, SiftExtractor};
pub use options::{DomainSizes, Limit, Normalization, Options, Orientation};
pub use sift::{Sift, extract};
pub use types::{Features, Keypoint};
pub use view::GrayView;
