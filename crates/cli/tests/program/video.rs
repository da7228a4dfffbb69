//! Videos as input. Tests that need ffmpeg are skipped without it.

use std::fs;
use std::path::Path;
use std::process::Command;

use tiepoint_pipeline::io::database::Database;
use tiepoint_pipeline::sfm::scene::Place;

use crate::skipped::skipped;
use crate::{Run, photos, tiepoint_in};

/// `date -u -d '2024-02-29 12:34:56' +%s`
const CREATED_S: f64 = 1_709_210_096.0;
const RATE_HZ: usize = 10;
/// A time base of milliseconds is the coarsest in use.
const TIME_TOLERANCE_S: f64 = 1e-3;

/// Whether ffmpeg is installed; without it, reports the calling test as skipped.
fn has_ffmpeg() -> bool {
    let there = Command::new("ffmpeg").arg("-version").output().is_ok();
    if !there {
        skipped("the program ffmpeg");
    }
    there
}

/// Writes a video of the corner of a room. After moving over all photos, the camera stands still
/// for the same time.
fn film(dir: &Path, name: &str, photos: usize) {
    let frames = dir.join("frames-of-film");
    fs::create_dir(&frames).unwrap();
    for index in 0..2 * photos {
        photos::photo(index.min(photos - 1), 3)
            .save(frames.join(format!("{index:03}.png")))
            .unwrap();
    }
    let made = Command::new("ffmpeg")
        .args(["-v", "error", "-framerate", &RATE_HZ.to_string(), "-i"])
        .arg(frames.join("%03d.png"))
        .args(["-metadata", "creation_time=2024-02-29T12:34:56Z", "-c:v", "mjpeg", "-q:v", "2"])
        .arg(dir.join(name))
        .status();
    assert!(made.unwrap().success());
    fs::remove_dir_all(frames).unwrap();
}

