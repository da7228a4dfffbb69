//! Which factors of a batch see the same blocks.

use super::chunk::{Batch, Bundle, Cell, Chunk};
use super::shape::Shape;

/// Collects the factors of a batch.
#[derive(Default)]
pub(super) struct Bundler {
    /// By shape and blocks, then in order.
    keys: Vec<u64>,
    factors: Vec<Entry>,
    /// Places of their segments, and tiles of the pairs of them, as in [`Bundle`].
    places: Vec<u32>,
}

struct Entry {
    shape: u16,
    places: usize,
    row: u32,
}

impl Entry {
    fn places<'a>(&self, shapes: &[Shape], places: &'a [u32]) -> &'a [u32] {
        let segments = shapes[self.shape as usize].segments.len();
        &places[self.places..][..segments + segments * (segments + 1) / 2]
    }
}

impl Bundler {
    /// Adds the factors of the chunk's last cell, from number `first` on, whose rows begin at `row`
    /// of the batch.
    pub(super) fn add(
        &mut self,
        chunk: &Chunk,
        shapes: &[Shape],
        cell: &Cell,
        first: [usize; 2],
        row: usize,
    ) {
        let [first, first_local] = first;
        let pattern = chunk.patterns.of(cell);
        let (mut locals, mut row) = (&chunk.factors.locals[first_local..], row);
        for &number in &chunk.factors.shape_of[first..] {
            let shape = &shapes[number as usize];
            let (these, rest) = locals.split_at(shape.segments.len());
            locals = rest;
            let begin = self.places.len();
            let at = |&local: &u16| {
                chunk.patterns.locals[pattern.locals.start + local as usize].at as u32
            };
            self.places.extend(these.iter().map(at));
            let key = self.places[begin..].iter().fold(u32::from(number), mixed);
            for (s, &l) in these.iter().enumerate() {
                let tile = |&m: &u16| {
                    let (lo, hi) = (l.min(m) as usize, l.max(m) as usize);
                    chunk.patterns.pair_tiles[pattern.pairs + hi * (hi + 1) / 2 + lo]
                };
                self.places.extend(these[..=s].iter().map(tile));
            }
            self.keys.push(u64::from(key) << 32 | self.factors.len() as u64);
            self.factors.push(Entry { shape: number, places: begin, row: row as u32 });
            row += shape.rows * shape.stride;
        }
    }

    /// Adds the batch and its bundles to the chunk.
    pub(super) fn close(&mut self, chunk: &mut Chunk, shapes: &[Shape], mut batch: Batch) {
        let begin = chunk.bundles.list.len();
        self.keys.sort_unstable();
        let mut last: Option<&Entry> = None;
        for &key in &self.keys {
            let entry = &self.factors[key as u32 as usize];
            let places = entry.places(shapes, &self.places);
            let same = last.is_some_and(|last| {
                last.shape == entry.shape && last.places(shapes, &self.places) == places
            });
            if !same {
                let rows = chunk.bundles.rows.len();
                let bundle = Bundle {
                    shape: entry.shape,
                    places: chunk.bundles.places.len(),
                    rows: rows..rows,
                };
                chunk.bundles.list.push(bundle);
                chunk.bundles.places.extend_from_slice(places);
            }
            last = Some(entry);
            let shape = &shapes[entry.shape as usize];
            chunk
                .bundles
                .rows
                .extend((0..shape.rows).map(|row| entry.row + (row * shape.stride) as u32));
            if let Some(bundle) = chunk.bundles.list.last_mut() {
                bundle.rows.end = chunk.bundles.rows.len();
            }
        }
        batch.bundles = begin..chunk.bundles.list.len();
        chunk.batches.push(batch);
        self.keys.clear();
        self.factors.clear();
        self.places.clear();
    }
}

/// The same number for the same numbers, and nearly always others for others.
fn mixed(sum: u32, number: &u32) -> u32 {
    (sum ^ number).wrapping_mul(0x9e37_79b1).rotate_left(13)
}
