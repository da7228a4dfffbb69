use proptest::prelude::*;
use tiepoint_features::{DescriptorFormat, DescriptorKind, Descriptors};

use super::*;

/// The reference implementation: tests all pairs of keypoints.
fn match_all_pairs(
    a: &Features,
    b: &Features,
    guide: &EpipolarGuide,
    options: &Options,
) -> Vec<Match> {
    let [sift_a, sift_b] = [a, b].map(|features| features.descriptors.as_sift().unwrap());
    let mut of_a = vec![Nearest::NONE; sift_a.len()];
    let mut of_b = vec![Nearest::NONE; sift_b.len()];
    for (i, nearest_of_a) in of_a.iter_mut().enumerate() {
        for (j, nearest_of_b) in of_b.iter_mut().enumerate() {
            let line = line_in_b(&guide.fundamental, &a.keypoints[i]);
            let (x, y) = (f64::from(b.keypoints[j].x), f64::from(b.keypoints[j].y));
            let product = line[0] * x + line[1] * y + line[2];
            let normal_squared = line[0] * line[0] + line[1] * line[1];
            let normal_squared =
                normal_squared.min(normal_squared_in_a(&guide.fundamental, &b.keypoints[j]));
            let allowed = guide.max_error_px * guide.max_error_px * normal_squared;
            if allowed > 0.0 && product * product <= allowed {
                let distance = squared_distance(&sift_a[i], &sift_b[j]);
                nearest_of_a.update(j as u32, distance);
                nearest_of_b.update(i as u32, distance);
            }
        }
    }
    select(&NearestBothWays { of_a, of_b }, options)
}

/// Random keypoints in an image of 640 × 480 pixels. The descriptors differ in their first bytes
/// only, so that many distances are equal.
fn features() -> impl Strategy<Value = Features> {
    prop::collection::vec((0.0f32..640.0, 0.0f32..480.0, any::<[u8; 3]>()), 0..60).prop_map(
        |list| {
            let keypoint =
                |&(x, y, _): &(f32, f32, _)| Keypoint { x, y, scale: 1.0, orientation: 0.0 };
            let descriptor = |(_, _, bytes): &(f32, f32, [u8; 3])| {
                std::array::from_fn(|k| bytes.get(k).map_or(0, |byte| byte & 7))
            };
            Features {
                keypoints: list.iter().map(keypoint).collect(),
                descriptors: list.iter().map(descriptor).collect(),
            }
        },
    )
}

/// The same features with descriptors of another kind.
fn with_kind(features: &Features, kind: DescriptorKind) -> Features {
    let format = DescriptorFormat { kind, dim: 128 };
    let descriptors = Descriptors::new(format, features.descriptors.entries().clone()).unwrap();
    Features { descriptors, ..features.clone() }
}

proptest! {
    #[test]
    fn strips_find_all_candidates(
        a in features(),
        b in features(),
        f in prop::array::uniform3(prop::array::uniform3(-1.0f64..1.0)),
        // Scales of the coordinates, for which the terms of F are of similar size or one dominates.
        weight in prop::array::uniform3(0u8..2),
        max_error_px in 0.1f64..60.0,
    ) {
        let unit = [0, 1, 2].map(|k| if weight[k] == 0 { 1.0 } else { 1e-2 });
        let fundamental =
            std::array::from_fn(|r| std::array::from_fn(|c| f[r][c] * unit[r] * unit[c]));
        let guide = EpipolarGuide { fundamental, max_error_px };
        for mutual in [false, true] {
            let options = Options {
                mutual,
                max_ratio: None,
                max_angle_rad: None,
                preempt: None,
                ..Options::default()
            };
            let expected = match_all_pairs(&a, &b, &guide, &options);
            prop_assert_eq!(match_guided(&a, &b, &guide, &options), expected.clone());
            // Other kinds of descriptors have the same candidates.
            let [a, b] = [&a, &b].map(|features| with_kind(features, DescriptorKind::Bytes));
            prop_assert_eq!(match_guided(&a, &b, &guide, &options), expected);
        }
    }
}

/// The fundamental matrix of a translation along x: corresponding keypoints have the same y.
const SIDEWAYS: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];

#[test]
fn distinguishes_repeated_structures() {
    let at = |x, y| Keypoint { x, y, scale: 2.0, orientation: 0.0 };
    // Three equal features above each other.
    let a = Features {
        keypoints: vec![at(10.0, 10.0), at(10.0, 50.0), at(10.0, 90.0)],
        descriptors: vec![[40; 128]; 3].into(),
    };
    let b =
        Features { keypoints: vec![at(30.0, 90.5), at(30.0, 9.5), at(30.0, 50.0)], ..a.clone() };
    let guide = EpipolarGuide { fundamental: SIDEWAYS, max_error_px: 2.0 };
    let matches = match_guided(&a, &b, &guide, &Options::default());
    assert_eq!(matches.iter().map(|m| (m.a, m.b)).collect::<Vec<_>>(), [(0, 1), (1, 2), (2, 0)]);
    assert_eq!(crate::match_features(&a.descriptors, &b.descriptors, &Options::default()), []);
}

#[test]
fn degenerate_geometry_gives_no_matches() {
    let at = |x, y| Keypoint { x, y, scale: 2.0, orientation: 0.0 };
    let keypoints = vec![at(10.0, 10.0), at(f32::NAN, 3.0), at(f32::INFINITY, 9.0)];
    let features = Features { keypoints, descriptors: vec![[40; 128]; 3].into() };
    for (f, max_error_px) in
        [([[0.0; 3]; 3], 1.0), ([[f64::NAN; 3]; 3], 1.0), (SIDEWAYS, f64::NAN), (SIDEWAYS, 0.0)]
    {
        let guide = EpipolarGuide { fundamental: f, max_error_px };
        assert_eq!(match_guided(&features, &features, &guide, &Options::default()), []);
    }
    let guide = EpipolarGuide { fundamental: SIDEWAYS, max_error_px: 1.0 };
    let empty = Features::default();
    assert_eq!(match_guided(&features, &empty, &guide, &Options::default()), []);
    assert_eq!(match_guided(&empty, &features, &guide, &Options::default()), []);
    assert_eq!(match_guided(&features, &features, &guide, &Options::default()).len(), 1);
}