fn times(workspace: &Path) -> Vec<(String, f64)> {
    let text = fs::read_to_string(workspace.join("timestamps.csv")).unwrap();
    let row = |line: &str| {
        let (name, seconds) = line.rsplit_once(',').unwrap();
        (name.to_owned(), seconds.parse().unwrap())
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn a_video_is_a_camera_whose_frames_have_times() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    film(dir.path(), "front.mov", 5);
    let run =
        || -> Run { tiepoint_in(dir.path(), "reconstruct {}/front.mov -o {}/ws --every 1 --json") };
    let report = run().done().json();
    assert_eq!(report["stages"]["features"]["images"], 5, "the stop gave no frames: {report}");
    assert_eq!(report["models"][0]["registered"], 5, "{report}");
    let times = times(&dir.path().join("ws"));
    for (index, (name, seconds)) in times.iter().enumerate() {
        assert_eq!(*name, format!("front/{index:06}.jpg"));
        let expected = CREATED_S + index as f64 / RATE_HZ as f64;
        assert!((seconds - expected).abs() < TIME_TOLERANCE_S, "{seconds} {expected}");
    }
    // No result of the workspace replaces the video.
    let film_before = std::fs::read(dir.path().join("front.mov")).unwrap();
    tiepoint_in(dir.path(), "export {}/ws --to ply -o {}/front.mov --overwrite")
        .failed(1, &["front.mov is read by this command"]);
    assert!(std::fs::read(dir.path().join("front.mov")).unwrap() == film_before);
    // A second run keeps the frames; another --every is an error.
    let events = run().done().events();
    assert!(events.iter().all(|event| event["event"] == "stage_kept"), "{events:?}");
    tiepoint_in(dir.path(), "reconstruct {}/front.mov -o {}/ws --every 2")
        .failed(1, &["frames", "--redo features"]);
    let again =
        tiepoint_in(dir.path(), "features {}/front.mov -o {}/ws --every 2 --redo features --json")
            .done();
    assert_eq!(again.json()["stages"]["features"]["images"], 3);
}

/// Adds a telemetry track as GoPros write it to a video: each tenth of a second a position, further
/// to the north by a ten-thousandth of a degree; that at 0.3 s has no fix.
fn add_telemetry(path: &Path) {
    let numbers =
        |list: &[u32]| -> Vec<u8> { list.iter().flat_map(|number| number.to_be_bytes()).collect() };
    let mp4_box = |name: &[u8], content: &[&[u8]]| {
        let content = content.concat();
        [&numbers(&[8 + content.len() as u32])[..], name, &content].concat()
    };
    let record = |name: &[u8], kind: u8, len: u8, content: &[u8]| {
        let count = (content.len() / usize::from(len)) as u16;
        let mut bytes = [name, &[kind, len], &count.to_be_bytes(), content].concat();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    };
    let position = |index: u32| {
        let fix = if index == 3 { 0 } else { 3 };
        numbers(&[480_000_000 + 1000 * index, 110_000_000, 519_000, 0, 0, 9000, 0, 150 << 16 | fix])
    };
    let scales = numbers(&[10_000_000, 10_000_000, 1000, 1000, 100, 1, 1000, 100, 1]);
    let stream = [
        record(b"TYPE", b'c', 1, b"lllllllSS"),
        record(b"SCAL", b'l', 4, &scales),
        record(b"GPS9", b'?', 32, &(0..10).flat_map(position).collect::<Vec<u8>>()),
    ];
    let payload = record(b"DEVC", 0, 1, &record(b"STRM", 0, 1, &stream.concat()));

    let mut bytes = fs::read(path).unwrap();
    let mut at = 0;
    let size_at = |bytes: &[u8], at: usize| {
        u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
    };
    while &bytes[at + 4..at + 8] != b"moov" {
        at += size_at(&bytes, at);
    }
    let moov = bytes.split_off(at);
    assert_eq!(moov.len(), size_at(&moov, 0), "the last box");
    let offset = at as u32 + 8;
    bytes.extend(mp4_box(b"mdat", &[&payload]));
    let tables = [
        mp4_box(b"stsd", &[&numbers(&[0, 1, 16]), b"gpmd", &numbers(&[0, 1])]),
        mp4_box(b"stts", &[&numbers(&[0, 1, 1, 1000])]),
        mp4_box(b"stsc", &[&numbers(&[0, 1, 1, 1, 1])]),
        mp4_box(b"stsz", &[&numbers(&[0, 0, 1, payload.len() as u32])]),
        mp4_box(b"stco", &[&numbers(&[0, 1, offset])]),
    ];
    let media = [
        mp4_box(b"mdhd", &[&numbers(&[0, 0, 0, 1000, 1000, 0])]),
        mp4_box(b"hdlr", &[&numbers(&[0, 0]), b"meta", &[0; 13]]),
        mp4_box(b"minf", &[&mp4_box(b"stbl", &[&tables.concat()])]),
    ];
    let header = mp4_box(b"tkhd", &[&numbers(&[1, 0, 0, 9, 0, 1000]), &[0; 60]]);
    let track = mp4_box(b"trak", &[&header, &mp4_box(b"mdia", &[&media.concat()])]);
    bytes.extend(mp4_box(b"moov", &[&moov[8..], &track]));
    fs::write(path, bytes).unwrap();
}

#[test]
fn frames_have_the_positions_that_the_camera_recorded() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    film(dir.path(), "front.mov", 5);
    add_telemetry(&dir.path().join("front.mov"));
    let run = |line: &str| tiepoint_in(dir.path(), line).done().stdout();
    let check = |workspace: &str| {
        let path = dir.path().join(workspace).join("database.db");
        let found = Database::open_read_only(&path).unwrap().read_pose_priors().unwrap();
        let indices: Vec<usize> = found.iter().map(|(image, _)| image.index()).collect();
        assert_eq!(indices, [0, 1, 2, 3, 4]);
        for (image, position) in found {
            let Place::Geodetic { latitude_deg, longitude_deg, altitude_m } = position.place else {
                panic!("{position:?}");
            };
            // That at 0.3 s is between its neighbours. The chord is below the arc by 4e-5 m.
            let expected = 48.0 + 1e-4 * image.index() as f64;
            assert!((latitude_deg - expected).abs() < 1e-9, "{latitude_deg} {expected}");
            assert!((longitude_deg - 11.0).abs() < 1e-9, "{longitude_deg}");
            assert!((altitude_m.unwrap() - 519.0).abs() < 1e-3, "{altitude_m:?}");
        }
    };
    let text = run("features {}/front.mov -o {}/ws --every 1");
    assert!(text.contains("5 of 5 photos have a position in their videos"), "{text}");
    check("ws");
    // Frames that are kept keep their positions.
    run("features {}/front.mov -o {}/ws --every 1 --redo features");
    check("ws");
    let off = run("reconstruct {}/front.mov -o {}/off --every 1 --position-priors off");
    assert!(!off.contains("position in"), "{off}");
}

