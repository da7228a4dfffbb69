//! A bounding volume hierarchy over the quads, built by the surface area heuristic (Wald 2007, "On
//! fast construction of SAH-based bounding volume hierarchies"). It is traversed by one ray in
//! double precision, or by sixteen rays in single precision, whose arithmetic the compiler
//! vectorises.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_simd::dispatch;

use super::quad::{Quad, Ray};

/// Number of rays of a packet: the pixels of a 4 × 4 tile, or the samples of one pixel.
pub(crate) const LANES: usize = 16;
/// Most quads of a leaf.
const LEAF: usize = 4;
const BINS: usize = 12;
/// Size of the traversal stack. Each child has at least an eighth of the quads, so that a tree of
/// 2³² quads has at most log 2³² / log 8/7 = 166 levels.
const STACK: usize = 168;
/// Smallest distance of a hit, in units of the direction of the ray.
const NEAREST: f32 = 0.05;
/// Id of a ray without a hit.
pub(crate) const NOTHING: u32 = u32::MAX;

type Bounds = [[f32; 3]; 2];
const EMPTY: Bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Bounds,
    /// First quad of a leaf; for an inner node its right child (the left child is the next node).
    first: u32,
    /// Number of quads of a leaf; 0 for an inner node.
    count: u32,
    axis: u32,
}

/// A quad for packets: the plane n·p = d; inside of the quad, a = A·p − a₀ and b = B·p − b₀ are in
/// 0..1.
#[derive(Clone, Copy, Debug)]
struct Plane {
    normal: [f32; 3],
    offset: f32,
    a: [f32; 3],
    a0: f32,
    b: [f32; 3],
    b0: f32,
    is_ellipse: bool,
}

/// The hierarchy.
#[derive(Clone, Debug)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    /// Quad indices in the order of the leaves.
    order: Vec<u32>,
    planes: Vec<Plane>,
}

/// Sixteen rays with the nearest hit of each.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packet {
    pub(crate) origin: [[f32; LANES]; 3],
    pub(crate) direction: [[f32; LANES]; 3],
    pub(crate) nearest: [f32; LANES],
    pub(crate) id: [u32; LANES],
}

fn bounds_of(quad: &Quad) -> Bounds {
    let mut bounds = EMPTY;
    for corner in quad.corners() {
        for axis in 0..3 {
            // Enlarged by more than the rounding of single precision.
            let (value, slack) = (corner[axis], 1e-6 * corner[axis].abs() + 1e-5);
            bounds[0][axis] = bounds[0][axis].min((value - slack) as f32);
            bounds[1][axis] = bounds[1][axis].max((value + slack) as f32);
        }
    }
    bounds
}

fn union(a: &Bounds, b: &Bounds) -> Bounds {
    let mut joined = *a;
    for axis in 0..3 {
        joined[0][axis] = joined[0][axis].min(b[0][axis]);
        joined[1][axis] = joined[1][axis].max(b[1][axis]);
    }
    joined
}

fn area(bounds: &Bounds) -> f32 {
    let [x, y, z] = std::array::from_fn(|axis| (bounds[1][axis] - bounds[0][axis]).max(0.0));
    x * y + y * z + z * x
}

impl Plane {
    fn new(quad: &Quad) -> Self {
        let single = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
        let normal = quad.normal();
        let (a, b) = (quad.u / quad.size[0], quad.v / quad.size[1]);
        Self {
            normal: single(normal),
            offset: normal.dot(&quad.origin) as f32,
            a: single(a),
            a0: a.dot(&quad.origin) as f32,
            b: single(b),
            b0: b.dot(&quad.origin) as f32,
            is_ellipse: quad.is_ellipse,
        }
    }
}

#[inline(always)]
fn dot(a: &[f32; 3], b: &[[f32; LANES]; 3], lane: usize) -> f32 {
    a[0] * b[0][lane] + a[1] * b[1][lane] + a[2] * b[2][lane]
}

