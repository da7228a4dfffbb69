//! Evaluation of preemptive matching. Prints one JSON line per pair: the matches of all features,
//! and the numbers of matches of the largest features. `bench/matching.py` verifies the pairs and
//! counts the rejected ones.
//!
//! `cargo run --release -p tiepoint-matching --example preempt REACH STEM...`, where `STEM.u8`
//! holds 128 bytes per descriptor, `STEM.f32` the scale of every keypoint, and images up to REACH
//! apart in the list are paired.

#![expect(clippy::print_stdout, reason = "an example is a program")]

use std::error::Error;
use std::time::Instant;

use tiepoint_features::SiftDescriptor;
use tiepoint_matching::sift::{Prepared, match_prepared};
use tiepoint_matching::{Match, Options, PairSelection, PreemptiveMatching, Sequence};

/// The evaluated numbers of leading features.
const LEADING: [usize; 4] = [128, 256, 512, 1024];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [overlap, stems @ ..] = arguments.as_slice() else {
        return Err("usage: preempt REACH STEM...".into());
    };
    let images: Vec<Image> = stems.iter().map(|stem| read(stem)).collect::<Result<_, _>>()?;
    let leading: Vec<[Prepared; LEADING.len()]> =
        images.iter().map(|image| LEADING.map(|n| image.largest(n))).collect();
    let prepared: Vec<Prepared> = images
        .iter()
        .map(|image| Prepared::with_leading(&image.descriptors, image.order(512)))
        .collect();
    let selection = PairSelection::sequential(overlap.parse()?);
    let options = Options::default();
    let always_preempted =
        Options { preempt: Some(PreemptiveMatching { min_matches: u32::MAX }), ..options.clone() };
    for (i, j) in selection.pairs(&[Sequence::new((0..images.len() as u32).collect())]) {
        let (a, b) = (i as usize, j as usize);
        let start = Instant::now();
        let matches = match_prepared(&prepared[a], &prepared[b], &options);
        let full_ms = 1e3 * start.elapsed().as_secs_f64();
        let start = Instant::now();
        match_prepared(&prepared[a], &prepared[b], &always_preempted);
        let preempt_ms = 1e3 * start.elapsed().as_secs_f64();
        let counts: Vec<usize> = (0..LEADING.len())
            .map(|k| match_prepared(&leading[a][k], &leading[b][k], &options).len())
            .collect();
        let list = |index: fn(&Match) -> u32| matches.iter().map(index).collect::<Vec<_>>();
        print!(r#"{{"i":{i},"j":{j},"leading":{LEADING:?},"counts":{counts:?},"#);
        println!(
            r#""full_ms":{full_ms},"preempt_ms":{preempt_ms},"a":{:?},"b":{:?}}}"#,
            list(|m| m.a),
            list(|m| m.b)
        );
    }
    Ok(())
}

/// The descriptors of an image, and their indices in descending order of the scales.
struct Image {
    descriptors: Vec<SiftDescriptor>,
    order: Vec<usize>,
}

impl Image {
    fn order(&self, count: usize) -> &[usize] {
        &self.order[..self.order.len().min(count)]
    }

    fn largest(&self, count: usize) -> Prepared {
        let all: Vec<SiftDescriptor> =
            self.order(count).iter().map(|&i| self.descriptors[i]).collect();
        Prepared::new(&all)
    }
}

fn read(stem: &str) -> Result<Image, Box<dyn Error>> {
    let load = |extension| {
        let path = format!("{stem}.{extension}");
        std::fs::read(&path).map_err(|error| format!("{path}: {error}"))
    };
    let descriptors = load("u8")?.as_chunks::<128>().0.to_vec();
    let scales: Vec<f32> =
        load("f32")?.as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
    let mut order: Vec<usize> = (0..descriptors.len().min(scales.len())).collect();
    order.sort_by(|&i, &j| scales[j].total_cmp(&scales[i]));
    Ok(Image { descriptors, order })
}
