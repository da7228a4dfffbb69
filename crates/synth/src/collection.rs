//! A collection of photos in no order: several cameras, a world, and poses.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::path::Path;

use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
use tiepoint_geometry::{Rigid3, Rng};
use tiepoint_scene::{Camera, Image, Reconstruction};

use crate::error::{Error, require};
use crate::lens::Lens;
use crate::photometry::{Development, develop, jpeg_bytes};
use crate::render::{Renderer, RowPose};
use crate::route::{Route, RoutePosition};
use crate::world::{ROOM_M, StreetOptions, TWINS_M, World};
use crate::write::write_file;

/// Diagonal of 35 mm film, in millimetres: the 35 mm equivalent focal length has the same diagonal
/// angle of view (CIPA DCG-001).
const FILM_DIAGONAL_MM: f64 = 43.266_615;
/// Distance of a facade from the centre line of its street, and of the photos on the other side, in
/// metres.
const PAVEMENT_M: f64 = 7.0;
/// Height of the flight above the ground, in metres.
const FLIGHT_M: f64 = 50.0;
/// Distance from a house to the photos around it, in metres.
const AROUND_HOUSE_M: f64 = 17.5;
const JPEG_QUALITY: u8 = 90;

/// What a collection shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CollectionKind {
    /// An object on a table, from around it at three heights.
    Table,
    /// A room, from inside.
    Room,
    /// Houses along streets, from above in a grid.
    Drone,
    /// The houses of one side of a street, from the other side.
    Facade,
    /// Two identical houses, from around each and along the road between them. No photo shows both.
    Twins,
    /// The same without the photos along the road.
    TwinsApart,
}

impl CollectionKind {
    /// All kinds.
    pub const ALL: [Self; 6] =
        [Self::Table, Self::Room, Self::Drone, Self::Facade, Self::Twins, Self::TwinsApart];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Table => "table",
            Self::Room => "room",
            Self::Drone => "drone",
            Self::Facade => "facade",
            Self::Twins => "twins",
            Self::TwinsApart => "twins-apart",
        }
    }
}

/// Options of a collection.
#[derive(Clone, Debug, PartialEq)]
pub struct CollectionOptions {
    /// What it shows.
    pub kind: CollectionKind,
    /// The seed of the world, the poses and all random numbers.
    pub seed: u64,
    /// Number of photos.
    pub photos: usize,
}

/// A camera of a collection.
#[derive(Clone, Debug)]
pub struct CollectionCamera {
    /// Its name, which the photos' EXIF data hold if they have any.
    pub name: &'static str,
    /// Its lens.
    pub lens: Lens,
    /// Size of its images, in pixels.
    pub width: u32,
    /// Size of its images, in pixels.
    pub height: u32,
    /// Whether its photos have EXIF data: its name and the 35 mm equivalent focal length, rounded
    /// to millimetres.
    pub has_exif: bool,
}

/// A photo, not yet rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    /// Its file name, which says nothing about the order or the camera.
    pub name: String,
    /// Index of its camera.
    pub camera: usize,
    /// Its pose, in metres.
    pub cam_from_world: Rigid3,
    /// The part of the scene that it was taken at: a twin's photos have the index of the twin (0
    /// or 1), all others `None`.
    pub twin: Option<usize>,
    development: Development,
}

/// A collection with its ground truth. Photos are rendered on demand.
#[derive(Clone, Debug)]
pub struct Collection {
    world: World,
    cameras: Vec<CollectionCamera>,
    photos: Vec<Photo>,
}

/// Where a photo is taken from, and the place in its middle, in metres.
type Sight = (Vector3<f64>, Vector3<f64>, Option<usize>);

