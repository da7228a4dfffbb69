pub(super) const CAMERAS: &str = "cameras";
pub(super) const RIGS: &str = "rigs";
pub(super) const FRAMES: &str = "frames";
pub(super) const IMAGES: &str = "images";
pub(super) const POINTS: &str = "points3D";
/// The files of a model, without extension, in the order in which they are replaced: no reader
/// accepts a model without `images`.
pub const MODEL_FILES: [&str; 5] = [CAMERAS, RIGS, FRAMES, POINTS, IMAGES];
/// The files that every reader requires.
pub(super) const REQUIRED: [&str; 3] = [CAMERAS, IMAGES, POINTS];
