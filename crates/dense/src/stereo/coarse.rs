//! Planes at half resolution, from the photos alone.

use super::cost::{Costs, LevelSource};
use super::field::{Cell, Field};
use super::initial::initial_field;
use super::maps::PlaneMap;
use super::seeds::{InverseDepthRange, Seed};
use super::sweep::{SweepOptions, sweep};
use super::view::{MAX_SOURCES, StereoImage};
use crate::ncc::{OUTSIDE, RADIUS};
use crate::plane::Rays;

/// Smallest side of the quarter level: four patches, below which a patch has too few neighbours.
const MIN_SIDE: usize = 4 * (2 * RADIUS + 1);
/// Sweeps on the quarter level. Random changes begin at four pixels and are halved by each sweep,
/// so that the last ones are half a pixel, the initial changes of the next level.
const QUARTER_SWEEPS: usize = 4;
const QUARTER_CHANGE_PX: f32 = 4.0;
/// Sweeps on the half level. A third one raises F1 by at most 0.2 %.
const HALF_SWEEPS: usize = 2;
const HALF_CHANGE_PX: f32 = 1.0;
/// First change of the components of a unit normal; halved by each sweep.
const CHANGE_NORMAL: f32 = 0.5;

/// Estimates the planes of an image at half resolution: from random planes near the points of the
/// sparse model on the quarter level, refined on the half level. The geometry of the sources is not
/// used. `random` is a seed of this image.
///
/// `None` without a seed or a source, or if the image is too small for a patch.
pub fn estimate_coarse(
    reference: &StereoImage,
    sources: &[&StereoImage],
    seeds: &[Seed],
    random: u64,
) -> Option<PlaneMap> {
    let sources = &sources[..sources.len().min(MAX_SOURCES)];
    let range = InverseDepthRange::of(seeds)?;
    let half = reference.halved();
    if sources.is_empty() || half.grey.width < 2 || half.grey.height < 2 {
        return None;
    }
    let half_sources: Vec<StereoImage> = sources.iter().map(|source| source.halved()).collect();
    if half_sources.iter().any(|source| source.grey.width < 2 || source.grey.height < 2) {
        return None;
    }
    let quarter = half.halved();
    let mut field = if quarter.grey.width.min(quarter.grey.height) >= MIN_SIDE {
        let quarter_sources: Vec<StereoImage> =
            half_sources.iter().map(StereoImage::halved).collect();
        let costs = costs(&quarter, &quarter_sources, range);
        let (width, height) = (quarter.grey.width, quarter.grey.height);
        let mut field = initial_field(width, height, &costs.rays, seeds, 4.0, &range, random);
        sweeps(&mut field, &quarter, &costs, QUARTER_SWEEPS, QUARTER_CHANGE_PX, random, true);
        doubled(&field, half.grey.width, half.grey.height)
    } else {
        let rays = Rays::new(&half.camera);
        initial_field(half.grey.width, half.grey.height, &rays, seeds, 2.0, &range, random)
    };
    let costs = costs(&half, &half_sources, range);
    sweeps(&mut field, &half, &costs, HALF_SWEEPS, HALF_CHANGE_PX, random ^ 1, false);
    Some(field.into_map())
}

fn costs(reference: &StereoImage, sources: &[StereoImage], range: InverseDepthRange) -> Costs {
    let sources = sources.iter().map(|source| LevelSource::new(reference, source, None));
    Costs::new(sources.collect(), Rays::new(&reference.camera), range)
}

/// Sweeps on one level, with changes that are halved from one to the next.
fn sweeps(
    field: &mut Field,
    view: &StereoImage,
    costs: &Costs,
    count: usize,
    change_px: f32,
    random: u64,
    random_plane: bool,
) {
    for index in 0..count {
        let share = 0.5f32.powi(index as i32);
        let options = SweepOptions {
            random: random.wrapping_add((index as u64 + 1).wrapping_mul(0xA076_1D64_78BD_642F)),
            has_costs: index > 0,
            // On the quarter level, the first planes are random and tell nothing about visibility;
            // then the images that see a pixel become known. On the half level they are.
            selects: random_plane == (index > 0),
            far: random_plane || index == 0,
            change_px: change_px * share,
            change_normal: CHANGE_NORMAL * share,
            random_plane,
        };
        sweep(field, &view.grey, costs, &options);
    }
}

/// The planes on the level of twice the resolution.
pub(super) fn doubled(coarse: &Field, width: usize, height: usize) -> Field {
    Field::new(width, height, |x, y| {
        let (column, row) = ((x / 2).min(coarse.width - 1), (y / 2).min(coarse.height - 1));
        let Cell { plane, cost, selection } = *coarse.cell(column, row);
        // From the centre of the pixel to that of the smaller one, in smaller pixels.
        let offset = |fine: usize, coarse: usize| fine as f32 - 2.0 * coarse as f32 - 0.5;
        let plane = plane.refined(offset(x, column), offset(y, row));
        let is_valid = plane.inverse_depth > 0.0;
        Cell { plane, cost: if is_valid { cost } else { OUTSIDE }, selection }
    })
}
