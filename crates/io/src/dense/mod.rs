//! Depth and normal maps, and the fused cloud with its visibility, as COLMAP writes them.

mod dense_map;
mod fused_ply;
mod fused_visibility;

pub use dense_map::DenseMap;
pub use fused_ply::FusedPly;
pub use fused_visibility::FusedVisibility;
