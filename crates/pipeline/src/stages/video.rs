//! Videos as input: selected frames are written into the workspace as photos with capture times.
//!
//! A recording has its start time in whole seconds at best. If the soundtracks of two recordings
//! correlate, they give the offset between the starts ([`start_offset_s`]). The frames of the
//! second one are selected at the times of the first one's, so that synchronous frames differ by at
//! most half a frame interval.

use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf, absolute};

use serde::{Deserialize, Serialize};
use tiepoint_input::fingerprint::hash_file_ends;
use tiepoint_input::images::{is_image, is_unread_image};
use tiepoint_input::video::{
    Candidate, FrameSelector, RATE_HZ, Recording, Reduction, STRETCH_S, Selected, Streams,
    Telemetry, Transfer, VideoReader, is_stabilised, is_video, read_sound, recordings,
    start_offset_s,
};
use tiepoint_input::{Error as InputError, Photos};
use tiepoint_io::timestamps;
use tiepoint_sfm::scene::{Place, Position, PositionTrack};
use tiepoint_store::{Error as StoreError, OutputFolder, escaped};

use crate::workspace::format::json;
use crate::{Error, Event, Stage, Watch, Workspace, emit};

const FRAMES: &str = "frames";
const RECORD: &str = "videos.json";
const TIMES: &str = "timestamps.csv";
/// Digits of the frame number in the name of a frame.
const FRAME_DIGITS: usize = 6;
/// A video whose frames end earlier than it states by more, in seconds, may lack its end. The sound
/// of a whole video may last longer than its frames. Not varied.
const MAX_MISSING_S: f64 = 2.0;

/// Source of the frames in a folder; the last file to be written there.
#[derive(Debug, Serialize, Deserialize)]
struct Record {
    every: Option<NonZeroUsize>,
    /// Name and fingerprint of each recording.
    videos: Vec<(String, String)>,
    /// What the report notes about them.
    #[serde(default)]
    notes: Vec<String>,
    /// Where the frames were taken, by what the cameras recorded beside the picture.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    positions: Vec<FramePosition>,
}

/// The position of a frame on WGS 84.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct FramePosition {
    image: String,
    latitude_deg: f64,
    longitude_deg: f64,
    altitude_m: Option<f64>,
}

impl FramePosition {
    fn new(image: &str, position: &Position) -> Option<Self> {
        let Place::Geodetic { latitude_deg, longitude_deg, altitude_m } = position.place else {
            return None;
        };
        Some(Self { image: image.to_owned(), latitude_deg, longitude_deg, altitude_m })
    }

