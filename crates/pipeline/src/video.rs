//! Videos as input: the frames worth having, as photos in the workspace.
//!
//! Of every `every` frames the sharpest is taken (the one of the most energy in its gradients: they show the same things), and left out
//! where the picture has hardly moved since the last one that was kept, so that a stop is not a thousand equal photos. Movement is the
//! median over blocks of a small copy of how far its slopes would have to move to change it so; cars that pass do not move a median.

use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tiepoint_io::timestamps;
use tiepoint_io::video::{Recording, VideoReader, is_video, recordings};
use tiepoint_io::{Rgb, is_image};
use tiepoint_sfm::geometry::numeric::median;

use crate::fingerprint::of_files;
use crate::records::write_json;
use crate::{Error, Event, Photos, Stage, Watch, Workspace, tell};

/// The paper takes every third frame of a camera at 30 Hz.
pub const DEFAULT_EVERY: NonZeroUsize = NonZeroUsize::new(3).unwrap();
/// Width of the small copy on which frames are compared, about.
const SMALL_WIDTH: u32 = 320;
/// Side of a block, and the least eigenvalue, per pixel, of the gradients' second moments that gives it texture.
const BLOCK: usize = 16;
const MIN_TEXTURE: f64 = 4.0;
/// Fewer textured blocks tell no movement.
const MIN_BLOCKS: usize = 8;
/// A frame that moved by less than this share of its width (0.8 pixels of the small copy) since the last one shows nothing new.
const MIN_MOVEMENT: f64 = 0.0025;

const FRAMES: &str = "frames";
const RECORD: &str = "videos.json";

/// What the frames were made from; written last.
#[derive(Debug, Serialize, Deserialize, PartialEq, Eq)]
struct Record {
    every: NonZeroUsize,
    /// Name and fingerprint of each recording.
    videos: Vec<(String, String)>,
}

/// A workspace, the photos that it is to be made from, and when they were taken where the input says it.
pub struct Opened {
    /// The workspace, held.
    pub workspace: Workspace,
    /// Its photos.
    pub photos: Photos,
    /// Times of frames of videos: CSV with the header `image,seconds`.
    pub timestamps: Option<PathBuf>,
}