impl Collection {
    /// Builds the world and draws the poses.
    ///
    /// # Errors
    ///
    /// [`Error::OutOfRange`] if the number of photos is not in 2..=10000.
    pub fn new(options: &CollectionOptions) -> Result<Self, Error> {
        let &CollectionOptions { kind, seed, photos: count } = options;
        require((2..=10_000).contains(&count), "photos", count as f64, "2 to 10000")?;
        let mut rng = Rng::stream(seed, &[20]);
        let (world, sights) = match kind {
            CollectionKind::Table => (World::table(seed), around_table(count, &mut rng)),
            CollectionKind::Room => (World::room(seed), inside_room(count, &mut rng)),
            CollectionKind::Drone => {
                let route = Route::street_loop(200.0, &mut rng)?;
                let world = World::street(&route, &StreetOptions::default(), seed)?;
                (world, above(&route, count, &mut rng))
            }
            CollectionKind::Facade => {
                // Steps of 1.2 m, and what the last photos see.
                let street = Route::highway(1.2 * count as f64 + 60.0)?;
                let world = World::street(&street, &StreetOptions::default(), seed)?;
                (world, along_facades(&street, count, &mut rng))
            }
            CollectionKind::Twins | CollectionKind::TwinsApart => {
                let road = Route::highway(220.0)?;
                let walk = if kind == CollectionKind::Twins { count / 3 } else { 0 };
                (World::twins(&road, seed), around_twins(count, walk, &mut rng))
            }
        };
        let cameras = cameras();
        // Numbers in a random order, with gaps.
        let mut numbers: Vec<usize> = (0..2 * count).collect();
        let photos = sights.into_iter().map(|(eye, target, twin)| {
            let number = numbers.swap_remove(rng.below(numbers.len()));
            let roll = 0.04 * rng.normal();
            let gain = 1.0 + 0.1 * rng.normal().clamp(-2.0, 2.0);
            let camera = rng.below(cameras.len());
            let development = Development { gain, noise: 0.01, seed: rng.next_u64() };
            let (name, cam_from_world) = (format!("IMG_{number:05}.jpg"), look(eye, target, roll));
            Photo { name, camera, cam_from_world, twin, development }
        });
        let mut photos: Vec<Photo> = photos.collect();
        photos.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(Self { world, cameras, photos })
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The cameras.
    pub fn cameras(&self) -> &[CollectionCamera] {
        &self.cameras
    }

    /// The photos in the order of their names.
    pub fn photos(&self) -> &[Photo] {
        &self.photos
    }

    /// The renderer of a camera. Keep it for several photos: it computes the ray of each pixel
    /// once.
    pub fn renderer(&self, camera: usize) -> Renderer<'_> {
        let CollectionCamera { lens, width, height, .. } = &self.cameras[camera];
        Renderer::new(&self.world, lens, *width, *height)
    }

    /// The JPEG file of a photo.
    ///
    /// # Errors
    ///
    /// [`Error::Encode`] if the image cannot be encoded.
    pub fn jpeg(&self, photo: &Photo, renderer: &Renderer) -> Result<Vec<u8>, Error> {
        let camera = &self.cameras[photo.camera];
        let world_from_cam = photo.cam_from_world.inverse();
        let light = renderer.render(|_| RowPose { world_from_cam, time_s: 0.0 });
        let exif = if camera.has_exif { exif(camera) } else { Vec::new() };
        jpeg_bytes(&develop(&light, &photo.development), JPEG_QUALITY, &exif).ok_or_else(|| {
            Error::Encode { path: photo.name.clone().into(), reason: "JPEG refused it".to_owned() }
        })
    }

    /// Renders a photo and writes it under its name in `folder`.
    ///
    /// # Errors
    ///
    /// [`Error::Encode`] if the image cannot be encoded, [`Error::Write`] if the file cannot be
    /// written.
    pub fn write_photo(
        &self,
        folder: &Path,
        photo: &Photo,
        renderer: &Renderer,
    ) -> Result<(), Error> {
        write_file(&folder.join(&photo.name), &self.jpeg(photo, renderer)?)
    }

