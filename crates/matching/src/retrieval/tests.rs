use proptest::prelude::*;
use tiepoint_features::Descriptor;

use super::bank::dot;
use super::*;
use crate::brute::Isa;
use crate::random::SplitMix64;

/// Descriptors of random direction in the first quadrant.
fn noise(count: usize, seed: u64) -> Vec<Descriptor> {
    let mut random = SplitMix64::new(seed, 1);
    (0..count).map(|_| std::array::from_fn(|_| random.below(90) as u8)).collect()
}

/// Images of a walk along a wall of features: each sees 60, and the next one moved on by 10; every
/// descriptor a little different each time.
fn walk(images: usize) -> Vec<Vec<Descriptor>> {
    let wall = noise(10 * images + 60, 3);
    let mut random = SplitMix64::new(4, 1);
    let mut seen_again =
        |descriptor: &Descriptor| descriptor.map(|x| x.saturating_add(random.below(9) as u8));
    (0..images)
        .map(|at| wall[10 * at..10 * at + 60].iter().map(&mut seen_again).collect())
        .collect()
}

fn bank(images: &[Vec<Descriptor>], options: &VocabularyOptions) -> (Vocabulary, Bank) {
    let vocabulary = Vocabulary::learn(&images.concat(), options);
    let bank = images.iter().map(|image| vocabulary.describe(image)).collect();
    (vocabulary, bank)
}

#[test]
fn images_that_see_the_same_are_similar() {
    let images = walk(40);
    let (vocabulary, bank) = bank(&images, &VocabularyOptions { words: 32, ..Default::default() });
    let mut right = 0;
    for (at, image) in images.iter().enumerate() {
        let found = bank.most_similar(&vocabulary.describe(image), 5, |_| true);
        assert_eq!((found[0].image, found.len()), (at as u32, 5));
        assert!((found[0].similarity - 1.0).abs() < 1e-5, "{:?}", found[0]);
        assert!(found.windows(2).all(|pair| pair[0].similarity >= pair[1].similarity));
        // Five sixths, two thirds of what they see is the same.
        right += found[1..].iter().filter(|similar| similar.image.abs_diff(at as u32) <= 3).count();
    }
    assert!(right >= 40 * 4 * 9 / 10, "{right}");
}

#[test]
fn pairs_are_those_of_related_images_without_the_known_ones() {
    let images = walk(37);
    let (_, bank) = bank(&images, &VocabularyOptions { words: 16, ..Default::default() });
    let known: Vec<_> = (0..36).map(|i| (i, i + 1)).collect();
    let mut expected = Vec::new();
    for (a, others) in (0..).zip(bank.related(3, |a: u32, b| a.abs_diff(b) > 1)) {
        assert_eq!(others.len(), 3);
        expected.extend(others.iter().map(|&b| (a.min(b), a.max(b))));
    }
    expected.sort_unstable();
    expected.dedup();
    assert_eq!(bank.pairs(3, &known), expected);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| bank.pairs(3, &known)), expected);
    }
}

/// Images 6 places apart share nothing; in between there are some that share with both.
#[test]
fn images_that_share_nothing_are_found_by_way_of_others() {
    const NOTHING_SHARED: u32 = 6;
    // Ten on both sides, five at the ends of the wall.
    const NEAR: u32 = NOTHING_SHARED + 9;
    let images = walk(60);
    let (vocabulary, bank) = bank(&images, &VocabularyOptions { words: 32, ..Default::default() });
    let related = bank.related(10, |a, b| a.abs_diff(b) >= NOTHING_SHARED);
    let [mut by_way_of_others, mut alike] = [0, 0];
    for (a, others) in (0u32..).zip(related) {
        let near = |others: &[u32]| others.iter().filter(|b| b.abs_diff(a) <= NEAR).count();
        by_way_of_others += near(&others);
        let plain = bank.most_similar(&vocabulary.describe(&images[a as usize]), 10, |b| {
            b.abs_diff(a) >= NOTHING_SHARED
        });
        alike += near(&plain.iter().map(|similar| similar.image).collect::<Vec<_>>());
    }
    assert!(by_way_of_others >= 60 * 9 && alike < 60 * 5, "{by_way_of_others} {alike}");
}

