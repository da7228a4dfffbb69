//! Checkpoints of the mapper in the workspace: a run that was killed goes on from the last one.
//!
//! The file begins with the key of its run, which is a hash of the version of the
//! program, the recipe of the stage and what the mapper is given, and with the hash of the state.

use std::cell::RefCell;
use std::time::{Duration, Instant};

use tiepoint_sfm::CheckpointStore;
use tiepoint_sfm::scene::{CorrespondenceGraph, Image, Keypoint, Match, Reconstruction};
use tiepoint_store::{Error as StoreError, OutputFolder, disk};

/// First bytes of the file.
pub(crate) const MAGIC: &[u8] = b"tiepoint mapper state 3\n";
const HASH_BYTES: usize = 32;
/// The time between two checkpoints is this multiple of what one takes, so that all of them take 2
/// % of the run, and at least the minimum.
const INTERVAL_IN_WRITES: u32 = 50;
const MIN_INTERVAL: Duration = Duration::from_secs(5);

/// The checkpoint in a workspace.
pub(crate) struct CheckpointFile<'a> {
    folder: &'a OutputFolder,
    key: [u8; HASH_BYTES],
    /// Images that may get a pose.
    num_images: usize,
    /// What the user is to know.
    notes: &'a RefCell<Vec<String>>,
    /// Begin of the last checkpoint, and the time until the next one.
    last: Instant,
    interval: Duration,
    /// Whether one could not be written: then no further one is.
    has_failed: bool,
}

/// The key of a run: the version of the program, the options, and what the mapper is given. The
/// fingerprint of the matches alone would not tell of a database that was changed since.
pub(crate) fn key_of(
    recipe: &str,
    scene: &Reconstruction,
    graph: &CorrespondenceGraph,
) -> [u8; HASH_BYTES] {
    let mut hash = blake3::Hasher::new();
    hash.update(env!("CARGO_PKG_VERSION").as_bytes()).update(recipe.as_bytes());
    for (id, camera) in scene.cameras() {
        hash.update(format!("{id:?} {camera:?}").as_bytes());
    }
    for (id, image) in scene.images() {
        let Image { name, camera, stream, time_s, keypoints, .. } = image;
        hash.update(format!("{id:?} {name:?} {camera:?} {stream:?} {time_s:?}").as_bytes());
        for Keypoint { pixel, scale_px } in &**keypoints {
            for number in [pixel.x, pixel.y, f64::from(*scale_px)] {
                hash.update(&number.to_le_bytes());
            }
        }
    }
    for (pair, two_view) in graph.pairs() {
        hash.update(format!("{pair:?} {:?}", two_view.kind).as_bytes());
        for Match { a, b } in &two_view.matches {
            hash.update(&a.to_le_bytes()).update(&b.to_le_bytes());
        }
    }
    *hash.finalize().as_bytes()
}

impl<'a> CheckpointFile<'a> {
    pub(crate) fn new(
        folder: &'a OutputFolder,
        key: [u8; HASH_BYTES],
        num_images: usize,
        notes: &'a RefCell<Vec<String>>,
    ) -> Self {
        let (last, interval) = (Instant::now(), MIN_INTERVAL);
        Self { folder, key, num_images, notes, last, interval, has_failed: false }
    }

    fn note(&self, what: impl Into<String>) {
        self.notes.borrow_mut().push(what.into());
    }

    /// The state of a file; an error in words.
    fn state_of(&self, mut content: Vec<u8>) -> Result<Vec<u8>, &'static str> {
        let header = MAGIC.len() + 2 * HASH_BYTES;
        if content.len() < header || !content.starts_with(MAGIC) {
            return Err("it is damaged");
        }
        let (key, hash) = content[MAGIC.len()..header].split_at(HASH_BYTES);
        if key != self.key {
            return Err("it is of other matches, other options or another version of the program");
        }
        if blake3::hash(&content[header..]).as_bytes() != hash {
            return Err("it is damaged");
        }
        content.drain(..header);
        Ok(content)
    }

    fn write(&self, state: &[u8]) -> Result<(), StoreError> {
        let hash = blake3::hash(state);
        self.folder.keep_state(&[MAGIC, &self.key, hash.as_bytes(), state].concat(), MAGIC)
    }
}

impl CheckpointStore for CheckpointFile<'_> {
    fn last(&mut self) -> Option<Vec<u8>> {
        let found = match self.folder.state(MAGIC) {
            Ok(None) => return None,
            Ok(Some(content)) => self.state_of(content).map_err(str::to_owned),
            Err(error) => Err(error.to_string()),
        };
        found
            .map_err(|why| self.note(format!("the checkpoint of the mapper is not used: {why}")))
            .ok()
    }

    fn resumed(&mut self, num_registered: Option<usize>) {
        match num_registered {
            Some(done) => self.note(format!(
                "the mapper goes on from a checkpoint: {done} of {} images had poses",
                self.num_images
            )),
            None => self.note("the checkpoint of the mapper is not used: it is damaged"),
        }
    }

    fn is_due(&mut self) -> bool {
        let is_due = !self.has_failed
            && (self.last.elapsed() >= self.interval || disk::is_watched(self.folder.path()));
        if is_due {
            self.last = Instant::now();
        }
        is_due
    }

    fn keep(&mut self, state: &[u8]) {
        match self.write(state) {
            Ok(()) => {
                self.interval = MIN_INTERVAL.max(self.last.elapsed() * INTERVAL_IN_WRITES);
            }
            Err(error) => {
                self.has_failed = true;
                self.note(format!(
                    "the mapper goes on without checkpoints, and would begin again if it were \
                    stopped: {error}"
                ));
            }
        }
    }
}
