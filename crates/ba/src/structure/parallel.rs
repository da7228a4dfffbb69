//! Work on every chunk.

use rayon::prelude::*;

use super::chunk::Chunk;

/// Runs `work` on every chunk, in parallel if there are several.
pub(crate) fn for_chunks<T: Send>(
    chunks: &[Chunk],
    items: &mut [T],
    work: impl Fn(&Chunk, &mut T) + Sync,
) {
    if chunks.len() > 1 {
        chunks.par_iter().zip(items).with_max_len(1).for_each(|(chunk, item)| work(chunk, item));
    } else {
        chunks.iter().zip(items).for_each(|(chunk, item)| work(chunk, item));
    }
}