    fn named(&self) -> (String, Position) {
        let Self { image, latitude_deg, longitude_deg, altitude_m } = self.clone();
        let place = Place::Geodetic { latitude_deg, longitude_deg, altitude_m };
        (image, Position { place, sigma_horizontal_m: None, sigma_vertical_m: None })
    }
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
/// folders of them). The sharpest of every `every` frames of a video is written into the workspace,
/// and by default the sharpest of each tenth of a second, and more where the image moves fast.
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
    every: Option<NonZeroUsize>,
    redo: Option<Stage>,
    watch: Watch,
) -> Result<OpenedInput, Error> {
    let files = videos(inputs)?;
    if files.is_empty() {
        // In this order: no workspace is created for an invalid input.
        let mut photos = Photos::open(inputs, masks)?;
        let workspace = Workspace::create(root)?;
        if every.is_some() {
            let note = "`features.every` selects frames of videos; of photos all are taken";
            photos.notes.push(note.to_owned());
        }
        let is_root = |input: &PathBuf| input.canonicalize().ok() == root.canonicalize().ok();
        if inputs.iter().any(is_root) {
            let note = format!("{} has photos, and gets the results, too", root.display());
            photos.notes.push(note);
        }
        return Ok(OpenedInput { photos, workspace, timestamps: None });
    }
    let recordings = with_unique_names(recordings(&files)?)?;
    let videos = recordings
        .iter()
        .map(|recording| Ok((recording.name.clone(), hash_file_ends(&recording.chapters)?)));
    let videos = videos.collect::<Result<Vec<_>, Error>>()?;
    let chapters: Vec<PathBuf> =
        recordings.iter().flat_map(|recording| recording.chapters.clone()).collect();
    let mut workspace = Workspace::create(root)?;
    workspace.protect_sources(chapters.iter().map(PathBuf::as_path));
    let folder = workspace.root().join(FRAMES);
    let (mut frames, before) = open_frames(&folder)?;
    let times = folder.join(TIMES);
    let kept = before.as_ref().filter(|before| (before.every, &before.videos) == (every, &videos));
    let (notes, positions) = if let Some(kept) = kept {
        (kept.notes.clone(), kept.positions.clone())
    } else {
        if before.is_some() && redo != Some(Stage::Features) {
            return Err(Error::OtherFrames { path: folder });
        }
        let earlier: Vec<String> = frames.names().map(str::to_owned).collect();
        frames.protect(chapters.iter().map(PathBuf::as_path));
        frames.ensure_writable(earlier.iter().map(String::as_str))?;
        let (mut names, notes, positions) = extract(&recordings, &frames, every, watch)?;
        let record = Record { every, videos, notes, positions };
        frames.stage_bytes(RECORD, &json(&record))?;
        names.push(RECORD.to_owned());
        let removed: Vec<String> =
            earlier.into_iter().filter(|name| !names.contains(name)).collect();
        frames.publish(&names, &removed)?;
        (record.notes, record.positions)
    };
    drop(frames);
    let mut photos = Photos::open(&[folder], masks)?;
    photos.notes.splice(0..0, notes);
    photos.positions = positions.iter().map(FramePosition::named).collect();
    Ok(OpenedInput { workspace, photos, timestamps: Some(times) })
}

/// Opens folders of photos, and the workspace at `root` for a shard of their features; creates it.
///
/// # Errors
///
/// There are videos, or fewer than two photos; the workspace cannot be opened or written.
pub fn open_shared_input(
    inputs: &[PathBuf],
    masks: Option<&Path>,
    root: &Path,
) -> Result<OpenedInput, Error> {
    if let Some(video) = videos(inputs)?.into_iter().next() {
        return Err(Error::ShardOfVideo { path: video });
    }
    let photos = Photos::open(inputs, masks)?;
    Ok(OpenedInput { workspace: Workspace::create_shared(root)?, photos, timestamps: None })
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
    let entries = entries.map_err(Error::unreadable(folder));
    match entries?.next() {
        None => Ok((OutputFolder::open(folder)?, None)),
        Some(_) => Err(StoreError::ForeignFile { path: folder.to_owned() }.into()),
    }
}

/// The video files among the inputs, and in input folders, or in their folders of cameras, without
/// images of any format; empty for photos.
///
/// # Errors
///
/// A folder cannot be read, or the input mixes photos and videos.
fn videos(inputs: &[PathBuf]) -> Result<Vec<PathBuf>, Error> {
    let mut files = Vec::new();
    for input in inputs {
        if input.is_dir() {
            let mut found = entries_of(input)?;
            if !found.iter().any(|path| path.is_file()) {
                let folders = found.iter().filter(|path| path.is_dir());
                let of_cameras: Vec<_> = folders.map(|path| entries_of(path)).collect();
                // What is wrong with a folder is said where photos are searched.
                found = of_cameras.into_iter().flatten().flatten().collect();
            }
            // Photos that are not read are named beside the photos, not passed over for videos.
            if !found.iter().any(|path| is_image(path) || is_unread_image(path)) {
                files.extend(found.into_iter().filter(|path| path.is_file() && is_video(path)));
            }
        } else if is_video(input) {
            files.push(input.clone());
        }
    }
    let of_photos = inputs.iter().find(|input| !files.iter().any(|file| file.starts_with(input)));
    match of_photos {
        Some(photos) if !files.is_empty() => {
            Err(InputError::MixedInput { photos: photos.clone(), video: files.swap_remove(0) }
                .into())
        }
        _ => Ok(files),
    }
}

