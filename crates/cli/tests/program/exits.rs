//! Exit of the program: unwritable results, and signals.

#![cfg(unix)]

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use crate::{Run, photos, tiepoint, tiepoint_in};

/// Time limit for the exit after a signal.
const LIMIT: Duration = Duration::from_secs(2);
/// Polling interval.
const NAP: Duration = Duration::from_millis(10);
/// Number of images: more than a machine renders before the signal.
const MANY: usize = 500;

fn program(dir: &Path, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tiepoint"));
    command.args(line.split_whitespace()).current_dir(dir);
    command
}

#[test]
#[cfg(target_os = "linux")]
fn a_result_that_cannot_be_written_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("bal.txt"), "0 0 0\n").unwrap();
    let full = |line: &str| {
        let stdout = File::options().write(true).open("/dev/full").unwrap();
        Run(program(dir.path(), line).stdout(stdout).output().unwrap())
    };
    for line in ["adjust bal.txt", "--help", "match --help", "--version"] {
        let run = full(line).failed(1, &["cannot write", "to stdout", "No space left"]);
        assert_eq!(run.stderr().lines().count(), 1, "{}", run.stderr());
    }
    let run = full("adjust bal.txt --json");
    assert_eq!(run.code(), 1);
    let events = run.events();
    assert_eq!(events.last().unwrap()["event"], "error", "{events:?}");
    assert!(
        events.last().unwrap()["message"].as_str().unwrap().contains("cannot write the result")
    );
}

#[test]
fn closed_stdout_is_no_error() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("bal.txt"), "0 0 0\n").unwrap();
    for line in ["adjust bal.txt", "adjust bal.txt --json", "--help"] {
        let mut child = program(dir.path(), line)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let run = Run(child.wait_with_output().unwrap()).done();
        assert!(!run.stderr().contains("tiepoint:"), "{}", run.stderr());
    }
}

fn wait_until(child: &mut Child, what: &str, is_so: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before {what}");
        assert!(start.elapsed() < Duration::from_secs(120), "{what} did not come");
        thread::sleep(NAP);
    }
}

/// Sends a signal and waits for the exit within the time limit.
fn stop(child: Child, signal: &str) -> Run {
    let sent = Instant::now();
    let kill = Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status();
    assert!(kill.unwrap().success());
    let run = Run(child.wait_with_output().unwrap());
    let took = sent.elapsed();
    assert!(took < LIMIT, "it took {took:?}: {}", run.stderr());
    run
}

fn spawn(dir: &Path, line: &str) -> Child {
    program(dir, line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

const SAYS: &str = "completed work was kept; give the same command again to resume";

#[test]
fn signal_stops_rendering_and_the_same_command_resumes() {
    let dir = tempfile::tempdir().unwrap();
    let line = |frames| format!("synth -o drive --size 64x48 --frames {frames} --length 1000");
    let images = || fs::read_dir(dir.path().join("drive/left")).map_or(0, Iterator::count);
    for (signal, code) in [("INT", 130), ("TERM", 143)] {
        let before = images();
        let mut child = spawn(dir.path(), &line(MANY));
        wait_until(&mut child, "an image", || images() > before);
        stop(child, signal).failed(code, &[&format!("stopped by SIG{signal}: {SAYS}")]);
    }
    let kept = fs::read_dir(dir.path().join("drive/left")).unwrap().next().unwrap().unwrap().path();
    let before = fs::metadata(&kept).unwrap().modified().unwrap();
    Run(program(dir.path(), &line(MANY)).output().unwrap()).done();
    assert_eq!(fs::metadata(&kept).unwrap().modified().unwrap(), before, "what is there stays");
}

/// Reads the lines of a stream in a thread of its own, so that the program never blocks.
fn drained(
    stream: impl Read + Send + 'static,
) -> (std::sync::mpsc::Receiver<String>, thread::JoinHandle<()>) {
    let (send, lines) = std::sync::mpsc::channel();
    let reader = thread::spawn(move || {
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            send.send(line).unwrap();
        }
    });
    (lines, reader)
}

#[test]
fn a_signal_ends_each_stage_cleanly() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 8, 0);
    let first = "reconstruct photos -o ws --json --threads 1";
    for (line, event, says) in [
        (first, "image_done", SAYS),
        (first, "pair_done", SAYS),
        (first, "image_registered", SAYS),
        ("reconstruct photos -o ws --json --redo map --threads 1", "image_registered", SAYS),
        ("match ws --json --redo match --threads 1", "pair_done", "again without --redo to resume"),
        (
            "reconstruct photos -o ws --json --redo features --threads 1",
            "image_done",
            "again without --redo to resume",
        ),
    ] {
        let mut child = spawn(dir.path(), line);
        let (lines, reader) = drained(child.stderr.take().unwrap());
        let is_it = |line: &String| line.contains(&format!("\"event\":\"{event}\""));
        assert!(lines.iter().any(|line| is_it(&line)), "{line}: no {event}");
        let run = stop(child, "INT");
        reader.join().unwrap();
        assert_eq!((run.code(), run.stdout()), (130, String::new()), "{line}");
        let rest: Vec<String> = lines.iter().collect();
        let errors: Vec<&String> = rest.iter().filter(|line| line.contains("\"error\"")).collect();
        assert_eq!(errors.len(), 1, "{rest:?}");
        assert_eq!(rest.last(), Some(errors[0]));
        let error: serde_json::Value = serde_json::from_str(errors[0]).unwrap();
        let message = error["message"].as_str().unwrap();
        assert!(message.starts_with("stopped by SIGINT: ") && message.contains(says), "{message}");
    }
    let report = tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/ws --json").done().json();
    assert_eq!(report["models"][0]["registered"], 8, "{report}");
}

