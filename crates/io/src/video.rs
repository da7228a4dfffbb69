//! Pictures of a video, decoded by the `ffmpeg` program.
//!
//! ffmpeg turns each picture as the file says, stretches it where its pixels are not square, and
//! writes it as a PPM to a pipe; its filter `showinfo` tells the time of each, so that variable
//! rates are respected. When the recording began, in whole seconds, is read from the file's
//! metadata; its sound is there too.

use std::collections::{BTreeMap, VecDeque};
use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use crate::exif::seconds_of_date;
pub use crate::gopro::is_stabilised;
use crate::images::has_extension;
use crate::pixels::{Allowed, MAX_PIXELS};
use crate::regular::require_regular_file;
use crate::{Error, Result, Rgb};

/// Names of files with these endings, in any case, are taken for videos.
const VIDEO_EXTENSIONS: [&str; 8] = ["mp4", "mov", "m4v", "mkv", "avi", "mts", "m2ts", "webm"];
/// Lines of ffmpeg's that an error quotes.
const QUOTED_LINES: usize = 3;
/// Pixels that are not square are made so by stretching the side that they are too short along;
/// then the time is told.
const FILTERS: &str = "scale=w='iw*max(sar,1)':h='ih/min(sar,1)',setsar=1,showinfo";
/// ffmpeg took `-vsync` for what it calls `-fps_mode` since 5.1.
const FIRST_WITH_FPS_MODE: (u32, u32) = (5, 1);

/// Whether a file is taken for a video, by its name.
pub fn is_video(path: &Path) -> bool {
    has_extension(path, &VIDEO_EXTENSIONS)
}

/// One recording by one camera: files that follow each other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recording {
    /// The stem of its first file's name, as the folder of its frames can be called: without white
    /// space around it, and with `_` for control characters and for a point at its beginning.
    pub name: String,
    /// Its files, the first one first.
    pub chapters: Vec<PathBuf>,
}

/// Joins the chapters into which an action camera cuts its recordings: `GH010042.MP4`,
/// `GH020042.MP4` and so on, or `GOPR0042.MP4`, `GP010042.MP4` of older ones, in the same folder.
/// Every other file is a recording of its own.
pub fn recordings(files: &[PathBuf]) -> Vec<Recording> {
    let mut chapters: BTreeMap<(PathBuf, String), BTreeMap<u32, PathBuf>> = BTreeMap::new();
    let mut order = Vec::new();
    for (index, file) in files.iter().enumerate() {
        let folder = file.parent().map(Path::to_owned).unwrap_or_default();
        // What is no chapter has a key of its own.
        let (recording, chapter) = chapter_of(file).unwrap_or_else(|| (format!("#{index}"), 0));
        let key = (folder, recording);
        if !order.contains(&key) {
            order.push(key.clone());
        }
        chapters.entry(key).or_default().insert(chapter, file.clone());
    }
    let name_of =
        |file: &PathBuf| file.file_stem().map(|stem| folder_name(&stem.to_string_lossy()));
    order
        .iter()
        .filter_map(|key| {
            let chapters: Vec<PathBuf> = chapters.get(key)?.values().cloned().collect();
            Some(Recording { name: chapters.first().and_then(name_of)?, chapters })
        })
        .collect()
}

/// A name that images may begin with. A folder that begins with a point would be hidden.
fn folder_name(stem: &str) -> String {
    let name: String = stem.trim().chars().map(|c| if c.is_control() { '_' } else { c }).collect();
    match name.strip_prefix('.') {
        Some(rest) => format!("_{rest}"),
        None if name.is_empty() => "_".to_owned(),
        None => name,
    }
}

/// Which recording a file belongs to, and its place in it.
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

/// A picture of a video.
#[derive(Clone, Debug)]
pub struct VideoFrame {
    /// When it was taken, in seconds since the video began.
    pub time_s: f64,
    /// The picture, as it is seen.
    pub image: Rgb,
}

/// What ffmpeg tells beside the pictures.
enum Told {
    /// When the recording began, in seconds since 1970.
    Created(f64),
    /// When the next picture was taken.
    Time(f64),
}

/// Reads the pictures of a video file, one after the other.
#[derive(Debug)]
pub struct VideoReader {
    path: PathBuf,
    child: Child,
    pictures: BufReader<ChildStdout>,
    told: Receiver<Told>,
    /// Ends with ffmpeg's last lines.
    listener: Option<JoinHandle<VecDeque<String>>>,
    created_s: Option<f64>,
    count: usize,
}

