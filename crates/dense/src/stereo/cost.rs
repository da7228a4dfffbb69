//! The cost of a plane at a pixel over all source images.

use super::maps::PlaneMap;
use super::seeds::InverseDepthRange;
use super::view::{MAX_SOURCES, StereoImage};
use crate::ncc::{Ncc, OUTSIDE, Patch, Source, Warp};
use crate::plane::{Plane, Rays};
use crate::transfer::{Transfer, Transferred};

/// Weight and limit (in pixels) of the geometric term: Xu & Tao 2019, Eq. 9. Half of the weight
/// lowers F1 by up to 0.5 %; twice changes it by at most 0.1 %.
const GEOMETRIC_WEIGHT: f32 = 0.2;
const GEOMETRIC_LIMIT: f32 = 3.0;

/// Number of source images, of those with the lowest costs, that make the cost: two that agree tell
/// a surface from a chance match, and the other images may not see it. One lowers F1 by
/// up to 1.1 %, with noise by up to 5.4 %; three lower it by up to 1.3 %.
const BEST: usize = 2;

/// Largest cost of a source image that is selected, that of a depth in `filter`: above, the plane
/// is wrong and does not tell which images see the surface. Half of it raises F1 by up to 0.9 % and
/// takes up to a fifth more time; twice of it lowers F1 by up to 1.9 %.
pub(super) const MAX_SELECTED_COST: f32 = 0.7;

/// Cost of the second source image of a plane that lies in one only: with a lower cost in that one,
/// the plane is kept, but a plane that two images see is preferred. Twice of it keeps none.
const NO_EVIDENCE: f32 = MAX_SELECTED_COST;

/// Index of a source image that does not see a pixel.
const NONE: u8 = u8::MAX;

/// Indices of the source images that see a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Selection([u8; BEST]);

/// The planes of a source image, for the geometric term.
struct Geometric {
    planes: PlaneMap,
    to_reference: Transfer,
}

/// A source image on a level of the pyramid.
pub(super) struct LevelSource {
    source: Source,
    to_source: Transfer,
    geometric: Option<Geometric>,
}

impl LevelSource {
    /// `planes`: those of the source image on the same level.
    pub(super) fn new(
        reference: &StereoImage,
        source: &StereoImage,
        planes: Option<PlaneMap>,
    ) -> Self {
        let to_reference = Transfer::new(&source.camera, &reference.camera);
        Self {
            source: Source::new(&source.grey),
            to_source: Transfer::new(&reference.camera, &source.camera),
            geometric: planes.map(|planes| Geometric { planes, to_reference }),
        }
    }
}

impl Geometric {
    /// The term for a pixel and its homogeneous place in the source image.
    #[inline(always)]
    fn cost(&self, x: f32, y: f32, place: &[f32; 3]) -> f32 {
        let error = self.error_px(x, y, place).unwrap_or(GEOMETRIC_LIMIT);
        GEOMETRIC_WEIGHT * error.min(GEOMETRIC_LIMIT)
    }

    /// Distance of a pixel to its transfer to the source and, at the inverse depth there, back, in
    /// pixels (Schönberger 2016, Eq. 11); `None` without a plane there, or if the point there lies
    /// behind the camera.
    #[inline(always)]
    fn error_px(&self, x: f32, y: f32, place: &[f32; 3]) -> Option<f32> {
        let (u, v) = (place[0] / place[2], place[1] / place[2]);
        let inverse_depth = self.planes.inverse_depth_at(u, v)?;
        let [p, q, z] = self.to_reference.place(u, v, inverse_depth);
        let (dx, dy) = (p / z - x, q / z - y);
        (z > 0.0).then(|| (dx * dx + dy * dy).sqrt())
    }
}

/// Distance to the planes of a source at which its support is half, in pixels of the half level.
/// With half or twice of it, confidences predict the right depths worse
/// (`docs/benchmarks/dense.md`).
const SUPPORT_PX: f32 = 0.125;

/// What the source images say of a depth.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Support {
    /// Number of sources whose planes agree.
    pub(super) count: usize,
    /// Sum over the sources of weights from 1 (the planes agree exactly) to 0.
    pub(super) sources: f32,
    /// Root of the weighted sum of the squared angles between the rays, in rad where they are
    /// small: pixels of parallax a footprint of depth.
    pub(super) angle: f32,
}

/// All that the cost of a plane depends on, on one level.
pub(super) struct Costs {
    pub(super) sources: Vec<LevelSource>,
    pub(super) rays: Rays,
    pub(super) range: InverseDepthRange,
    /// [`BEST`], or one of one or two images, since a surface may be hidden from the other.
    best: usize,
}

/// A pixel with its patch.
pub(super) struct PixelCosts<'a> {
    costs: &'a Costs,
    patch: &'a Patch,
    x: f32,
    y: f32,
    at_infinity: [[f32; 3]; MAX_SOURCES],
}

impl Costs {
    /// The support of an inverse depth at a pixel; sources count that agree to `max_error_px`.
    pub(super) fn support(&self, x: f32, y: f32, inverse_depth: f32, max_error_px: f32) -> Support {
        let mut support = Support::default();
        for source in &self.sources {
            let to = &source.to_source;
            let place = to.place(x, y, inverse_depth);
            let error = source.geometric.as_ref().and_then(|term| term.error_px(x, y, &place));
            let Some(error) = error.filter(|_| place[2] > 0.0) else { continue };
            let weight = 1.0 / (1.0 + (error / SUPPORT_PX) * (error / SUPPORT_PX));
            support.count += usize::from(error <= max_error_px);
            support.sources += weight;
            support.angle += weight * to.squared_parallax(&place) * inverse_depth * inverse_depth;
        }
        support.angle = support.angle.sqrt() / self.rays.focal[0];
        support
    }

