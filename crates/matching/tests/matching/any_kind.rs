//! Matching of descriptors of any kind, compared with its definition.

use proptest::prelude::*;
use tiepoint_features::{
    DescriptorEntries, DescriptorFormat, DescriptorKind, Descriptors, Features, Keypoint,
};
use tiepoint_matching::{
    EpipolarGuide, Match, Matcher, NearestNeighbours, Options, PreemptiveMatching, match_features,
    match_guided,
};

/// Relative tolerance: a descriptor as near to the limit of a test may pass or fail because of
/// rounding. Squared distances of small integers are exact.
const ROUNDING: f64 = 1e-12;

fn rows(descriptors: &Descriptors) -> Vec<Vec<f64>> {
    let entries: Vec<f64> = match descriptors.entries() {
        DescriptorEntries::Bytes(entries) => entries.iter().map(|&x| x.into()).collect(),
        DescriptorEntries::Floats(entries) => entries.iter().map(|&x| x.into()).collect(),
    };
    entries.chunks(descriptors.format().dim).map(<[f64]>::to_vec).collect()
}

fn squared(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}

fn angle_rad(a: &[f64], b: &[f64]) -> f64 {
    let product: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
    let norms = (squared(a, &vec![0.0; a.len()]) * squared(b, &vec![0.0; b.len()])).sqrt();
    // A vector without direction has any angle.
    if norms == 0.0 { 0.0 } else { (product / norms).clamp(-1.0, 1.0).acos() }
}