/// Opens the input of a workspace: folders of photos, or videos (files, or folders of them), of which the frames worth having are put
/// into the workspace first, one of `every`. With `redo` they are taken anew.
pub fn open_input(
    inputs: &[PathBuf],
    masks: Option<&Path>,
    root: &Path,
    every: NonZeroUsize,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<Opened, Error> {
    let files = videos(inputs)?;
    if files.is_empty() {
        // In this order: for an input that is no good nothing is begun.
        let photos = Photos::open(inputs, masks)?;
        return Ok(Opened { photos, workspace: Workspace::create(root)?, timestamps: None });
    }
    let recordings = named_apart(recordings(&files))?;
    let videos =
        recordings.iter().map(|recording| Ok((recording.name.clone(), of_files(&recording.chapters)?)));
    let record = Record { every, videos: videos.collect::<Result<_, Error>>()? };
    let workspace = Workspace::create(root)?;
    let folder = workspace.root().join(FRAMES);
    let times = folder.join("timestamps.csv");
    let before =
        fs::read(folder.join(RECORD)).ok().and_then(|bytes| serde_json::from_slice::<Record>(&bytes).ok());
    if before.as_ref() != Some(&record) || redo == Some(Stage::Features) {
        if before.is_some() && redo != Some(Stage::Features) {
            return Err(Error::OtherFrames { path: folder });
        }
        extract(&recordings, &folder, &times, every, watch)?;
        write_json(&folder.join(RECORD), &record)?;
    }
    let photos = Photos::open(&[folder], masks)?;
    Ok(Opened { workspace, photos, timestamps: Some(times) })
}

/// The video files that are meant: inputs themselves, or what lies in a folder without images. Empty where photos are meant.
fn videos(inputs: &[PathBuf]) -> Result<Vec<PathBuf>, Error> {
    let mut files = Vec::new();
    for input in inputs {
        if input.is_dir() {
            let entries = fs::read_dir(input).and_then(Iterator::collect::<Result<Vec<_>, _>>);
            let entries = entries.map_err(|cause| Error::Unreadable { path: input.clone(), cause })?;
            let mut here: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
            here.sort();
            if !here.iter().any(|path| is_image(path)) {
                files.extend(here.into_iter().filter(|path| path.is_file() && is_video(path)));
            }
        } else if is_video(input) {
            files.push(input.clone());
        }
    }
    let of_photos = inputs.iter().find(|input| !files.iter().any(|file| file.starts_with(input)));
    match of_photos {
        Some(photos) if !files.is_empty() => {
            Err(Error::MixedInput { photos: photos.clone(), video: files.swap_remove(0) })
        }
        _ => Ok(files),
    }
}

/// Cameras of the same name are told apart by their folders.
fn named_apart(mut recordings: Vec<Recording>) -> Result<Vec<Recording>, Error> {
    let names: Vec<String> = recordings.iter().map(|recording| recording.name.clone()).collect();
    for recording in &mut recordings {
        if names.iter().filter(|name| **name == recording.name).count() > 1 {
            let folder = recording.chapters.first().and_then(|file| file.parent()?.file_name());
            let folder = folder.map_or_else(String::new, |folder| folder.to_string_lossy().into_owned());
            recording.name = format!("{folder}-{}", recording.name);
        }
    }
    for (index, recording) in recordings.iter().enumerate() {
        if recordings[..index].iter().any(|other| other.name == recording.name) {
            return Err(Error::TwoVideosOfOneName { name: recording.name.clone() });
        }
    }
    Ok(recordings)
}

/// Writes the frames of all recordings, and when they were taken.
fn extract(
    recordings: &[Recording],
    folder: &Path,
    times: &Path,
    every: NonZeroUsize,
    watch: Watch,
) -> Result<(), Error> {
    let output = |path: &Path| {
        let path = path.to_owned();
        move |cause| Error::Output { path, cause }
    };
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(output(folder))?;
    }
    let mut taken: Vec<(String, f64)> = Vec::new();
    for recording in recordings {
        let own = folder.join(&recording.name);
        fs::create_dir_all(&own).map_err(output(&own))?;
        let mut chooser = Chooser::new(every);
        let (mut read, mut began_s, mut offset_s, mut last_s, mut interval_s) = (0, None, 0.0, 0.0, 0.0);
        let mut keep = |frame: Option<Candidate>, watch: Watch, read: usize| -> Result<(), Error> {
            let Some(frame) = frame else { return Ok(()) };
            let file = format!("{:06}.jpg", frame.index);
            frame.image.write(&own.join(&file))?;
            let name = format!("{}/{file}", recording.name);
            tell(watch, &Event::FrameKept { image: &name, read })?;
            taken.push((name, frame.time_s));
            Ok(())
        };
        for chapter in &recording.chapters {
            let mut reader = VideoReader::open(chapter)?;
            while let Some(frame) = reader.next_frame()? {
                let began_s = *began_s.get_or_insert(reader.created_s().unwrap_or(0.0));
                let time_s = began_s + offset_s + frame.time_s;
                if read > 0 {
                    interval_s = time_s - last_s;
                }
                last_s = time_s;
                keep(chooser.add(Candidate::new(read, time_s, frame.image)), watch, read)?;
                read += 1;
            }
            // A chapter begins where the one before has ended.
            offset_s = last_s + interval_s - began_s.unwrap_or(0.0);
        }
        keep(chooser.end(), watch, read)?;
    }
    taken.sort_by(|a, b| a.0.cmp(&b.0));
    timestamps::write(times, taken.iter().map(|(name, time_s)| (name.as_str(), *time_s)))?;
    Ok(())
}

/// A frame, and what is compared of it.
struct Candidate {
    index: usize,
    time_s: f64,
    image: Rgb,
    small: Small,
    sharpness: f64,
}

