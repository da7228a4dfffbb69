//! How files of this program are known as its own.

use tiepoint_store::Mark;

/// A PLY file.
pub const PLY_MARK: Mark = Mark::Inside("\ncomment tiepoint\n");
/// A LAS or LAZ file: the generating software in its header, which zeros surround.
pub(crate) const LAS_MARK: Mark = Mark::Inside("\0tiepoint\0");
/// A binary glTF file: the first member of its JSON part.
pub(crate) const GLTF_MARK: Mark = Mark::Inside(r#"{"asset":{"generator":"tiepoint""#);
/// The first line of a text file, if its format has comments.
pub(crate) const COMMENT: &str = "# tiepoint";
/// A text file whose format has comments.
pub(crate) const COMMENT_MARK: Mark = Mark::Start(COMMENT);
