//! A drive: the street, the vehicle, the cameras with their clocks, and every image that they take,
//! on demand.

use image::RgbImage;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{Rigid3, Rng};
use tiepoint_scene::{Camera, Image, Reconstruction};

use crate::clocks::{Clock, schedule};
use crate::error::{Error, require};
use crate::photometry::{Development, develop, through_jpeg};
use crate::render::{Renderer, RowPose, surface_at};
use crate::{
    ActionLens, Effects, Lens, Motion, Mount, Route, StreetOptions, SurfacePoint, Trajectory, World,
};

/// Focal length of the ideal pinhole, in image widths.
const PINHOLE_FOCAL: f64 = 0.60;
/// Projection through a rolling shutter ends when the row moves by less than this, in pixels.
const ROW_TOLERANCE_PX: f64 = 1e-9;
const ROW_ITERATIONS: usize = 50;
/// Periods of the wandering exposure, in seconds.
const EXPOSURE_PERIODS_S: [f64; 2] = [9.7, 4.1];

/// Which way the street runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RouteKind {
    /// Around a block, back to the start and a little further.
    Loop,
    /// Onwards.
    Open,
}

/// What to drive, with what.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveOptions {
    /// World, route and every random number follow from it.
    pub seed: u64,
    /// Which way the street runs.
    pub route: RouteKind,
    /// How long the street is, in metres.
    pub length_m: f64,
    /// How the vehicle is driven; suspension and vibration are taken from the effects.
    pub motion: Motion,
    /// What stands along the street; moving cars are taken from the effects.
    pub street: StreetOptions,
    /// The cameras.
    pub mounts: Vec<Mount>,
    /// Size of the images, in pixels.
    pub width: u32,
    /// Size of the images, in pixels.
    pub height: u32,
    /// Images a second.
    pub rate_hz: f64,
    /// What is not ideal.
    pub effects: Effects,
}

impl Default for DriveOptions {
    /// A loop of 200 m with a stereo pair that looks ahead, at ten images a second; everything
    /// ideal.
    fn default() -> Self {
        Self {
            seed: 1,
            route: RouteKind::Loop,
            length_m: 200.0,
            motion: Motion::default(),
            street: StreetOptions::default(),
            mounts: Mount::stereo(crate::Mounting::Front, 0.5).to_vec(),
            width: 640,
            height: 480,
            rate_hz: 10.0,
            effects: Effects::default(),
        }
    }
}

/// One image to be taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposure {
    /// Path of the image relative to the input: `camera/000000.png`.
    pub name: String,
    /// True time of the middle row's exposure, in seconds since the drive began.
    pub time_s: f64,
    /// What the camera writes down as its time, in seconds of its own clock.
    pub stamp_s: f64,
    development: Development,
}

/// A mount that gives swings slowly, as on rubber when the vehicle brakes and turns.
const FLEX_PERIOD_S: f64 = 5.0;

/// A camera of the drive, with the truth about it.
#[derive(Clone, Debug)]
pub struct DriveCamera {
    /// Its name, and that of its folder.
    pub name: String,
    /// Its lens.
    pub lens: Lens,
    /// Size of its images, in pixels.
    pub width: u32,
    /// Size of its images, in pixels.
    pub height: u32,
    /// Where it sits, on average.
    pub cam_from_vehicle: Rigid3,
    /// The rotation by which it swings about that place, as axis-angle, and where in its period it
    /// begins.
    flex: (Vector3<f64>, f64),
    /// Its clock.
    pub clock: Clock,
    /// Time from its first row to its last, in seconds.
    pub readout_s: f64,
    /// Its images, in order of time.
    pub exposures: Vec<Exposure>,
}

impl DriveCamera {
    fn cam_from_vehicle_at(&self, time_s: f64) -> Rigid3 {
        let (swing, phase) = self.flex;
        if swing == Vector3::zeros() {
            return self.cam_from_vehicle;
        }
        let angle = (std::f64::consts::TAU * time_s / FLEX_PERIOD_S + phase).sin();
        Rigid3::from_axis_angle(swing * angle, Vector3::zeros()) * self.cam_from_vehicle
    }
}

/// About an axis of any direction.
fn flex(rad: f64, rng: &mut Rng) -> (Vector3<f64>, f64) {
    let height = 2.0 * rng.uniform() - 1.0;
    let [azimuth, phase] = std::array::from_fn(|_| std::f64::consts::TAU * rng.uniform());
    let level = (1.0 - height * height).sqrt();
    (rad * Vector3::new(level * azimuth.cos(), level * azimuth.sin(), height), phase)
}

/// A drive with everything known about it. Nothing is rendered until it is asked for.
#[derive(Clone, Debug)]
pub struct Drive {
    route: Route,
    trajectory: Trajectory,
    world: World,
    cameras: Vec<DriveCamera>,
    jpeg_quality: Option<u8>,
}

