//! Rendering: from the world to the linear radiance on the sensor.
//!
//! The first pass casts the ray of each pixel (sixteen at a time) and stores the key of the
//! surface. A pixel whose neighbours have the same key is shaded once, with its texture averaged
//! over its footprint. A pixel on an edge is sampled again with 4 × 4 rays; each surface is shaded
//! once, weighted by its fraction of the samples. Every row has its own pose and time, which is the
//! rolling shutter. Rows are computed in parallel, and each depends only on its index.

use rayon::prelude::*;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix3, Vector2, Vector3};

use crate::lens::Lens;
use crate::world::{Hit, LANES, MovingCarPose, NOTHING, Packet, Pixel, Ray, SurfacePoint, World};

/// Side of a tile of pixels, and of the grid of samples in a pixel: LANES is its square.
const TILE: usize = 4;
const _: () = assert!(TILE * TILE == LANES);
/// Key of the sky, and of a pixel whose ray the lens does not image.
const SKY: u64 = (NOTHING as u64) << 32;

/// Pose and time of a camera at the exposure of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowPose {
    /// Transform from the camera to the world, in metres.
    pub world_from_cam: Rigid3,
    /// True time, in seconds.
    pub time_s: f64,
}

/// Linear radiance of an image: red, green, blue of each pixel by rows; white is about 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Radiance {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width * height` pixels.
    pub pixels: Vec<[f32; 3]>,
}

/// Renders the images of a lens. The ray of each pixel is computed once.
#[derive(Clone, Debug)]
pub struct Renderer<'w> {
    world: &'w World,
    width: usize,
    height: usize,
    /// Unit rays in the camera frame, by rows; zero where the lens images no ray.
    rays: Vec<[f32; 3]>,
}

/// The pose of a row and the poses of the moving cars at its time.
struct Row {
    index: usize,
    rotation: Matrix3<f64>,
    centre: Vector3<f64>,
    moving_cars: Vec<(usize, MovingCarPose)>,
}

impl Row {
    fn moving_car(&self, moving_car: usize) -> Option<MovingCarPose> {
        self.moving_cars.iter().find(|(index, _)| *index == moving_car).map(|(_, pose)| *pose)
    }
}

impl<'w> Renderer<'w> {
    /// A renderer for images of `width` × `height` pixels through a lens.
    pub fn new(world: &'w World, lens: &Lens, width: u32, height: u32) -> Self {
        let (width, height) = (width as usize, height as usize);
        let row = |y: usize| {
            (0..width).map(move |x| {
                let pixel = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
                let ray = lens.unproject(&pixel).unwrap_or_else(Vector3::zeros);
                [ray.x as f32, ray.y as f32, ray.z as f32]
            })
        };
        let rays = (0..height).into_par_iter().flat_map_iter(row).collect();
        Self { world, width, height, rays }
    }

    /// The ray of the centre of a pixel and its differences to the next pixel on the right and
    /// below, in the camera frame.
    fn ray_in_cam(&self, x: usize, y: usize) -> [Vector3<f64>; 3] {
        let at = |x: usize, y: usize| {
            let [dx, dy, dz] = self.rays[y * self.width + x];
            Vector3::new(f64::from(dx), f64::from(dy), f64::from(dz))
        };
        let here = at(x, y);
        let right = if x + 1 < self.width { at(x + 1, y) - here } else { here - at(x - 1, y) };
        let down = if y + 1 < self.height { at(x, y + 1) - here } else { here - at(x, y - 1) };
        [here, right, down]
    }

    fn pixel(&self, row: &Row, x: usize) -> Pixel {
        let [direction, right, down] = self.ray_in_cam(x, row.index).map(|v| row.rotation * v);
        Pixel { ray: Ray { origin: row.centre, direction }, right, down }
    }

