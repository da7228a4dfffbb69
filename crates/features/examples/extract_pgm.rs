//! Extracts features from binary PGM files and prints the seconds per image, without reading the
//! files. `bench/sift.py` compares it with other programs.
//!
//! For each image it writes NAME.features, little-endian: the number of features (u32), then x, y,
//! scale, orientation of each (f32), then the descriptors. `--within` runs one image at a time on
//! all threads instead of one image per thread.
//!
//! ```text
//! cargo run --release -p tiepoint-features --example extract_pgm -- [--threads N] [--repeat N]
//!     [--max N] [--octave N] [--exact] [--dsp] [--within] FILE...
//! ```

#![allow(clippy::print_stdout)] // A program.

use std::path::{Path, PathBuf};
use std::time::Instant;

use rayon::prelude::*;
use tiepoint_features::{DomainSizes, Features, GrayView, Limit, Options, Sift};

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Pixels of a P5 file, and its columns and rows.
fn read_pgm(path: &Path) -> Result<(Vec<u8>, usize, usize), Failure> {
    let bytes = std::fs::read(path)?;
    let mut header = bytes.splitn(4, |b| b.is_ascii_whitespace());
    let mut word = || std::str::from_utf8(header.next().unwrap_or_default());
    let (magic, width, height) = (word()?, word()?.parse()?, word()?.parse()?);
    if magic != "P5" {
        return Err(format!("{} is not a binary PGM file", path.display()).into());
    }
    let pixels = bytes.len().checked_sub(width * height).ok_or("the file is too short")?;
    Ok((bytes[pixels..].to_vec(), width, height))
}

fn write(path: &Path, features: &Features) -> Result<(), Failure> {
    let mut bytes = (features.keypoints.len() as u32).to_le_bytes().to_vec();
    for k in &features.keypoints {
        bytes.extend([k.x, k.y, k.scale, k.orientation].iter().flat_map(|v| v.to_le_bytes()));
    }
    bytes.extend(features.descriptors.as_sift().unwrap_or_default().as_flattened());
    Ok(std::fs::write(path, bytes)?)
}

fn main() -> Result<(), Failure> {
    let mut options = Options::default();
    let (mut threads, mut repeat, mut within) = (2, 1, false);
    let mut paths = Vec::new();
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut number = || args.next().unwrap_or_default().parse::<usize>();
        match arg.as_str() {
            "--threads" => threads = number()?,
            "--repeat" => repeat = number()?,
            "--max" => options.max_features = number()?,
            "--octave" => options.first_octave = number()? as i32,
            "--exact" => options.limit = Limit::Exact,
            "--dsp" => options.domain_sizes = Some(DomainSizes::default()),
            "--within" => within = true,
            _ => paths.push(PathBuf::from(arg)),
        }
    }
    let images = paths.iter().map(|p| read_pgm(p)).collect::<Result<Vec<_>, _>>()?;
    let views: Vec<GrayView<'_>> =
        images.iter().map(|(p, w, h)| GrayView::new(p, *w, *h)).collect();
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    let mut workers = (0..threads).map(|_| Sift::new(options)).collect::<Result<Vec<_>, _>>()?;
    let mut best = f64::INFINITY;
    let mut all = Vec::new();
    for _ in 0..repeat {
        let start = Instant::now();
        all = if within {
            views
                .iter()
                .map(|v| workers[0].extract_parallel(v, None))
                .collect::<Result<Vec<_>, _>>()?
        } else {
            let share = views.len().div_ceil(threads);
            let parts = views.par_chunks(share).zip(&mut workers);
            parts
                .flat_map_iter(|(views, sift)| views.iter().map(move |v| sift.extract(v, None)))
                .collect::<Result<Vec<_>, _>>()?
        };
        best = best.min(start.elapsed().as_secs_f64() / views.len() as f64);
    }
    println!("{best:.4}");
    for (path, features) in paths.iter().zip(&all) {
        write(&path.with_extension("features"), features)?;
    }
    Ok(())
}
