//! Frames and sound of videos, decoded by the program `ffmpeg`.
//!
//! ffmpeg rotates each frame as the metadata say, scales non-square pixels to square ones, and
//! writes PPM images to a pipe. Frames of more than eight bits a channel come with 16, and are
//! reduced here; those of high dynamic range are tone-mapped. The filter `showinfo` prints the time
//! stamp of each frame, so that variable frame rates are respected. The start time of the recording
//! is read from the metadata, in whole seconds.

use std::collections::{BTreeMap, VecDeque};
use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

pub use super::gopro::is_stabilised;
use super::tone_map::ToneMap;
pub use super::tone_map::Transfer;
use crate::images::Rgb;
use crate::images::seconds_of_date;
use crate::images::{DEFAULT_MAX_PIXELS, SizeLimit};
use crate::images::{VIDEO_EXTENSIONS, has_extension};
use tiepoint_io::{Error, Result};
use tiepoint_store::{escaped, require_regular_file};

/// Lines of the log of ffmpeg that an error quotes.
const QUOTED_LINES: usize = 3;
/// Filters of ffmpeg: scale non-square pixels up to square ones, then print the time stamps.
const FILTERS: &str = "scale=w='iw*max(sar,1)':h='ih/min(sar,1)',setsar=1,showinfo";
/// Put before [`FILTERS`] for interlaced video: one frame of each two fields.
const DEINTERLACE: &str = "yadif=mode=send_frame:deint=interlaced,";
/// First version of ffmpeg with the option `-fps_mode`; earlier versions call it `-vsync`.
const FIRST_WITH_FPS_MODE: (u32, u32) = (5, 1);

/// Whether a file is a video, by its extension.
pub fn is_video(path: &Path) -> bool {
    has_extension(path, &VIDEO_EXTENSIONS)
}

/// One recording of one camera: consecutive files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recording {
    /// The stem of the name of the first file, made safe as the name of a folder: trimmed, with `_`
    /// for control characters and for a leading dot.
    pub name: String,
    /// The files in the order of recording.
    pub chapters: Vec<PathBuf>,
    /// Whether the first chapter is missing: the files hold the time at which that one began.
    pub is_late: bool,
}

/// Groups the chapter files into which action cameras split a recording: `GH010042.MP4`,
/// `GH020042.MP4` and so on, or `GOPR0042.MP4`, `GP010042.MP4` of older cameras, in the same
/// folder. Every other file is a recording of its own.
///
/// # Errors
///
/// If two files are the same chapter, and if a chapter between others is missing: how long it is
/// nobody knows, and later chapters would have wrong times.
pub fn recordings(files: &[PathBuf]) -> Result<Vec<Recording>> {
    let mut chapters: BTreeMap<(PathBuf, String), BTreeMap<u32, PathBuf>> = BTreeMap::new();
    let mut order = Vec::new();
    for (index, file) in files.iter().enumerate() {
        let folder = file.parent().map(Path::to_owned).unwrap_or_default();
        // A file that is not a chapter gets a key of its own.
        let (recording, chapter) = chapter_of(file).unwrap_or_else(|| (format!("#{index}"), 0));
        let key = (folder, recording);
        if !order.contains(&key) {
            order.push(key.clone());
        }
        if let Some(other) = chapters.entry(key).or_default().insert(chapter, file.clone()) {
            let what = format!(
                "is chapter {chapter} of a recording, as is {}: move one of the two away",
                escaped(&other)
            );
            return Err(Error::content(file, what));
        }
    }
    let name_of =
        |file: &PathBuf| file.file_stem().map(|stem| folder_name(&stem.to_string_lossy()));
    let mut recordings = Vec::new();
    for key in &order {
        let Some(found) = chapters.get(key) else { continue };
        let numbers: Vec<(&u32, &PathBuf)> = found.iter().collect();
        if let Some(two) = numbers.windows(2).find(|two| *two[1].0 != two[0].0 + 1) {
            let what = format!(
                "is chapter {} of the recording of {}, and chapter {} is missing, so that its \
                times are unknown: give that file too, or this one in a run of its own",
                two[1].0,
                escaped(two[0].1),
                two[0].0 + 1
            );
            return Err(Error::content(two[1].1, what));
        }
        let Some((number, first)) = numbers.first() else { continue };
        let Some(name) = name_of(first) else { continue };
        // Files of one name are no chapters; `GOPR` is chapter 0 and the first.
        let is_late = **number > 1 || **number == 1 && key.1.starts_with("GP");
        recordings.push(Recording { name, chapters: found.values().cloned().collect(), is_late });
    }
    Ok(recordings)
}