    /// Renders an image; `row_pose` gives the pose of the camera for a height on the sensor in
    /// pixels (the centre of row r is at r + 0.5).
    pub fn render(&self, row_pose: impl Fn(f64) -> RowPose + Sync) -> Radiance {
        let middle = row_pose(0.5 * self.height as f64);
        let moving_cars =
            self.world.moving_cars_near(&middle.world_from_cam.translation, middle.time_s);
        let rows: Vec<Row> = (0..self.height)
            .into_par_iter()
            .map(|index| {
                let RowPose { world_from_cam, time_s } = row_pose(index as f64 + 0.5);
                let with_pose = |&moving_car: &usize| {
                    Some((moving_car, self.world.moving_car_pose(moving_car, time_s)?))
                };
                Row {
                    index,
                    rotation: world_from_cam.rotation.to_rotation_matrix().into_inner(),
                    centre: world_from_cam.translation,
                    moving_cars: moving_cars.iter().filter_map(with_pose).collect(),
                }
            })
            .collect();
        let mut keys = vec![SKY; self.width * self.height];
        keys.par_chunks_mut(self.width * TILE).zip(rows.par_chunks(TILE)).for_each(
            |(keys, rows)| {
                for x in (0..self.width).step_by(TILE) {
                    self.trace_tile(rows, x, keys);
                }
            },
        );
        let mut pixels = vec![[0.0; 3]; self.width * self.height];
        pixels.par_chunks_mut(self.width).zip(&rows).for_each(|(pixels, row)| {
            for (x, pixel) in pixels.iter_mut().enumerate() {
                *pixel = self.shade(row, x, &keys);
            }
        });
        Radiance { width: self.width, height: self.height, pixels }
    }