#[test]
fn non_square_pixels_are_resampled() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    film(dir.path(), "front.mov", 3);
    for (name, squeezed) in
        [("narrow.mov", "scale=iw/2:ih,setsar=2/1"), ("low.mov", "scale=iw:ih/2,setsar=1/2")]
    {
        let made = Command::new("ffmpeg")
            .args(["-v", "error", "-i"])
            .arg(dir.path().join("front.mov"))
            .args(["-vf", squeezed, "-c:v", "mjpeg", "-q:v", "2"])
            .arg(dir.path().join(name))
            .status();
        assert!(made.unwrap().success());
        tiepoint_in(dir.path(), &format!("features {{}}/{name} -o {{}}/{name}.ws --every 1"))
            .done();
        let stem = name.split('.').next().unwrap();
        let frame = dir.path().join(format!("{name}.ws/frames/{stem}/000000.jpg"));
        assert_eq!(
            image::image_dimensions(frame).unwrap(),
            (photos::WIDTH, photos::HEIGHT),
            "{name}"
        );
    }
}

/// Runs ffmpeg on the video `from`, with options between input and output.
fn converted(dir: &Path, from: &str, options: &[&str], to: &str) -> bool {
    let made = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(dir.join(from))
        .args(options)
        .arg(dir.join(to))
        .status();
    made.unwrap().success()
}

#[test]
fn more_than_eight_bits_are_read() {
    /// Mean absolute difference of grey values to the film of eight bits, from the rounding of
    /// colours; and least correlation with it after tone mapping, which is no linear function.
    const MAX_DIFFERENCE: f64 = 4.0;
    const MIN_CORRELATION: f64 = 0.9;
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    film(dir.path(), "plain.mov", 3);
    let frames = |stem: &str, note: Option<&str>| -> Vec<f64> {
        let run = tiepoint_in(
            dir.path(),
            &format!("features {{}}/{stem} -o {{}}/{stem}.ws --every 1 --json"),
        );
        let report = run.done().json();
        let notes = report["stages"]["features"]["notes"].to_string();
        match note {
            Some(note) => assert!(notes.contains(note), "{stem}: {notes}"),
            None => assert!(!notes.contains("8 bits"), "{stem}: {notes}"),
        }
        let name = stem.split('.').next().unwrap();
        let frame = dir.path().join(format!("{stem}.ws/frames/{name}/000000.jpg"));
        image::open(frame).unwrap().to_luma8().into_raw().into_iter().map(f64::from).collect()
    };
    let plain = frames("plain.mov", None);
    let format = |name: &'static str| ["-pix_fmt", name];
    let ffv1 = |name| [&format(name)[..], &["-c:v", "ffv1"]].concat();
    let transfer = |name| {
        [
            &["-color_trc", name, "-color_primaries", "bt2020"][..],
            &["-colorspace", "bt2020nc"],
            &ffv1("yuv420p10le"),
        ]
        .concat()
    };
    let prores = [&["-c:v", "prores_ks"][..], &format("yuv422p10le")].concat();
    let scaled = Some("more than 8 bits a channel were scaled");
    for (name, options, note) in [
        ("ten.mkv", ffv1("yuv420p10le"), scaled),
        ("grey.mkv", ffv1("gray10le"), scaled),
        ("sixteen.mkv", ffv1("gray16le"), scaled),
        ("rgb.mkv", ffv1("gbrp12le"), scaled),
        ("prores.mov", prores, scaled),
        ("eight.mkv", ffv1("yuv444p"), None),
        ("hlg.mkv", transfer("arib-std-b67"), Some("(HLG) was tone-mapped")),
        ("pq.mkv", transfer("smpte2084"), Some("(PQ) was tone-mapped")),
    ] {
        assert!(converted(dir.path(), "plain.mov", &options, name), "{name}");
        let found = frames(name, note);
        assert_eq!(found.len(), plain.len(), "{name}");
        if name.starts_with("hlg") || name.starts_with("pq") {
            let correlation = correlation(&found, &plain);
            assert!(correlation > MIN_CORRELATION, "{name}: {correlation}");
        } else {
            let differences = found.iter().zip(&plain).map(|(a, b)| (a - b).abs());
            let mean = differences.sum::<f64>() / plain.len() as f64;
            assert!(mean < MAX_DIFFERENCE, "{name}: {mean}");
        }
    }
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let product = |a: &[f64], mean_a: f64, b: &[f64], mean_b: f64| -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - mean_a) * (b - mean_b)).sum()
    };
    product(a, mean_a, b, mean_b)
        / (product(a, mean_a, a, mean_a) * product(b, mean_b, b, mean_b)).sqrt()
}

