use super::*;
use crate::random::stream;

const IMAGES: u32 = 400;

/// Positions of images along a street. Images are similar if they are near.
fn similar(positions: &[f64], count: usize) -> Vec<Vec<Similar>> {
    let of_image = |(image, at): (u32, &f64)| {
        let mut others: Vec<Similar> = (0..)
            .zip(positions)
            .filter(|(other, _)| *other != image)
            .map(|(image, other)| Similar {
                image,
                similarity: 1.0 / (1.0 + (at - other).abs()) as f32,
            })
            .collect();
        others.sort_by(|a, b| b.similarity.total_cmp(&a.similarity).then(a.image.cmp(&b.image)));
        others.truncate(count);
        others
    };
    (0..).zip(positions).map(of_image).collect()
}

fn camera(images: std::ops::Range<u32>, first_s: f64, order: SequenceOrder) -> CameraImages {
    let times_s = images.clone().map(|image| first_s + f64::from(image - images.start)).collect();
    let sequence = Sequence::with_times(images.collect(), times_s).unwrap();
    CameraImages { sequence, order }
}

fn choose(cameras: &[CameraImages], positions: &[f64]) -> AutoPairs {
    auto_pairs(cameras, &similar(positions, num_similar(cameras)))
}

#[test]
fn a_sequence_has_its_neighbours_and_its_loops() {
    // The second half is the same street again.
    let positions: Vec<f64> = (0..IMAGES).map(|k| f64::from(k % (IMAGES / 2))).collect();
    for order in [SequenceOrder::Times, SequenceOrder::Numbers] {
        let chosen = choose(&[camera(0..IMAGES, 0.0, order)], &positions);
        assert_eq!(chosen.is_sequence, [true]);
        for (a, b) in chosen.pairs.iter().filter(|(a, _)| (50..150).contains(a)) {
            let (gap, place) = (b - a, (b - a).min((b - a).abs_diff(IMAGES / 2)));
            assert!(gap <= AutoPairs::OVERLAP || place <= 2 * AutoPairs::OVERLAP, "{a} {b}");
        }
        for a in AutoPairs::OVERLAP..IMAGES - AutoPairs::OVERLAP {
            let has = |b: u32| chosen.pairs.binary_search(&(a.min(b), a.max(b))).is_ok();
            assert!((1..=AutoPairs::OVERLAP).all(|gap| has(a + gap) && has(a - gap)));
            let again = (a + IMAGES / 2) % IMAGES;
            assert!(has(again), "{a} sees the place of {again}");
        }
        // Each image has its neighbours and its loops, and a pair is of two images.
        assert!(
            chosen.pairs.len()
                <= IMAGES as usize * (AutoPairs::OVERLAP as usize + AutoPairs::NUM_LOOP_IMAGES)
        );
    }
}

#[test]
fn numbers_in_random_order_are_no_sequence() {
    let mut places: Vec<u32> = (0..IMAGES).collect();
    stream(3, 0).shuffle(&mut places);
    let positions: Vec<f64> = places.iter().map(|&place| f64::from(place)).collect();
    let chosen = choose(&[camera(0..IMAGES, 0.0, SequenceOrder::Numbers)], &positions);
    assert_eq!(chosen.is_sequence, [false]);
    let unknown = CameraImages {
        sequence: Sequence::new((0..IMAGES).collect()),
        order: SequenceOrder::Unknown,
    };
    assert_eq!(choose(&[unknown], &positions), chosen);
    for a in 0..IMAGES {
        let of_image = chosen.pairs.iter().filter(|(i, j)| *i == a || *j == a).count();
        assert!(of_image >= AutoPairs::NUM_SIMILAR_IMAGES, "{a}: {of_image}");
    }
}