impl Packet {
    /// Rays without a hit.
    pub(crate) fn new(origin: [[f32; LANES]; 3], direction: [[f32; LANES]; 3]) -> Self {
        Self { origin, direction, nearest: [f32::INFINITY; LANES], id: [NOTHING; LANES] }
    }

    pub(crate) fn set(&mut self, lane: usize, ray: &Ray) {
        for axis in 0..3 {
            self.origin[axis][lane] = ray.origin[axis] as f32;
            self.direction[axis][lane] = ray.direction[axis] as f32;
        }
    }

    #[inline(always)]
    fn intersect(&mut self, plane: &Plane, id: u32) {
        let mut distance = [0.0f32; LANES];
        let mut is_nearer = [0u32; LANES];
        for lane in 0..LANES {
            let towards = dot(&plane.normal, &self.direction, lane);
            distance[lane] = (plane.offset - dot(&plane.normal, &self.origin, lane)) / towards;
            // Intersection with the plane; the comparisons reject NaN and infinity.
            let t = distance[lane];
            let a = dot(&plane.a, &self.origin, lane) + t * dot(&plane.a, &self.direction, lane)
                - plane.a0;
            let b = dot(&plane.b, &self.origin, lane) + t * dot(&plane.b, &self.direction, lane)
                - plane.b0;
            let inside = if plane.is_ellipse {
                (a - 0.5) * (a - 0.5) + (b - 0.5) * (b - 0.5) <= 0.25
            } else {
                (0.0..=1.0).contains(&a) & (0.0..=1.0).contains(&b)
            };
            is_nearer[lane] = u32::from(inside & (t > NEAREST) & (t < self.nearest[lane]));
        }
        for lane in 0..LANES {
            self.nearest[lane] =
                if is_nearer[lane] != 0 { distance[lane] } else { self.nearest[lane] };
            self.id[lane] = if is_nearer[lane] != 0 { id } else { self.id[lane] };
        }
    }
}

impl Bvh {
    pub(crate) fn new(quads: &[Quad]) -> Self {
        let bounds: Vec<Bounds> = quads.iter().map(bounds_of).collect();
        let mut order: Vec<u32> = (0..quads.len() as u32).collect();
        let mut nodes = Vec::new();
        if !quads.is_empty() {
            build(&bounds, &mut order, 0, &mut nodes);
        }
        let planes = order.iter().map(|&index| Plane::new(&quads[index as usize])).collect();
        Self { nodes, order, planes }
    }