/// A file stem as the name of a folder of frames. A folder with a leading dot would be hidden.
fn folder_name(stem: &str) -> String {
    let name: String = stem.trim().chars().map(|c| if c.is_control() { '_' } else { c }).collect();
    match name.strip_prefix('.') {
        Some(rest) => format!("_{rest}"),
        None if name.is_empty() => "_".to_owned(),
        None => name,
    }
}

/// The key of the recording that a chapter file belongs to, and the number of the chapter.
fn chapter_of(file: &Path) -> Option<(String, u32)> {
    let stem = file.file_stem()?.to_str()?.to_ascii_uppercase();
    let (head, digits) = stem.split_at_checked(4)?;
    if digits.len() != 4 || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    if head == "GOPR" {
        return Some((format!("GP{digits}"), 0));
    }
    let chapter = head[2..].parse().ok()?;
    let kind = &head[..2];
    matches!(kind, "GH" | "GX" | "GP").then(|| (format!("{kind}{digits}"), chapter))
}

/// A frame of a video.
#[derive(Clone, Debug)]
pub struct VideoFrame {
    /// Time since the beginning of the video, in seconds.
    pub time_s: f64,
    /// The upright image.
    pub image: Rgb,
}

/// How frames became eight bits a channel of standard range.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reduction {
    /// They have been that.
    #[default]
    None,
    /// More bits were scaled to eight.
    Scaled,
    /// High dynamic range was tone-mapped.
    ToneMapped(Transfer),
}

/// An event in the log of ffmpeg.
enum LogEvent {
    /// The video has a high dynamic range.
    HighRange(Transfer),
    /// The recording began at this time, in seconds since 1970.
    Created(f64),
    /// Time stamp of the next frame, in seconds.
    Time(f64),
}

/// Reads the frames of a video file in their order.
pub struct VideoReader {
    path: PathBuf,
    child: Child,
    frames: BufReader<ChildStdout>,
    events: Receiver<LogEvent>,
    /// Reads the log of ffmpeg; returns its last lines.
    log_reader: Option<JoinHandle<VecDeque<String>>>,
    created_s: Option<f64>,
    reduction: Reduction,
    tone_map: Option<ToneMap>,
    streams: Streams,
    count: usize,
}

/// The video streams of a file. The first one is read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Streams {
    /// Duration that the file states, in seconds: of its longest stream.
    pub duration_s: Option<f64>,
    /// Whether the first one is interlaced, and its frames are deinterlaced.
    pub is_interlaced: bool,
    /// The number of moving ones; a cover picture is none.
    pub count: usize,
}