#[test]
fn videos_of_a_drive_give_frames_of_the_same_times() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    film(dir.path(), "left.mov", 9);
    // The right camera saw some frames sharper than the left one.
    let blurred = "gblur=sigma=2:enable='lt(n,9)*not(mod(n,3))'";
    assert!(converted(dir.path(), "left.mov", &["-vf", blurred, "-q:v", "2"], "right.mov"));
    let of = |run: &str, side: &str| -> Vec<f64> {
        let times = times(&dir.path().join(run));
        let of_side = times.iter().filter(|(name, _)| name.starts_with(side));
        of_side.map(|(_, time_s)| time_s - CREATED_S).collect()
    };
    let features = |options: &str, run: &str| -> String {
        let command =
            format!("features {{}}/left.mov {{}}/right.mov -o {{}}/{run} {options} --json");
        tiepoint_in(dir.path(), &command).done().json()["stages"]["features"]["notes"].to_string()
    };
    // At 10 Hz a frame is a stretch, and all that move are taken.
    let notes = features("", "all");
    assert_eq!(of("all", "left").len(), 9, "{notes}");
    assert_eq!(of("all", "left"), of("all", "right"));
    assert!(notes.contains("left: 9 of 18 frames taken") && notes.contains("--every 1"), "{notes}");
    features("--every 3", "third");
    assert!(of("third", "left").len() < 5, "{:?}", of("third", "left"));
    assert_eq!(of("third", "left"), of("third", "right"));
    // Cameras of other rates: the nearest frames, at most half an interval of the second away.
    for (name, rate_hz) in [("slow.mov", 8.0), ("fast.mov", 30.0)] {
        let rate = format!("fps={rate_hz}");
        let options = ["-vf", rate.as_str(), "-q:v", "2", "-map_metadata", "-1"];
        assert!(converted(dir.path(), "left.mov", &options, name));
        tiepoint_in(dir.path(), &format!("features {{}}/left.mov {{}}/{name} -o {{}}/{name}.ws"))
            .done();
        let run = format!("{name}.ws");
        let (left, other) = (of(&run, "left"), of(&run, name.split('.').next().unwrap()));
        for time_s in &left {
            let nearest = other.iter().map(|other| (other - time_s).abs()).fold(1.0, f64::min);
            assert!(nearest <= 0.5 / rate_hz + TIME_TOLERANCE_S, "{name}: {left:?} {other:?}");
        }
        assert!(other.len() <= left.len() + 1, "{name}: {left:?} {other:?}");
    }
}

/// Writes eight seconds of knocks at irregular times, starting at `from_s`, as a mono WAV file.
fn knocks(path: &Path, from_s: f64) {
    const RATE: u32 = 8000;
    const SECONDS: u32 = 8;
    let at_s = [0.7, 1.1, 2.3, 2.45, 3.9, 4.8, 5.05, 6.6, 7.2, 7.9, 8.15];
    let value = |k: u32| {
        let time_s = from_s + f64::from(k) / f64::from(RATE);
        let since = at_s.iter().map(|at_s| time_s - at_s).filter(|since_s| *since_s >= 0.0);
        let knock: f64 =
            since.map(|since_s| (-since_s / 0.02).exp() * (3000.0 * since_s).sin()).sum();
        // Independent noise.
        let hiss = f64::from(k.wrapping_mul(0x9E37_79B9) ^ (from_s * 1e3) as u32)
            / f64::from(u32::MAX)
            - 0.5;
        (20_000.0 * knock + 200.0 * hiss) as i16
    };
    let samples: Vec<u8> = (0..RATE * SECONDS).flat_map(|k| value(k).to_le_bytes()).collect();
    let mut bytes = b"RIFF".to_vec();
    bytes.extend((36 + samples.len() as u32).to_le_bytes());
    bytes.extend(b"WAVEfmt \x10\0\0\0\x01\0\x01\0");
    bytes.extend(RATE.to_le_bytes());
    bytes.extend((2 * RATE).to_le_bytes());
    bytes.extend(b"\x02\0\x10\0data");
    bytes.extend((samples.len() as u32).to_le_bytes());
    bytes.extend(samples);
    fs::write(path, bytes).unwrap();
}

