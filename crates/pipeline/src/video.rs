//! Videos as input: selected frames are written into the workspace as photos with capture times.
//!
//! A recording has its start time in whole seconds at best. If the soundtracks of two recordings
//! correlate, they give the offset between the starts ([`audio_offset`]). Then the frames of the
//! second one are selected at the times of the first one's, so that synchronous frames differ by at
//! most half a frame interval.

mod audio_offset;
mod frame_selection;

use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tiepoint_io::is_image;
use tiepoint_io::timestamps;
use tiepoint_io::video::{Recording, VideoReader, is_stabilised, is_video, read_sound, recordings};

use crate::fingerprint::of_files;
use crate::output_folder::OutputFolder;
use crate::records::json;
use crate::{Error, Event, Photos, Stage, Watch, Workspace, emit};
use frame_selection::{Candidate, FrameSelector};

/// Huang, Elhashash & Qin 2022 use every third frame at 30 Hz.
pub const DEFAULT_EVERY: NonZeroUsize = NonZeroUsize::new(3).unwrap();
const FRAMES: &str = "frames";
const RECORD: &str = "videos.json";
const TIMES: &str = "timestamps.csv";
/// Digits of the frame number in the name of a frame.
const FRAME_DIGITS: usize = 6;

/// Source of the frames in a folder; the last file to be written there.
#[derive(Debug, Serialize, Deserialize, PartialEq, Eq)]
struct Record {
    every: NonZeroUsize,
    /// Name and fingerprint of each recording.
    videos: Vec<(String, String)>,
}

/// A workspace with its input photos.
pub struct OpenedInput {
    /// The locked workspace.
    pub workspace: Workspace,
    /// The input photos, or the selected frames of videos.
    pub photos: Photos,
    /// CSV file of the capture times of frames, with the header `image,seconds`; `None` for photos.
    pub timestamps: Option<PathBuf>,
}