#[test]
fn where_nothing_is_alike_the_most_similar_ones_are_related() {
    let images: Vec<Vec<Descriptor>> = (0..30).map(|at| noise(50, 100 + at)).collect();
    let (vocabulary, bank) = bank(&images, &VocabularyOptions { words: 8, ..Default::default() });
    for (a, others) in bank.related(4, |a, b| !(a + b).is_multiple_of(3)).into_iter().enumerate() {
        let image = a as u32;
        let plain = bank.most_similar(&vocabulary.describe(&images[a]), 4, |b| {
            b != image && !(image + b).is_multiple_of(3)
        });
        assert_eq!(others, plain.iter().map(|similar| similar.image).collect::<Vec<_>>());
    }
}

#[test]
fn only_the_leading_features_say_what_an_image_looks_like() {
    let sample = noise(2 * Vocabulary::LEADING, 8);
    let vocabulary =
        Vocabulary::learn(&sample, &VocabularyOptions { words: 8, ..Default::default() });
    assert_eq!(vocabulary.describe(&sample), vocabulary.describe(&sample[..Vocabulary::LEADING]));
    assert_ne!(vocabulary.describe(&sample), vocabulary.describe(&sample[1..]));
}

#[test]
fn the_vocabulary_is_that_of_plain_k_means() {
    let sample = noise(500, 9);
    let options = VocabularyOptions { words: 20, rounds: 3, seed: 5 };
    let first = Vocabulary::learn(&sample, &VocabularyOptions { rounds: 0, ..options });
    let global = |vocabulary: &Vocabulary| vocabulary.describe(&sample[..100]);
    assert_eq!(
        global(&first),
        global(&Vocabulary::learn(&sample, &VocabularyOptions { rounds: 0, ..options }))
    );
    assert_ne!(
        global(&first),
        global(&Vocabulary::learn(&sample, &VocabularyOptions { rounds: 0, seed: 6, ..options }))
    );
    // Moving words to the means of what is nearest to them brings descriptors nearer.
    let spread = |vocabulary: &Vocabulary| -> u64 {
        let packed = crate::Prepared::new(&sample);
        let found = crate::nearest(&packed, vocabulary.packed()).of_a;
        found.iter().map(|nearest| u64::from(nearest.distance)).sum()
    };
    let spreads: Vec<u64> = (0..4)
        .map(|rounds| spread(&Vocabulary::learn(&sample, &VocabularyOptions { rounds, ..options })))
        .collect();
    assert!(spreads.windows(2).all(|pair| pair[1] < pair[0]), "{spreads:?}");
}

#[test]
fn little_or_nothing_to_learn_from() {
    let nothing = Vocabulary::learn(&[], &VocabularyOptions::default());
    let (vocabulary, mut bank) = bank(&[noise(3, 1), noise(1, 2)], &VocabularyOptions::default());
    bank.push(&vocabulary.describe(&[]));
    let found = bank.most_similar(&vocabulary.describe(&[]), 5, |_| true);
    assert!(found.iter().all(|similar| similar.similarity == 0.0) && found.len() == 3);
    assert_eq!(bank.pairs(0, &[]), []);
    let empty: Bank = [nothing.describe(&noise(9, 1)), nothing.describe(&[])].into_iter().collect();
    assert_eq!(empty.pairs(3, &[]), [(0, 1)]);
    assert_eq!(Bank::default().pairs(3, &[]), []);
}

proptest! {
    #[test]
    fn scalar_products_are_exact_on_every_instruction_set(
        a in prop::collection::vec(any::<i8>(), 0..3000),
        from in 0usize..200,
    ) {
        let b: Vec<i8> = a.iter().rev().map(|x| x.wrapping_mul(7)).collect();
        let (a, b) = (&a[from.min(a.len())..], &b[from.min(b.len())..]);
        let expected: i64 = a.iter().zip(b).map(|(&x, &y)| i64::from(x) * i64::from(y)).sum();
        for isa in Isa::supported() {
            prop_assert_eq!(dot(isa, a, b), expected);
        }
    }

    #[test]
    fn descriptors_of_any_content_are_described(
        bytes in prop::collection::vec(any::<u8>(), 0..40),
        seed in any::<u64>(),
    ) {
        let image: Vec<Descriptor> = bytes
            .iter()
            .map(|&x| std::array::from_fn(|k| if k % 3 == 0 { x } else { 255 - x }))
            .collect();
        let vocabulary =
            Vocabulary::learn(&image, &VocabularyOptions { words: 7, rounds: 2, seed });
        let bank: Bank = std::iter::once(vocabulary.describe(&image)).collect();
        let found = bank.most_similar(&vocabulary.describe(&image), 1, |_| true);
        prop_assert!(found[0].similarity <= 1.0 + 1e-5 && found[0].similarity >= 0.0);
    }
}
