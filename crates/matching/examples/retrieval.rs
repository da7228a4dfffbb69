//! Retrieval of overlapping photos by the inverted index: pairs, recall, time and memory.
//!
//! ```text
//! cargo run --release -p tiepoint-matching --example retrieval -- \
//!     FOLDER [POINTS] [DESCRIPTORS_PER_WORD] [all]
//! cargo run --release -p tiepoint-matching --example retrieval -- scale PHOTOS
//! ```
//!
//! The first form takes `FOLDER/photos/*.jpg` and the true pairs with at least POINTS (30) common
//! points in `FOLDER/truth.csv`, as `tiepoint-synth --example unordered` writes them. Extracted
//! descriptors are kept in `FOLDER/descriptors.bin`. With `all`, retrieval by global descriptors of
//! all photos with all follows. The second form simulates photos of 1,000 features: a place has ten
//! photos with 200 features in common, and the others are noise.

#![allow(clippy::print_stdout)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Instant;

use rayon::prelude::*;
use tiepoint_features::{GrayView, Options, Sift, SiftDescriptor};
use tiepoint_matching::retrieval::{
    GlobalDescriptor, ImageWords, InvertedIndex, RetrievalIndex, Vocabulary, VocabularyOptions,
    VocabularyTree,
};
use tiepoint_simd::Rng;

/// As in the pipeline.
const DESCRIPTORS_PER_WORD: usize = 128;
const SAMPLE_PER_WORD: usize = 8;
/// Numbers of similar images to measure.
const COUNTS: [usize; 6] = [5, 10, 20, 50, 100, 200];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let first = arguments.first().ok_or("usage: retrieval FOLDER [POINTS] | scale PHOTOS")?;
    if first == "scale" {
        let count: usize = arguments.get(1).ok_or("usage: retrieval scale PHOTOS")?.parse()?;
        return scale(count);
    }
    let folder = Path::new(first);
    let min_points: usize = arguments.get(1).map_or(Ok(30), |text| text.parse())?;
    let names = names(&folder.join("photos"))?;
    let photos = descriptors(folder, &names)?;
    let number: BTreeMap<&str, u32> = names.iter().map(String::as_str).zip(0..).collect();
    let mut truth = BTreeSet::new();
    for line in std::fs::read_to_string(folder.join("truth.csv"))?.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        if fields[2].parse::<usize>()? >= min_points {
            let (a, b) = (number[fields[0]], number[fields[1]]);
            truth.insert((a.min(b), a.max(b)));
        }
    }
    println!("{} photos, {} true pairs", photos.len(), truth.len());
    let per_word: usize = arguments.get(2).map_or(Ok(DESCRIPTORS_PER_WORD), |text| text.parse())?;
    let (ranked, seconds) = inverted(photos.len(), per_word, |k| photos[k].clone());
    show("inverted", &ranked, &truth, seconds);
    if arguments.get(3).is_some() {
        let start = Instant::now();
        let ranked = vlad(&photos);
        show("VLAD and diffusion", &ranked, &truth, [0.0, 0.0, start.elapsed().as_secs_f64()]);
    }
    Ok(())
}

fn names(photos: &Path) -> Result<Vec<String>, std::io::Error> {
    let mut names: Vec<String> = std::fs::read_dir(photos)?
        .map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()))
        .collect::<Result<_, std::io::Error>>()?;
    names.sort();
    Ok(names)
}

/// Descriptors of the photos, from the file of an earlier run if it is there.
fn descriptors(
    folder: &Path,
    names: &[String],
) -> Result<Vec<Vec<SiftDescriptor>>, Box<dyn std::error::Error>> {
    let kept = folder.join("descriptors.bin");
    if let Ok(bytes) = std::fs::read(&kept) {
        let mut photos = Vec::new();
        let mut rest = &bytes[..];
        while let Some((count, after)) = rest.split_first_chunk::<8>() {
            let (of_photo, after) = after.split_at(128 * u64::from_le_bytes(*count) as usize);
            photos.push(of_photo.as_chunks::<128>().0.to_vec());
            rest = after;
        }
        return Ok(photos);
    }
    let extract = |name: &String| -> Result<Vec<SiftDescriptor>, String> {
        let image = image::open(folder.join("photos").join(name)).map_err(|e| e.to_string())?;
        let grey = image.to_luma8();
        let view = GrayView::new(grey.as_raw(), grey.width() as usize, grey.height() as usize);
        let mut sift = Sift::new(Options::default()).map_err(|error| error.to_string())?;
        let found = sift.extract(&view, None).map_err(|error| error.to_string())?;
        Ok(found.descriptors.as_sift().unwrap_or_default().to_vec())
    };
    let photos: Vec<Vec<SiftDescriptor>> =
        names.par_iter().map(extract).collect::<Result<_, String>>()?;
    let mut bytes = Vec::new();
    for photo in &photos {
        bytes.extend((photo.len() as u64).to_le_bytes());
        bytes.extend(photo.as_flattened());
    }
    std::fs::write(kept, bytes)?;
    Ok(photos)
}