#[test]
fn parallel_cameras_share_neighbours_and_others_do_not() {
    let half = IMAGES / 2;
    let there_and_there: Vec<f64> = (0..IMAGES).map(|k| f64::from(k % half)).collect();
    let elsewhere: Vec<f64> = (0..IMAGES).map(|k| f64::from(k % half + 900 * (k / half))).collect();
    let has_simultaneous_pairs = |cameras: &[CameraImages], positions: &[f64]| {
        let found = choose(cameras, positions);
        found.pairs.iter().filter(|(a, b)| *a < half && *b == a + half).count() == half as usize
    };
    let at = |first_s: f64, order| {
        [camera(0..half, 0.0, SequenceOrder::Times), camera(half..IMAGES, first_s, order)]
    };
    assert!(has_simultaneous_pairs(&at(0.4, SequenceOrder::Times), &there_and_there));
    assert!(!has_simultaneous_pairs(&at(0.4, SequenceOrder::Times), &elsewhere));
    // Never on at the same time: their pairs are loops.
    let apart = at(1e6, SequenceOrder::Times);
    assert_eq!(positions(&apart[0], &apart[1]), vec![None; half as usize]);
    assert!(!follows(&apart[0], &apart[1], &similar(&there_and_there, num_similar(&apart))));
    let kinds = at(0.0, SequenceOrder::Numbers);
    assert!(!follows(&kinds[0], &kinds[1], &similar(&there_and_there, num_similar(&kinds))));
}

/// Photos around one object all see each other; a recording of times or of cameras in parallel has
/// few pairs.
#[test]
fn of_few_images_only_recordings_leave_out_pairs() {
    let few = AutoPairs::MAX_EXHAUSTIVE as u32;
    let half = few / 2;
    let all = (few * (few - 1) / 2) as usize;
    let along: Vec<f64> = (0..few).map(f64::from).collect();
    let num_pairs = |order, interval_s: f64| {
        let times_s = (0..few).map(|k| interval_s * f64::from(k)).collect();
        let sequence = Sequence::with_times((0..few).collect(), times_s).unwrap();
        choose(&[CameraImages { sequence, order }], &along).pairs.len()
    };
    assert_eq!(num_pairs(SequenceOrder::Numbers, 1.0), all);
    assert_eq!(num_pairs(SequenceOrder::Times, 3.0), all, "photos by hand");
    let per_image = AutoPairs::OVERLAP as usize + AutoPairs::NUM_LOOP_IMAGES;
    assert!(num_pairs(SequenceOrder::Times, 0.1) <= few as usize * per_image);
    let two = [0..half, half..few].map(|images| camera(images, 0.0, SequenceOrder::Numbers));
    let in_parallel: Vec<f64> = (0..few).map(|k| f64::from(k % half)).collect();
    let chosen = choose(&two, &in_parallel);
    assert_eq!(chosen.is_sequence, [true, true]);
    // Neighbours in the own camera, in the other one, and loops.
    let per_image = per_image + AutoPairs::OVERLAP as usize + 1;
    assert!(chosen.pairs.len() <= few as usize * per_image, "{}", chosen.pairs.len());
    // Beside a recording, photos have all images.
    let elsewhere: Vec<f64> = (0..few).map(|k| f64::from(k % half + 900 * (k / half))).collect();
    let times_s = (0..half).map(|k| 0.1 * f64::from(k)).collect();
    let sequence = Sequence::with_times((0..half).collect(), times_s).unwrap();
    let recording = CameraImages { sequence, order: SequenceOrder::Times };
    let mixed = choose(&[recording, two[1].clone()], &elsewhere);
    assert_eq!(mixed.is_sequence, [true, false]);
    for a in half..few {
        let of_image = mixed.pairs.iter().filter(|(i, j)| *i == a || *j == a).count();
        assert_eq!(of_image, few as usize - 1, "{a}");
    }
}

/// The most similar images are nearly all of a small camera.
#[test]
fn few_images_in_random_order_are_no_sequence() {
    for images in [20, 40, 60] {
        let draws = 0..20;
        let are_sequences = draws.filter(|draw| {
            let mut places: Vec<u32> = (0..images).collect();
            stream(4, *draw).shuffle(&mut places);
            let positions: Vec<f64> = places.iter().map(|place| f64::from(*place)).collect();
            let camera = camera(0..images, 0.0, SequenceOrder::Numbers);
            follows(&camera, &camera, &similar(&positions, images as usize))
        });
        let num = are_sequences.count();
        assert!(num <= 1, "{num} of 20 with {images} images");
    }
}

#[test]
fn few_or_no_images() {
    assert_eq!(auto_pairs(&[], &[]), AutoPairs::default());
    let one = camera(0..1, 0.0, SequenceOrder::Times);
    assert_eq!(auto_pairs(&[one], &[Vec::new()]).pairs, []);
}