/// Opens or creates the workspace at `root` for `inputs`: folders of photos, or videos (files or
/// folders of them). The sharpest of every `every` frames of a video is written into the workspace.
/// Existing frames of other videos, or with another `every`, are replaced if `redo` is the feature
/// stage.
///
/// # Errors
///
/// The input mixes photos and videos, cannot be read or has fewer than two photos; two videos have
/// the same name; existing frames differ and are not to be redone; the workspace cannot be opened
/// or written; `watch` returns `Break`.
pub fn open_input(
    inputs: &[PathBuf],
    masks: Option<&Path>,
    root: &Path,
    every: NonZeroUsize,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<OpenedInput, Error> {
    let files = videos(inputs)?;
    if files.is_empty() {
        // In this order: no workspace is created for an invalid input.
        let photos = Photos::open(inputs, masks)?;
        return Ok(OpenedInput { photos, workspace: Workspace::create(root)?, timestamps: None });
    }
    let recordings = with_unique_names(recordings(&files))?;
    let videos = recordings
        .iter()
        .map(|recording| Ok((recording.name.clone(), of_files(&recording.chapters)?)));
    let record = Record { every, videos: videos.collect::<Result<_, Error>>()? };
    let workspace = Workspace::create(root)?;
    let folder = workspace.root().join(FRAMES);
    let (mut frames, before) = open_frames(&folder)?;
    let times = folder.join(TIMES);
    if before.as_ref() != Some(&record) {
        if before.is_some() && redo != Some(Stage::Features) {
            return Err(Error::OtherFrames { path: folder });
        }
        let earlier: Vec<String> = frames.names().map(str::to_owned).collect();
        frames.protect(
            recordings.iter().flat_map(|recording| &recording.chapters).map(PathBuf::as_path),
        );
        frames.refuse_foreign(earlier.iter().map(String::as_str))?;
        let mut names = extract(&recordings, &frames, every, watch)?;
        frames.stage_bytes(RECORD, &json(&record))?;
        names.push(RECORD.to_owned());
        let removed: Vec<String> =
            earlier.into_iter().filter(|name| !names.contains(name)).collect();
        frames.publish(&names, &removed)?;
    }
    drop(frames);
    let photos = Photos::open(&[folder], masks)?;
    Ok(OpenedInput { workspace, photos, timestamps: Some(times) })
}

/// Opens the folder of the frames, and reads the source of the frames if they are complete.
///
/// # Errors
///
/// The folder is foreign or cannot be read or written.
fn open_frames(folder: &Path) -> Result<(OutputFolder, Option<Record>), Error> {
    let read = || {
        let text = fs::read(folder.join(RECORD)).ok()?;
        serde_json::from_slice::<Record>(&text).ok()
    };
    if OutputFolder::is_ours(folder) || !folder.exists() {
        return Ok((OutputFolder::open(folder)?, read()));
    }
    let entries = fs::read_dir(folder);
    let entries = entries.map_err(|cause| Error::Unreadable { path: folder.to_owned(), cause });
    match entries?.next() {
        None => Ok((OutputFolder::open(folder)?, None)),
        Some(_) => Err(Error::ForeignFile { path: folder.to_owned() }),
    }
}

/// The video files among the inputs and in input folders without images; empty for photos.
///
/// # Errors
///
/// A folder cannot be read, or the input mixes photos and videos.
fn videos(inputs: &[PathBuf]) -> Result<Vec<PathBuf>, Error> {
    let mut files = Vec::new();
    for input in inputs {
        if input.is_dir() {
            let entries = fs::read_dir(input).and_then(Iterator::collect::<Result<Vec<_>, _>>);
            let entries =
                entries.map_err(|cause| Error::Unreadable { path: input.clone(), cause })?;
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

/// Prefixes the names of recordings with their folders where two have the same name.
///
/// # Errors
///
/// Two recordings still have the same name.
fn with_unique_names(mut recordings: Vec<Recording>) -> Result<Vec<Recording>, Error> {
    let names: Vec<String> = recordings.iter().map(|recording| recording.name.clone()).collect();
    for recording in &mut recordings {
        if names.iter().filter(|name| **name == recording.name).count() > 1 {
            let folder = recording.chapters.first().and_then(|file| file.parent()?.file_name());
            let folder =
                folder.map_or_else(String::new, |folder| folder.to_string_lossy().into_owned());
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

/// Stages the selected frames of all recordings and their capture times. Returns the file names.
fn extract(
    recordings: &[Recording],
    frames: &OutputFolder,
    every: NonZeroUsize,
    watch: Watch,
) -> Result<Vec<String>, Error> {
    // Names and capture times of the selected frames.
    let mut selected: Vec<(String, f64)> = Vec::new();
    let start_offsets_s = start_offsets_s(recordings, watch)?;
    // Start time and times of the selected frames of the first recording.
    let (mut first_start_s, mut first_times_s) = (None, Vec::new());
    for (recording, start_offset_s) in recordings.iter().zip(start_offsets_s) {
        let is_moving = recording.chapters.first().map(|file| is_stabilised(file)).transpose()?;
        if is_moving.flatten() == Some(true) {
            emit(watch, &Event::Stabilised { recording: &recording.name })?;
        }
        let target_times_s =
            if start_offset_s.is_some() { first_times_s.clone() } else { Vec::new() };
        let mut selector = FrameSelector::new(every, target_times_s);
        let start_by_audio_s = start_offset_s.and_then(|offset_s| Some(first_start_s? + offset_s));
        let (mut read, mut start_s, mut chapter_offset_s, mut last_s, mut interval_s) =
            (0, start_by_audio_s, 0.0, 0.0, 0.0);
        let selected_before = selected.len();
        let mut keep = |frame: Option<Candidate>, watch: Watch, read: usize| -> Result<(), Error> {
            let Some(frame) = frame else { return Ok(()) };
            let name = format!("{}/{:0FRAME_DIGITS$}.jpg", recording.name, frame.index);
            frame.image.write(&frames.stage(&name)?)?;
            emit(watch, &Event::FrameKept { image: &name, read })?;
            selected.push((name, frame.time_s));
            Ok(())
        };
        for chapter in &recording.chapters {
            let mut reader = VideoReader::open(chapter)?;
            while let Some(frame) = reader.next_frame()? {
                let start_s = *start_s.get_or_insert(reader.created_s().unwrap_or(0.0));
                let time_s = start_s + chapter_offset_s + frame.time_s;
                if read > 0 {
                    interval_s = time_s - last_s;
                }
                last_s = time_s;
                keep(selector.add(Candidate::new(read, time_s, frame.image)), watch, read)?;
                read += 1;
            }
            // A chapter starts one frame interval after the last frame of the previous one.
            chapter_offset_s = last_s + interval_s - start_s.unwrap_or(0.0);
        }
        keep(selector.end(), watch, read)?;
        if first_start_s.is_none() {
            first_start_s = start_s;
            first_times_s = selected[selected_before..].iter().map(|(_, time_s)| *time_s).collect();
        }
    }
    selected.sort_by(|a, b| a.0.cmp(&b.0));
    timestamps::write(
        &frames.stage(TIMES)?,
        selected.iter().map(|(name, time_s)| (name.as_str(), *time_s)),
    )?;
    Ok(selected.into_iter().map(|(name, _)| name).chain([TIMES.to_owned()]).collect())
}

/// Start of each recording minus start of the first one, in seconds, if the soundtracks correlate.
fn start_offsets_s(recordings: &[Recording], watch: Watch) -> Result<Vec<Option<f64>>, Error> {
    let mut offsets_s = vec![None; recordings.len()];
    let Some((first, others)) = recordings.split_first().filter(|(_, others)| !others.is_empty())
    else {
        return Ok(offsets_s);
    };
    let sound = |recording: &Recording| -> Result<Vec<i16>, Error> {
        let chapters =
            recording.chapters.iter().map(|chapter| read_sound(chapter, audio_offset::RATE_HZ));
        Ok(chapters.collect::<Result<Vec<_>, _>>()?.concat())
    };
    let of_first = sound(first)?;
    for (other, offset_s) in others.iter().zip(&mut offsets_s[1..]) {
        *offset_s = audio_offset::start_offset_s(&of_first, &sound(other)?);
        if let Some(after_s) = *offset_s {
            let (reference, recording) = (first.name.as_str(), other.name.as_str());
            emit(watch, &Event::SoundHeard { reference, recording, after_s })?;
        }
    }
    Ok(offsets_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mixed_input_is_rejected_and_recordings_get_unique_names() {
        let dir = tempfile::tempdir().unwrap();
        for folder in ["photos", "left", "right"] {
            fs::create_dir(dir.path().join(folder)).unwrap();
        }
        let path = |name: &str| dir.path().join(name);
        for name in ["photos/1.jpg", "left/GX010042.MP4", "left/GX020042.MP4", "right/GX010042.MP4"]
        {
            fs::write(path(name), "").unwrap();
        }
        assert_eq!(videos(&[path("photos")]).unwrap(), Vec::<PathBuf>::new());
        assert!(matches!(videos(&[path("photos"), path("left")]), Err(Error::MixedInput { .. })));
        let files = videos(&[path("left"), path("right/GX010042.MP4")]).unwrap();
        assert_eq!(files.len(), 3);
        let named = with_unique_names(recordings(&files)).unwrap();
        let names: Vec<&str> = named.iter().map(|recording| recording.name.as_str()).collect();
        assert_eq!(names, ["left-GX010042", "right-GX010042"]);
        assert!(matches!(
            with_unique_names(recordings(&[path("left/a.mp4"), path("left/a.mov")])),
            Err(Error::TwoVideosOfOneName { .. })
        ));
    }
}
