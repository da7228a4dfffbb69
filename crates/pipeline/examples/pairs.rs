//! Run time of matching and verification per image pair on one core, over the pairs of a workspace.
//!
//! `cargo run --release -p tiepoint-pipeline --example pairs -- WORKSPACE [STEP] [FEATURES]`
//!
//! Uses every STEP-th matched pair in the database of the workspace, and the FEATURES largest
//! features of each image. The matches are compared with those of an exhaustive comparison of all
//! descriptors: there must be no difference.

#![allow(clippy::print_stdout)]

use std::path::Path;
use std::time::Instant;

use tiepoint_io::database::Database;
use tiepoint_io::features::{Features, SiftDescriptor};
use tiepoint_sfm::convert::{keypoint, matched};
use tiepoint_sfm::geometry::Rng;
use tiepoint_sfm::matching::Options;
use tiepoint_sfm::matching::sift::{Prepared, match_prepared, nearest, select};
use tiepoint_sfm::scene::{ImageId, Keypoint, Match};
use tiepoint_sfm::two_view::{ImageObservations, VerifyOptions, verify_pair};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let workspace = arguments.first().ok_or("usage: pairs WORKSPACE [STEP] [FEATURES]")?;
    let number =
        |at: usize, default: usize| arguments.get(at).map_or(Ok(default), |text| text.parse());
    let (step, most) = (number(1, 1)?, number(2, usize::MAX)?);
    let database = Database::open(&Path::new(workspace).join("database.db"))?;
    let (cameras, images) = (database.read_cameras()?, database.read_images()?);
    let options = Options::default();
    let mut seconds = [0.0; 4];
    let [mut pairs, mut features, mut matches, mut verified, mut different] = [0; 5];
    for pair in database.matched_pairs()?.into_iter().step_by(step.max(1)) {
        let (keypoints_a, descriptors_a) = largest(&database.read_features(pair.a)?, most);
        let (keypoints_b, descriptors_b) = largest(&database.read_features(pair.b)?, most);
        let (preparing, [a, b]) =
            timed(|| [&descriptors_a, &descriptors_b].map(|d| Prepared::new(d)));
        let (matching, found) = timed(|| match_prepared(&a, &b, &options));
        let (in_full, expected) = timed(|| select(&nearest(&a, &b), &options));
        let list: Vec<Match> = found.iter().map(matched).collect();
        let camera = |image: ImageId| &cameras[images[image.index()].camera.index()];
        let view_a = ImageObservations { keypoints: &keypoints_a, camera: camera(pair.a) };
        let view_b = ImageObservations { keypoints: &keypoints_b, camera: camera(pair.b) };
        let seed = Rng::stream(0, &[u64::from(pair.a.0), u64::from(pair.b.0)]).next_u64();
        let (verifying, two_view) =
            timed(|| verify_pair(view_a, view_b, &list, &VerifyOptions::default(), seed));
        for (sum, part) in seconds.iter_mut().zip([preparing / 2.0, matching, in_full, verifying]) {
            *sum += part;
        }
        pairs += 1;
        features += a.len() + b.len();
        matches += found.len();
        verified += usize::from(two_view.is_verified());
        different += usize::from(found != expected);
    }
    let count = pairs.max(1);
    let [preparing, matching, in_full, verifying] = seconds.map(|s| 1e3 * s / count as f64);
    println!(
        "{pairs} pairs, {} features an image, {} matches a pair; {verified} verified, {different} \
        with other matches than in full",
        features / 2 / count,
        matches / count
    );
    println!(
        "ms of one core: an image made ready {preparing:.2}; a pair matched {matching:.2} (in \
        full {in_full:.2}), verified {verifying:.2}"
    );
    Ok(())
}

fn timed<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let start = Instant::now();
    let result = work();
    (start.elapsed().as_secs_f64(), result)
}

/// The largest features of an image.
fn largest(features: &Features, most: usize) -> (Vec<Keypoint>, Vec<SiftDescriptor>) {
    let mut order: Vec<usize> = (0..features.keypoints.len()).collect();
    order.sort_by(|&i, &j| features.keypoints[j].scale.total_cmp(&features.keypoints[i].scale));
    order.truncate(most);
    let keypoint = |&i: &usize| keypoint(&features.keypoints[i]);
    let descriptors = features.descriptors.as_sift().unwrap_or_default();
    (order.iter().map(keypoint).collect(), order.iter().map(|&i| descriptors[i]).collect())
}
