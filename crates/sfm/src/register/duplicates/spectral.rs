//! Divisions by eigenvectors, from which the search starts.
//!
//! Two images are alike if one finds more than the usual share of the points that the other
//! observes and that it is expected to observe. For a point with n observers that the share μ of
//! the images finds which are expected to, an image that finds it counts (1 − μ) / n² for each
//! observer, and one that misses it −μ / n². The signs of the leading eigenvectors of the
//! normalised matrix divide the images into parts that are alike (Shi & Malik 2000).

use rayon::prelude::*;
use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::{DMatrix, SymmetricEigen};

use super::expected::Expectations;

/// Eigenvectors. On twins-apart, seeds 11 and 12, local search from one of the first four leads to
/// the two houses (a prototype). Not varied.
const VECTORS: usize = 4;
/// Steps of the subspace iteration. Only signs matter. Not varied.
const STEPS: usize = 100;
/// Key of the random stream of the first subspace.
const STREAM: u64 = 0x7370_6563;

/// Rows of a sparse matrix: columns and values.
type Rows = Vec<Vec<(usize, f64)>>;

/// Divisions by the signs of eigenvectors, in descending order of the eigenvalues.
pub(super) fn divisions(expectations: &Expectations, seed: u64) -> Vec<Vec<bool>> {
    let rows = likeness(expectations);
    let num = rows.len();
    let mut rng = Rng::stream(seed, &[STREAM]);
    let mut basis = DMatrix::from_fn(num, VECTORS.min(num), |_, _| rng.normal());
    for _ in 0..STEPS {
        // The eigenvalues lie within ±1: those of the sum with the identity are not negative.
        basis = (&basis + product(&rows, &basis)).qr().q();
    }
    let small = basis.transpose() * product(&rows, &basis);
    let eigen = SymmetricEigen::new((&small + small.transpose()) * 0.5);
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let vectors = basis * eigen.eigenvectors;
    order.iter().map(|k| vectors.column(*k).iter().map(|value| *value > 0.0).collect()).collect()
}

fn product(rows: &Rows, basis: &DMatrix<f64>) -> DMatrix<f64> {
    let mut product = DMatrix::zeros(rows.len(), basis.ncols());
    for (row, entries) in rows.iter().enumerate() {
        for &(column, value) in entries {
            for k in 0..basis.ncols() {
                product[(row, k)] += value * basis[(column, k)];
            }
        }
    }
    product
}

/// The normalised symmetric matrix.
fn likeness(expectations: &Expectations) -> Rows {
    let Expectations { observers, expected, images, .. } = expectations;
    let mut by_track: Vec<Vec<(usize, f64)>> = vec![Vec::new(); observers.len()];
    for it in expected {
        by_track[it.track].push((it.image, f64::from(u8::from(it.is_found))));
    }
    for (expected, observers) in by_track.iter_mut().zip(observers) {
        let share = expected.iter().map(|it| it.1).sum::<f64>() / expected.len().max(1) as f64;
        let scale = (observers.len() as f64).powi(-2);
        expected.iter_mut().for_each(|it| it.1 = scale * (it.1 - share));
    }
    let mut observed = vec![Vec::new(); images.len()];
    for (track, observers) in observers.iter().enumerate() {
        observers.iter().for_each(|image| observed[*image].push(track));
    }
    let row = |tracks: &Vec<usize>| {
        let mut sums = vec![0.0; images.len()];
        for (image, value) in tracks.iter().flat_map(|track| &by_track[*track]) {
            sums[*image] += value;
        }
        sums
    };
    let entries = |row: Vec<f64>| row.into_iter().enumerate().filter(|it| it.1 != 0.0).collect();
    let rows: Rows = observed.par_iter().map(row).map(entries).collect();
    let mut symmetric: Rows = vec![Vec::new(); images.len()];
    for (one, entries) in rows.iter().enumerate() {
        for &(other, value) in entries.iter().filter(|(other, _)| *other != one) {
            symmetric[one].push((other, value));
            symmetric[other].push((one, value));
        }
    }
    for entries in &mut symmetric {
        entries.sort_by_key(|it| it.0);
        let merged = entries.chunk_by(|a, b| a.0 == b.0);
        *entries = merged.map(|same| (same[0].0, same.iter().map(|it| it.1).sum())).collect();
    }
    let degree = |entries: &Vec<(usize, f64)>| entries.iter().map(|it| it.1.abs()).sum::<f64>();
    let degrees: Vec<f64> = symmetric.iter().map(degree).collect();
    for (one, entries) in symmetric.iter_mut().enumerate() {
        for (other, value) in entries {
            *value /= (degrees[one] * degrees[*other]).sqrt();
        }
    }
    symmetric
}