#[test]
fn signal_stops_work_without_events() {
    let dir = tempfile::tempdir().unwrap();
    // A street of a hundred kilometres is laid out before the first event.
    let line = "synth -o drive --length 100000 --frames 2 --size 64x48 --scan";
    for (signal, code) in [("INT", 130), ("TERM", 143)] {
        let child = spawn(dir.path(), line);
        // The signal handlers are installed by now.
        thread::sleep(Duration::from_millis(500));
        let run = stop(child, signal).failed(code, &[&format!("stopped by SIG{signal}: {SAYS}")]);
        assert_eq!(run.stderr().matches("stopped by").count(), 1, "{}", run.stderr());
    }
}

#[test]
fn signal_stops_a_run_that_is_blocked_on_stderr() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 2, 0);
    let (mut stderr, reader) = UnixStream::pair().unwrap();
    stderr.set_nonblocking(true).unwrap();
    while stderr.write(&[b'\n'; 1024]).is_ok() {}
    stderr.set_nonblocking(false).unwrap();
    let mut command = program(dir.path(), "features photos -o ws --json");
    let mut child = command.stdout(Stdio::piped()).stderr(OwnedFd::from(stderr)).spawn().unwrap();
    thread::sleep(Duration::from_secs(2));
    assert!(child.try_wait().unwrap().is_none(), "its first event waits for the reader");
    assert_eq!(stop(child, "TERM").code(), 143);
    drop(reader);
}

/// The run blocks on its first event, that the features are kept, until after the signal.
#[test]
fn message_keeps_redo_if_the_stage_has_not_begun() {
    let dir = tempfile::tempdir().unwrap();
    photos::write(&dir.path().join("photos"), 3, 0);
    tiepoint_in(dir.path(), "reconstruct {}/photos -o {}/ws").done();
    let database = fs::read(dir.path().join("ws/database.db")).unwrap();
    let (mut stderr, mut reader) = UnixStream::pair().unwrap();
    stderr.set_nonblocking(true).unwrap();
    while stderr.write(&[b'\n'; 1024]).is_ok() {}
    stderr.set_nonblocking(false).unwrap();
    let mut command = program(dir.path(), "reconstruct photos -o ws --json --redo match");
    let mut child = command.stdout(Stdio::null()).stderr(OwnedFd::from(stderr)).spawn().unwrap();
    drop(command);
    thread::sleep(Duration::from_secs(1));
    assert!(child.try_wait().unwrap().is_none(), "its first event waits for the reader");
    assert!(
        Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success()
    );
    let mut stderr_text = String::new();
    reader.read_to_string(&mut stderr_text).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(
        stderr_text.contains(SAYS) && !stderr_text.contains("without --redo"),
        "{}",
        stderr_text.trim_start()
    );
    assert!(
        fs::read(dir.path().join("ws/database.db")).unwrap() == database,
        "nothing was cleared"
    );
}

#[test]
fn control_characters_do_not_reach_the_terminal() {
    let run =
        tiepoint(["match", "no\u{1b}[31m\nworkspace"]).failed(1, &[r"no\u{1b}[31m\nworkspace"]);
    assert_eq!(run.stderr().lines().count(), 1);
}
