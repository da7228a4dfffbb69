//! The pipeline on downscaled photos: fountain-P11 of Strecha et al. 2008.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use image::imageops::FilterType;
use tiepoint_pipeline::evaluation::{Truth, evaluate_poses};
use tiepoint_pipeline::input::{Calibration, Photos};
use tiepoint_pipeline::sfm::geometry::{CameraModelKind, Intrinsics};
use tiepoint_pipeline::stages::{FeatureOptions, extract_features};
use tiepoint_pipeline::workspace::LocatedModel;
use tiepoint_pipeline::{Error, Event, Options, Report, Stage, Workspace, reconstruct};

use crate::skipped;

/// Downscaling factor: from 3072 x 2048 to 512 x 341; the last two lines are cropped.
const SHRINK: u32 = 6;
/// Full-size photos with known intrinsics give 2.5 mm; a pixel is `SHRINK` times as large here.
const MAX_MEAN_CENTRE_ERROR_M: f64 = 6.0 * 2.5e-3;
/// K.txt of the data set: fx, fy, cx, cy of the full-size photos.
const FULL_SIZE_INTRINSICS: [f64; 4] = [2759.48, 2764.16, 1520.69, 1006.81];

/// Name of a photo in the ground truth, and a small grey version as PNG data.
type Small = (String, Vec<u8>);

/// Small versions of all photos, computed once for all tests.
fn small_photos(data: &Path) -> &'static [Small] {
    static PHOTOS: OnceLock<Vec<Small>> = OnceLock::new();
    PHOTOS.get_or_init(|| {
        let photos = data.join("fountain-P11/images");
        let folder = tiepoint_pipeline::input::ImageFolder::open(&[photos], None).unwrap();
        let shrink = |(index, name): (usize, &str)| {
            let luma = folder.luma(index).unwrap();
            let (width, height) = (luma.width / SHRINK * SHRINK, luma.height / SHRINK * SHRINK);
            let image = image::GrayImage::from_raw(luma.width, luma.height, luma.data).unwrap();
            let image = image::imageops::crop_imm(&image, 0, 0, width, height).to_image();
            let small = image::imageops::resize(
                &image,
                width / SHRINK,
                height / SHRINK,
                FilterType::Triangle,
            );
            let mut png = Cursor::new(Vec::new());
            small.write_to(&mut png, image::ImageFormat::Png).unwrap();
            (name.to_owned(), png.into_inner())
        };
        folder.images().iter().map(|photo| photo.name.as_str()).enumerate().map(shrink).collect()
    })
}

/// Writes the first `count` small photos to `to`.
fn write_photos(data: &Path, count: usize, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for (name, png) in small_photos(data).iter().take(count) {
        fs::write(to.join(name), png).unwrap();
    }
}

/// Options with known intrinsics. (0, 0) is the corner of the first pixel, so that all parameters
/// scale with the photo.
fn calibrated() -> Options {
    let params = FULL_SIZE_INTRINSICS.map(|param| param / f64::from(SHRINK));
    let intrinsics = Intrinsics::new(CameraModelKind::Pinhole, &params).unwrap();
    let features =
        FeatureOptions { calibration: Calibration::Known(intrinsics), ..FeatureOptions::default() };
    Options { features, ..Options::default() }
}

fn run(photos: &Path, workspace: &Path, threads: usize) -> Report {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        reconstruct(&[photos.to_owned()], workspace, &calibrated(), &mut |_| {
            ControlFlow::Continue(())
        })
        .unwrap()
    })
}

