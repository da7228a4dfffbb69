//! Memory layout of byte vectors for the brute-force kernel: panels of sixteen vectors.
//!
//! Within a panel the bytes are transposed in groups of four: one SIMD load gives the same four
//! bytes of sixteen (or eight) vectors, the operand of a `u8 × i8` dot-product instruction.

/// Number of vectors in a panel.
pub(crate) const PANEL: usize = 16;
/// Number of panels in the widest tile of the kernel. Lists of panels are padded to a multiple of
/// it.
pub(crate) const TILE: usize = 4;

/// Largest magnitude of a centred byte, `byte − 128`, of compressed descriptors. `vpmaddubsw` adds
/// two products of a byte from 0 to 180 and one from -90 to 90: at most 32,400, which 16 bits hold.
/// With 91 they do not.
pub(crate) const MAX_ENTRY: i32 = 90;
/// Largest square of a centred vector of compressed descriptors: 16 bits hold their scores
/// (`brute::screen`).
pub(crate) const MAX_SQUARE: i32 = 32_700;
const _: () = assert!(4 * MAX_ENTRY * MAX_ENTRY < 1 << 15 && MAX_SQUARE < (1 << 15) - 1);

/// A list of vectors of `G` groups of four bytes.
pub(crate) trait Vectors<const G: usize> {
    /// Number of vectors.
    fn len(&self) -> usize;
    /// The four bytes of group `group` of vector `index`, as a little-endian word.
    fn word(&self, index: usize, group: usize) -> u32;
}

/// Sixteen vectors, `[group][vector]`, each group of four bytes as a little-endian word.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
pub(crate) struct Panel<const G: usize>(pub(crate) [[u32; PANEL]; G]);

/// Vectors in panels: the columns of the kernel.
#[derive(Clone, Debug, Default)]
pub(crate) struct Packed<const G: usize> {
    pub(crate) len: usize,
    pub(crate) panels: Vec<Panel<G>>,
    /// `|x|² − 256 Σx` of every vector.
    pub(crate) terms: Vec<i32>,
}

impl<const G: usize> Packed<G> {
    /// Packs `len` vectors. `vector(i)` returns the groups of four bytes of vector `i`. The bytes
    /// of padding vectors are `padding`.
    pub(crate) fn new(
        len: usize,
        padding: u8,
        mut vector: impl FnMut(usize) -> [[u8; 4]; G],
    ) -> Self {
        let count = len.div_ceil(PANEL).next_multiple_of(TILE);
        let padding = u32::from_le_bytes([padding; 4]);
        let mut panels = vec![Panel([[padding; PANEL]; G]); count];
        let mut terms = Vec::with_capacity(len);
        for index in 0..len {
            let vector = vector(index);
            let panel = &mut panels[index / PANEL];
            for (words, bytes) in panel.0.iter_mut().zip(&vector) {
                words[index % PANEL] = u32::from_le_bytes(*bytes);
            }
            let term = |&x: &u8| i32::from(x) * (i32::from(x) - 256);
            terms.push(vector.as_flattened().iter().map(term).sum());
        }
        Packed { len, panels, terms }
    }
}

/// `|x − 128|²` for `|x|² − 256 Σx`.
#[inline(always)]
pub(crate) fn centred_square<const G: usize>(term: i32) -> i32 {
    term + 4 * G as i32 * 128 * 128
}

impl<const G: usize> Vectors<G> for Packed<G> {
    fn len(&self) -> usize {
        self.len
    }
    #[inline]
    fn word(&self, index: usize, group: usize) -> u32 {
        self.panels[index / PANEL].0[group][index % PANEL]
    }
}