impl VideoReader {
    /// Starts ffmpeg on a file.
    ///
    /// # Errors
    ///
    /// If the file cannot be opened or is not a regular file, and if ffmpeg cannot be run.
    pub fn open(path: &Path) -> Result<Self> {
        require_regular_file(path)?;
        // A file that cannot be opened: the message of ffmpeg would be long.
        std::fs::File::open(path).map_err(Error::io(path))?;
        let passthrough = if version(path)? >= FIRST_WITH_FPS_MODE {
            ["-fps_mode", "passthrough"]
        } else {
            ["-vsync", "0"]
        };
        let streams = streams(path)?;
        let deinterlace = if streams.is_interlaced { DEINTERLACE } else { "" };
        let mut child = ffmpeg()
            .args(["-nostdin", "-hide_banner", "-loglevel", "info", "-nostats", "-i"])
            .arg(file_url(path))
            .args(["-map", "0:v:0", "-vf", &format!("{deinterlace}{FILTERS}")])
            .args(passthrough)
            .args(["-f", "image2pipe", "-c:v", "ppm", "-"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(ffmpeg_missing(path))?;
        let (Some(frames), Some(log)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(Error::content(path, "the pipes of ffmpeg could not be opened"));
        };
        let (sender, events) = channel();
        let log_reader = Some(std::thread::spawn(move || read_log(BufReader::new(log), &sender)));
        Ok(Self {
            path: path.to_owned(),
            child,
            frames: BufReader::new(frames),
            events,
            log_reader,
            created_s: None,
            reduction: Reduction::None,
            tone_map: None,
            streams,
            count: 0,
        })
    }

    /// What ffmpeg tells of the streams of the file.
    pub fn streams(&self) -> Streams {
        self.streams
    }

    /// Start time of the recording by the clock of the camera, in seconds since 1970 (whole
    /// seconds), if the metadata hold it. Available after the first frame was read.
    pub fn created_s(&self) -> Option<f64> {
        self.created_s
    }

    /// How the frames became eight bits a channel. Available after the first frame was read.
    pub fn reduction(&self) -> Reduction {
        self.reduction
    }

    /// Reads the next frame; `None` after the last one. A truncated file gives the frames before
    /// the truncation.
    ///
    /// # Errors
    ///
    /// If the file has no frame that ffmpeg can decode, and if ffmpeg prints no time stamp for a
    /// frame.
    pub fn next_frame(&mut self) -> Result<Option<VideoFrame>> {
        let ppm = match read_ppm(&mut self.frames).map_err(Error::io(&self.path))? {
            Some(ppm) => ppm,
            None if self.count > 0 => return Ok(None),
            None => return Err(self.no_frames_error()),
        };
        self.count += 1;
        loop {
            match self.events.recv() {
                Ok(LogEvent::Created(seconds)) => self.created_s = self.created_s.or(Some(seconds)),
                Ok(LogEvent::HighRange(transfer)) => {
                    self.tone_map.get_or_insert_with(|| ToneMap::new(transfer));
                    self.reduction = Reduction::ToneMapped(transfer);
                }
                Ok(LogEvent::Time(time_s)) => {
                    if ppm.is_deep && self.reduction == Reduction::None {
                        self.reduction = Reduction::Scaled;
                    }
                    let image = ppm.into_rgb(self.tone_map.as_ref());
                    return Ok(Some(VideoFrame { time_s, image }));
                }
                Err(_) => {
                    let what = format!("ffmpeg does not tell the time of frame {}", self.count);
                    return Err(Error::content(&self.path, what));
                }
            }
        }
    }

    /// The error of a file without any frame, with the last lines of the log of ffmpeg.
    fn no_frames_error(&mut self) -> Error {
        let lines = self
            .log_reader
            .take()
            .and_then(|log_reader| log_reader.join().ok())
            .unwrap_or_default();
        let output: Vec<String> = lines.into();
        Error::content(
            &self.path,
            format!("no video could be read from it; ffmpeg says: {}", output.join("; ")),
        )
    }
}

impl Drop for VideoReader {
    fn drop(&mut self) {
        // Fails if ffmpeg has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads the sound of a video file: one channel, `rate_hz` samples a second, from the time of the
/// first frame. Empty without a sound track.
///
/// # Errors
///
/// If the path leads to something other than a regular file, and if ffmpeg cannot be run.
pub fn read_sound(path: &Path, rate_hz: u32) -> Result<Vec<i16>> {
    require_regular_file(path)?;
    let finished = ffmpeg()
        .args(["-nostdin", "-v", "error", "-i"])
        .arg(file_url(path))
        // Gaps are filled with silence, so that the sound stays synchronous with the frames.
        .args([
            "-map",
            "0:a:0?",
            "-af",
            "aresample=async=1:first_pts=0",
            "-ac",
            "1",
            "-ar",
            &rate_hz.to_string(),
        ])
        .args(["-f", "s16le", "-"])
        .stdin(Stdio::null())
        .output()
        .map_err(ffmpeg_missing(path))?;
    // ffmpeg exits with an error if there is no sound track: the output is empty then.
    Ok(finished
        .stdout
        .chunks_exact(2)
        .map(|bytes| i16::from_le_bytes([bytes[0], bytes[1]]))
        .collect())
}

/// The command `ffmpeg`, in a process group of its own: Ctrl-C on a terminal would otherwise end
/// ffmpeg early, and the truncated stream would pass for the whole video. ffmpeg ends when its pipe
/// is closed.
fn ffmpeg() -> Command {
    let mut command = Command::new("ffmpeg");
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
}

/// The streams of a file as ffmpeg describes them.
fn streams(path: &Path) -> Result<Streams> {
    // Without an output, ffmpeg describes the input and exits with an error.
    let described = ffmpeg()
        .args(["-nostdin", "-hide_banner", "-i"])
        .arg(file_url(path))
        .stdin(Stdio::null())
        .output()
        .map_err(ffmpeg_missing(path))?;
    Ok(parse_streams(&String::from_utf8_lossy(&described.stderr)))
}

fn parse_streams(text: &str) -> Streams {
    let videos: Vec<&str> = text
        .lines()
        .filter_map(|line| line.trim_start().strip_prefix("Stream #")?.split_once("Video: "))
        .map(|(_, format)| format)
        .filter(|format| !format.contains("(attached pic)"))
        .collect();
    let is_interlaced = |format: &&str| {
        ["top", "bottom"].iter().any(|order| {
            format.contains(&format!("{order} first")) || format.contains(&format!("{order} coded"))
        })
    };
    Streams {
        duration_s: text.lines().find_map(parse_duration_s),
        is_interlaced: videos.first().is_some_and(is_interlaced),
        count: videos.len(),
    }
}

/// The duration in `  Duration: 00:01:02.50, start: 0.000000, bitrate: 1205 kb/s`.
fn parse_duration_s(line: &str) -> Option<f64> {
    let (text, _) = line.trim_start().strip_prefix("Duration: ")?.split_once(',')?;
    text.split(':').try_fold(0.0, |sum, part| Some(60.0 * sum + part.parse::<f64>().ok()?))
}

/// The URL of a file for ffmpeg. Without `file:`, `12:30.mp4` would be a protocol and `-x.mp4` an
/// option.
fn file_url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

fn ffmpeg_missing(video: &Path) -> impl FnOnce(std::io::Error) -> Error {
    move |cause| {
        Error::content(
            video,
            format!(
                "reading a video needs the program ffmpeg, which could not be run ({cause}): \
                install it"
            ),
        )
    }
}

/// The version of ffmpeg. A build from the repository has no number and counts as newest.
fn version(video: &Path) -> Result<(u32, u32)> {
    let output =
        ffmpeg().arg("-version").stdin(Stdio::null()).output().map_err(ffmpeg_missing(video))?;
    Ok(parse_version(&String::from_utf8_lossy(&output.stdout)).unwrap_or((u32::MAX, 0)))
}

fn parse_version(text: &str) -> Option<(u32, u32)> {
    let mut numbers = text.strip_prefix("ffmpeg version ")?.split(|c: char| !c.is_ascii_digit());
    Some((numbers.next()?.parse().ok()?, numbers.next()?.parse().unwrap_or(0)))
}

/// Sends the events of the log; returns the last of the other lines.
fn read_log(log: impl BufRead, events: &Sender<LogEvent>) -> VecDeque<String> {
    let mut last = VecDeque::new();
    for line in log.split(b'\n').map_while(|line| line.ok()) {
        let line = String::from_utf8_lossy(&line);
        let event = match parse_log_line(&line) {
            Some(event) => event,
            None => {
                last.push_back(line.trim().to_owned());
                if last.len() > QUOTED_LINES {
                    last.pop_front();
                }
                continue;
            }
        };
        // A dropped reader is no error: the pipe must be drained.
        let _ = events.send(event);
    }
    last
}

fn parse_log_line(line: &str) -> Option<LogEvent> {
    if let Some((_, rest)) = line.split_once(" pts_time:") {
        let time_s = rest
            .split_whitespace()
            .next()?
            .parse()
            .ok()
            .filter(|time_s: &f64| time_s.is_finite())?;
        return line.contains("showinfo").then_some(LogEvent::Time(time_s));
    }
    if let Some(transfer) = high_range(line) {
        return Some(LogEvent::HighRange(transfer));
    }
    let (key, value) = line.split_once(':')?;
    if key.trim() != "creation_time" {
        return None;
    }
    let date = value.trim().split(['.', 'Z']).next()?;
    // Cameras whose clock was never set write 1904 or 1970.
    seconds_of_date(date).filter(|seconds| *seconds > 0.0).map(LogEvent::Created)
}

/// The transfer function in the description of a stream, if it is one of high dynamic range:
/// `Stream #0:0: Video: hevc (Main 10), yuv420p10le(tv, bt2020nc/bt2020/arib-std-b67), 1920x1080`.
/// ffmpeg describes the stream of its output in the same way, and that has been read from this one.
fn high_range(line: &str) -> Option<Transfer> {
    let (_, format) = line.trim_start().strip_prefix("Stream #")?.split_once("Video: ")?;
    let mut names = format.split(|c: char| !c.is_ascii_alphanumeric() && c != '-');
    names.find_map(|name| match name {
        "arib-std-b67" => Some(Transfer::Hlg),
        "smpte2084" => Some(Transfer::Pq),
        _ => None,
    })
}

/// An image of a stream of PPM images.
#[derive(Debug, PartialEq, Eq)]
struct Ppm {
    width: u32,
    height: u32,
    /// Whether a sample has two bytes, the higher one first.
    is_deep: bool,
    samples: Vec<u8>,
}

impl Ppm {
    /// The image with eight bits a channel.
    fn into_rgb(self, tone_map: Option<&ToneMap>) -> Rgb {
        let Self { width, height, is_deep, samples } = self;
        let data = match (tone_map, is_deep) {
            (None, false) => samples,
            (None, true) => deep(&samples).map(eight_bits).collect(),
            (Some(map), false) => {
                let pixels = samples.as_chunks().0.iter();
                pixels.flat_map(|pixel: &[u8; 3]| map.map(pixel.map(sixteen_bits))).collect()
            }
            (Some(map), true) => {
                let pixels = samples.as_chunks::<6>().0.iter();
                pixels
                    .flat_map(|&[r1, r0, g1, g0, b1, b0]| {
                        map.map([[r1, r0], [g1, g0], [b1, b0]].map(u16::from_be_bytes))
                    })
                    .collect()
            }
        };
        Rgb { width, height, data }
    }
}

fn deep(samples: &[u8]) -> impl Iterator<Item = u16> {
    samples.as_chunks().0.iter().map(|bytes| u16::from_be_bytes(*bytes))
}

/// A value of 16 bits as one of eight, rounded.
fn eight_bits(value: u16) -> u8 {
    ((u32::from(value) + 128) / 257) as u8
}

fn sixteen_bits(value: u8) -> u16 {
    257 * u16::from(value)
}

/// Reads an image of a stream of PPM images. `None` at the end of the stream, also within an image.
fn read_ppm(stream: &mut impl BufRead) -> std::io::Result<Option<Ppm>> {
    let invalid =
        || std::io::Error::new(std::io::ErrorKind::InvalidData, "ffmpeg wrote no PPM image");
    let mut words = Vec::new();
    for _ in 0..3 {
        let mut line = Vec::new();
        if stream.read_until(b'\n', &mut line)? == 0 {
            return if words.is_empty() { Ok(None) } else { Err(invalid()) };
        }
        words.extend(String::from_utf8_lossy(&line).split_whitespace().map(str::to_owned));
    }
    let [kind, width, height, depth] = &words[..] else { return Err(invalid()) };
    let (Ok(width), Ok(height)) = (width.parse::<u32>(), height.parse::<u32>()) else {
        return Err(invalid());
    };
    let is_deep = match (kind.as_str(), depth.as_str()) {
        ("P6", "255") => false,
        ("P6", "65535") => true,
        _ => return Err(invalid()),
    };
    // A video with a wrong size makes ffmpeg write images of that size.
    let checked = SizeLimit::Pixels(DEFAULT_MAX_PIXELS).check(width, height);
    checked.map_err(|what| std::io::Error::new(std::io::ErrorKind::InvalidData, what))?;
    let length = 3 * u64::from(width) * u64::from(height) * if is_deep { 2 } else { 1 };
    let mut samples = Vec::new();
    stream.take(length).read_to_end(&mut samples)?;
    let is_whole = samples.len() as u64 == length;
    Ok(is_whole.then_some(Ppm { width, height, is_deep, samples }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(files: &[&str]) -> Vec<(String, usize)> {
        let files: Vec<PathBuf> = files.iter().map(PathBuf::from).collect();
        recordings(&files).unwrap().into_iter().map(|r| (r.name, r.chapters.len())).collect()
    }

    #[test]
    fn chapter_files_are_grouped() {
        let of = |name: &str, chapters| (name.to_owned(), chapters);
        assert_eq!(
            names(&["a/GH020042.MP4", "a/GH010042.MP4", "b/GH010042.MP4", "a/GH010043.MP4"]),
            [of("GH010042", 2), of("GH010042", 1), of("GH010043", 1)]
        );
        assert_eq!(names(&["GOPR0007.mp4", "GP010007.mp4"]), [of("GOPR0007", 2)]);
        assert_eq!(names(&["left.mp4", "right.mp4", "IMG_0042.MOV", "DJI_0042.MP4"]).len(), 4);
        let files = [PathBuf::from("GX020042.MP4"), PathBuf::from("GX010042.MP4")];
        assert_eq!(recordings(&files).unwrap()[0].chapters, [files[1].clone(), files[0].clone()]);
    }

    #[test]
    fn missing_and_double_chapters_are_named() {
        let of = |names: &[&str]| {
            recordings(&names.iter().map(PathBuf::from).collect::<Vec<_>>())
                .map_err(|error| error.to_string())
        };
        let error = of(&["GX010042.MP4", "GX030042.MP4"]).unwrap_err();
        assert!(error.starts_with("GX030042.MP4: is chapter 3 "), "{error}");
        assert!(error.contains("chapter 2 is missing"), "{error}");
        let error = of(&["GX010042.MP4", "gx010042.mov"]).unwrap_err();
        assert!(error.contains("gx010042.mov: is chapter 1") && error.contains("GX010042.MP4"));
        for (names, is_late) in [
            (&["GX010042.MP4", "GX020042.MP4"][..], false),
            (&["GX020042.MP4", "GX030042.MP4"], true),
            (&["GOPR0042.MP4", "GP010042.MP4"], false),
            (&["GP010042.MP4"], true),
            (&["left.mp4"], false),
        ] {
            assert_eq!(of(names).unwrap()[0].is_late, is_late, "{names:?}");
        }
    }

    #[test]
    fn streams_tell_of_fields_and_of_a_second_lens() {
        let of = |formats: &[&str]| {
            let line = |(k, format): (usize, &&str)| {
                format!("  Stream #0:{k}[0x1](und): Video: h264 (High), {format}\n")
            };
            let found = parse_streams(&formats.iter().enumerate().map(line).collect::<String>());
            (found.is_interlaced, found.count)
        };
        let progressive = "yuv420p(tv, bt709, progressive), 8x8, 25 fps";
        assert_eq!(of(&[progressive]), (false, 1));
        assert_eq!(of(&["yuv420p(top first), 8x8, 25 fps", progressive]), (true, 2));
        assert_eq!(of(&["yuv420p(tv, bt709, bottom coded first (swapped)), 8x8"]), (true, 1));
        assert_eq!(of(&[progressive, "yuvj444p(pc), 640x640, 90k tbr (attached pic)"]), (false, 1));
        let stated = |duration: &str| {
            let text = format!("  Duration: {duration}, start: 0.000000, bitrate: 1205 kb/s\n");
            parse_streams(&text).duration_s
        };
        assert_eq!((stated("01:01:02.50"), stated("N/A")), (Some(3662.5), None));
    }

    #[test]
    fn recording_names_are_names_of_folders() {
        for (file, expected) in [
            (" a b .mp4", "a b"),
            ("a\nb.mp4", "a_b"),
            (".a.mp4", "_a"),
            ("12:30.mp4", "12:30"),
            (" .mp4", "_"),
        ] {
            assert_eq!(names(&[file]), [(expected.to_owned(), 1)]);
        }
    }

    #[test]
    fn log_lines_and_versions_of_ffmpeg_are_parsed() {
        let line =
            "[Parsed_showinfo_0 @ 0x55] n:   3 pts:   1536 pts_time:0.1 duration: 512 fmt:yuv420p";
        assert!(matches!(parse_log_line(line), Some(LogEvent::Time(time_s)) if time_s == 0.1));
        let line = "    creation_time   : 2024-02-29T12:34:56.000000Z";
        // `date -u -d '2024-02-29 12:34:56' +%s`
        let created_s = match parse_log_line(line) {
            Some(LogEvent::Created(seconds)) => seconds,
            _ => f64::NAN,
        };
        assert_eq!(created_s, 1_709_210_096.0);
        for line in [
            "creation_time : 1904-01-01T00:00:00.000000Z",
            "x pts_time:NOPTS showinfo",
            "title : 5",
            "",
        ] {
            assert!(parse_log_line(line).is_none(), "{line}");
        }
        assert_eq!(parse_version("ffmpeg version 5.1.9-0+deb12u1 Copyright"), Some((5, 1)));
        assert_eq!(parse_version("ffmpeg version n7.0 Copyright"), None);
        assert_eq!(parse_version("ffmpeg version 4.4.2-0ubuntu0.22.04.1"), Some((4, 4)));
    }

    #[test]
    fn truncated_ppm_ends_the_stream() {
        let mut bytes =
            b"P6\n2 1\n255\nabcdefP6\n1 1\n65535\nuvwxyzP6\n9 9\n255\ntoo little".as_slice();
        let of = |width, is_deep, samples: &[u8]| {
            Some(Ppm { width, height: 1, is_deep, samples: samples.to_vec() })
        };
        assert_eq!(read_ppm(&mut bytes).unwrap(), of(2, false, b"abcdef"));
        assert_eq!(read_ppm(&mut bytes).unwrap(), of(1, true, b"uvwxyz"));
        assert_eq!(read_ppm(&mut bytes).unwrap(), None);
        for other in ["P5\n1 1\n255\nx", "P6\n-1 1\n255\nx", "P6\n1 1\n1023\nxxxxxx"] {
            assert!(read_ppm(&mut other.as_bytes()).is_err(), "{other}");
        }
    }

    #[test]
    fn sixteen_bits_become_eight() {
        let deep = |samples: [u16; 3]| Ppm {
            width: 1,
            height: 1,
            is_deep: true,
            samples: samples.iter().flat_map(|sample| sample.to_be_bytes()).collect(),
        };
        assert_eq!(deep([0, 65_535, 257 * 100 + 128]).into_rgb(None).data, [0, 255, 100]);
        // The white of a page in HLG, with 16 bits and with eight.
        let map = ToneMap::new(Transfer::Hlg);
        let shallow = Ppm { width: 1, height: 1, is_deep: false, samples: vec![191; 3] };
        let (deep, shallow) =
            (deep([49_151; 3]).into_rgb(Some(&map)), shallow.into_rgb(Some(&map)));
        assert!(deep.data[0].abs_diff(shallow.data[0]) <= 1, "{deep:?} {shallow:?}");
        assert!((225..235).contains(&deep.data[0]), "{deep:?}");
    }

    #[test]
    fn streams_of_high_range_are_recognised() {
        let stream = |what: &str| format!("  Stream #0:0[0x1](und): Video: hevc (Main 10), {what}");
        let of = |what: &str| high_range(&stream(what));
        assert_eq!(of("yuv420p10le(tv, bt2020nc/bt2020/arib-std-b67), 8x8"), Some(Transfer::Hlg));
        assert_eq!(of("yuv420p10le(tv, bt2020nc/bt2020/smpte2084), 8x8"), Some(Transfer::Pq));
        assert_eq!(of("yuv420p10le(tv, bt709), 8x8"), None);
        assert_eq!(high_range("    title  : Stream #0:0: Video: smpte2084"), None);
    }
}
