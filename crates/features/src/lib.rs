#![doc = include_str!("../README.md")]

mod bands;
mod blur;
mod buffer;
mod describe;
mod descriptor;
mod duplicates;
mod error;
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

pub use error::Error;
pub use options::{DomainSizes, Limit, Normalization, Options, Orientation};
pub use sift::{Sift, extract};
pub use types::{Descriptor, Features, Keypoint};
pub use view::GrayView;