/// The most similar photos to each by the inverted index, and the seconds for vocabulary,
/// description and queries.
fn inverted(
    count: usize,
    per_word: usize,
    photo: impl Fn(usize) -> Vec<SiftDescriptor> + Sync,
) -> (Vec<Vec<u32>>, [f64; 3]) {
    let most = COUNTS[COUNTS.len() - 1];
    let start = Instant::now();
    let leading = |k: usize| photo(k).len().min(Vocabulary::LEADING);
    let leading: Vec<usize> = (0..count).into_par_iter().map(leading).collect();
    let words = leading.iter().sum::<usize>().div_ceil(per_word);
    let of_photo = (SAMPLE_PER_WORD * words).div_ceil(count.max(1));
    let sample: Vec<SiftDescriptor> = (0..count)
        .into_par_iter()
        .flat_map_iter(|k| Vocabulary::sample(&photo(k), of_photo).copied().collect::<Vec<_>>())
        .collect();
    let vocabulary = VocabularyTree::learn(&sample, words, 0);
    drop(sample);
    let learn_s = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let described: Vec<ImageWords> =
        (0..count).into_par_iter().map(|k| vocabulary.describe(&photo(k))).collect();
    let describe_s = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let index = InvertedIndex::new(&vocabulary, &described);
    drop(described);
    let found = index.most_similar(most);
    let ranked = found.iter().map(|others| others.iter().map(|other| other.image).collect());
    (ranked.collect(), [learn_s, describe_s, start.elapsed().as_secs_f64()])
}

/// The same by global descriptors and diffusion, all photos with all.
fn vlad(photos: &[Vec<SiftDescriptor>]) -> Vec<Vec<u32>> {
    let step = photos.len().div_ceil(256).max(1);
    let sample: Vec<SiftDescriptor> = photos
        .iter()
        .step_by(step)
        .flat_map(|photo| Vocabulary::sample(photo, 200).copied())
        .collect();
    let vocabulary = Vocabulary::learn(&sample, &VocabularyOptions::default());
    let described: Vec<GlobalDescriptor> =
        photos.par_iter().map(|photo| vocabulary.describe(photo)).collect();
    let index: RetrievalIndex = described.into_iter().collect();
    index.related(COUNTS[COUNTS.len() - 1], |_, _| true)
}

fn show(
    name: &str,
    ranked: &[Vec<u32>],
    truth: &BTreeSet<(u32, u32)>,
    [learn_s, describe_s, query_s]: [f64; 3],
) {
    println!(
        "{name}: vocabulary {learn_s:.1} s, description {describe_s:.1} s, query {query_s:.1} s"
    );
    for count in COUNTS {
        let pairs: BTreeSet<(u32, u32)> = (0..)
            .zip(ranked)
            .flat_map(|(a, others)| {
                others.iter().take(count).map(move |&b: &u32| (b.min(a), b.max(a)))
            })
            .collect();
        let found = truth.iter().filter(|pair| pairs.contains(pair)).count();
        println!(
            "  {count:4}: {} pairs, {:.4} of the true ones, {:.4} of the chosen are true",
            pairs.len(),
            found as f64 / truth.len() as f64,
            found as f64 / pairs.len() as f64
        );
    }
}

/// Times and memory for simulated photos.
fn scale(count: usize) -> Result<(), Box<dyn std::error::Error>> {
    let photo = |k: usize| -> Vec<SiftDescriptor> {
        let of_place = (0..200).map(|i| simulated((k / 10) as u64, i, (k % 10) as u64));
        let own = (200..1000).map(|i| simulated(k as u64 + (1 << 40), i, 0));
        of_place.chain(own).collect()
    };
    let (ranked, [learn_s, describe_s, query_s]) = inverted(count, DESCRIPTORS_PER_WORD, photo);
    let right: usize = ranked
        .iter()
        .enumerate()
        .map(|(a, others)| others.iter().take(9).filter(|&&b| b as usize / 10 == a / 10).count())
        .sum();
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("");
    println!(
        "{count} photos: vocabulary {learn_s:.1} s, description {describe_s:.1} s, query \
        {query_s:.1} s, recall {:.4}, peak memory {}",
        right as f64 / (9 * count) as f64,
        peak.trim()
    );
    Ok(())
}

/// Descriptor `i` of a place, with noise that depends on the photo.
fn simulated(place: u64, i: u64, photo: u64) -> SiftDescriptor {
    let mut state = mix(place.wrapping_mul(1_000_003).wrapping_add(i));
    let mut noise = mix(state ^ photo.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    std::array::from_fn(|_| {
        state = mix(state);
        noise = mix(noise);
        // Skewed as gradients are: most entries are small.
        let entry = (state % 256) * (state / 256 % 256) / 256 * (state / 65536 % 256) / 256;
        (entry + noise % 16).min(255) as u8
    })
}

/// Random bits that depend on these.
fn mix(z: u64) -> u64 {
    Rng::from_state(z).next_u64()
}