/// What a folder holds, sorted. Hidden files are ignored, as macOS's `._clip.mp4` beside
/// `clip.mp4`.
fn entries_of(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let entries = fs::read_dir(folder).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let entries = entries.map_err(Error::unreadable(folder))?;
    let is_hidden = |path: &PathBuf| {
        path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."))
    };
    let mut here: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
    here.retain(|path| !is_hidden(path));
    here.sort();
    Ok(here)
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
            // Of `clip.mp4` the folder is the current one. Links are not followed: two of them may
            // lead into one folder.
            let file = recording.chapters.first().and_then(|file| absolute(file).ok());
            let folder = file.as_deref().and_then(|file| file.parent()?.file_name());
            if let Some(folder) = folder {
                recording.name = format!("{}-{}", folder.to_string_lossy(), recording.name);
            }
        }
    }
    for (index, recording) in recordings.iter().enumerate() {
        let same = recordings[..index].iter().find(|other| other.name == recording.name);
        if let Some(same) = same {
            let first_file = |of: &Recording| of.chapters.first().cloned().unwrap_or_default();
            let (first, other) = (first_file(same), first_file(recording));
            return Err(InputError::TwoVideosOfOneName { first, other }.into());
        }
    }
    Ok(recordings)
}

/// Names of files, what is to be noted, and where the frames were taken.
type Extracted = (Vec<String>, Vec<String>, Vec<FramePosition>);

/// Stages the selected frames of all recordings and their capture times.
fn extract(
    recordings: &[Recording],
    frames: &OutputFolder,
    every: Option<NonZeroUsize>,
    watch: Watch,
) -> Result<Extracted, Error> {
    // Names and capture times of the selected frames.
    let mut selected: Vec<(String, f64)> = Vec::new();
    let (mut notes, mut positions) = (Vec::new(), Vec::new());
    let start_offsets_s = start_offsets_s(recordings, watch)?;
    // Whether the first recording tells when it began, and when that was.
    let (mut is_dated, mut first_start_s) = (true, None);
    // Times of the frames that were selected for no other recording.
    let mut target_times_s: Vec<f64> = Vec::new();
    for (recording, start_offset_s) in recordings.iter().zip(start_offsets_s) {
        let is_moving = recording.chapters.first().map(|file| is_stabilised(file)).transpose()?;
        if is_moving.flatten() == Some(true) {
            emit(watch, &Event::Stabilised { recording: &recording.name })?;
        }
        let mut selector = FrameSelector::new(every, target_times_s.clone());
        let start_by_audio_s = start_offset_s.and_then(|offset_s| Some(first_start_s? + offset_s));
        let (mut read, mut start_s, mut chapter_offset_s, mut last_s, mut interval_s) =
            (0, start_by_audio_s, 0.0, 0.0, 0.0);
        let (mut reduction, mut streams) = (Reduction::None, Streams::default());
        let mut fixes = Vec::new();
        let selected_before = selected.len();
        let mut keep = |chosen: Selected, watch: Watch, read: usize| -> Result<(), Error> {
            let Selected { frame, is_target } = chosen;
            let name = format!("{}/{:0FRAME_DIGITS$}.jpg", recording.name, frame.index);
            frame.image.write(&frames.stage(&name)?)?;
            emit(watch, &Event::FrameSelected { image: &name, read })?;
            selected.push((name, frame.time_s));
            if !is_target {
                target_times_s.push(frame.time_s);
            }
            Ok(())
        };
        for chapter in &recording.chapters {
            let mut reader = VideoReader::open(chapter)?;
            while let Some(frame) = reader.next_frame()? {
                let start_s = *start_s.get_or_insert_with(|| {
                    // Times by one clock only: a recording without a date began with the first one.
                    let own_s = reader.created_s().filter(|_| is_dated && !recording.is_late);
                    own_s.or(first_start_s).unwrap_or(0.0)
                });
                if first_start_s.is_none() {
                    is_dated = reader.created_s().is_some() && !recording.is_late;
                    first_start_s = Some(start_s);
                }
                let time_s = start_s + chapter_offset_s + frame.time_s;
                if read > 0 {
                    interval_s = time_s - last_s;
                }
                last_s = time_s;
                for chosen in selector.add(Candidate::new(read, time_s, frame.image)) {
                    keep(chosen, watch, read)?;
                }
                read += 1;
            }
            reduction = reader.reduction();
            streams = reader.streams();
            fixes.extend(fixes_of(chapter, start_s.unwrap_or(0.0) + chapter_offset_s)?);
            // A chapter starts one frame interval after the last frame of the previous one.
            let next_offset_s = last_s + interval_s - start_s.unwrap_or(0.0);
            let read_s = next_offset_s - chapter_offset_s;
            notes.extend(missing_end_note(chapter, read_s, streams.duration_s));
            chapter_offset_s = next_offset_s;
        }
        if let Some(chosen) = selector.end() {
            keep(chosen, watch, read)?;
        }
        let of_recording = &selected[selected_before..];
        notes.push(taken_note(&recording.name, of_recording.len(), read, every));
        positions.extend(positions_of(of_recording, fixes));
        notes.extend(reduction_note(&recording.name, reduction));
        notes.extend(stream_notes(recording, streams));
    }
    selected.sort_by(|a, b| a.0.cmp(&b.0));
    timestamps::write(
        &frames.stage(TIMES)?,
        selected.iter().map(|(name, time_s)| (name.as_str(), *time_s)),
    )?;
    let names = selected.into_iter().map(|(name, _)| name).chain([TIMES.to_owned()]).collect();
    Ok((names, notes, positions))
}