impl Candidate {
    fn new(index: usize, time_s: f64, image: Rgb) -> Self {
        let small = Small::new(&image);
        Self { index, time_s, sharpness: sharpness(&image), image, small }
    }
}

/// Takes the sharpest of each so many frames, unless it shows what the last one showed.
struct Chooser {
    every: NonZeroUsize,
    seen: usize,
    best: Option<Candidate>,
    last: Option<Small>,
}

impl Chooser {
    fn new(every: NonZeroUsize) -> Self {
        Self { every, seen: 0, best: None, last: None }
    }

    fn add(&mut self, frame: Candidate) -> Option<Candidate> {
        if self.best.as_ref().is_none_or(|best| frame.sharpness > best.sharpness) {
            self.best = Some(frame);
        }
        self.seen += 1;
        if self.seen == self.every.get() { self.end() } else { None }
    }

    /// What is left when no more frames come.
    fn end(&mut self) -> Option<Candidate> {
        self.seen = 0;
        let best = self.best.take()?;
        let stands = self
            .last
            .as_ref()
            .and_then(|last| best.small.movement_px(last))
            .is_some_and(|movement| movement < MIN_MOVEMENT * best.small.width as f64);
        if stands {
            return None;
        }
        self.last = Some(best.small.clone());
        Some(best)
    }
}

/// Mean square of the differences of neighbouring greens: what blur takes away.
fn sharpness(image: &Rgb) -> f64 {
    let width = image.width as usize;
    let rows = image.data.chunks_exact(3 * width.max(1));
    let energy = |row: &[u8]| -> u64 {
        let greens = row.iter().skip(1).step_by(3);
        greens.clone().zip(greens.skip(1)).map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2)).sum()
    };
    let total: u64 = rows.map(energy).sum();
    total as f64 / image.data.len().max(1) as f64
}

/// A grey copy, each pixel the mean of a square of the picture.
#[derive(Clone)]
struct Small {
    width: usize,
    height: usize,
    pixels: Vec<f32>,
}

impl Small {
    fn new(image: &Rgb) -> Self {
        let side = (image.width / SMALL_WIDTH).max(1) as usize;
        let (width, height) = (image.width as usize / side, image.height as usize / side);
        let mut pixels = vec![0.0; width * height];
        for (y, row) in
            image.data.chunks_exact(3 * image.width.max(1) as usize).take(height * side).enumerate()
        {
            for (x, green) in row.iter().skip(1).step_by(3).take(width * side).enumerate() {
                pixels[y / side * width + x / side] += f32::from(*green);
            }
        }
        let scale = 1.0 / (side * side) as f32;
        pixels.iter_mut().for_each(|pixel| *pixel *= scale);
        Self { width, height, pixels }
    }

    /// How far the picture has moved since `other`, in pixels, where that is little; something large, where it is not; `None` where nothing
    /// can be told.
    fn movement_px(&self, other: &Self) -> Option<f64> {
        if (self.width, self.height) != (other.width, other.height) {
            return None;
        }
        let mut movements: Vec<f64> = Vec::new();
        for top in (1..self.height.saturating_sub(BLOCK)).step_by(BLOCK) {
            for left in (1..self.width.saturating_sub(BLOCK)).step_by(BLOCK) {
                movements.extend(self.block_movement_px(other, left, top));
            }
        }
        if movements.len() < MIN_BLOCKS { None } else { median(&mut movements) }
    }