    /// The first hit of a ray between two distances: quad index, distance, (u, v) in metres.
    pub(crate) fn cast(
        &self,
        quads: &[Quad],
        ray: &Ray,
        min_distance: f64,
        max_distance: f64,
    ) -> Option<(u32, f64, [f64; 2])> {
        let inverse = ray.direction.map(|d| 1.0 / d);
        let mut best: Option<(u32, f64, [f64; 2])> = None;
        let mut limit = max_distance;
        if self.nodes.is_empty() {
            return None;
        }
        let mut stack = [0u32; STACK];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let index = stack[depth];
            let node = &self.nodes[index as usize];
            let (mut near, mut far) = (min_distance, limit);
            for axis in 0..3 {
                let low = (f64::from(node.bounds[0][axis]) - ray.origin[axis]) * inverse[axis];
                let high = (f64::from(node.bounds[1][axis]) - ray.origin[axis]) * inverse[axis];
                // `min` and `max` drop the NaN of a ray in a face of the box.
                near = near.max(low.min(high));
                far = far.min(low.max(high));
            }
            if near > far {
                continue;
            }
            if node.count == 0 {
                let (left, right) = (index + 1, node.first);
                let is_backwards = ray.direction[node.axis as usize] < 0.0;
                let order = if is_backwards { [left, right] } else { [right, left] };
                stack[depth..depth + 2].copy_from_slice(&order);
                depth += 2;
                continue;
            }
            for &quad in &self.order[node.first as usize..(node.first + node.count) as usize] {
                if let Some((distance, uv)) = quads[quad as usize].intersect(ray, min_distance)
                    && distance < limit
                {
                    (best, limit) = (Some((quad, distance, uv)), distance);
                }
            }
        }
        best
    }

    /// Updates the nearest hits of a packet; ids are quad indices plus `first_id`.
    pub(crate) fn cast_packet(&self, packet: &mut Packet, first_id: u32) {
        if self.nodes.is_empty() {
            return;
        }
        cast_packet(self, packet, first_id);
    }

    #[inline(always)]
    fn cast_packet_here(&self, packet: &mut Packet, first_id: u32) {
        let inverse = packet.direction.map(|axis| axis.map(|d| 1.0 / d));
        let scaled: [[f32; LANES]; 3] = std::array::from_fn(|axis| {
            std::array::from_fn(|lane| packet.origin[axis][lane] * inverse[axis][lane])
        });
        let mut stack = [0u32; STACK];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let index = stack[depth];
            let node = &self.nodes[index as usize];
            let mut is_hit = [0u32; LANES];
            for lane in 0..LANES {
                let (mut near, mut far) = (NEAREST, packet.nearest[lane]);
                for axis in 0..3 {
                    let low = node.bounds[0][axis] * inverse[axis][lane] - scaled[axis][lane];
                    let high = node.bounds[1][axis] * inverse[axis][lane] - scaled[axis][lane];
                    let (first, last) = if low < high { (low, high) } else { (high, low) };
                    near = if first > near { first } else { near };
                    far = if last < far { last } else { far };
                }
                is_hit[lane] = u32::from(near <= far);
            }
            if is_hit.iter().fold(0, |any, &met| any | met) == 0 {
                continue;
            }
            if node.count == 0 {
                let (left, right) = (index + 1, node.first);
                let is_backwards = packet.direction[node.axis as usize][LANES / 2] < 0.0;
                let order = if is_backwards { [left, right] } else { [right, left] };
                stack[depth..depth + 2].copy_from_slice(&order);
                depth += 2;
                continue;
            }
            for k in node.first..node.first + node.count {
                packet.intersect(&self.planes[k as usize], first_id + self.order[k as usize]);
            }
        }
    }
}

dispatch! {
    /// [`Bvh::cast_packet_here`], compiled for the vectors of the processor.
    fn cast_packet(bvh: &Bvh, packet: &mut Packet, first_id: u32) {
        bvh.cast_packet_here(packet, first_id)
    }
}

