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

/// Images of a walk along a wall of features: each sees 60, and the next one moved on by 10; every descriptor a little
/// different each time.
fn walk(images: usize) -> Vec<Vec<Descriptor>> {
    let wall = noise(10 * images + 60, 3);
    let mut random = SplitMix64::new(4, 1);
    let mut seen_again =
        |descriptor: &Descriptor| descriptor.map(|x| x.saturating_add(random.below(9) as u8));
    (0..images).map(|at| wall[10 * at..10 * at + 60].iter().map(&mut seen_again).collect()).collect()
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
fn pairs_are_those_of_the_single_queries_without_the_known_ones() {
    let images = walk(37);
    let (vocabulary, bank) = bank(&images, &VocabularyOptions { words: 16, ..Default::default() });
    let known: Vec<_> = (0..36).map(|i| (i, i + 1)).collect();
    let mut expected = Vec::new();
    for (at, image) in images.iter().enumerate() {
        let at = at as u32;
        for similar in bank.most_similar(&vocabulary.describe(image), 3, |other| other.abs_diff(at) > 1) {
            expected.push((at.min(similar.image), at.max(similar.image)));
        }
    }
    expected.sort_unstable();
    expected.dedup();
    assert_eq!(bank.pairs(3, &known), expected);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| bank.pairs(3, &known)), expected);
    }
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
    fn descriptors_of_any_content_are_described(bytes in prop::collection::vec(any::<u8>(), 0..40), seed in any::<u64>()) {
        let image: Vec<Descriptor> = bytes.iter().map(|&x| std::array::from_fn(|k| if k % 3 == 0 { x } else { 255 - x })).collect();
        let vocabulary = Vocabulary::learn(&image, &VocabularyOptions { words: 7, rounds: 2, seed });
        let bank: Bank = std::iter::once(vocabulary.describe(&image)).collect();
        let found = bank.most_similar(&vocabulary.describe(&image), 1, |_| true);
        prop_assert!(found[0].similarity <= 1.0 + 1e-5 && found[0].similarity >= 0.0);
    }
}