    /// The ground truth as a reconstruction: cameras and poses, without points.
    pub fn truth(&self) -> Reconstruction {
        let mut truth = Reconstruction::default();
        let ids: Vec<_> = self
            .cameras
            .iter()
            .map(|camera| {
                truth.add_camera(Camera {
                    intrinsics: camera.lens.paraxial_intrinsics(),
                    width: camera.width,
                    height: camera.height,
                    has_focal_prior: camera.has_exif,
                })
            })
            .collect();
        for photo in &self.photos {
            let image = Image::new(photo.name.clone(), ids[photo.camera], Vec::new());
            let image = truth.add_image(image);
            truth.register(image, photo.cam_from_world);
        }
        truth
    }
}

/// A phone, a compact camera with a longer lens, whose photos have no EXIF data, and a phone held
/// upright.
fn cameras() -> Vec<CollectionCamera> {
    let camera = |name, width: u32, height: u32, focal_px: f64, has_exif| CollectionCamera {
        name,
        lens: Lens::pinhole(focal_px, width, height),
        width,
        height,
        has_exif,
    };
    vec![
        camera("wide", 640, 480, 483.0, true),
        camera("long", 600, 400, 561.0, false),
        camera("upright", 480, 640, 522.0, true),
    ]
}

/// cam_from_world of a camera at `eye` that looks at `target`, turned by `roll_rad` about its axis.
fn look(eye: Vector3<f64>, target: Vector3<f64>, roll_rad: f64) -> Rigid3 {
    let forward = (target - eye).normalize();
    // North is up in a photo of the ground.
    let up = if forward.z.abs() > 0.99 { Vector3::y() } else { Vector3::z() };
    let right = forward.cross(&up).normalize();
    let axes = Matrix3::from_columns(&[right, forward.cross(&right), forward]);
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), roll_rad);
    let world_from_cam = Rotation3::from_matrix_unchecked(axes) * turn;
    Rigid3::new(UnitQuaternion::from_rotation_matrix(&world_from_cam), eye).inverse()
}

fn in_range(rng: &mut Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.uniform()
}

fn jitter(rng: &mut Rng, size_m: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| in_range(rng, -size_m, size_m))
}

fn direction(yaw_rad: f64, pitch_rad: f64) -> Vector3<f64> {
    let (sin, cos) = pitch_rad.sin_cos();
    Vector3::new(cos * yaw_rad.cos(), cos * yaw_rad.sin(), sin)
}

/// Three rings around the middle of the object, each evenly spaced with some disorder.
fn around_table(count: usize, rng: &mut Rng) -> Vec<Sight> {
    let sight = |index: usize, rng: &mut Rng| {
        let (ring, step) = (index % 3, (index / 3) as f64 + in_range(rng, -0.3, 0.3));
        let yaw = TAU * step / count.div_ceil(3) as f64;
        let pitch = [0.17, 0.5, 0.9][ring] + in_range(rng, -0.06, 0.06);
        let middle = Vector3::new(0.0, 0.0, 0.7);
        let eye = middle + direction(yaw, pitch) * in_range(rng, 4.8, 6.2);
        (eye, middle + jitter(rng, 0.3), None)
    };
    (0..count).map(|index| sight(index, rng)).collect()
}

/// Photos from anywhere at least 1.3 m from the walls, in all directions.
fn inside_room(count: usize, rng: &mut Rng) -> Vec<Sight> {
    let [half_width, half_depth] = [0.5 * ROOM_M[0] - 1.3, 0.5 * ROOM_M[1] - 1.3];
    let sight = |index: usize, rng: &mut Rng| {
        let eye = Vector3::new(
            in_range(rng, -half_width, half_width),
            in_range(rng, -half_depth, half_depth),
            in_range(rng, 1.3, 1.8),
        );
        let yaw = TAU * (index as f64 + in_range(rng, -0.5, 0.5)) / count as f64;
        (eye, eye + direction(yaw, in_range(rng, -0.3, 0.1)), None)
    };
    (0..count).map(|index| sight(index, rng)).collect()
}