    /// Computes the keys of a tile of pixels. Tiles at the right and the lower border repeat the
    /// last column and row.
    fn trace_tile(&self, rows: &[Row], x: usize, keys: &mut [u64]) {
        let place = |lane: usize| {
            (&rows[(lane / TILE).min(rows.len() - 1)], (x + lane % TILE).min(self.width - 1))
        };
        let mut packet = Packet::new([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        let mut rays = [Ray { origin: Vector3::zeros(), direction: Vector3::zeros() }; LANES];
        for (lane, ray) in rays.iter_mut().enumerate() {
            let (row, column) = place(lane);
            let [dx, dy, dz] = self.rays[row.index * self.width + column];
            let direction =
                row.rotation * Vector3::new(f64::from(dx), f64::from(dy), f64::from(dz));
            *ray = Ray { origin: row.centre, direction };
            packet.set(lane, ray);
        }
        let max_deviation = (rays[0].direction - rays[LANES - 1].direction).norm();
        self.cast(&mut packet, &rays[LANES / 2], max_deviation, |lane| place(lane).0);
        for (lane, ray) in rays.iter().enumerate() {
            if lane / TILE < rows.len() && x + lane % TILE < self.width {
                let row = place(lane).0;
                let key =
                    self.world.key(packet.id[lane], ray, |moving_car| row.moving_car(moving_car));
                keys[lane / TILE * self.width + x + lane % TILE] = key;
            }
        }
    }

    /// Casts a packet of rays, which deviate from `middle` by at most `max_deviation` per metre.
    fn cast<'r>(
        &self,
        packet: &mut Packet,
        middle: &Ray,
        max_deviation: f64,
        row_of: impl Fn(usize) -> &'r Row,
    ) {
        // A car that enters or leaves the street during the readout is rendered only if it is
        // present in every row.
        let first = row_of(0);
        let moving_cars: Vec<(usize, [MovingCarPose; LANES])> = first
            .moving_cars
            .iter()
            .filter(|(_, pose)| self.world.moving_car_is_near(pose, middle, max_deviation))
            .filter(|(moving_car, _)| row_of(LANES - 1).moving_car(*moving_car).is_some())
            .map(|&(moving_car, pose)| {
                (
                    moving_car,
                    std::array::from_fn(|lane| row_of(lane).moving_car(moving_car).unwrap_or(pose)),
                )
            })
            .collect();
        self.world.cast_packet(packet, &moving_cars);
    }

    fn shade(&self, row: &Row, x: usize, keys: &[u64]) -> [f32; 3] {
        let at = |x: usize, y: usize| keys[y * self.width + x];
        let (y, key) = (row.index, at(x, row.index));
        let pixel = self.pixel(row, x);
        if pixel.ray.direction == Vector3::zeros() {
            return [0.0; 3];
        }
        let is_inside = (x == 0 || at(x - 1, y) == key)
            && (x + 1 == self.width || at(x + 1, y) == key)
            && (y == 0 || at(x, y - 1) == key)
            && (y + 1 == self.height || at(x, y + 1) == key);
        if is_inside {
            let hit = self.resolve((key >> 32) as u32, &pixel.ray, row);
            return self.world.radiance(hit.as_ref(), &pixel);
        }
        self.shade_edge(row, &pixel)
    }

    fn resolve(&self, id: u32, ray: &Ray, row: &Row) -> Option<Hit> {
        if id == NOTHING {
            None
        } else {
            self.world.resolve(id, ray, |moving_car| row.moving_car(moving_car))
        }
    }

    /// Shades a pixel with several surfaces.
    fn shade_edge(&self, row: &Row, pixel: &Pixel) -> [f32; 3] {
        let offset = |k: usize| (k as f64 + 0.5) / TILE as f64 - 0.5;
        let ray = |[right, down]: [f64; 2]| Ray {
            origin: pixel.ray.origin,
            direction: pixel.ray.direction + pixel.right * right + pixel.down * down,
        };
        let mut packet = Packet::new([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        let offsets: [[f64; 2]; LANES] =
            std::array::from_fn(|lane| [offset(lane % TILE), offset(lane / TILE)]);
        for (lane, &offset) in offsets.iter().enumerate() {
            packet.set(lane, &ray(offset));
        }
        let max_deviation = pixel.right.norm() + pixel.down.norm();
        self.cast(&mut packet, &pixel.ray, max_deviation, |_| row);
        let keys: [u64; LANES] = std::array::from_fn(|lane| {
            self.world
                .key(packet.id[lane], &ray(offsets[lane]), |moving_car| row.moving_car(moving_car))
        });
        let mut sum = [0.0f32; 3];
        for (first, &key) in keys.iter().enumerate() {
            if keys[..first].contains(&key) {
                continue;
            }
            let of_key = || (0..LANES).filter(|&lane| keys[lane] == key);
            let count = of_key().count();
            let mean: [f64; 2] = [0, 1]
                .map(|axis| of_key().map(|lane| offsets[lane][axis]).sum::<f64>() / count as f64);
            // The mean ray of the samples of a surface may miss it, if its visible region is not
            // convex; then the nearest sample is shaded instead.
            let is_met = |offset: [f64; 2]| {
                self.world
                    .key((key >> 32) as u32, &ray(offset), |moving_car| row.moving_car(moving_car))
                    == key
            };
            let distance2 = |lane: usize| {
                (offsets[lane][0] - mean[0]).powi(2) + (offsets[lane][1] - mean[1]).powi(2)
            };
            let nearest =
                of_key().min_by(|&a, &b| distance2(a).total_cmp(&distance2(b))).unwrap_or(first);
            let offset = if is_met(mean) { mean } else { offsets[nearest] };
            let sample = Pixel { ray: ray(offset), ..*pixel };
            let hit = self.resolve((key >> 32) as u32, &sample.ray, row);
            let light = self.world.radiance(hit.as_ref(), &sample);
            sum = std::array::from_fn(|c| sum[c] + light[c] * (count as f32 / LANES as f32));
        }
        sum
    }
}

/// The surface point at a pixel position (subpixel accurate) of a lens, with the pose of its row.
pub(crate) fn surface_at(
    world: &World,
    lens: &Lens,
    pose: &RowPose,
    pixel: &Vector2<f64>,
) -> Option<SurfacePoint> {
    let ray_in_cam = lens.unproject(pixel)?;
    let origin = pose.world_from_cam.translation;
    world.cast(&Ray { origin, direction: pose.world_from_cam.rotation * ray_in_cam }, pose.time_s)
}
