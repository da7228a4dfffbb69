//! Checkpoints of the mapper in a workspace. While a test watches the changes of files, there is
//! one at each step. `bench/checkpoints.py` kills the program itself.

use std::collections::BTreeMap;
use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use image::imageops::{FilterType, resize};
use tiepoint_io::store::disk::faults::Faults;
use tiepoint_pipeline::sfm::MapperOptions;
use tiepoint_pipeline::stages::MapOptions;
use tiepoint_pipeline::{Error, Event, Options, Stage, reconstruct};

use super::{SIZE, copy, folder, leftovers, results};
use crate::photos;

const COUNT: usize = 6;
const STATE: &str = "ws/.tiepoint-state";

/// Maps the photos of a folder; returns what was noted. `images`: the run is stopped when as many
/// have poses, or not at all.
fn run(dir: &Path, images: usize, seed: u64) -> (Result<(), Error>, Vec<String>) {
    let mut notes = Vec::new();
    let watch = &mut |event: &Event| {
        match event {
            Event::Noted { what } => notes.push((*what).to_owned()),
            Event::ImageRegistered { registered, .. } if *registered == images => {
                return ControlFlow::Break(());
            }
            _ => {}
        }
        ControlFlow::Continue(())
    };
    let mapper = MapperOptions { seed, ..MapperOptions::default() };
    let mapping = MapOptions { mapper, ..MapOptions::default() };
    let options = Options { mapping, redo: Some(Stage::Map), ..Options::default() };
    let done = reconstruct(&[dir.join("photos")], &dir.join("ws"), &options, watch).map(drop);
    (done, notes)
}

fn about_checkpoints(notes: &[String]) -> Vec<&String> {
    notes.iter().filter(|note| note.contains("checkpoint")).collect()
}

struct Stopped {
    _base: tempfile::TempDir,
    /// A workspace whose mapper was stopped.
    dir: PathBuf,
    /// The results of a run that was not stopped.
    expected: BTreeMap<String, Vec<u8>>,
}

fn stopped() -> Stopped {
    let base = folder();
    let dir = base.path().canonicalize().unwrap();
    fs::create_dir_all(dir.join("photos")).unwrap();
    for index in 0..COUNT {
        let small = resize(&photos::photo(index, 0), SIZE.0, SIZE.1, FilterType::Triangle);
        small.save(dir.join(format!("photos/{index}.png"))).unwrap();
    }
    let (done, notes) = run(&dir, usize::MAX, 0);
    done.unwrap();
    assert!(about_checkpoints(&notes).is_empty(), "{notes:?}");
    let expected = results(&dir);
    let watched = Faults::count(&dir);
    let (stopped, _) = run(&dir, 4, 0);
    drop(watched);
    assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
    assert!(dir.join(STATE).is_file());
    Stopped { _base: base, dir, expected }
}

impl Stopped {
    /// Changes a copy of the workspace and goes on, with or without the same seed; returns the one
    /// note on checkpoints. The results are those of a run that was not stopped.
    fn note_after(&self, seed: u64, change: impl FnOnce(&Path)) -> String {
        let copied = folder();
        let dir = copied.path().canonicalize().unwrap();
        copy(&self.dir, &dir);
        change(&dir.join(STATE));
        let (done, notes) = run(&dir, usize::MAX, seed);
        done.unwrap();
        assert!(seed != 0 || results(&dir) == self.expected);
        assert!(leftovers(&dir).is_empty(), "{:?}", leftovers(&dir));
        let notes = about_checkpoints(&notes);
        assert_eq!(notes.len(), 1, "{notes:?}");
        // The summary has the same line.
        let report = fs::read_to_string(dir.join("ws/report.json")).unwrap();
        assert!(report.contains(notes[0].as_str()), "{report}");
        notes[0].clone()
    }
}

#[test]
fn a_stopped_mapper_goes_on_and_a_checkpoint_that_is_not_its_own_is_not_used() {
    let stopped = stopped();
    // That behind the image before the one at which the run was stopped.
    let expected = "the mapper goes on from a checkpoint: 3 of 6 images had poses";
    assert_eq!(stopped.note_after(0, |_| {}), expected);
    let not_used = "the checkpoint of the mapper is not used: ";
    let change = |change: fn(&mut Vec<u8>)| {
        move |path: &Path| {
            let mut content = fs::read(path).unwrap();
            change(&mut content);
            fs::write(path, content).unwrap();
        }
    };
    let damaged = format!("{not_used}it is damaged");
    for damage in [
        |content: &mut Vec<u8>| content.truncate(40),
        |content: &mut Vec<u8>| content.truncate(content.len() - 1),
        |content: &mut Vec<u8>| *content.last_mut().unwrap() ^= 1,
        // A state with its own hash, which is no state.
        |content: &mut Vec<u8>| {
            content.truncate(24 + 32 + 32);
            content.extend([255; 100]);
            let hash = blake3::hash(&[255; 100]);
            content[24 + 32..24 + 32 + 32].copy_from_slice(hash.as_bytes());
        },
    ] {
        assert_eq!(stopped.note_after(0, change(damage)), damaged);
    }
    let other = format!(
        "{not_used}it is of other matches, other options or another version of the program"
    );
    // The key begins behind the 24 bytes of the name.
    assert_eq!(stopped.note_after(0, change(|content| content[24] ^= 1)), other);
    assert_eq!(stopped.note_after(1, |_| {}), other);
}

#[test]
fn a_mapper_that_cannot_write_checkpoints_goes_on_and_says_so_once() {
    let stopped = stopped();
    let dir = &stopped.dir;
    fs::remove_file(dir.join(STATE)).unwrap();
    fs::create_dir(dir.join(STATE)).unwrap();
    let watched = Faults::count(dir);
    let (done, notes) = run(dir, usize::MAX, 0);
    drop(watched);
    done.unwrap();
    let notes = about_checkpoints(&notes);
    assert_eq!(notes.len(), 1, "{notes:?}");
    let expected = "the mapper goes on without checkpoints, and would begin again if it were \
                    stopped: cannot write ";
    assert!(notes[0].starts_with(expected), "{notes:?}");
    assert!(results(dir) == stopped.expected);
}
