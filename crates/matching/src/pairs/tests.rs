use super::*;

fn sequential(overlap: u32) -> PairSelection {
    PairSelection::sequential(overlap)
}

#[test]
fn text_round_trip_and_invalid_texts() {
    for text in [
        "exhaustive",
        "sequential:1",
        "sequential:20",
        "sequential:20+ends",
        "sequential:20+thin",
        "sequential:20+thin+ends+loops:2",
        "sequential:20+loops:10",
        "sequential:3+ends+loops:1",
        "similar:30",
    ] {
        assert_eq!(text.parse::<PairSelection>().unwrap().to_string(), text);
    }
    assert_eq!("sequential".parse(), Ok(sequential(10)));
    for text in [
        "",
        "all",
        "sequential:",
        "sequential:0",
        "sequential:-3",
        "sequential:+3",
        "sequential:3+",
        "sequential:3+loop",
        "sequential:3+loops",
        "sequential:3+loops:",
        "sequential:3+loops:0",
        "sequential:3+loops:2+ends",
        "sequential:3+ends+thin",
        "similar:0",
        "similar",
        "sequential:99999999999",
        "Exhaustive",
    ] {
        let error = text.parse::<PairSelection>().unwrap_err();
        assert_eq!(error, Error::PairSelection(text.to_owned()));
        assert!(error.to_string().contains("sequential:20"), "{error}");
    }
}

#[test]
fn exhaustive_selects_every_pair_once() {
    let cameras = [Sequence::new(vec![4, 2, 0]), Sequence::new(vec![1, 3])];
    let expected: Vec<Pair> = (0..5).flat_map(|i| (i + 1..5).map(move |j| (i, j))).collect();
    assert_eq!(PairSelection::Exhaustive.pairs(&cameras), expected);
    assert_eq!(PairSelection::Exhaustive.pairs(&[]), []);
    assert_eq!(PairSelection::Exhaustive.pairs(&[Sequence::new(vec![7])]), []);
}

#[test]
fn sequential_within_one_camera() {
    let camera = [Sequence::new(vec![0, 1, 2, 3])];
    assert_eq!(sequential(1).pairs(&camera), [(0, 1), (1, 2), (2, 3)]);
    assert_eq!(sequential(2).pairs(&camera), [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]);
    assert_eq!(sequential(u32::MAX).pairs(&camera).len(), 6);
}

#[test]
fn sequential_across_cameras_by_position() {
    let (frames, overlap) = (7, 2);
    // Camera k has the images 10k..10k+7.
    let cameras: Vec<Sequence> =
        (0..3).map(|k| Sequence::new((10 * k..10 * k + frames).collect())).collect();
    let mut expected = Vec::new();
    for a in 0..30u32 {
        for b in a + 1..30 {
            if a % 10 < frames && b % 10 < frames && (a % 10).abs_diff(b % 10) <= overlap {
                expected.push((a, b));
            }
        }
    }
    assert_eq!(sequential(overlap).pairs(&cameras), expected);
}

#[test]
fn number_of_pairs_of_two_cameras() {
    // Two sequences of 2,000 frames, 20 neighbours each way in both: within a camera 2 × (2000·20 −
    // 210) pairs, across cameras 2000 + 2 (2000·20 − 210).
    let cameras = [Sequence::new((0..2000).collect()), Sequence::new((2000..4000).collect())];
    assert_eq!(sequential(20).pairs(&cameras).len(), 4 * (2000 * 20 - 210) + 2000);
}

#[test]
fn thinned_neighbours_are_at_most_half_of_those_of_a_drive() {
    const FRAMES: u32 = 2000;
    let cameras =
        [Sequence::new((0..FRAMES).collect()), Sequence::new((FRAMES..2 * FRAMES).collect())];
    let [all, thinned] = ["sequential:20", "sequential:20+thin"]
        .map(|text| text.parse::<PairSelection>().unwrap().pairs(&cameras));
    let is_taken =
        |&(a, b): &Pair| [0, 1, 2, 3, 4, 6, 8, 12, 16].contains(&(a % FRAMES).abs_diff(b % FRAMES));
    assert_eq!(thinned, all.iter().copied().filter(is_taken).collect::<Vec<_>>());
    assert!(2 * thinned.len() < all.len(), "{} of {}", thinned.len(), all.len());
}

#[test]
fn sequential_across_cameras_by_time() {
    // Camera B has half the frame rate and starts 1.1 s after camera A.
    let a = Sequence::with_times(vec![0, 1, 2, 3, 4], vec![0.0, 1.0, 2.0, 3.0, 4.0]).unwrap();
    let b = Sequence::with_times(vec![5, 6], vec![1.1, 3.1]).unwrap();
    let across =
        |pairs: Vec<Pair>| pairs.into_iter().filter(|&(i, j)| i < 5 && j >= 5).collect::<Vec<_>>();
    let tiny = across(sequential(1).pairs(&[a.clone(), b.clone()]));
    // Both images of B are within one position of the nearest image for every image of A.
    assert_eq!(tiny.len(), 10);
    // Without times, images at equal positions count as simultaneous.
    let by_position = across(sequential(1).pairs(&[a, Sequence::new(vec![5, 6])]));
    assert_eq!(by_position, [(0, 5), (0, 6), (1, 5), (1, 6), (2, 6)]);
}

#[test]
fn position_nearest_in_time() {
    let sequence = Sequence::with_times(vec![0, 1, 2], vec![0.0, 1.0, 1.5]).unwrap();
    for (time_s, position) in
        [(-5.0, 0), (0.0, 0), (0.5, 0), (0.51, 1), (1.0, 1), (1.24, 1), (1.26, 2), (9.0, 2)]
    {
        assert_eq!(sequence.position_at(time_s), position, "{time_s}");
    }
}

#[test]
fn closed_ends_are_matched() {
    let selection: PairSelection = "sequential:2+ends".parse().unwrap();
    let cameras = [Sequence::new((0..10).collect()), Sequence::new((10..20).collect())];
    let mut expected = sequential(2).pairs(&cameras);
    for first in [0, 1, 10, 11] {
        for last in [8, 9, 18, 19] {
            expected.push((first.min(last), first.max(last)));
        }
    }
    expected.sort_unstable();
    assert_eq!(selection.pairs(&cameras), expected);
    // Sequences shorter than the overlap, and empty ones.
    let short = [Sequence::new(vec![0, 1]), Sequence::default()];
    assert_eq!(selection.pairs(&short), [(0, 1)]);
}

#[test]
fn invalid_times_are_errors() {
    assert_eq!(
        Sequence::with_times(vec![0, 1], vec![0.0]),
        Err(Error::TimeCount { images: 2, times: 1 })
    );
    assert_eq!(
        Sequence::with_times(vec![0, 1], vec![1.0, 0.5]),
        Err(Error::TimeOrder { index: 1, time_s: 0.5 })
    );
    assert!(matches!(
        Sequence::with_times(vec![0], vec![f64::NAN]),
        Err(Error::TimeOrder { index: 0, .. })
    ));
}