/// Appends the hierarchy over `order` to `nodes`; `start` is the position of `order` in the list of
/// all quads.
fn build(bounds: &[Bounds], order: &mut [u32], start: usize, nodes: &mut Vec<Node>) {
    let whole = order.iter().fold(EMPTY, |sum, &index| union(&sum, &bounds[index as usize]));
    let here = nodes.len();
    nodes.push(Node { bounds: whole, first: start as u32, count: order.len() as u32, axis: 0 });
    if order.len() <= LEAF {
        return;
    }
    let centre = |index: u32, axis: usize| {
        let bounds = &bounds[index as usize];
        0.5 * (bounds[0][axis] + bounds[1][axis])
    };
    let mut best = (f32::INFINITY, 0, 0.0);
    for axis in 0..3 {
        let (low, high) =
            order.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &index| {
                (low.min(centre(index, axis)), high.max(centre(index, axis)))
            });
        if high <= low {
            continue;
        }
        let bin_of = |index: u32| {
            (((centre(index, axis) - low) / (high - low) * BINS as f32) as usize).min(BINS - 1)
        };
        let mut bins = [(EMPTY, 0usize); BINS];
        for &index in order.iter() {
            let bin = &mut bins[bin_of(index)];
            *bin = (union(&bin.0, &bounds[index as usize]), bin.1 + 1);
        }
        for split in 1..BINS {
            let side = |bins: &[(Bounds, usize)]| {
                let (bounds, count) =
                    bins.iter().fold((EMPTY, 0), |sum, bin| (union(&sum.0, &bin.0), sum.1 + bin.1));
                if count == 0 { f32::INFINITY } else { area(&bounds) * count as f32 }
            };
            let cost = side(&bins[..split]) + side(&bins[split..]);
            if cost < best.0 {
                best = (cost, axis, low + (high - low) * split as f32 / BINS as f32);
            }
        }
    }
    let (_, axis, at) = best;
    order.sort_by(|&a, &b| centre(a, axis).total_cmp(&centre(b, axis)).then(a.cmp(&b)));
    // Each child has at least an eighth of the quads, which bounds the depth.
    let middle = order.partition_point(|&index| centre(index, axis) < at);
    let middle = middle.clamp(order.len() / 8 + 1, order.len() - order.len() / 8 - 1);
    nodes[here].axis = axis as u32;
    nodes[here].count = 0;
    let (left, right) = order.split_at_mut(middle);
    build(bounds, left, start, nodes);
    nodes[here].first = nodes.len() as u32;
    build(bounds, right, start + middle, nodes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_geometry::Rng;

    const QUADS: usize = 300;
    const RAYS: usize = 2000;

    fn direction(rng: &mut Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| rng.normal()).normalize()
    }

    fn scene(rng: &mut Rng) -> Vec<Quad> {
        (0..QUADS)
            .map(|k| {
                let u = direction(rng);
                let v = u.cross(&direction(rng)).normalize();
                let origin = Vector3::from_fn(|_, _| 20.0 * (rng.uniform() - 0.5));
                let size = [0.2 + 3.0 * rng.uniform(), 0.2 + 3.0 * rng.uniform()];
                Quad { origin, u, v, size, is_ellipse: k % 3 == 0, surface: 0 }
            })
            .collect()
    }

    #[test]
    fn rays_and_packets_agree_with_a_linear_search() {
        // Distance of hits from an edge or another quad within which single precision may decide
        // differently, in metres.
        const SINGLE_M: f64 = 1e-4;
        let mut rng = Rng::stream(11, &[]);
        let quads = scene(&mut rng);
        let bvh = Bvh::new(&quads);
        let mut disagreements = 0;
        for _ in 0..RAYS / LANES {
            let rays: [Ray; LANES] = std::array::from_fn(|_| Ray {
                origin: Vector3::from_fn(|_, _| 2.0 * rng.uniform()),
                direction: direction(&mut rng),
            });
            let mut packet = Packet::new(
                std::array::from_fn(|axis| {
                    std::array::from_fn(|lane| rays[lane].origin[axis] as f32)
                }),
                std::array::from_fn(|axis| {
                    std::array::from_fn(|lane| rays[lane].direction[axis] as f32)
                }),
            );
            let mut portable = packet;
            bvh.cast_packet_here(&mut portable, 100);
            bvh.cast_packet(&mut packet, 100);
            assert_eq!((packet.id, packet.nearest), (portable.id, portable.nearest));
            for (lane, ray) in rays.iter().enumerate() {
                let min_distance = f64::from(NEAREST);
                let slow = (0..QUADS as u32)
                    .filter_map(|k| {
                        quads[k as usize].intersect(ray, min_distance).map(|(t, uv)| (k, t, uv))
                    })
                    .min_by(|a, b| a.1.total_cmp(&b.1));
                assert_eq!(bvh.cast(&quads, ray, min_distance, f64::INFINITY), slow);
                let fast = (packet.id[lane] != NOTHING).then(|| packet.id[lane] - 100);
                let agrees = fast == slow.map(|hit| hit.0)
                    && slow.is_none_or(|hit| {
                        (hit.1 - f64::from(packet.nearest[lane])).abs() < SINGLE_M
                    });
                disagreements += usize::from(!agrees);
            }
        }
        assert!(disagreements <= 2, "{disagreements} of {RAYS}");
    }

    #[test]
    fn empty_hierarchy_has_no_hits() {
        let ray = Ray { origin: Vector3::zeros(), direction: Vector3::z() };
        assert_eq!(Bvh::new(&[]).cast(&[], &ray, 0.0, f64::INFINITY), None);
    }
}