impl Drive {
    /// Lays out the street, drives through it and sets the cameras' clocks.
    pub fn new(options: &DriveOptions) -> Result<Self, Error> {
        options.effects.validate()?;
        require(!options.mounts.is_empty(), "number of cameras", 0.0, "at least one")?;
        require(
            (0.01..=1000.0).contains(&options.rate_hz),
            "rate_hz",
            options.rate_hz,
            "0.01 to 1000",
        )?;
        for (name, size) in [("width", options.width), ("height", options.height)] {
            require((2..=20_000).contains(&size), name, f64::from(size), "2 to 20000 pixels")?;
        }
        let (seed, effects) = (options.seed, &options.effects);
        let mut rng = Rng::stream(seed, &[10]);
        let route = match options.route {
            RouteKind::Loop => Route::street_loop(options.length_m, &mut rng)?,
            RouteKind::Open => Route::open_street(options.length_m, &mut rng)?,
        };
        let street = StreetOptions { moving_cars: effects.moving_cars, ..options.street.clone() };
        let world = World::street(&route, &street, seed)?;
        let motion = Motion {
            suspension: effects.suspension,
            vibration_rad: effects.vibration_rad,
            ..options.motion.clone()
        };
        // Streams of their own: switching an effect changes nothing else.
        let trajectory = Trajectory::drive(&route, &motion, &mut Rng::stream(seed, &[11]))?;
        let cameras = options.mounts.iter().enumerate();
        let cameras =
            cameras.map(|(index, mount)| camera(options, index, mount, &trajectory)).collect();
        Ok(Self {
            route,
            trajectory,
            world,
            cameras,
            jpeg_quality: effects.photometry.jpeg_quality,
        })
    }

    /// Leaves out the images of every camera after its first `frames`.
    pub fn keep_first(&mut self, frames: usize) {
        for camera in &mut self.cameras {
            camera.exposures.truncate(frames);
        }
    }

    /// The centre line.
    pub fn route(&self) -> &Route {
        &self.route
    }

    /// Where the vehicle is when.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// The street.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The cameras, in order of the mounts.
    pub fn cameras(&self) -> &[DriveCamera] {
        &self.cameras
    }

    /// The camera and the exposure of an image, by its name; `None` for an image of another drive.
    pub fn find(&self, image: &str) -> Option<(usize, &Exposure)> {
        self.cameras.iter().enumerate().find_map(|(camera, DriveCamera { exposures, .. })| {
            // Numbers have leading zeros, so names are in order.
            let index =
                exposures.binary_search_by(|exposure| exposure.name.as_str().cmp(image)).ok()?;
            Some((camera, &exposures[index]))
        })
    }

    /// The rig's calibration: a camera's pose in the frame of the first.
    pub fn cam_from_rig(&self, camera: usize) -> Rigid3 {
        if camera == 0 {
            return Rigid3::identity();
        }
        self.cameras[camera].cam_from_vehicle * self.cameras[0].cam_from_vehicle.inverse()
    }

    /// The pose of a camera at a true time.
    pub fn cam_from_world(&self, camera: usize, time_s: f64) -> Rigid3 {
        let camera = &self.cameras[camera];
        camera.cam_from_vehicle_at(time_s) * self.trajectory.world_from_vehicle(time_s).inverse()
    }

    /// Where a camera is while it exposes height `y` (pixels) of an image whose middle row is
    /// exposed at `time_s`.
    pub fn row_pose(&self, camera: usize, time_s: f64, y: f64) -> RowPose {
        let camera = &self.cameras[camera];
        let time_s = time_s + (y / f64::from(camera.height) - 0.5) * camera.readout_s;
        let world_from_cam = self.trajectory.world_from_vehicle(time_s)
            * camera.cam_from_vehicle_at(time_s).inverse();
        RowPose { world_from_cam, time_s }
    }

    /// The pixel at which a camera images a point that stands still, rolling shutter and lens
    /// included; `None` where it does not. (Pixels may lie off the sensor; what stands in between
    /// is not looked at.)
    pub fn project(
        &self,
        camera: usize,
        time_s: f64,
        point_in_world: &Vector3<f64>,
    ) -> Option<Vector2<f64>> {
        let DriveCamera { lens, height, readout_s, .. } = &self.cameras[camera];
        let project_from_row = |y: f64| {
            let cam_from_world = self.row_pose(camera, time_s, y).world_from_cam.inverse();
            lens.project(&(cam_from_world * *point_in_world))
        };
        let mut pixel = project_from_row(0.5 * f64::from(*height))?;
        if *readout_s == 0.0 {
            return Some(pixel);
        }
        // The row that sees the point depends on where it is seen: a contraction, since images move
        // by much less than their height during the readout.
        for _ in 0..ROW_ITERATIONS {
            let next = project_from_row(pixel.y)?;
            let moved = (next.y - pixel.y).abs();
            pixel = next;
            if moved < ROW_TOLERANCE_PX {
                return Some(pixel);
            }
        }
        None
    }

