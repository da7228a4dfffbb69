//! Undistorted pixels of COLMAP 4.2.1 (`pycolmap.undistort_image`, default options), for an image
//! in which each error of a place shows. `bench/undistort.py` compares all pixels of larger images.

use tiepoint_dense::undistort::{UndistortOptions, Undistortion, undistort_camera};
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::Camera;

const WIDTH: u32 = 96;
const HEIGHT: u32 = 64;

/// Camera model, parameters, size of the undistorted image, and colours at [`place`].
type Sample = (&'static str, &'static [f64], (u32, u32), [[u8; 3]; 6]);

const SAMPLES: &[Sample] = &[
    (
        "PINHOLE",
        &[88.0, 89.0, 48.6, 31.7],
        (96, 64),
        [
            [221, 185, 17],
            [89, 229, 13],
            [91, 63, 147],
            [121, 133, 45],
            [213, 177, 25],
            [16, 234, 68],
        ],
    ),
    (
        "SIMPLE_RADIAL",
        &[88.0, 48.6, 31.7, -0.12],
        (98, 63),
        [
            [51, 195, 147],
            [108, 132, 90],
            [119, 38, 174],
            [159, 81, 111],
            [151, 208, 17],
            [62, 176, 108],
        ],
    ),
    (
        "RADIAL",
        &[88.0, 48.6, 31.7, -0.15, 0.04],
        (99, 64),
        [
            [106, 169, 131],
            [80, 183, 41],
            [124, 74, 155],
            [90, 133, 72],
            [197, 179, 14],
            [79, 178, 76],
        ],
    ),
    (
        "OPENCV",
        &[88.0, 89.0, 48.6, 31.7, -0.15, 0.04, 0.001, -0.002],
        (99, 64),
        [
            [128, 161, 114],
            [87, 178, 39],
            [125, 75, 155],
            [91, 133, 72],
            [189, 184, 14],
            [77, 186, 65],
        ],
    ),
    (
        "FULL_OPENCV",
        &[88.0, 89.0, 48.6, 31.7, -0.1, 0.04, 0.001, -0.002, 0.01, 0.05, 0.01, 0.0],
        (99, 64),
        [
            [129, 161, 114],
            [87, 178, 39],
            [125, 75, 155],
            [91, 133, 72],
            [189, 184, 14],
            [77, 186, 65],
        ],
    ),
    (
        "FOV",
        &[88.0, 89.0, 48.6, 31.7, 0.7],
        (95, 61),
        [
            [97, 169, 148],
            [170, 64, 131],
            [195, 91, 156],
            [94, 38, 216],
            [197, 186, 23],
            [118, 111, 139],
        ],
    ),
    (
        "SIMPLE_DIVISION",
        &[88.0, 48.6, 31.7, -0.12],
        (98, 63),
        [
            [71, 184, 142],
            [108, 131, 91],
            [118, 38, 174],
            [159, 81, 111],
            [153, 207, 17],
            [64, 176, 105],
        ],
    ),
    (
        "DIVISION",
        &[88.0, 89.0, 48.6, 31.7, -0.12],
        (98, 63),
        [
            [72, 183, 142],
            [108, 131, 91],
            [118, 39, 174],
            [159, 81, 111],
            [154, 206, 16],
            [64, 176, 105],
        ],
    ),
    (
        "SIMPLE_FISHEYE",
        &[50.0, 48.6, 31.7],
        (139, 72),
        [
            [179, 44, 206],
            [93, 124, 188],
            [88, 118, 152],
            [108, 139, 52],
            [107, 148, 157],
            [148, 122, 155],
        ],
    ),
    (
        "FISHEYE",
        &[50.0, 51.0, 48.6, 31.7],
        (139, 72),
        [
            [185, 35, 208],
            [93, 125, 188],
            [87, 97, 156],
            [107, 140, 51],
            [109, 144, 157],
            [148, 124, 155],
        ],
    ),
    (
        "SIMPLE_RADIAL_FISHEYE",
        &[50.0, 48.6, 31.7, 0.02],
        (135, 71),
        [
            [171, 38, 196],
            [72, 126, 219],
            [164, 90, 143],
            [155, 71, 97],
            [132, 159, 113],
            [144, 161, 142],
        ],
    ),
    (
        "RADIAL_FISHEYE",
        &[50.0, 48.6, 31.7, 0.02, -0.004],
        (135, 72),
        [
            [147, 59, 188],
            [137, 92, 165],
            [157, 51, 140],
            [104, 144, 49],
            [130, 156, 89],
            [146, 138, 148],
        ],
    ),
    (
        "OPENCV_FISHEYE",
        &[50.0, 51.0, 48.6, 31.7, 0.02, -0.008, 0.002, -0.0004],
        (136, 71),
        [
            [180, 37, 200],
            [56, 129, 223],
            [107, 135, 145],
            [132, 62, 119],
            [101, 146, 166],
            [143, 177, 134],
        ],
    ),
    (
        "THIN_PRISM_FISHEYE",
        &[50.0, 51.0, 48.6, 31.7, 0.02, -0.008, 0.0005, -0.0003, 0.001, 0.0, 0.0004, -0.0002],
        (136, 71),
        [
            [178, 39, 200],
            [57, 129, 222],
            [108, 138, 145],
            [132, 62, 119],
            [99, 147, 167],
            [144, 172, 136],
        ],
    ),
    (
        "RAD_TAN_THIN_PRISM_FISHEYE",
        &[
            50.0, 51.0, 48.6, 31.7, 0.02, -0.008, 0.001, 0.0, 0.0, 0.0, 0.0005, -0.0003, 0.0004,
            -0.0002, 0.0, 0.0,
        ],
        (135, 71),
        [
            [156, 52, 196],
            [72, 127, 211],
            [160, 84, 143],
            [155, 71, 98],
            [129, 156, 117],
            [143, 141, 152],
        ],
    ),
    (
        "EUCM",
        &[88.0, 89.0, 48.6, 31.7, 0.6, 1.1],
        (105, 65),
        [
            [33, 216, 111],
            [161, 122, 45],
            [117, 67, 157],
            [118, 84, 131],
            [206, 160, 9],
            [60, 185, 89],
        ],
    ),
];