/// A grid above a street, looking down.
fn above(route: &Route, count: usize, rng: &mut Rng) -> Vec<Sight> {
    let (low, high) = route.bounds();
    let (size, columns) = (high - low, (count as f64).sqrt().ceil() as usize);
    let rows = count.div_ceil(columns);
    let sight = |index: usize, rng: &mut Rng| {
        let cell = Vector2::new((index % columns) as f64 + 0.5, (index / columns) as f64 + 0.5);
        let share = cell.component_div(&Vector2::new(columns as f64, rows as f64));
        let place = low + size.component_mul(&share);
        let eye = place.push(FLIGHT_M) + jitter(rng, 1.0);
        (eye, eye + Vector3::new(0.0, 0.0, -FLIGHT_M) + jitter(rng, 3.0), None)
    };
    (0..count).map(|index| sight(index, rng)).collect()
}

/// Along the pavement, looking across the street.
fn along_facades(street: &Route, count: usize, rng: &mut Rng) -> Vec<Sight> {
    let step_m = (street.length_m() - 60.0) / count as f64;
    let sight = |index: usize, rng: &mut Rng| {
        let along_m = 30.0 + step_m * (index as f64 + in_range(rng, -0.4, 0.4));
        let position = RoutePosition { along_m, left_m: -PAVEMENT_M };
        let eye = street.point_beside(position).push(in_range(rng, 1.5, 1.8));
        let yaw = FRAC_PI_2 + in_range(rng, -0.35, 0.35);
        (eye, eye + direction(yaw, in_range(rng, 0.0, 0.2)), None)
    };
    (0..count).map(|index| sight(index, rng)).collect()
}

/// A ring around each house, and `walk` photos across the road on the way from the first to the
/// second.
fn around_twins(count: usize, walk: usize, rng: &mut Rng) -> Vec<Sight> {
    let each = (count - walk).div_ceil(2);
    let middles = TWINS_M.map(|[x, y]| Vector3::new(x, y, 3.0));
    let sight = |index: usize, rng: &mut Rng| {
        if index < count - walk {
            let (twin, step) = (index / each, (index % each) as f64 + in_range(rng, -0.3, 0.3));
            let eye = middles[twin]
                + direction(TAU * step / each as f64, 0.0) * in_range(rng, 16.5, AROUND_HOUSE_M);
            let eye = Vector3::new(eye.x, eye.y, in_range(rng, 1.5, 1.9));
            return (eye, middles[twin] + jitter(rng, 1.0), Some(twin));
        }
        let share = ((index - (count - walk)) as f64 + 0.5) / walk as f64;
        let [from, to] = TWINS_M.map(|[x, _]| x);
        let eye = Vector3::new(from + share * (to - from), in_range(rng, -8.0, -5.0), 1.7);
        let yaw = FRAC_PI_2 + in_range(rng, -0.15, 0.15);
        (eye, eye + direction(yaw, 0.1), None)
    };
    (0..count).map(|index| sight(index, rng)).collect()
}