impl VideoReader {
    /// Starts ffmpeg on a file.
    pub fn open(path: &Path) -> Result<Self> {
        require_regular_file(path)?;
        // ffmpeg's own words for this are many.
        std::fs::File::open(path).map_err(Error::io(path))?;
        let passthrough = if version(path)? >= FIRST_WITH_FPS_MODE {
            ["-fps_mode", "passthrough"]
        } else {
            ["-vsync", "0"]
        };
        let mut child = ffmpeg()
            .args(["-nostdin", "-hide_banner", "-loglevel", "info", "-nostats", "-i"])
            .arg(input(path))
            .args(["-map", "0:v:0", "-vf", FILTERS])
            .args(passthrough)
            .args(["-f", "image2pipe", "-c:v", "ppm", "-"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(missing(path))?;
        let (Some(pictures), Some(log)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(Error::content(path, "the pipes of ffmpeg could not be opened"));
        };
        let (tell, told) = channel();
        let listener = Some(std::thread::spawn(move || listen(BufReader::new(log), &tell)));
        Ok(Self {
            path: path.to_owned(),
            child,
            pictures: BufReader::new(pictures),
            told,
            listener,
            created_s: None,
            count: 0,
        })
    }

    /// When the recording began by the camera's clock, in seconds since 1970, where the file says
    /// it (in whole seconds); known once a picture was read.
    pub fn created_s(&self) -> Option<f64> {
        self.created_s
    }

    /// The next picture; `None` after the last one. A file that breaks off gives what comes before.
    pub fn next_frame(&mut self) -> Result<Option<VideoFrame>> {
        let image = match read_ppm(&mut self.pictures).map_err(Error::io(&self.path))? {
            Some((width, height, data)) => Rgb { width, height, data },
            None if self.count > 0 => return Ok(None),
            None => return Err(self.nothing()),
        };
        self.count += 1;
        loop {
            match self.told.recv() {
                Ok(Told::Created(seconds)) => self.created_s = self.created_s.or(Some(seconds)),
                Ok(Told::Time(time_s)) => return Ok(Some(VideoFrame { time_s, image })),
                Err(_) => {
                    let what = format!("ffmpeg does not tell the time of picture {}", self.count);
                    return Err(Error::content(&self.path, what));
                }
            }
        }
    }

    /// Why there is no picture at all, in ffmpeg's words.
    fn nothing(&mut self) -> Error {
        let lines =
            self.listener.take().and_then(|listener| listener.join().ok()).unwrap_or_default();
        let said: Vec<String> = lines.into();
        Error::content(
            &self.path,
            format!("no video could be read from it; ffmpeg says: {}", said.join("; ")),
        )
    }
}

impl Drop for VideoReader {
    fn drop(&mut self) {
        // It may have ended long ago.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The sound of a video file in one channel at a rate, from when its pictures begin; empty where it
/// has none.
pub fn read_sound(path: &Path, rate_hz: u32) -> Result<Vec<i16>> {
    require_regular_file(path)?;
    let done = ffmpeg()
        .args(["-nostdin", "-v", "error", "-i"])
        .arg(input(path))
        // Silence takes the place of what is missing, so that the sound keeps time with the
        // pictures.
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
        .map_err(missing(path))?;
    // Without a track of sound there is nothing to write, which ffmpeg calls an error.
    Ok(done.stdout.chunks_exact(2).map(|bytes| i16::from_le_bytes([bytes[0], bytes[1]])).collect())
}

/// The program. Ctrl-C on a terminal goes to this process and not to ffmpeg: a stream that ffmpeg
/// broke off would pass for the whole video. ffmpeg ends when nobody reads its pipe any more.
fn ffmpeg() -> Command {
    let mut command = Command::new("ffmpeg");
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
}

/// A file as ffmpeg takes it for one, whatever its name: `12:30.mp4` alone would be a protocol, and
/// `-x.mp4` an option.
fn input(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

fn missing(video: &Path) -> impl FnOnce(std::io::Error) -> Error {
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

/// The version of ffmpeg. One built from its repository, which has no number, is newer than any
/// that matters here.
fn version(video: &Path) -> Result<(u32, u32)> {
    let said = ffmpeg().arg("-version").stdin(Stdio::null()).output().map_err(missing(video))?;
    Ok(parse_version(&String::from_utf8_lossy(&said.stdout)).unwrap_or((u32::MAX, 0)))
}

fn parse_version(said: &str) -> Option<(u32, u32)> {
    let mut numbers = said.strip_prefix("ffmpeg version ")?.split(|c: char| !c.is_ascii_digit());
    Some((numbers.next()?.parse().ok()?, numbers.next()?.parse().unwrap_or(0)))
}

/// Sends on what matters; returns the last lines of the rest.
fn listen(log: impl BufRead, tell: &Sender<Told>) -> VecDeque<String> {
    let mut last = VecDeque::new();
    for line in log.split(b'\n').map_while(|line| line.ok()) {
        let line = String::from_utf8_lossy(&line);
        let told = match told(&line) {
            Some(told) => told,
            None => {
                last.push_back(line.trim().to_owned());
                if last.len() > QUOTED_LINES {
                    last.pop_front();
                }
                continue;
            }
        };
        // Nobody listens any more: the pipe is still to be emptied.
        let _ = tell.send(told);
    }
    last
}

fn told(line: &str) -> Option<Told> {
    if let Some((_, rest)) = line.split_once(" pts_time:") {
        let time_s = rest
            .split_whitespace()
            .next()?
            .parse()
            .ok()
            .filter(|time_s: &f64| time_s.is_finite())?;
        return line.contains("showinfo").then_some(Told::Time(time_s));
    }
    let (key, value) = line.split_once(':')?;
    if key.trim() != "creation_time" {
        return None;
    }
    let date = value.trim().split(['.', 'Z']).next()?;
    // Cameras whose clock was never set say 1904 or 1970.
    seconds_of_date(date).filter(|seconds| *seconds > 0.0).map(Told::Created)
}

/// A picture of a stream of PPMs: width, height and bytes; `None` at its end, also where it breaks
/// off.
fn read_ppm(stream: &mut impl BufRead) -> std::io::Result<Option<(u32, u32, Vec<u8>)>> {
    let broken =
        || std::io::Error::new(std::io::ErrorKind::InvalidData, "ffmpeg gave no PPM picture");
    let mut words = Vec::new();
    for _ in 0..3 {
        let mut line = Vec::new();
        if stream.read_until(b'\n', &mut line)? == 0 {
            return if words.is_empty() { Ok(None) } else { Err(broken()) };
        }
        words.extend(String::from_utf8_lossy(&line).split_whitespace().map(str::to_owned));
    }
    let [kind, width, height, depth] = &words[..] else { return Err(broken()) };
    let (Ok(width), Ok(height)) = (width.parse::<u32>(), height.parse::<u32>()) else {
        return Err(broken());
    };
    if kind != "P6" || depth != "255" {
        return Err(broken());
    }
    // A stream that lies about its size makes ffmpeg write just that.
    let allowed = Allowed::Pixels(MAX_PIXELS).check(width, height);
    allowed.map_err(|what| std::io::Error::new(std::io::ErrorKind::InvalidData, what))?;
    let length = 3 * u64::from(width) * u64::from(height);
    let mut data = Vec::new();
    stream.take(length).read_to_end(&mut data)?;
    Ok((data.len() as u64 == length).then_some((width, height, data)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(files: &[&str]) -> Vec<(String, usize)> {
        let files: Vec<PathBuf> = files.iter().map(PathBuf::from).collect();
        recordings(&files).into_iter().map(|r| (r.name, r.chapters.len())).collect()
    }

    #[test]
    fn chapters_are_joined_and_other_files_are_not() {
        let of = |name: &str, chapters| (name.to_owned(), chapters);
        assert_eq!(
            names(&["a/GH020042.MP4", "a/GH010042.MP4", "b/GH010042.MP4", "a/GH010043.MP4"]),
            [of("GH010042", 2), of("GH010042", 1), of("GH010043", 1)]
        );
        assert_eq!(names(&["GOPR0007.mp4", "GP010007.mp4"]), [of("GOPR0007", 2)]);
        assert_eq!(names(&["left.mp4", "right.mp4", "IMG_0042.MOV", "DJI_0042.MP4"]).len(), 4);
        let files = [PathBuf::from("GX020042.MP4"), PathBuf::from("GX010042.MP4")];
        assert_eq!(recordings(&files)[0].chapters, [files[1].clone(), files[0].clone()]);
    }

    #[test]
    fn recordings_are_called_as_folders_can_be() {
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
    fn what_ffmpeg_says_is_understood() {
        let line =
            "[Parsed_showinfo_0 @ 0x55] n:   3 pts:   1536 pts_time:0.1 duration: 512 fmt:yuv420p";
        assert!(matches!(told(line), Some(Told::Time(time_s)) if time_s == 0.1));
        let line = "    creation_time   : 2024-02-29T12:34:56.000000Z";
        // `date -u -d '2024-02-29 12:34:56' +%s`
        assert!(matches!(told(line), Some(Told::Created(seconds)) if seconds == 1_709_210_096.0));
        for line in [
            "creation_time : 1904-01-01T00:00:00.000000Z",
            "x pts_time:NOPTS showinfo",
            "title : 5",
            "",
        ] {
            assert!(told(line).is_none(), "{line}");
        }
        assert_eq!(parse_version("ffmpeg version 5.1.9-0+deb12u1 Copyright"), Some((5, 1)));
        assert_eq!(parse_version("ffmpeg version n7.0 Copyright"), None);
        assert_eq!(parse_version("ffmpeg version 4.4.2-0ubuntu0.22.04.1"), Some((4, 4)));
    }

    #[test]
    fn pictures_come_one_by_one_and_a_torn_one_is_the_end() {
        let mut bytes = b"P6\n2 1\n255\nabcdefP6\n1 1\n255\nxyzP6\n9 9\n255\ntoo little".as_slice();
        assert_eq!(read_ppm(&mut bytes).unwrap(), Some((2, 1, b"abcdef".to_vec())));
        assert_eq!(read_ppm(&mut bytes).unwrap(), Some((1, 1, b"xyz".to_vec())));
        assert_eq!(read_ppm(&mut bytes).unwrap(), None);
        assert!(read_ppm(&mut b"P5\n1 1\n255\nx".as_slice()).is_err());
        assert!(read_ppm(&mut b"P6\n-1 1\n255\nx".as_slice()).is_err());
    }
}