/// Contents of the result files.
fn results(workspace: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files: Vec<PathBuf> = fs::read_dir(workspace.join("sparse/0"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.push(workspace.join("points.ply"));
    let read = |path: PathBuf| {
        (path.strip_prefix(workspace).unwrap().to_owned(), fs::read(&path).unwrap())
    };
    files.into_iter().map(read).collect()
}

#[test]
fn fountain_is_reconstructed_with_the_same_bytes_on_one_thread_and_two() {
    let Some(data) = skipped::data() else { return };
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    write_photos(&data, usize::MAX, &photos);
    let report = run(&photos, &dir.path().join("two"), 2);
    assert_eq!((report.models.len(), report.models[0].registered), (1, 11));
    let truth: Truth =
        format!("strecha:{}", data.join("fountain-P11/cameras").display()).parse().unwrap();
    let model = LocatedModel::open(&dir.path().join("two")).unwrap();
    let evaluation = evaluate_poses(&model, &truth, None).unwrap();
    assert_eq!((evaluation.images, evaluation.registered), (11, 11));
    let mean_m = evaluation.centre_error.mean;
    assert!(mean_m < MAX_MEAN_CENTRE_ERROR_M, "mean centre error {mean_m} m");
    run(&photos, &dir.path().join("one"), 1);
    assert!(
        results(&dir.path().join("one")) == results(&dir.path().join("two")),
        "not the same bytes"
    );
}

#[test]
fn interrupted_run_resumes_to_the_same_result() {
    const COUNT: usize = 5;
    let Some(data) = skipped::data() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (photos, workspace) = (dir.path().join("photos"), dir.path().join("ws"));
    write_photos(&data, COUNT, &photos);
    run(&photos, &dir.path().join("undisturbed"), 2);

    // Stops at the given event. Returns the number of steps that were done when the stage began.
    let stop_at = |stop: &dyn Fn(&Event) -> bool| {
        let mut done_before = 0;
        let result =
            reconstruct(std::slice::from_ref(&photos), &workspace, &calibrated(), &mut |event| {
                if let Event::StageBegan { done, .. } = event {
                    done_before = *done;
                }
                if stop(event) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            });
        assert!(matches!(result, Err(Error::Cancelled)), "{result:?}");
        done_before
    };
    let third_image =
        |event: &Event| matches!(event, Event::ImageDone { image, .. } if image.contains("0002"));
    assert_eq!(stop_at(&third_image), 0);
    let mut pairs = std::cell::Cell::new(0);
    let fourth_pair = |event: &Event| {
        pairs.set(pairs.get() + usize::from(matches!(event, Event::PairDone { .. })));
        pairs.get() == 4
    };
    stop_at(&fourth_pair);
    let done = stop_at(&|event| matches!(event, Event::ImageRegistered { .. }));
    assert_eq!((pairs.get_mut(), done), (&mut 4, 0), "the mapper starts from scratch");
    let report = run(&photos, &workspace, 2);
    assert_eq!(
        report.stages.matches.as_ref().map(|matches| matches.pairs),
        Some(COUNT * (COUNT - 1) / 2)
    );
    assert!(results(&workspace) == results(&dir.path().join("undisturbed")), "not the same bytes");
}

#[test]
fn features_of_an_interrupted_run_are_not_computed_again() {
    let Some(data) = skipped::data() else { return };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("photos");
    write_photos(&data, 4, &folder);
    let photos = Photos::open(&[folder], None).unwrap();
    let mut workspace = Workspace::create(&dir.path().join("ws")).unwrap();
    let mut extract = |limit: usize| {
        let mut images = Vec::new();
        let result = extract_features(
            &photos,
            &mut workspace,
            &FeatureOptions::default(),
            None,
            &mut |event| {
                if let Event::ImageDone { image, .. } = event {
                    images.push((*image).to_owned());
                }
                if images.len() == limit {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            },
        );
        (images, result.is_ok())
    };
    let (first, done) = extract(3);
    assert_eq!((first.len(), done), (3, false));
    let (rest, done) = extract(usize::MAX);
    assert_eq!((rest.len(), done), (1, true));
    assert!(!first.contains(&rest[0]));
    assert_eq!(extract(usize::MAX), (vec![], true), "kept");
    let report = workspace.report().unwrap().stages.features.unwrap();
    assert_eq!((report.images, report.skipped.len()), (4, 0));
    assert_eq!(Stage::ALL.map(Stage::name), ["features", "match", "map", "dense"]);
}