/// Writes a video with a soundtrack of knocks; its last frame is repeated to the length of the
/// soundtrack.
fn with_sound(dir: &Path, name: &str, from_s: f64) {
    film(dir, "silent.mov", 5);
    knocks(&dir.join("knocks.wav"), from_s);
    let made = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(dir.join("silent.mov"))
        .arg("-i")
        .arg(dir.join("knocks.wav"))
        .args([
            "-vf",
            "tpad=stop_mode=clone:stop_duration=7",
            "-c:v",
            "mjpeg",
            "-q:v",
            "2",
            "-c:a",
            "pcm_s16le",
        ])
        .arg(dir.join(name))
        .status();
    assert!(made.unwrap().success());
    fs::remove_file(dir.join("silent.mov")).unwrap();
}

#[test]
fn audio_offset_synchronises_frames() {
    // Sound travels 1.7 m in this time.
    const SOUND_TOLERANCE_S: f64 = 0.005;
    const LATER_S: f64 = 0.23;
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    with_sound(dir.path(), "left.mov", 0.0);
    with_sound(dir.path(), "right.mov", LATER_S);
    let run =
        tiepoint_in(dir.path(), "features {}/left.mov {}/right.mov -o {}/ws --every 1 --json")
            .done();
    let heard = run.events().into_iter().find(|event| event["event"] == "audio_offset").unwrap();
    assert_eq!((&heard["reference"], &heard["recording"]), (&"left".into(), &"right".into()));
    assert!((heard["after_s"].as_f64().unwrap() - LATER_S).abs() < SOUND_TOLERANCE_S, "{heard}");
    let times = times(&dir.path().join("ws"));
    let of = |side: &str| -> Vec<f64> {
        times.iter().filter(|(name, _)| name.starts_with(side)).map(|(_, time_s)| *time_s).collect()
    };
    let (left, right) = (of("left"), of("right"));
    assert_eq!(left.len(), 5, "{times:?}");
    // At 0.2, 0.3 and 0.4 s; the right camera had not started at the earlier left frames.
    for (index, time_s) in right.iter().take(3).enumerate() {
        let partner_s = left[index + 2];
        assert!((time_s - partner_s).abs() <= 0.5 / RATE_HZ as f64, "{times:?}");
    }
}

#[test]
fn chapters_are_concatenated() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    film(dir.path(), "GX010042.mov", 4);
    fs::copy(dir.path().join("GX010042.mov"), dir.path().join("GX020042.mov")).unwrap();
    let report = tiepoint_in(dir.path(), "features {} -o {}/ws --every 1 --json").done().json();
    // The second chapter starts at the first photo again, so that all of its four frames differ.
    assert_eq!(report["stages"]["features"]["images"], 8, "{report}");
    let times = times(&dir.path().join("ws"));
    assert_eq!(times[4].0, "GX010042/000008.jpg");
    assert!((times[4].1 - CREATED_S - 0.8).abs() < TIME_TOLERANCE_S, "{times:?}");
}

#[test]
fn file_names_are_not_interpreted_by_ffmpeg() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    with_sound(dir.path(), "plain.mov", 0.0);
    for name in ["12:30.mov", "-x.mov", "a\nb.mov"] {
        fs::copy(dir.path().join("plain.mov"), dir.path().join(name)).unwrap();
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
    command.args([
        "features",
        "-o",
        "ws",
        "--every",
        "1",
        "--json",
        "--",
        "12:30.mov",
        "-x.mov",
        "a\nb.mov",
    ]);
    let run = Run(command.current_dir(dir.path()).output().unwrap()).done();
    let heard: Vec<_> =
        run.events().into_iter().filter(|event| event["event"] == "audio_offset").collect();
    let recordings: Vec<&str> =
        heard.iter().map(|heard| heard["recording"].as_str().unwrap()).collect();
    assert_eq!(recordings, ["-x", "a_b"], "their sound is read too");
    for folder in ["12:30", "-x", "a_b"] {
        assert!(dir.path().join("ws/frames").join(folder).join("000000.jpg").is_file(), "{folder}");
    }
}

