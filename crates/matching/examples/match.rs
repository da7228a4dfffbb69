//! Matches the descriptors of two files, or of two synthetic images, and prints the matches.
//!
//! `cargo run --release -p tiepoint-matching --example match [A B]`, where A and B are raw files of
//! 128 bytes per descriptor (numpy: `descriptors.astype(np.uint8).tofile(path)`).

#![expect(clippy::print_stdout, reason = "an example is a program")]

use std::error::Error;
use std::time::Instant;

use tiepoint_features::{Descriptors, SiftDescriptor};
use tiepoint_matching::sift::Isa;
use tiepoint_matching::{Options, match_features};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (a, b) = match arguments.as_slice() {
        [] => synthetic_images(),
        [a, b] => (read(a)?, read(b)?),
        _ => return Err("give two files of raw descriptors, or none".into()),
    };
    let start = Instant::now();
    let matches = match_features(&a, &b, &Options::default());
    let seconds = start.elapsed().as_secs_f64();
    for m in &matches {
        println!("{} {} {:.3} rad", m.a, m.b, m.angle_rad());
    }
    println!(
        "{} matches of {} and {} features in {seconds:.4} s on {}",
        matches.len(),
        a.len(),
        b.len(),
        Isa::best()
    );
    Ok(())
}

fn read(path: &str) -> Result<Descriptors, Box<dyn Error>> {
    let bytes = std::fs::read(path).map_err(|error| format!("{path}: {error}"))?;
    match bytes.as_chunks::<128>() {
        (descriptors, []) => Ok(descriptors.to_vec().into()),
        (_, rest) => {
            Err(format!("{path}: {} bytes more than a multiple of 128", rest.len()).into())
        }
    }
}

/// Synthetic images: 1000 random descriptors of norm 512, of which every second one is in the
/// second image with noise.
fn synthetic_images() -> (Descriptors, Descriptors) {
    let mut state = 1u64;
    let mut random = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    let unit = |values: [f64; 128]| -> SiftDescriptor {
        let length = values.iter().map(|x| x * x).sum::<f64>().sqrt();
        values.map(|x| (512.0 * x / length).round().min(255.0) as u8)
    };
    let mut a = Vec::new();
    let mut b = Vec::new();
    for k in 0..1000 {
        let values: [f64; 128] = std::array::from_fn(|_| random().powi(3));
        a.push(unit(values));
        let seen_again =
            values.map(|x| if k % 2 == 0 { x + 0.05 * random() } else { random().powi(3) });
        b.push(unit(seen_again));
    }
    b.reverse();
    (a.into(), b.into())
}
