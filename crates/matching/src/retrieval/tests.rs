use proptest::prelude::*;
use tiepoint_features::SiftDescriptor;

use super::index::dot;
use super::*;
use crate::brute::Isa;
use crate::random::stream;

/// Descriptors of random direction in the first quadrant.
fn noise(count: usize, seed: u64) -> Vec<SiftDescriptor> {
    let mut random = stream(seed, 1);
    (0..count).map(|_| std::array::from_fn(|_| random.below(90) as u8)).collect()
}

/// A sequence of images along a wall of features. Each image has 60 features, shifted by 10 from
/// the previous image, with noise in the descriptors.
fn wall_sequence(images: usize) -> Vec<Vec<SiftDescriptor>> {
    let wall = noise(10 * images + 60, 3);
    let mut random = stream(4, 1);
    let mut seen_again =
        |descriptor: &SiftDescriptor| descriptor.map(|x| x.saturating_add(random.below(9) as u8));
    (0..images)
        .map(|at| wall[10 * at..10 * at + 60].iter().map(&mut seen_again).collect())
        .collect()
}

fn index(
    images: &[Vec<SiftDescriptor>],
    options: &VocabularyOptions,
) -> (Vocabulary, RetrievalIndex) {
    let vocabulary = Vocabulary::learn(&images.concat(), options);
    let index = images.iter().map(|image| vocabulary.describe(image)).collect();
    (vocabulary, index)
}

#[test]
fn overlapping_images_are_similar() {
    let images = wall_sequence(40);
    let (vocabulary, index) =
        index(&images, &VocabularyOptions { words: 32, ..Default::default() });
    let mut right = 0;
    for (at, image) in images.iter().enumerate() {
        let found = index.most_similar(&vocabulary.describe(image), 5, |_| true);
        assert_eq!((found[0].image, found.len()), (at as u32, 5));
        assert!((found[0].similarity - 1.0).abs() < 1e-5, "{:?}", found[0]);
        assert!(found.windows(2).all(|pair| pair[0].similarity >= pair[1].similarity));
        // Images up to three positions apart share at least half of their features.
        right += found[1..].iter().filter(|similar| similar.image.abs_diff(at as u32) <= 3).count();
    }
    assert!(right >= 40 * 4 * 9 / 10, "{right}");
}

#[test]
fn pairs_are_related_images_without_known_pairs() {
    let images = wall_sequence(37);
    let (_, index) = index(&images, &VocabularyOptions { words: 16, ..Default::default() });
    let known: Vec<_> = (0..36).map(|i| (i, i + 1)).collect();
    let mut expected = Vec::new();
    for (a, others) in (0..).zip(index.related(3, |a: u32, b| a.abs_diff(b) > 1)) {
        assert_eq!(others.len(), 3);
        expected.extend(others.iter().map(|&b| (a.min(b), a.max(b))));
    }
    expected.sort_unstable();
    expected.dedup();
    assert_eq!(index.pairs(3, &known), expected);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| index.pairs(3, &known)), expected);
    }
}

/// Images 6 positions apart share no features. Images in between share features with both.
#[test]
fn diffusion_relates_images_without_common_features() {
    const MIN_GAP: u32 = 6;
    // The ten nearest candidates on each side.
    const NEAR: u32 = MIN_GAP + 9;
    let images = wall_sequence(60);
    let (vocabulary, index) =
        index(&images, &VocabularyOptions { words: 32, ..Default::default() });
    let related = index.related(10, |a, b| a.abs_diff(b) >= MIN_GAP);
    let [mut num_by_diffusion, mut num_by_similarity] = [0, 0];
    for (a, others) in (0u32..).zip(related) {
        let near = |others: &[u32]| others.iter().filter(|b| b.abs_diff(a) <= NEAR).count();
        num_by_diffusion += near(&others);
        let similar = index.most_similar(&vocabulary.describe(&images[a as usize]), 10, |b| {
            b.abs_diff(a) >= MIN_GAP
        });
        num_by_similarity += near(&similar.iter().map(|other| other.image).collect::<Vec<_>>());
    }
    assert!(
        num_by_diffusion >= 60 * 9 && num_by_similarity < 60 * 5,
        "{num_by_diffusion} {num_by_similarity}"
    );
}

#[test]
fn related_falls_back_to_the_most_similar_images() {
    let images: Vec<Vec<SiftDescriptor>> = (0..30).map(|at| noise(50, 100 + at)).collect();
    let (vocabulary, index) = index(&images, &VocabularyOptions { words: 8, ..Default::default() });
    for (a, others) in index.related(4, |a, b| !(a + b).is_multiple_of(3)).into_iter().enumerate() {
        let image = a as u32;
        let similar = index.most_similar(&vocabulary.describe(&images[a]), 4, |b| {
            b != image && !(image + b).is_multiple_of(3)
        });
        assert_eq!(others, similar.iter().map(|other| other.image).collect::<Vec<_>>());
    }
}