/// Where the colours of a sample are.
fn place(index: usize, (width, height): (u32, u32)) -> (u32, u32) {
    let x = 0.07 + 0.17 * index as f64;
    let y = 0.08 + 0.28 * ((2 * index) % 4) as f64;
    ((f64::from(width) * x) as u32, (f64::from(height) * y) as u32)
}

#[test]
fn pixels_are_those_of_colmap() {
    let value = |x: u32, y: u32, channel: u32| {
        (((31 * x + 17 * y + 91 * channel) ^ (7 * x * y + channel)) & 255) as u8
    };
    let pixels: Vec<u8> = (0..HEIGHT)
        .flat_map(|y| (0..WIDTH).flat_map(move |x| [0, 1, 2].map(|channel| value(x, y, channel))))
        .collect();
    for (model, params, size, colors) in SAMPLES {
        let kind = CameraModelKind::ALL.iter().find(|kind| kind.name() == *model).unwrap();
        let intrinsics = Intrinsics::new(*kind, params).unwrap();
        let from = Camera { intrinsics, width: WIDTH, height: HEIGHT, has_focal_prior: true };
        let to = undistort_camera(&from, &UndistortOptions::default()).unwrap();
        assert_eq!((to.width, to.height), *size, "{model}");
        let image = Undistortion::new(&from, &to).image::<3>(&pixels).unwrap();
        for (index, color) in colors.iter().enumerate() {
            let (x, y) = place(index, *size);
            let found = &image[3 * (y * to.width + x) as usize..][..3];
            let off = found.iter().zip(color).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(off <= Some(1), "{model} at {x}, {y}: {found:?}, COLMAP {color:?}");
        }
    }
}
