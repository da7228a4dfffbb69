//! Pruned matching of photos beside brute force, on every instruction set of the CPU.

use std::path::Path;

use tiepoint_features::{GrayView, Options as SiftOptions, extract};
use tiepoint_matching::Options;
use tiepoint_matching::sift::{Isa, Prepared, match_prepared_on, nearest, select};

use crate::skipped;

#[test]
fn matches_of_photos_are_those_of_brute_force() {
    let Some(data) = skipped::data() else { return };
    for [a, b] in [
        ["fountain-P11/images/0004.jpg", "fountain-P11/images/0006.jpg"],
        ["Herz-Jesus-P8/images/0002.jpg", "Herz-Jesus-P8/images/0003.jpg"],
        ["kitti04/images/left/000010.png", "kitti04/images/left/000012.png"],
    ] {
        let (a, b) = (prepared(&data.join(a)), prepared(&data.join(b)));
        for max_ratio in [Some(0.8), None] {
            let options = Options { max_ratio, ..Options::default() };
            let expected = select(&nearest(&a, &b), &options);
            assert!(expected.len() > 300, "{} matches", expected.len());
            for isa in Isa::supported() {
                assert_eq!(match_prepared_on(isa, &a, &b, &options), expected, "{isa}");
            }
        }
    }
}

/// The features of a photo of half the size.
fn prepared(path: &Path) -> Prepared {
    let photo = image::open(path).unwrap();
    let grey = photo.thumbnail(photo.width() / 2, photo.height() / 2).to_luma8();
    let view = GrayView::new(grey.as_raw(), grey.width() as usize, grey.height() as usize);
    let options = SiftOptions { max_features: 4000, ..SiftOptions::default() };
    Prepared::new(extract(&view, &options).unwrap().descriptors.as_sift().unwrap())
}