/// EXIF data (TIFF, little endian): the model and the 35 mm equivalent focal length.
fn exif(camera: &CollectionCamera) -> Vec<u8> {
    const ASCII: u16 = 2;
    const SHORT: u16 = 3;
    const LONG: u16 = 4;
    let diagonal = f64::from(camera.width).hypot(f64::from(camera.height));
    let focal_mm = (camera.lens.focal_px() / diagonal * FILM_DIAGONAL_MM).round() as u32;
    let model = [camera.name.as_bytes(), &[0]].concat();
    // A directory: the number of entries, the entries of twelve bytes, the offset of the next.
    let entry = |tag: u16, kind: u16, count: u32, value: u32| {
        let mut bytes = [tag.to_le_bytes(), kind.to_le_bytes()].concat();
        bytes.extend([count.to_le_bytes(), value.to_le_bytes()].concat());
        bytes
    };
    let directory = |entries: &[Vec<u8>]| {
        [&(entries.len() as u16).to_le_bytes()[..], &entries.concat(), &[0; 4]].concat()
    };
    let (header, first, second) = (8, 2 + 2 * 12 + 4, 2 + 12 + 4);
    let first_directory = directory(&[
        entry(0x0110, ASCII, model.len() as u32, header + first + second),
        entry(0x8769, LONG, 1, header + first),
    ]);
    let second_directory = directory(&[entry(0xA405, SHORT, 1, focal_mm)]);
    let start = [b"II*\0".as_slice(), &header.to_le_bytes()].concat();
    [start, first_directory, second_directory, model].concat()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::world::Ray;

    /// Pixels between the rays that find out what a photo shows.
    const GRID_PX: usize = 20;

    fn collection(kind: CollectionKind, photos: usize) -> Collection {
        Collection::new(&CollectionOptions { kind, seed: 3, photos }).expect("valid options")
    }

    /// The points that a grid of rays of a photo hits.
    fn seen(collection: &Collection, photo: &Photo) -> Vec<Vector3<f64>> {
        let CollectionCamera { lens, width, height, .. } = &collection.cameras[photo.camera];
        let world_from_cam = photo.cam_from_world.inverse();
        let ray = |x: u32, y: u32| {
            let pixel = Vector2::new(f64::from(x), f64::from(y));
            let direction = world_from_cam.rotation * lens.unproject(&pixel)?;
            let ray = Ray { origin: world_from_cam.translation, direction };
            Some(collection.world.cast(&ray, 0.0)?.point_in_world)
        };
        let rows = (0..*height).step_by(GRID_PX);
        rows.flat_map(|y| (0..*width).step_by(GRID_PX).filter_map(move |x| ray(x, y))).collect()
    }

    /// Whether a photo shows a point.
    fn shows(collection: &Collection, photo: &Photo, point: &Vector3<f64>) -> bool {
        let CollectionCamera { lens, width, height, .. } = &collection.cameras[photo.camera];
        let is_inside = lens.project(&(photo.cam_from_world * *point)).is_some_and(|pixel| {
            (0.0..f64::from(*width)).contains(&pixel.x)
                && (0.0..f64::from(*height)).contains(&pixel.y)
        });
        let origin = photo.cam_from_world.origin_in_a();
        let ray = Ray { origin, direction: point - origin };
        is_inside && collection.world.is_clear(&ray, 0.0, 1e-6)
    }

    /// The photos of all kinds but `twins-apart` hang together: each shows a fifth of what an
    /// earlier one of a chain shows, so that a mapper can register all.
    #[test]
    fn photos_show_what_others_show() {
        for kind in CollectionKind::ALL {
            let collection = collection(kind, 90);
            let photos = collection.photos();
            let points: Vec<_> = photos.iter().map(|photo| seen(&collection, photo)).collect();
            let overlap = |a: usize, b: usize| {
                let common = points[a].iter().filter(|p| shows(&collection, &photos[b], p)).count();
                5 * common >= points[a].len()
            };
            let (mut reached, mut open) = (BTreeSet::from([0]), vec![0]);
            while let Some(one) = open.pop() {
                let is_next = |&other: &usize| {
                    !reached.contains(&other) && overlap(one, other) && overlap(other, one)
                };
                let next: Vec<usize> = (0..photos.len()).filter(is_next).collect();
                reached.extend(&next);
                open.extend(next);
            }
            let expected = match kind {
                CollectionKind::TwinsApart => photos.len() / 2,
                _ => photos.len(),
            };
            // A parked car may fill a photo across a street.
            let spare = usize::from(kind == CollectionKind::Facade);
            assert!((expected - spare..=expected).contains(&reached.len()), "{kind:?}");
            if kind == CollectionKind::TwinsApart {
                let twins: BTreeSet<_> = reached.iter().map(|&k| photos[k].twin).collect();
                assert_eq!(twins.len(), 1);
            }
        }
    }

    /// No photo shows both houses, and the same view of each is the same image of a house.
    #[test]
    fn twins_are_identical_and_apart() {
        let collection = collection(CollectionKind::Twins, 60);
        let middle = |twin: usize| Vector3::new(TWINS_M[twin][0], TWINS_M[twin][1], 0.0);
        let is_of = |point: &Vector3<f64>, twin: usize| {
            let off = point - middle(twin);
            off.x.abs() < 5.5 && off.y.abs() < 4.6 && off.z > 0.5
        };
        let mut shown = [0; 2];
        for photo in collection.photos() {
            let points = seen(&collection, photo);
            let twins = [0, 1].map(|twin| points.iter().any(|point| is_of(point, twin)));
            assert_ne!(twins, [true; 2], "{}", photo.name);
            for twin in 0..2 {
                shown[twin] += usize::from(twins[twin]);
                assert!(twins[twin] || photo.twin != Some(twin), "{}", photo.name);
            }
        }
        assert!(shown[0] >= 20 && shown[1] >= 20, "{shown:?}");

        // From above the cars and hedges beside the houses, so that nothing hides the walls.
        let lens = Lens::pinhole(60.0, 64, 48);
        let renderer = Renderer::new(&collection.world, &lens, 64, 48);
        for yaw in [-2.0, -1.0, 0.5, 2.2] {
            let images = [0, 1].map(|twin| {
                let target = middle(twin) + Vector3::new(0.0, 0.0, 6.0);
                let pose = look(target + direction(yaw, 0.3) * 13.0, target, 0.0);
                let world_from_cam = pose.inverse();
                let light = renderer.render(|_| RowPose { world_from_cam, time_s: 0.0 });
                let pixels = light.pixels.into_iter().enumerate();
                let of_house = |(k, light): (usize, [f32; 3])| {
                    let pixel = Vector2::new((k % 64) as f64 + 0.5, (k / 64) as f64 + 0.5);
                    let direction = world_from_cam.rotation * lens.unproject(&pixel)?;
                    let ray = Ray { origin: world_from_cam.translation, direction };
                    let point = collection.world.cast(&ray, 0.0)?.point_in_world;
                    (is_of(&point, twin) && point.z > 2.0).then_some((k, light))
                };
                pixels.filter_map(of_house).collect::<Vec<_>>()
            });
            let [one, other] = &images;
            assert!(one.len() > 300, "{}", one.len());
            let same = one.iter().zip(other).filter(|(a, b)| {
                // Pixels at the border of the house also show what is behind it.
                a.0 == b.0 && a.1.iter().zip(&b.1).all(|(a, b)| (a - b).abs() < 1e-3)
            });
            assert!(same.count() * 10 > 8 * one.len());
        }
    }

    #[test]
    fn equal_options_give_equal_bytes_and_names_tell_nothing() {
        let first = collection(CollectionKind::Table, 30);
        let again = collection(CollectionKind::Table, 30);
        let other = CollectionOptions { kind: CollectionKind::Table, seed: 4, photos: 30 };
        let other = Collection::new(&other).expect("valid options");
        assert_eq!(first.photos(), again.photos());
        assert_ne!(first.photos(), other.photos());
        let photo = &first.photos()[2];
        let jpeg = |of: &Collection| {
            of.jpeg(photo, &of.renderer(photo.camera)).expect("an image of 640 pixels")
        };
        assert_eq!(jpeg(&first), jpeg(&again));
        assert_ne!(jpeg(&first), jpeg(&other));
        let names: BTreeSet<_> = first.photos().iter().map(|photo| &photo.name).collect();
        assert_eq!(names.len(), 30);
        // Neighbours in the order of names are no neighbours in space: their mean distance is half
        // of the diameter of the rings and more.
        let centres = first.photos().iter().map(|photo| photo.cam_from_world.origin_in_a());
        let centres: Vec<_> = centres.collect();
        let steps = centres.windows(2).map(|pair| (pair[1] - pair[0]).norm());
        assert!(steps.sum::<f64>() / 29.0 > 4.0);
        let one = CollectionOptions { kind: CollectionKind::Table, seed: 3, photos: 1 };
        assert!(Collection::new(&one).is_err());
    }
}
