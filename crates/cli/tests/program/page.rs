//! `report.html` in a browser. The test is skipped without Chromium.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::Duration;

use serde_json::Value;

use crate::skipped::skipped;
use crate::{photos, tiepoint_in};

const COUNT: usize = 5;
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];
/// What the browser prints before the result.
const RESULT: &str = "RESULT ";
/// A browser on a busy machine takes a few seconds.
const PATIENCE: Duration = Duration::from_secs(90);
/// Collects all that goes wrong in the page.
const WATCH: &str = "<script>
    const problems = [];
    addEventListener('error', event => problems.push(event.message));
    addEventListener('unhandledrejection', event => problems.push(String(event.reason)));
    addEventListener('securitypolicyviolation', event => problems.push(event.blockedURI));
    console.error = console.warn = (...words) => problems.push(words.join(' '));
    </script>";
const SCRIPT: &str = include_str!("page.js");

/// A running browser, which ends with it.
struct Browser(Child);

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Opens a page without a window and with graphics in software; `None` if there is no browser.
fn open(page: &Path, profile: &Path) -> Option<Browser> {
    BROWSERS.iter().find_map(|name| {
        let child = Command::new(name)
            .args(["--headless", "--no-sandbox", "--no-first-run", "--enable-logging=stderr"])
            .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
            .args(["--disable-background-networking", "--disable-component-update"])
            .args(["--disable-sync", "--disable-extensions", "--window-size=1200,900"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg(format!("file://{}", page.display()))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        child.ok().map(Browser)
    })
}

/// The result that the script in a page prints to the console; `None` without a browser.
fn result(page: &Path, profile: &Path) -> Option<Value> {
    let mut browser = open(page, profile)?;
    let stderr = BufReader::new(browser.0.stderr.take().unwrap());
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        for line in stderr.lines().map_while(Result::ok) {
            if let Some((_, found)) = line.split_once(RESULT) {
                let _ = sender.send(found.to_owned());
            }
        }
    });
    let line = receiver.recv_timeout(PATIENCE).expect("the page's script came to its end");
    // The console adds quotes and the place in the source.
    let mut values = serde_json::Deserializer::from_str(&line).into_iter();
    values.next().map(|value| value.expect("the script prints JSON"))
}

#[test]
fn a_browser_draws_the_page_and_shows_the_photo_of_a_clicked_camera() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), COUNT, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    tiepoint_in(dir, "view {}/ws").done();
    let html = fs::read_to_string(dir.join("ws/report.html")).unwrap();
    let page = dir.join("page.html");
    let watched = html.replacen("<style>", &format!("{WATCH}<style>"), 1);
    fs::write(&page, watched + &format!("<script>{SCRIPT}</script>")).unwrap();
    let Some(found) = result(&page, &dir.join("profile")) else {
        skipped("the program chromium");
        return;
    };
    assert_eq!(found["problems"], serde_json::json!([]));
    let report: Value =
        serde_json::from_slice(&fs::read(dir.join("ws/report.json")).unwrap()).unwrap();
    assert_eq!(found["points"], report["models"][0]["points"], "all points are drawn");
    assert!(found["lit"].as_u64() > Some(500), "{found}");
    assert!(found["red"].as_u64() > Some(100), "frusta: {found}");
    // Some keypoints have a point, others do not; between them is the photo.
    assert_eq!(found["photo"], found["image"]);
    assert!(found["text"].as_str().unwrap().contains("keypoints with a point"), "{found}");
    assert!(!found["text"].as_str().unwrap().contains("no photo"), "{found}");
    assert!(found["colours"].as_u64() > Some(500), "{found}");
    assert!(found["green"].as_u64() > Some(100), "{found}");
    assert!(found["orange"].as_u64() > Some(100), "{found}");
    for word in
        ["isOpen", "isMarked", "hoveredNothing", "hasMoved", "fewest", "all", "turns", "zooms"]
    {
        assert_eq!(found[word], true, "{word}: {found}");
    }
    assert!(found["eye"].as_f64().unwrap() < 1e-6, "looks through the camera: {found}");
    for wrong in ["unnamed", "misnamed", "skipping"] {
        assert_eq!(found[wrong], serde_json::json!([]), "{wrong}");
    }
    assert_eq!(found["legend"], format!("camera 1: {COUNT} images"));
    assert!(found["bar"].as_str().unwrap().contains(" unit"), "{found}");
    let axes = ["axes", "ticks"].map(|name| found[name].as_array().unwrap().clone()).concat();
    assert!(axes.len() > 13, "{found}");
    for axis in axes {
        let labels: Vec<&str> =
            axis.as_array().unwrap().iter().map(|label| label.as_str().unwrap()).collect();
        let mut distinct = labels.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), labels.len(), "{labels:?}");
        assert!((2..=8).contains(&labels.len()), "{labels:?}");
        assert!(labels.iter().all(|label| label.len() <= 8), "{labels:?}");
    }
}
