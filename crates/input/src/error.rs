use std::path::PathBuf;

use crate::CameraGrouping;

/// Why an input cannot be used. Each message is one sentence: what, where, what to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Fewer than two usable photos.
    #[error(
        "{path} gives {usable} usable photo{s} of {found}: at least two that overlap are \
        needed{also}",
        s = if *usable == 1 { "" } else { "s" },
        also = skipped.first().map_or_else(String::new, |reason| format!("; {} skipped, first \
        {reason}", skipped.len()))
    )]
    TooFewPhotos {
        /// The input.
        path: PathBuf,
        /// Photos found.
        found: usize,
        /// Photos that could be read.
        usable: usize,
        /// Why files named like photos could not be used, one sentence for each.
        skipped: Vec<String>,
    },
    /// The input mixes photos and videos.
    #[error(
        "{photos} holds photos and {video} is a video: give folders of photos or videos, not both"
    )]
    MixedInput {
        /// An input folder of photos.
        photos: PathBuf,
        /// A video.
        video: PathBuf,
    },
    /// Two videos have the same name, which would make them one camera.
    #[error("{}: each video is one camera", match first == other {
        true => format!("{} is given twice", first.display()),
        false => format!("{} and {} have one name, rename one", first.display(), other.display()),
    })]
    TwoVideosOfOneName {
        /// The first of the two.
        first: PathBuf,
        /// The other one.
        other: PathBuf,
    },
    /// Photos that are asked to share a camera have different sizes.
    #[error(
        "`features.cameras` {grouping} makes {first} and {other} one camera, but the first is \
        {first_size} and the other {other_size}: leave the option out, or give \
        `features.cameras` image"
    )]
    TwoSizes {
        /// Which photos share a camera.
        grouping: CameraGrouping,
        /// A photo.
        first: String,
        /// Its size in pixels.
        first_size: Size,
        /// A photo of another size.
        other: String,
        /// Its size in pixels.
        other_size: Size,
    },
    /// Known intrinsics were given for photos of several sizes.
    #[error(
        "`features.intrinsics` are those of one image size, but {first} is {first_size} and \
        {other} is {other_size}: give a file with each camera by `features.calibration`"
    )]
    IntrinsicsOfSizes {
        /// A photo.
        first: String,
        /// Its size in pixels.
        first_size: Size,
        /// A photo of another size.
        other: String,
        /// Its size in pixels.
        other_size: Size,
    },
    /// Known intrinsics of all cameras do not fit the photos.
    #[error("`features.intrinsics`: {what}")]
    Intrinsics {
        /// The contradiction.
        what: String,
    },
    /// No lens has the given focal length.
    #[error(
        "`features.focal_prior`: no lens has a focal length of {focal_px:.3e} pixels at {image}, \
        which has {size}: give between 0.1 and 150 times the longer side, or leave the option out"
    )]
    FocalPrior {
        /// The focal length, in pixels of the photo.
        focal_px: f64,
        /// A photo.
        image: String,
        /// Its size in pixels.
        size: Size,
    },
    /// A calibration does not fit the photos.
    #[error("{path}: {what}")]
    Calibration {
        /// The file.
        path: PathBuf,
        /// The contradiction.
        what: String,
    },
    /// A file cannot be read.
    #[error(transparent)]
    File(#[from] tiepoint_io::Error),
    /// A file or folder is missing, or is not what it has to be.
    #[error(transparent)]
    Store(#[from] tiepoint_store::Error),
    /// Images of a sequence have times that are not finite.
    #[error(transparent)]
    Matching(#[from] tiepoint_matching::Error),
}

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size(pub u32, pub u32);

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} x {}", self.0, self.1)
    }
}