    /// Root mean square change of brightness over root mean square slope, where there are slopes in all directions. Exposure may differ.
    fn block_movement_px(&self, other: &Self, left: usize, top: usize) -> Option<f64> {
        let (mut xx, mut xy, mut yy, mut change, mut change2) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for y in top..top + BLOCK {
            for x in left..left + BLOCK {
                let at = |x: usize, y: usize| f64::from(other.pixels[y * self.width + x]);
                let (dx, dy) = (0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1)));
                let difference = f64::from(self.pixels[y * self.width + x]) - at(x, y);
                (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
                (change, change2) = (change + difference, change2 + difference * difference);
            }
        }
        let area = (BLOCK * BLOCK) as f64;
        let (half_trace, determinant) = (0.5 * (xx + yy), xx * yy - xy * xy);
        let least = half_trace - (half_trace * half_trace - determinant).max(0.0).sqrt();
        let variance = (change2 - change * change / area).max(0.0);
        (least >= MIN_TEXTURE * area).then(|| (variance / half_trace).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (u32, u32) = (640, 480);

    /// A picture with texture everywhere, moved to the right by so many pixels, and smeared over so many.
    fn picture(moved: f64, smear: usize) -> Rgb {
        let value = |x: f64, y: f64| {
            127.0 + 50.0 * ((0.11 * x).sin() * (0.13 * y).cos() + (0.31 * x + 0.17 * y).sin())
        };
        let mut data = Vec::new();
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                let of = |k: usize| value(f64::from(x) - moved - k as f64, f64::from(y));
                let mean = (0..smear.max(1)).map(of).sum::<f64>() / smear.max(1) as f64;
                data.extend([mean as u8; 3]);
            }
        }
        Rgb { width: SIZE.0, height: SIZE.1, data }
    }

    fn kept(every: usize, frames: &[(f64, usize)]) -> Vec<usize> {
        let mut chooser = Chooser::new(NonZeroUsize::new(every).unwrap());
        let mut kept: Vec<usize> = frames
            .iter()
            .enumerate()
            .filter_map(|(index, &(moved, smear))| {
                chooser.add(Candidate::new(index, 0.0, picture(moved, smear))).map(|frame| frame.index)
            })
            .collect();
        kept.extend(chooser.end().map(|frame| frame.index));
        kept
    }

    #[test]
    fn the_sharpest_of_so_many_frames_is_kept() {
        let frames = [(0.0, 9), (8.0, 1), (16.0, 9), (24.0, 9), (32.0, 9), (40.0, 1), (48.0, 1)];
        assert_eq!(kept(3, &frames), [1, 5, 6]);
        assert_eq!(kept(1, &frames[..3]), [0, 1, 2]);
    }

    #[test]
    fn a_stop_is_one_frame() {
        // 0.0025 of 640 pixels are 1.6; creeping adds up.
        assert_eq!(
            kept(1, &[(0.0, 1), (0.0, 1), (0.5, 1), (1.2, 1), (2.4, 1), (2.4, 1), (60.0, 1)]),
            [0, 4, 6]
        );
    }

    #[test]
    fn a_picture_without_texture_is_kept() {
        let grey = |level: u8| Rgb { width: 64, height: 48, data: vec![level; 64 * 48 * 3] };
        let mut chooser = Chooser::new(NonZeroUsize::MIN);
        for index in 0..3 {
            assert!(chooser.add(Candidate::new(index, 0.0, grey(9))).is_some());
        }
    }

    #[test]
    fn photos_and_videos_are_not_mixed_and_cameras_are_told_apart() {
        let dir = tempfile::tempdir().unwrap();
        for folder in ["photos", "left", "right"] {
            fs::create_dir(dir.path().join(folder)).unwrap();
        }
        let path = |name: &str| dir.path().join(name);
        for name in ["photos/1.jpg", "left/GX010042.MP4", "left/GX020042.MP4", "right/GX010042.MP4"] {
            fs::write(path(name), "").unwrap();
        }
        assert_eq!(videos(&[path("photos")]).unwrap(), Vec::<PathBuf>::new());
        assert!(matches!(videos(&[path("photos"), path("left")]), Err(Error::MixedInput { .. })));
        let files = videos(&[path("left"), path("right/GX010042.MP4")]).unwrap();
        assert_eq!(files.len(), 3);
        let named = named_apart(recordings(&files)).unwrap();
        let names: Vec<&str> = named.iter().map(|recording| recording.name.as_str()).collect();
        assert_eq!(names, ["left-GX010042", "right-GX010042"]);
        assert!(matches!(
            named_apart(recordings(&[path("left/a.mp4"), path("left/a.mov")])),
            Err(Error::TwoVideosOfOneName { .. })
        ));
    }
}