    /// `sources` has from one to [`MAX_SOURCES`] images.
    pub(super) fn new(sources: Vec<LevelSource>, rays: Rays, range: InverseDepthRange) -> Self {
        let best = sources.len().div_ceil(2).min(BEST);
        Self { sources, rays, range, best }
    }

    #[inline(always)]
    pub(super) fn pixel<'a>(&'a self, patch: &'a Patch, x: f32, y: f32) -> PixelCosts<'a> {
        let mut at_infinity = [[0.0; 3]; MAX_SOURCES];
        for (at_infinity, source) in at_infinity.iter_mut().zip(&self.sources) {
            *at_infinity = source.to_source.at_infinity(x, y);
        }
        PixelCosts { costs: self, patch, x, y, at_infinity }
    }
}

impl PixelCosts<'_> {
    /// The cost of a plane in one source image, of a plane that the reference image sees.
    #[inline(always)]
    fn in_source<N: Ncc>(&self, index: usize, plane: &Plane) -> f32 {
        let source = &self.costs.sources[index];
        let at_infinity = &self.at_infinity[index];
        let Plane { inverse_depth, slope } = *plane;
        let Transferred { centre, derivatives: [dx, dy] } =
            source.to_source.patch(at_infinity, [self.x, self.y], inverse_depth, slope);
        let warp = Warp { centre, dx, dy };
        let cost = N::cost(&source.source, &warp, self.patch);
        match &source.geometric {
            Some(geometric) if cost < OUTSIDE => cost + geometric.cost(self.x, self.y, &centre),
            _ => cost,
        }
    }

    #[inline(always)]
    fn is_possible(&self, plane: &Plane) -> bool {
        self.costs.range.contains(plane.inverse_depth)
            && self.costs.rays.sees(self.x, self.y, plane)
    }

    /// The cost of a plane over the source images with the lowest costs, and these images if all of
    /// them correlate with it.
    #[inline(always)]
    pub(super) fn select<N: Ncc>(&self, plane: &Plane) -> (f32, Option<Selection>) {
        if !self.is_possible(plane) {
            return (OUTSIDE, None);
        }
        let best = self.costs.best;
        let mut lowest = [OUTSIDE; BEST];
        let mut selected = [NONE; BEST];
        for index in 0..self.costs.sources.len() {
            let cost = self.in_source::<N>(index, plane);
            insert(&mut lowest, &mut selected, cost, index as u8);
        }
        // A surface that lies in one source image only has no evidence from a second one.
        for cost in lowest[1..].iter_mut().filter(|cost| **cost >= OUTSIDE) {
            *cost = NO_EVIDENCE;
        }
        let is_seen = lowest[0] < MAX_SELECTED_COST && lowest[best - 1] <= NO_EVIDENCE;
        (mean(&lowest[..best]), is_seen.then_some(Selection(selected)))
    }

    /// The mean cost of a plane over the selected source images, or over those with the lowest
    /// costs if none are selected; some number of at least `limit` if it is not below.
    #[inline(always)]
    pub(super) fn cost<N: Ncc>(
        &self,
        plane: &Plane,
        selection: Option<Selection>,
        limit: f32,
    ) -> f32 {
        let Some(Selection(selected)) = selection else { return self.select::<N>(plane).0 };
        if !self.is_possible(plane) {
            return OUTSIDE;
        }
        let best = self.costs.best;
        let limit = limit * best as f32;
        let mut sum = 0.0;
        // First those of the higher costs, which more often end it.
        for index in selected[..best].iter().rev() {
            sum += match *index {
                NONE => NO_EVIDENCE,
                index => self.in_source::<N>(usize::from(index), plane),
            };
            // The images that are left cannot have costs below zero.
            if sum >= limit {
                break;
            }
        }
        sum / best as f32
    }

    /// Change of the inverse depth that moves the pixel by one pixel in the source image with the
    /// largest parallax; `None` if no image has parallax.
    #[inline(always)]
    pub(super) fn inverse_depth_per_pixel(&self, inverse_depth: f32) -> Option<f32> {
        let mut parallax = 0.0f32;
        for (at_infinity, source) in self.at_infinity.iter().zip(&self.costs.sources) {
            let place = source.to_source.at(at_infinity, inverse_depth);
            let squared = source.to_source.squared_parallax(&place);
            if place[2] > 0.0 && squared.is_finite() {
                parallax = parallax.max(squared);
            }
        }
        (parallax > 0.0).then(|| 1.0 / parallax.sqrt())
    }
}

/// Inserts a cost and its index among the lowest ones, which are sorted.
#[inline(always)]
fn insert(lowest: &mut [f32; BEST], selected: &mut [u8; BEST], cost: f32, index: u8) {
    let mut place = BEST;
    while place > 0 && cost < lowest[place - 1] {
        place -= 1;
        if place + 1 < BEST {
            (lowest[place + 1], selected[place + 1]) = (lowest[place], selected[place]);
        }
        (lowest[place], selected[place]) = (cost, index);
    }
}

fn mean(costs: &[f32]) -> f32 {
    costs.iter().sum::<f32>() / costs.len() as f32
}