#[test]
fn global_descriptors_depend_on_the_leading_features_only() {
    let sample = noise(2 * Vocabulary::LEADING, 8);
    let vocabulary =
        Vocabulary::learn(&sample, &VocabularyOptions { words: 8, ..Default::default() });
    assert_eq!(vocabulary.describe(&sample), vocabulary.describe(&sample[..Vocabulary::LEADING]));
    assert_ne!(vocabulary.describe(&sample), vocabulary.describe(&sample[1..]));
}

#[test]
fn k_means_reduces_the_distances_to_words() {
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
    // Every iteration of k-means reduces the sum of squared distances.
    let sum_of_distances = |vocabulary: &Vocabulary| -> u64 {
        let packed = crate::prepared::Prepared::new(&sample);
        let found = crate::brute::nearest(&packed, vocabulary.packed()).of_a;
        found.iter().map(|nearest| u64::from(nearest.distance)).sum()
    };
    let sums: Vec<u64> = (0..4)
        .map(|rounds| {
            sum_of_distances(&Vocabulary::learn(&sample, &VocabularyOptions { rounds, ..options }))
        })
        .collect();
    assert!(sums.windows(2).all(|pair| pair[1] < pair[0]), "{sums:?}");
}

#[test]
fn small_and_empty_samples() {
    let nothing = Vocabulary::learn(&[], &VocabularyOptions::default());
    let (vocabulary, mut index) = index(&[noise(3, 1), noise(1, 2)], &VocabularyOptions::default());
    index.push(&vocabulary.describe(&[]));
    let found = index.most_similar(&vocabulary.describe(&[]), 5, |_| true);
    assert!(found.iter().all(|similar| similar.similarity == 0.0) && found.len() == 3);
    assert_eq!(index.pairs(0, &[]), []);
    let empty: RetrievalIndex =
        [nothing.describe(&noise(9, 1)), nothing.describe(&[])].into_iter().collect();
    assert_eq!(empty.pairs(3, &[]), [(0, 1)]);
    assert_eq!(RetrievalIndex::default().pairs(3, &[]), []);
}

fn inverted_index(images: &[Vec<SiftDescriptor>]) -> (Vec<ImageWords>, InvertedIndex) {
    let sample = images.concat();
    let vocabulary = VocabularyTree::learn(&sample, sample.len() / 16, 0);
    let described: Vec<ImageWords> =
        images.iter().map(|image| vocabulary.describe(image)).collect();
    let index = InvertedIndex::new(&vocabulary, &described);
    (described, index)
}

/// The slow twin: a dense matrix of ±1 for every image, with a row for each word, and the sum over
/// all words for every pair of images.
#[test]
fn inverted_index_matches_dense_products() {
    // Images in the middle share features with many others; the last two have none.
    let mut images = wall_sequence(70);
    images.extend([Vec::new(), Vec::new(), noise(40, 77)]);
    let (described, index) = inverted_index(&images);
    let num_words = 1 + described.iter().filter_map(|image| image.words().last()).max().unwrap();
    let dense: Vec<Vec<Option<[i32; 128]>>> = described
        .iter()
        .map(|image| {
            let mut rows = vec![None; num_words as usize];
            for (&word, signature) in image.words().iter().zip(image.signatures()) {
                let sign = |k: usize| if signature[k / 64] >> (k % 64) & 1 == 1 { 1 } else { -1 };
                rows[word as usize] = Some(std::array::from_fn(sign));
            }
            rows
        })
        .collect();
    let num_images = |word: usize| dense.iter().filter(|rows| rows[word].is_some()).count();
    let idf: Vec<f64> = (0..num_words as usize)
        .map(|word| (images.len() as f64 / num_images(word).max(1) as f64).ln())
        .collect();
    let product = |a: usize, b: usize| -> f64 {
        let of_word = |word: usize| {
            let (x, y) = (dense[a][word]?, dense[b][word]?);
            let cosine = f64::from(x.iter().zip(&y).map(|(x, y)| x * y).sum::<i32>()) / 128.0;
            Some(idf[word] * cosine.max(0.0).powi(3))
        };
        (0..num_words as usize).filter_map(of_word).sum()
    };
    let norm = |a: usize| product(a, a).sqrt();
    let found = index.most_similar(images.len());
    for (a, found) in found.iter().enumerate() {
        for b in (0..images.len()).filter(|&b| b != a) {
            let expected = product(a, b) / (norm(a) * norm(b));
            let similarity = found.iter().find(|similar| similar.image as usize == b);
            // Weights have 16 bits after the point, and similarities 24.
            let similarity = f64::from(similarity.map_or(0.0, |similar| similar.similarity));
            let expected = if expected.is_nan() { 0.0 } else { expected };
            assert!((similarity - expected).abs() < 1e-5, "{a} {b}: {similarity} {expected}");
        }
        let order = |two: &[Similar]| {
            two[0].similarity > two[1].similarity
                || two[0].similarity == two[1].similarity && two[0].image < two[1].image
        };
        assert!(found.windows(2).all(order));
    }
    assert!(found[70].is_empty() && found[71].is_empty());
    let few = index.most_similar(5);
    assert!(few.iter().zip(&found).all(|(few, all)| few[..] == all[..few.len().min(5)]));
}

