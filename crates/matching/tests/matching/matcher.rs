//! Mutual matching, preemptive matching and parallel matching of pairs.

use tiepoint_features::{Descriptors, Features, Keypoint, SiftDescriptor};
use tiepoint_matching::forest::Checks;
use tiepoint_matching::sift::{Prepared, match_prepared};
use tiepoint_matching::{
    Matcher, Method, NearestNeighbours, Options, PreemptiveMatching, match_features,
};

/// Descriptor `k` of a set of descriptors with large mutual distances.
fn distinct(k: usize) -> SiftDescriptor {
    std::array::from_fn(|i| if i / 8 == k % 16 || i % 8 == k / 16 { 100 } else { 3 })
}

fn features(order: impl Iterator<Item = usize>) -> Features {
    let keypoint = |(place, k): (usize, usize)| Keypoint {
        x: place as f32,
        y: 0.5,
        scale: 1.0 + k as f32,
        orientation: 0.0,
    };
    let (keypoints, descriptors): (Vec<Keypoint>, Vec<SiftDescriptor>) =
        order.enumerate().map(|(place, k)| (keypoint((place, k)), distinct(k))).unzip();
    Features { keypoints, descriptors: descriptors.into() }
}

fn sift(descriptors: &Descriptors) -> &[SiftDescriptor] {
    descriptors.as_sift().unwrap()
}

#[test]
fn mutual_matching_is_symmetric() {
    let (a, b) = (features(0..60), features((20..80).rev()));
    let options = Options { max_ratio: Some(0.95), ..Options::default() };
    let forward: Vec<_> = match_features(&a.descriptors, &b.descriptors, &options)
        .iter()
        .map(|m| (m.a, m.b))
        .collect();
    let mut back: Vec<_> = match_features(&b.descriptors, &a.descriptors, &options)
        .iter()
        .map(|m| (m.b, m.a))
        .collect();
    back.sort_unstable();
    assert_eq!(forward, (20..60).map(|k| (k, 79 - k)).collect::<Vec<_>>());
    assert_eq!(forward, back);
}

#[test]
fn preemptive_matching_uses_the_largest_features() {
    // The ten largest features of the images are 50..60 and 70..80, without common features. In
    // total there are 30 common features.
    let (a, b) = (features(0..60), features(30..80));
    let full = Options::default();
    let preempt = Options { preempt: Some(PreemptiveMatching { min_matches: 1 }), ..full.clone() };
    // The scales increase with the index or decrease with it: the last or the first are largest.
    let prepare = |features: &Features, leading: usize| {
        let order: Vec<usize> = (0..features.keypoints.len()).rev().take(leading).collect();
        Prepared::with_leading(sift(&features.descriptors), &order)
    };
    assert_eq!(match_prepared(&prepare(&a, 10), &prepare(&b, 10), &full).len(), 30);
    assert_eq!(match_prepared(&prepare(&a, 10), &prepare(&b, 10), &preempt), []);
    // The 25 largest features of both images include 55..60.
    let expected = match_prepared(&prepare(&a, 10), &prepare(&b, 10), &full);
    assert_eq!(match_prepared(&prepare(&a, 25), &prepare(&b, 25), &preempt), expected);
    // Images that were prepared without leading features are matched in full.
    assert_eq!(
        match_prepared(&Prepared::new(sift(&a.descriptors)), &prepare(&b, 10), &preempt),
        expected
    );
}

#[test]
fn matches_of_pairs_do_not_depend_on_the_number_of_threads() {
    let sets = [0..40, 20..70, 0..0, 10..100].map(features);
    let numbered: Vec<(u32, &Features)> = (0..).zip(&sets).collect();
    let pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
    let of_pair = |&(i, j): &(u32, u32)| {
        let [a, b] = [i, j].map(|image| &sets[image as usize].descriptors);
        match_features(a, b, &Options::default())
    };
    let expected: Vec<_> = pairs.iter().map(of_pair).collect();
    let mut images = NearestNeighbours::default().images();
    images.insert(&numbered).unwrap();
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| images.match_pairs(&pairs)).unwrap(), expected);
    }
}

/// The built-in matcher prepares an image for the options that it has.
#[test]
fn the_matcher_uses_forests_and_leading_features() {
    let (a, b) = (features(0..200), features((100..220).rev()));
    let numbered = [(0, &a), (1, &b)];
    let matches = |options: &Options| {
        let mut images = NearestNeighbours::new(options.clone()).unwrap().images();
        images.insert(&numbered).unwrap();
        images.match_pairs(&[(0, 1)]).unwrap().remove(0)
    };
    let expected = matches(&Options::default());
    assert!(!expected.is_empty());
    let forest = Options { method: Method::Forest(Checks::Total(256)), ..Options::default() };
    assert_eq!(matches(&forest), expected);
    let preempt = |min_matches| Options {
        preempt: Some(PreemptiveMatching { min_matches }),
        ..Options::default()
    };
    // All features are leading ones.
    let count = expected.len() as u32;
    assert_eq!(matches(&preempt(count)), expected);
    assert_eq!(matches(&preempt(count + 1)), []);
}

#[test]
fn forests_give_the_matches_of_brute_force_for_distinct_features() {
    let (a, b) = (features(0..200), features((100..220).rev()));
    let brute = Options::default();
    let forest = Options { method: Method::Forest(Checks::Total(256)), ..Options::default() };
    let expected = match_features(&a.descriptors, &b.descriptors, &brute);
    assert_eq!(match_features(&a.descriptors, &b.descriptors, &forest), expected);
    // Images without forests are matched by brute force.
    let [a, b] = [a, b].map(|image| Prepared::new(sift(&image.descriptors)));
    assert_eq!(match_prepared(&a, &b, &forest), expected);
}

#[test]
fn cheapest_method_uses_forests_for_many_features() {
    let cheapest = Method::Cheapest(Checks::default());
    assert!(!cheapest.uses_forest(500) && cheapest.uses_forest(1_000_000));
    assert!(
        !Method::BruteForce.uses_forest(1_000_000)
            && Method::Forest(Checks::default()).uses_forest(1)
    );
    // More checks increase the number of features from which forests are used.
    let threshold = |checks| {
        (0..40).find(|&k| Method::Cheapest(Checks::Total(checks)).uses_forest(1 << k)).unwrap()
    };
    assert!(threshold(1024) > threshold(64));
}