/// The positions that a camera recorded beside the picture of a file that begins at `start_s`.
fn fixes_of(chapter: &Path, start_s: f64) -> Result<Vec<(f64, Position)>, Error> {
    let Some(telemetry) = Telemetry::read(chapter)? else { return Ok(Vec::new()) };
    let track = telemetry.positions();
    let times_s = track.times_s().iter().map(|time_s| start_s + time_s);
    Ok(times_s.zip(track.positions().iter().copied()).collect())
}

/// Where the frames of a recording were taken. Before the first position, after the last one and
/// without a fix nobody knows.
fn positions_of(frames: &[(String, f64)], fixes: Vec<(f64, Position)>) -> Vec<FramePosition> {
    let track = PositionTrack::new(fixes);
    let of_frame = |(name, time_s): &(String, f64)| FramePosition::new(name, &track.at(*time_s)?);
    frames.iter().filter_map(of_frame).collect()
}

/// How many frames of a recording are taken, and how to take more.
fn taken_note(recording: &str, taken: usize, read: usize, every: Option<NonZeroUsize>) -> String {
    let (rule, more) = match every {
        None => (
            format!("one in {STRETCH_S} s, more where the image moves fast, none where it stands"),
            "`features.every` 1 takes all that move",
        ),
        Some(NonZeroUsize::MIN) => return format!("{recording}: {taken} of {read} frames taken"),
        Some(every) => (
            format!("one of {every}, none where the image stands"),
            "a smaller `features.every` \
            takes more",
        ),
    };
    match taken < read {
        true => format!("{recording}: {taken} of {read} frames taken ({rule}); {more}"),
        false => format!("{recording}: all {read} frames taken"),
    }
}

/// That the frames of a file end long before the duration that it states.
fn missing_end_note(file: &Path, read_s: f64, stated_s: Option<f64>) -> Option<String> {
    let stated_s = stated_s.filter(|stated_s| stated_s - read_s > MAX_MISSING_S)?;
    let file = escaped(file);
    Some(format!(
        "{file}: the frames that can be read end at {read_s:.1} s of {stated_s:.1} s, so that the \
        file may lack its end"
    ))
}

/// What is unusual about the files of a recording.
fn stream_notes(recording: &Recording, streams: Streams) -> Vec<String> {
    let (name, mut notes) = (&recording.name, Vec::new());
    if recording.is_late {
        notes.push(format!(
            "{name}: its first chapter is missing, so that its date tells no time: give that file \
            too if other cameras recorded with it"
        ));
    }
    if streams.is_interlaced {
        notes.push(format!(
            "{name}: interlaced video was deinterlaced, one frame of each two fields"
        ));
    }
    if streams.count > 1 {
        let others = streams.count - 1;
        notes.push(format!(
            "{name}: the first of {} video streams is read, {others} not: give each as a file, as \
            with `ffmpeg -i IN -map 0:v:1 -c copy OUT`",
            streams.count
        ));
    }
    notes
}