#[test]
fn inverted_index_finds_overlapping_images() {
    let images = wall_sequence(60);
    let (described, index) = inverted_index(&images);
    let found = index.most_similar(4);
    let near = |(a, others): (u32, &Vec<Similar>)| {
        // Images up to three positions apart share at least half of their features.
        others.iter().filter(|other| other.image.abs_diff(a) <= 3).count()
    };
    let right: usize = (0..).zip(&found).map(near).sum();
    assert!(right >= 60 * 4 * 9 / 10, "{right}");
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (again, index) = pool.install(|| inverted_index(&images));
        assert_eq!(again, described);
        assert_eq!(pool.install(|| index.most_similar(4)), found);
    }
}

#[test]
fn repeated_features_of_an_image_count_once() {
    let mut images = wall_sequence(30);
    let before = inverted_index(&images).1.most_similar(3);
    let window = images[0][0];
    images[3].extend([window; 40]);
    images[20].extend([window; 40]);
    let after = inverted_index(&images).1.most_similar(3);
    let others = |found: &[Similar]| found.iter().map(|s| s.image).collect::<Vec<_>>();
    assert!(!others(&after[3]).contains(&20) && !others(&after[20]).contains(&3));
    assert_eq!(others(&before[3]).len(), 3);
}

#[test]
fn vocabulary_tree_of_few_descriptors() {
    let nothing = VocabularyTree::learn(&[], 100, 0);
    assert!(nothing.is_empty());
    let described = [nothing.describe(&noise(9, 1)), nothing.describe(&[])];
    let index = InvertedIndex::new(&nothing, &described);
    assert_eq!((index.len(), index.is_empty()), (2, false));
    assert_eq!(index.most_similar(3), [vec![], vec![]]);
    let sample = noise(5, 3);
    let vocabulary = VocabularyTree::learn(&sample, 100, 0);
    assert!((1..=100).contains(&vocabulary.len()));
    assert_eq!(vocabulary.describe(&sample).words().len().min(1), 1);
}

/// The tree finds the nearest word of all for most descriptors, and always that of the node.
#[test]
fn words_are_mostly_the_nearest_of_all() {
    let sample = noise(2000, 12);
    let vocabulary = VocabularyTree::learn(&sample, 250, 0);
    let distance = |descriptor: &SiftDescriptor, word: u32| {
        crate::distance::squared_distance(descriptor, vocabulary.word(word))
    };
    let words = vocabulary.assign(&sample);
    let is_nearest = |(descriptor, &word): (&SiftDescriptor, &u32)| {
        (0..vocabulary.len() as u32).all(|w| distance(descriptor, w) >= distance(descriptor, word))
    };
    let nearest = sample.iter().zip(&words).filter(|&pair| is_nearest(pair)).count();
    // Directions without clusters are the hardest case; one in 250 words would be luck.
    assert!(nearest > sample.len() / 4, "{nearest}");
    assert_eq!(vocabulary.assign(&sample[7..9]), words[7..9]);
}

proptest! {
    #[test]
    fn dot_products_are_exact_on_every_instruction_set(
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
    fn describes_any_descriptors(
        bytes in prop::collection::vec(any::<u8>(), 0..40),
        seed in any::<u64>(),
    ) {
        let image: Vec<SiftDescriptor> = bytes
            .iter()
            .map(|&x| std::array::from_fn(|k| if k % 3 == 0 { x } else { 255 - x }))
            .collect();
        let vocabulary =
            Vocabulary::learn(&image, &VocabularyOptions { words: 7, rounds: 2, seed });
        let index: RetrievalIndex = std::iter::once(vocabulary.describe(&image)).collect();
        let found = index.most_similar(&vocabulary.describe(&image), 1, |_| true);
        prop_assert!(found[0].similarity <= 1.0 + 1e-5 && found[0].similarity >= 0.0);
    }
}