/// The index of the nearest row, and the squared distances of the nearest and second nearest.
fn nearest(one: &[f64], others: &[Vec<f64>]) -> Option<(usize, f64, f64)> {
    let mut all: Vec<(f64, usize)> =
        others.iter().enumerate().map(|(i, other)| (squared(one, other), i)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Some((all.first()?.1, all[0].0, all.get(1).map_or(f64::INFINITY, |second| second.0)))
}

/// The matches by their definition, and whether one is as near to a limit as rounding.
fn definition(a: &Descriptors, b: &Descriptors, options: &Options) -> (Vec<Match>, bool) {
    let (a, b) = (rows(a), rows(b));
    let mut is_close = false;
    let mut is_below = |value: f64, limit: f64| {
        is_close |= (value - limit).abs() <= ROUNDING * limit.max(1.0);
        value < limit
    };
    let mut passes = |one: &[f64], others: &[Vec<f64>], found: (usize, f64, f64)| {
        let (index, distance, second) = found;
        let angle = angle_rad(one, &others[index]);
        options.max_ratio.is_none_or(|max| is_below(distance.sqrt(), max * second.sqrt()))
            && options.max_angle_rad.is_none_or(|max| is_below(angle, max))
    };
    let mut found = Vec::new();
    for (i, one) in a.iter().enumerate() {
        let Some(forward) = nearest(one, &b).filter(|found| passes(one, &b, *found)) else {
            continue;
        };
        let (j, distance, _) = forward;
        let is_mutual =
            nearest(&b[j], &a).is_some_and(|back| back.0 == i && passes(&b[j], &a, back));
        if !options.mutual || is_mutual {
            found.push(Match { a: i as u32, b: j as u32, distance });
        }
    }
    (found, is_close)
}

/// Two images of a kind and a dimension with small integers as entries. Some descriptors are in
/// both images.
fn images() -> impl Strategy<Value = (Descriptors, Descriptors)> {
    let kinds = [
        DescriptorKind::Bytes,
        DescriptorKind::Floats,
        DescriptorKind::AlikedN16Rot,
        DescriptorKind::AlikedN32,
    ];
    let dims = prop::sample::select(vec![1usize, 3, 15, 16, 17, 64, 100, 128, 129]);
    let sizes = (0usize..24, 0usize..24, 0usize..8);
    (prop::sample::select(kinds.to_vec()), dims, sizes, any::<u64>()).prop_map(
        |(kind, dim, (len_a, len_b, common), seed)| {
            let mut random = tiepoint_simd::Rng::from_state(seed);
            let mut numbers = |count: usize| -> Vec<i16> {
                (0..count).map(|_| random.below(17) as i16).collect()
            };
            let a = numbers(len_a * dim);
            let mut b = numbers(len_b * dim);
            let shared = common.min(len_a).min(len_b) * dim;
            b[..shared].copy_from_slice(&a[..shared]);
            let made = |numbers: Vec<i16>| {
                let entries = match kind.has_floats() {
                    // Signed, as those of learned descriptors.
                    true => DescriptorEntries::Floats(
                        numbers.iter().map(|&x| f32::from(x) - 8.0).collect(),
                    ),
                    false => {
                        DescriptorEntries::Bytes(numbers.iter().map(|&x| x as u8 * 15).collect())
                    }
                };
                Descriptors::new(DescriptorFormat { kind, dim }, entries).unwrap()
            };
            (made(a), made(b))
        },
    )
}

proptest! {
    #[test]
    fn matches_are_those_of_the_definition(
        (a, b) in images(),
        mutual in any::<bool>(),
        max_ratio in prop::option::of(0.3f64..1.0),
        max_angle_rad in prop::option::of(0.05f64..3.0),
    ) {
        let options = Options { max_ratio, max_angle_rad, mutual, ..Options::default() };
        let (expected, is_close) = definition(&a, &b, &options);
        prop_assume!(!is_close);
        prop_assert_eq!(match_features(&a, &b, &options), expected);
    }
}

fn floats(dim: usize, entries: Vec<f32>) -> Descriptors {
    let format = DescriptorFormat { kind: DescriptorKind::Floats, dim };
    Descriptors::new(format, DescriptorEntries::Floats(entries)).unwrap()
}

fn bytes(dim: usize, entries: Vec<u8>) -> Descriptors {
    let format = DescriptorFormat { kind: DescriptorKind::Bytes, dim };
    Descriptors::new(format, DescriptorEntries::Bytes(entries)).unwrap()
}

/// A single descriptor passes the ratio test, and every number of entries has its distance.
#[test]
fn distances_are_exact_for_bytes_of_any_dimension() {
    let options = Options { max_ratio: None, max_angle_rad: None, ..Options::default() };
    for dim in [1, 31, 32, 1000, 70_000] {
        let found =
            match_features(&bytes(dim, vec![0; dim]), &bytes(dim, vec![255; dim]), &options);
        assert_eq!(found, [Match { a: 0, b: 0, distance: 65_025.0 * dim as f64 }]);
    }
}

#[test]
fn other_formats_and_invalid_numbers_have_no_matches() {
    let options = Options { max_ratio: None, max_angle_rad: None, ..Options::default() };
    let one = floats(4, vec![1.0, 0.0, 0.0, 2.0]);
    assert_eq!(match_features(&one, &one, &options).len(), 1);
    for other in [
        bytes(4, vec![1, 0, 0, 2]),
        floats(2, vec![1.0, 0.0, 0.0, 2.0]),
        floats(4, vec![f32::NAN, 0.0, 0.0, 2.0]),
        floats(4, vec![f32::INFINITY, 0.0, 0.0, 2.0]),
        floats(4, Vec::new()),
        vec![[1; 128]].into(),
    ] {
        assert_eq!(match_features(&one, &other, &options), [], "{}", other.format());
        assert_eq!(match_features(&other, &one, &options), [], "{}", other.format());
    }
    for invalid in [f64::NAN, -1.0] {
        let ratio = Options { max_ratio: Some(invalid), ..options.clone() };
        let angle = Options { max_angle_rad: Some(invalid), ..options.clone() };
        assert_eq!(match_features(&one, &one, &ratio), []);
        assert_eq!(match_features(&one, &one, &angle), []);
    }
}

/// Images of features on a line with distinct floats; number `k` has scale `k`.
fn line(numbers: std::ops::Range<usize>) -> Features {
    let keypoint = |k: usize| Keypoint { x: k as f32, y: 1.0, scale: k as f32, orientation: 0.0 };
    let entries = numbers.clone().flat_map(|k| [(k as f32).sin(), (k as f32).cos()]).collect();
    Features { keypoints: numbers.map(keypoint).collect(), descriptors: floats(2, entries) }
}

#[test]
fn the_matcher_matches_any_kind_and_preempts() {
    let (a, b) = (line(0..1100), line(20..1120));
    let exact = Options { max_angle_rad: Some(1e-3), max_ratio: None, ..Options::default() };
    let expected = match_features(&a.descriptors, &b.descriptors, &exact);
    assert!(expected.len() > 500, "{}", expected.len());
    for (min_matches, is_matched) in [(1, true), (1100, false)] {
        let preempt = Some(PreemptiveMatching { min_matches });
        let matcher = NearestNeighbours::new(Options { preempt, ..exact.clone() }).unwrap();
        let mut images = matcher.images();
        images.insert(&[(3, &a), (7, &b), (9, &Features::default())]).unwrap();
        let found = images.match_pairs(&[(3, 7), (3, 9)]).unwrap();
        let of_pair = if is_matched { expected.clone() } else { Vec::new() };
        assert_eq!(found, [of_pair, Vec::new()]);
        images.retain(&|image| image == 3);
        let with_itself = if is_matched { a.keypoints.len() } else { 0 };
        assert_eq!(images.match_pairs(&[(3, 3)]).unwrap()[0].len(), with_itself);
    }
}

#[test]
fn guided_matching_takes_floats() {
    // Two features with the same descriptor on different lines.
    let at = |x, y| Keypoint { x, y, scale: 1.0, orientation: 0.0 };
    let descriptors = floats(3, [0.5, -0.25, 1.0].repeat(2));
    let a = Features { keypoints: vec![at(10.0, 10.0), at(10.0, 50.0)], descriptors };
    let b = Features { keypoints: vec![at(30.0, 50.5), at(30.0, 9.5)], ..a.clone() };
    // The fundamental matrix of a translation along x.
    let fundamental = [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];
    let guide = EpipolarGuide { fundamental, max_error_px: 2.0 };
    let found = match_guided(&a, &b, &guide, &Options::default());
    assert_eq!(found.iter().map(|m| (m.a, m.b)).collect::<Vec<_>>(), [(0, 1), (1, 0)]);
    assert_eq!(match_guided(&a, &Features::default(), &guide, &Options::default()), []);
}