/// How the frames of a recording became eight bits a channel, if they had not been that.
fn reduction_note(recording: &str, reduction: Reduction) -> Option<String> {
    let how = match reduction {
        Reduction::None => return None,
        Reduction::Scaled => "more than 8 bits a channel were scaled to 8",
        Reduction::ToneMapped(Transfer::Hlg) => {
            "high dynamic range (HLG) was tone-mapped to 8 bits a channel"
        }
        Reduction::ToneMapped(Transfer::Pq) => {
            "high dynamic range (PQ) was tone-mapped to 8 bits a channel"
        }
    };
    Some(format!("{recording}: {how}"))
}

/// Start of each recording minus start of the first one, in seconds, if the soundtracks correlate.
fn start_offsets_s(recordings: &[Recording], watch: Watch) -> Result<Vec<Option<f64>>, Error> {
    let mut offsets_s = vec![None; recordings.len()];
    let Some((first, others)) = recordings.split_first().filter(|(_, others)| !others.is_empty())
    else {
        return Ok(offsets_s);
    };
    let sound = |recording: &Recording| -> Result<Vec<i16>, Error> {
        let chapters = recording.chapters.iter().map(|chapter| read_sound(chapter, RATE_HZ));
        Ok(chapters.collect::<Result<Vec<_>, _>>()?.concat())
    };
    let of_first = sound(first)?;
    for (other, offset_s) in others.iter().zip(&mut offsets_s[1..]) {
        *offset_s = start_offset_s(&of_first, &sound(other)?);
        if let Some(after_s) = *offset_s {
            let (reference, recording) = (first.name.as_str(), other.name.as_str());
            emit(watch, &Event::AudioOffset { reference, recording, after_s })?;
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
        for name in [
            "photos/1.jpg",
            "left/GX010042.MP4",
            "left/GX020042.MP4",
            "left/._GX020042.MP4",
            "right/GX010042.MP4",
        ] {
            fs::write(path(name), "").unwrap();
        }
        assert_eq!(videos(&[path("photos")]).unwrap(), Vec::<PathBuf>::new());
        // A telephone's photos with a short video each.
        fs::create_dir(path("live")).unwrap();
        for name in ["live/1.HEIC", "live/1.MOV"] {
            fs::write(path(name), "").unwrap();
        }
        assert_eq!(videos(&[path("live")]).unwrap(), Vec::<PathBuf>::new());
        assert!(matches!(
            videos(&[path("photos"), path("left")]),
            Err(Error::Input(InputError::MixedInput { .. }))
        ));
        let files = videos(&[path("left"), path("right/GX010042.MP4")]).unwrap();
        assert_eq!(files.len(), 3);
        let named = with_unique_names(recordings(&files).unwrap()).unwrap();
        let names: Vec<&str> = named.iter().map(|recording| recording.name.as_str()).collect();
        assert_eq!(names, ["left-GX010042", "right-GX010042"]);
        // A folder of cameras, of videos or of photos.
        fs::create_dir_all(path("drive/left")).unwrap();
        fs::create_dir_all(path("drive/right")).unwrap();
        for name in ["drive/left/run.mp4", "drive/right/run.mp4"] {
            fs::write(path(name), "").unwrap();
        }
        let files = videos(&[path("drive")]).unwrap();
        assert_eq!(files, ["drive/left/run.mp4", "drive/right/run.mp4"].map(path));
        let named = with_unique_names(recordings(&files).unwrap()).unwrap();
        assert_eq!([&*named[0].name, &*named[1].name], ["left-run", "right-run"]);
        fs::write(path("drive/right/1.jpg"), "").unwrap();
        assert_eq!(videos(&[path("drive")]).unwrap(), Vec::<PathBuf>::new());
        assert!(matches!(
            with_unique_names(recordings(&[path("left/a.mp4"), path("left/a.mov")]).unwrap()),
            Err(Error::Input(InputError::TwoVideosOfOneName { .. }))
        ));
        let twice =
            with_unique_names(recordings(&[path("left/a.mp4"), path("left/a.mp4")]).unwrap());
        let error = twice.unwrap_err().to_string();
        assert!(error.ends_with("left/a.mp4 is given twice: each video is one camera"), "{error}");
    }
}