#[test]
#[cfg(unix)]
fn interrupted_video_is_not_complete() {
    use std::os::unix::process::CommandExt;
    use std::process::Stdio;
    use std::time::Duration;
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let made = Command::new("ffmpeg")
        .args([
            "-v",
            "error",
            "-f",
            "lavfi",
            "-i",
            "testsrc2=size=640x480:rate=30:duration=20",
            "-c:v",
            "mjpeg",
        ])
        .arg(dir.path().join("a.mov"))
        .status();
    assert!(made.unwrap().success());
    let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
    command.args(["features", "a.mov", "-o", "ws"]).current_dir(dir.path());
    command.process_group(0).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    // Frames are staged until all are extracted.
    let frames =
        || fs::read_dir(dir.path().join("ws/frames/.tiepoint-new/a")).map_or(0, Iterator::count);
    while frames() < 2 {
        assert!(child.try_wait().unwrap().is_none(), "it ended before there were frames");
        std::thread::sleep(Duration::from_millis(5));
    }
    // A terminal sends the signal to the whole group.
    let kill = Command::new("kill").args(["-INT", "--", &format!("-{}", child.id())]).status();
    assert!(kill.unwrap().success());
    Run(child.wait_with_output().unwrap()).failed(130, &["stopped by SIGINT"]);
    assert!(!dir.path().join("ws/frames/videos.json").exists(), "the frames are not all there");
}

#[test]
fn invalid_videos_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("words.mp4"), "these are words").unwrap();
    let reason = if has_ffmpeg() { "no video could be read" } else { "needs the program ffmpeg" };
    tiepoint_in(dir.path(), "features {}/words.mp4 -o {}/ws").failed(1, &["words.mp4", reason]);
    tiepoint_in(dir.path(), "features {}/none.mp4 -o {}/ws")
        .failed(1, &["none.mp4", "No such file"]);
}

/// What the report notes on a video of which all frames are taken.
fn notes_on(dir: &Path, video: &str) -> String {
    let line = format!("features {{}}/{video} -o {{}}/{video}.ws --every 1 --json");
    tiepoint_in(dir, &line).done().json()["stages"]["features"]["notes"].to_string()
}

#[test]
fn the_missing_end_of_a_video_is_named() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    film(dir, "front.mov", 5);
    // The header is before the frames, as cameras that stream write it, and states 20 s.
    let slow = ["-vf", "setpts=20*PTS", "-c:v", "mjpeg", "-q:v", "2", "-movflags", "+faststart"];
    assert!(converted(dir, "front.mov", &slow, "whole.mov"));
    let bytes = fs::read(dir.join("whole.mov")).unwrap();
    fs::write(dir.join("cut.mov"), &bytes[..bytes.len() / 2]).unwrap();
    let notes = |name: &str| notes_on(dir, name);
    let whole = notes("whole.mov");
    assert!(!whole.contains("may lack its end"), "{whole}");
    let cut = notes("cut.mov");
    assert!(cut.contains("cut.mov: the frames that can be read end at"), "{cut}");
}

#[test]
fn photos_beside_a_video_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    fs::write(dir.path().join("a.mp4"), "").unwrap();
    tiepoint_in(dir.path(), "features {}/photos {}/a.mp4 -o {}/ws")
        .failed(1, &["photos", "a.mp4", "not both"]);
    assert!(!dir.path().join("ws").exists(), "nothing was begun");
}

#[test]
fn missing_ffmpeg_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("a.mp4"), "x").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
    command.args(["features", "a.mp4", "-o", "ws"]).current_dir(dir.path()).env("PATH", dir.path());
    Run(command.output().unwrap()).failed(1, &["a.mp4", "needs the program ffmpeg", "install it"]);
}

#[test]
fn interlaced_video_is_deinterlaced_and_a_second_stream_is_named() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    film(dir, "front.mov", 4);
    // Two pictures become the two fields of a frame; MPEG-2 says so.
    let fields = ["-vf", "interlace=scan=tff:lowpass=off", "-c:v", "mpeg2video", "-q:v", "2"];
    let fields = [&fields[..], &["-flags", "+ilme+ildct", "-r", "25"]].concat();
    assert!(converted(dir, "front.mov", &fields, "fields.mpg.mkv"));
    let two = ["-map", "0:v:0", "-map", "0:v:0", "-c", "copy"];
    assert!(converted(dir, "front.mov", &two, "two.mov"));
    let notes = |name: &str| notes_on(dir, name);
    assert!(notes("fields.mpg.mkv").contains("interlaced video was deinterlaced"));
    assert!(notes("two.mov").contains("the first of 2 video streams is read"));
    let plain = notes("front.mov");
    assert!(!plain.contains("interlaced") && !plain.contains("streams"), "{plain}");
}
