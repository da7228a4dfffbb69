//! Options out of their range are refused by name, and all others work.

use tiepoint_geometry::{Loss, OptionError};
use tiepoint_sfm::register::RegisterOptions;
use tiepoint_sfm::rolling_shutter::Readout;
use tiepoint_sfm::tracks::{FilterOptions, TrackOptions};
use tiepoint_sfm::two_view::VerifyOptions;
use tiepoint_sfm::{Mapper, MapperOptions};
use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions};

/// Values that no threshold has.
const WRONG: [f64; 3] = [-1.0, f64::NAN, f64::INFINITY];
/// Images of each camera, and observations of an image: the smallest drive that is mapped.
const IMAGES: usize = 4;
const OBSERVATIONS: usize = 100;

/// Sets one option.
type Set = (&'static str, fn(&mut MapperOptions, f64));

/// All options of the mapper that are numbers. The patterns name all fields, so that a new option
/// does not compile until it is here.
fn numbers() -> [Set; 9] {
    let MapperOptions {
        refine: _,
        keep_calibrations: _,
        select_camera_models: _,
        tracks:
            TrackOptions {
                max_create_error_px: _,
                max_merge_error_px: _,
                min_angle_rad: _,
                two_view: _,
                max_transitivity: _,
            },
        filter: FilterOptions { max_error_px: _, min_angle_rad: _ },
        register: RegisterOptions { max_error_px: _, min_num_inliers: _, min_inlier_ratio: _ },
        min_initial_inliers: _,
        min_model_size: _,
        loss: _,
        local_images: _,
        global_growth: _,
        rig: _,
        readout: _,
        seed: _,
    } = MapperOptions::default();
    [
        ("tracks.max_create_error_px", |options, x| options.tracks.max_create_error_px = x),
        ("tracks.max_merge_error_px", |options, x| options.tracks.max_merge_error_px = x),
        ("tracks.min_angle_rad", |options, x| options.tracks.min_angle_rad = x),
        ("filter.max_error_px", |options, x| options.filter.max_error_px = x),
        ("filter.min_angle_rad", |options, x| options.filter.min_angle_rad = x),
        ("register.max_error_px", |options, x| options.register.max_error_px = x),
        ("register.min_inlier_ratio", |options, x| options.register.min_inlier_ratio = x),
        ("loss scale", |options, x| options.loss = Loss::SoftL1(x)),
        ("global_growth", |options, x| options.global_growth = x),
    ]
}

fn counts() -> [Set; 5] {
    [
        ("tracks.max_transitivity", |options, x| options.tracks.max_transitivity = x as usize),
        ("register.min_num_inliers", |options, x| options.register.min_num_inliers = x as usize),
        ("min_initial_inliers", |options, x| options.min_initial_inliers = x as usize),
        ("min_model_size", |options, x| options.min_model_size = x as usize),
        ("local_images", |options, x| options.local_images = x as usize),
    ]
}

fn with((_, set): Set, value: f64) -> MapperOptions {
    let mut options = MapperOptions::default();
    set(&mut options, value);
    options
}

#[test]
fn wrong_numbers_are_refused_by_name() {
    for option in numbers() {
        for value in WRONG {
            let OptionError { name, .. } = with(option, value).validate().unwrap_err();
            assert_eq!(name, option.0, "{value}");
        }
    }
    for readout in [f64::NAN, f64::INFINITY] {
        let readout = Some(Readout::Known(readout));
        MapperOptions { readout, ..MapperOptions::default() }.validate().unwrap_err();
    }
    let default = VerifyOptions::default();
    for value in WRONG {
        for options in [
            VerifyOptions { max_error_px: value, ..default },
            VerifyOptions { min_e_f_inlier_ratio: value, ..default },
            VerifyOptions { max_h_inlier_ratio: value, ..default },
        ] {
            options.validate().unwrap_err();
        }
    }
    VerifyOptions { min_num_inliers: 0, ..default }.validate().unwrap_err();
}

/// Zero is refused, or the mapper works with it.
#[test]
fn zero_is_refused_or_works() {
    let mut drive =
        Drive::new(&DriveOptions { rate_hz: 4.0, ..DriveOptions::default() }).expect("a drive");
    drive.keep_first(IMAGES);
    let observations = 2 * IMAGES * OBSERVATIONS;
    let features = FeatureOptions { observations, ..FeatureOptions::default() };
    let scene = FeatureScene::new(&drive, &features).expect("sound options");
    let (graph, images) = (scene.graph(&MatchOptions::default()), scene.without_poses());
    let mut refused = Vec::new();
    for option in numbers().into_iter().chain(counts()) {
        let options = with(option, 0.0);
        let mapped = Mapper::new(&graph, &images).run(&options);
        if options.validate().is_err() {
            mapped.unwrap_err();
            refused.push(option.0);
        } else {
            assert!(!mapped.unwrap().is_empty(), "{}", option.0);
        }
    }
    let expected = [
        "tracks.max_create_error_px",
        "tracks.max_merge_error_px",
        "filter.max_error_px",
        "register.max_error_px",
        "loss scale",
        "global_growth",
        "register.min_num_inliers",
        "min_initial_inliers",
        "local_images",
    ];
    assert_eq!(refused, expected);
}