    /// The true surface point that a pixel sees; `None` for the sky.
    pub fn surface_at(
        &self,
        camera: usize,
        time_s: f64,
        pixel: &Vector2<f64>,
    ) -> Option<SurfacePoint> {
        let pose = self.row_pose(camera, time_s, pixel.y);
        surface_at(&self.world, &self.cameras[camera].lens, &pose, pixel)
    }

    /// Renders images of a camera; keep it, since it looks up the ray of every pixel once.
    pub fn renderer(&self, camera: usize) -> Renderer<'_> {
        let DriveCamera { lens, width, height, .. } = &self.cameras[camera];
        Renderer::new(&self.world, lens, *width, *height)
    }

    /// Takes an image as the camera would have: with its exposure, noise and compression.
    pub fn render(&self, camera: usize, exposure: &Exposure, renderer: &Renderer) -> RgbImage {
        let raw = self.render_raw(camera, exposure, renderer);
        match self.jpeg_quality {
            Some(quality) => through_jpeg(&raw, quality).unwrap_or(raw),
            None => raw,
        }
    }

    /// The image before compression, and the quality to compress it with.
    pub(crate) fn render_raw(
        &self,
        camera: usize,
        exposure: &Exposure,
        renderer: &Renderer,
    ) -> RgbImage {
        let light = renderer.render(|y| self.row_pose(camera, exposure.time_s, y));
        develop(&light, &exposure.development)
    }

    pub(crate) fn jpeg_quality(&self) -> Option<u8> {
        self.jpeg_quality
    }

    /// The poses of all images at their middle rows, with the pinhole that equals each lens on its
    /// axis (exact for the ideal lens; the action lens is in no family of COLMAP's) and the stamps
    /// as times; no points. Images are ordered by camera, then time.
    pub fn truth(&self) -> Reconstruction {
        let mut truth = Reconstruction::default();
        for (index, camera) in self.cameras.iter().enumerate() {
            let id = truth.add_camera(Camera {
                intrinsics: camera.lens.paraxial_intrinsics(),
                width: camera.width,
                height: camera.height,
                has_focal_prior: true,
            });
            for exposure in &camera.exposures {
                let image = truth.add_image(Image::new(exposure.name.clone(), id, Vec::new()));
                truth.set_time(image, Some(exposure.stamp_s));
                truth.register(image, self.cam_from_world(index, exposure.time_s));
            }
        }
        truth
    }
}

fn camera(
    options: &DriveOptions,
    index: usize,
    mount: &Mount,
    trajectory: &Trajectory,
) -> DriveCamera {
    let (seed, effects) = (options.seed, &options.effects);
    let stream = |purpose: u64| Rng::stream(seed, &[12, index as u64, purpose]);
    let lens = if effects.has_action_lens {
        Lens::Action(ActionLens::sample(options.width, options.height, &mut stream(0)))
    } else {
        Lens::pinhole(PINHOLE_FOCAL * f64::from(options.width), options.width, options.height)
    };
    let mount =
        if effects.is_misaligned { mount.misaligned(&mut stream(1)) } else { mount.clone() };
    let timing = schedule(
        &effects.clocks,
        index == 0,
        options.rate_hz,
        trajectory.duration_s(),
        &mut stream(2),
    );
    let phases: [f64; 2] = {
        let mut rng = stream(3);
        std::array::from_fn(|_| std::f64::consts::TAU * rng.uniform())
    };
    let extension = if effects.photometry.jpeg_quality.is_some() { "jpg" } else { "png" };
    let exposure = |(k, &(time_s, stamp_s)): (usize, &(f64, f64))| {
        let waves = EXPOSURE_PERIODS_S.iter().zip(phases);
        let wave: f64 = waves
            .map(|(period, phase)| 0.5 * (std::f64::consts::TAU * time_s / period + phase).sin())
            .sum();
        Exposure {
            name: format!("{}/{k:06}.{extension}", mount.name),
            time_s,
            stamp_s,
            development: Development {
                gain: (effects.photometry.exposure_stops * wave).exp2(),
                noise: effects.photometry.noise,
                seed: stream(4).next_u64() ^ (k as u64) << 20,
            },
        }
    };
    DriveCamera {
        name: mount.name.clone(),
        lens,
        width: options.width,
        height: options.height,
        cam_from_vehicle: mount.cam_from_vehicle,
        flex: if index == 0 { Default::default() } else { flex(effects.flex_rad, &mut stream(5)) },
        clock: timing.clock,
        readout_s: effects.readout_s,
        exposures: timing.times_s.iter().enumerate().map(exposure).collect(),
    }
}
