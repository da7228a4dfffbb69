//! Kinds and dimensions of descriptors.

use std::fmt;

/// A descriptor of SIFT: 4 × 4 cells of 8 gradient directions, cells row-major, directions of a
/// cell contiguous.
pub type SiftDescriptor = [u8; 128];

/// Which method made descriptors. Only descriptors of the same kind are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum DescriptorKind {
    /// SIFT: 128 bytes.
    #[default]
    Sift,
    /// ALIKED-N16rot of COLMAP 4: floats.
    AlikedN16Rot,
    /// ALIKED-N32 of COLMAP 4: floats.
    AlikedN32,
    /// Bytes of another method, which are compared by their Euclidean distance.
    Bytes,
    /// 32-bit floats of another method, which are compared by their Euclidean distance.
    Floats,
}

impl DescriptorKind {
    /// Whether the entries are 32-bit floats; else they are bytes.
    pub fn has_floats(self) -> bool {
        matches!(self, Self::AlikedN16Rot | Self::AlikedN32 | Self::Floats)
    }
}

/// Kind and dimension of descriptors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct DescriptorFormat {
    /// The method.
    pub kind: DescriptorKind,
    /// Number of entries of a descriptor.
    pub dim: usize,
}

impl DescriptorFormat {
    /// SIFT: 128 bytes.
    pub const SIFT: Self = Self { kind: DescriptorKind::Sift, dim: size_of::<SiftDescriptor>() };

    /// Size of a descriptor in bytes.
    pub fn num_bytes(self) -> usize {
        if self.kind.has_floats() { self.dim.saturating_mul(size_of::<f32>()) } else { self.dim }
    }
}

impl Default for DescriptorFormat {
    fn default() -> Self {
        Self::SIFT
    }
}

/// As in `SIFT` and `64 floats`.
impl fmt::Display for DescriptorFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self.kind {
            DescriptorKind::Sift => return f.write_str("SIFT"),
            DescriptorKind::AlikedN16Rot => "ALIKED_N16ROT of ",
            DescriptorKind::AlikedN32 => "ALIKED_N32 of ",
            DescriptorKind::Bytes | DescriptorKind::Floats => "",
        };
        let entries = if self.kind.has_floats() { "floats" } else { "bytes" };
        write!(f, "{name}{} {entries}", self.dim)
    }
}
