//! Rendered images agree with the ground truth.

use image::RgbImage;
use tiepoint_geometry::nalgebra::{Matrix2, Vector2, Vector3};
use tiepoint_geometry::{Rigid3, Rng};
use tiepoint_synth::lens::{ActionLens, Lens};
use tiepoint_synth::render::{Radiance, Renderer, RowPose};
use tiepoint_synth::trajectory::{Carrier, Motion};
use tiepoint_synth::world::{Material, Quad, Surface, World};
use tiepoint_synth::{Drive, DriveOptions, Effects, Mount, RouteKind, ViewDirection, image};

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;
/// Largest errors with a global and a rolling shutter, in pixels.
const MAX_GLOBAL_ERROR_PX: f64 = 0.05;
const MAX_ROLLING_ERROR_PX: f64 = 0.1;

/// Refines the corner of a checkerboard near a pixel. A Gaussian preserves the point symmetry of a
/// corner, so that the blurred image has a saddle point there: the stationary point of a quadratic
/// (Lucchese & Mitra 2002).
fn refine_corner(image: &Radiance, guess: Vector2<f64>) -> Vector2<f64> {
    const SIGMA_PX: f64 = 2.5;
    const RADIUS: i64 = 10;
    const ITERATIONS: usize = 4;
    const LOST: Vector2<f64> = Vector2::new(f64::INFINITY, f64::INFINITY);
    let mut corner = guess;
    for _ in 0..ITERATIONS {
        // Derivatives of the blurred image are sums with the derivatives of the Gaussian.
        let (mut gradient, mut hessian) = (Vector2::zeros(), Matrix2::zeros());
        let (cx, cy) = (corner.x.floor() as i64, corner.y.floor() as i64);
        for y in cy - RADIUS..=cy + RADIUS {
            for x in cx - RADIUS..=cx + RADIUS {
                let light = f64::from(image.pixels[y as usize * image.width + x as usize][1]);
                let d = (corner - Vector2::new(x as f64 + 0.5, y as f64 + 0.5)) / SIGMA_PX;
                let weight = light * (-0.5 * d.norm_squared()).exp();
                gradient -= d * weight;
                hessian += (d * d.transpose() - Matrix2::identity()) * weight;
            }
        }
        let Some(inverse) = hessian.try_inverse() else { return LOST };
        corner -= inverse * gradient * SIGMA_PX;
        if (corner - guess).norm() > 2.0 {
            return LOST;
        }
    }
    corner
}

/// A checkerboard of 25 cm squares, 16 m wide, in front of the camera; corners are at multiples of
/// 0.25 m.
fn checker() -> (World, Quad) {
    let quad = Quad {
        // High above the ground, near which walls are darkened.
        origin: Vector3::new(-8.0, 3.0, 46.0),
        u: Vector3::x(),
        v: Vector3::z(),
        size: [16.0, 8.0],
        is_ellipse: false,
        surface: 0,
    };
    (World::from_quads(vec![quad], vec![Surface::new(Material::Checker, [0.8; 3], 1)]), quad)
}

/// A camera that looks along +y with x to the right, slightly rotated.
fn world_from_cam(centre: Vector3<f64>) -> Rigid3 {
    let level =
        Rigid3::from_axis_angle(Vector3::x() * -std::f64::consts::FRAC_PI_2, Vector3::zeros());
    let askew = Rigid3::from_axis_angle(Vector3::new(0.05, 0.12, 0.08), Vector3::zeros());
    Rigid3::new((level * askew).rotation, centre)
}

/// Errors of all corners well inside of the image, in pixels.
fn corner_errors_px(
    lens: &Lens,
    project: impl Fn(Vector3<f64>) -> Option<Vector2<f64>>,
    row_pose: impl Fn(f64) -> RowPose + Sync,
) -> Vec<f64> {
    let (world, quad) = checker();
    let image = Renderer::new(&world, lens, WIDTH, HEIGHT).render(row_pose);
    let mut errors = Vec::new();
    let corner = |i: i32, j: i32| {
        project(quad.origin + quad.u * (0.25 * f64::from(i)) + quad.v * (0.25 * f64::from(j)))
    };
    for i in 1..63 {
        for j in 1..31 {
            let (Some(pixel), Some(right), Some(above)) =
                (corner(i, j), corner(i + 1, j), corner(i, j + 1))
            else {
                continue;
            };
            // The window must not contain the next corner.
            let is_apart = (right - pixel).norm() > 26.0 && (above - pixel).norm() > 26.0;
            let is_inside = (12.0..f64::from(WIDTH) - 12.0).contains(&pixel.x)
                && (12.0..f64::from(HEIGHT) - 12.0).contains(&pixel.y);
            if is_inside && is_apart {
                errors.push((refine_corner(&image, pixel) - pixel).norm());
            }
        }
    }
    errors
}

#[test]
fn checkerboard_corners_agree_with_the_lens() {
    let mut rng = Rng::stream(1, &[]);
    let lenses = [
        Lens::pinhole(380.0, WIDTH, HEIGHT),
        Lens::Action(ActionLens::sample(WIDTH, HEIGHT, &mut rng)),
    ];
    // A field of this size is seen: it is larger than the largest error.
    let fields = lenses.clone().map(|lens| {
        lens.with_field(2.0 * MAX_GLOBAL_ERROR_PX, WIDTH, HEIGHT, &mut Rng::stream(4, &[]))
    });
    for lens in lenses.into_iter().chain(fields) {
        for x in [0.0, 0.37, 1.1] {
            let pose = world_from_cam(Vector3::new(x, 0.21 * x, 50.1));
            let errors = corner_errors_px(
                &lens,
                |point| lens.project(&(pose.inverse() * point)),
                |_| RowPose { world_from_cam: pose, time_s: 0.0 },
            );
            let worst = errors.iter().copied().fold(0.0, f64::max);
            assert!(errors.len() > 80, "{} corners", errors.len());
            assert!(worst < MAX_GLOBAL_ERROR_PX, "{worst} px");
        }
    }
}

#[test]
fn rolling_shutter_agrees_with_the_row_poses() {
    // 11 m/s and a slow rotation, 20 ms readout: a shear of 28 px at 3 m.
    const READOUT_S: f64 = 0.020;
    let lens = Lens::Action(ActionLens::sample(WIDTH, HEIGHT, &mut Rng::stream(2, &[])));
    let row_pose = |y: f64| {
        let time_s = (y / f64::from(HEIGHT) - 0.5) * READOUT_S;
        let turn = Rigid3::from_axis_angle(Vector3::new(0.1, 0.4, 0.2) * time_s, Vector3::zeros());
        let pose = world_from_cam(Vector3::new(11.0 * time_s, 0.5 * time_s, 50.0));
        RowPose {
            world_from_cam: Rigid3::new(pose.rotation * turn.rotation, pose.translation),
            time_s,
        }
    };
    let from_row =
        |y: f64, point: Vector3<f64>| lens.project(&(row_pose(y).world_from_cam.inverse() * point));
    let project = |point: Vector3<f64>| {
        (0..20).try_fold(Vector2::repeat(240.0), |pixel: Vector2<f64>, _| from_row(pixel.y, point))
    };
    let errors = corner_errors_px(&lens, project, row_pose);
    let worst = errors.iter().copied().fold(0.0, f64::max);
    assert!(errors.len() > 80, "{} corners", errors.len());
    assert!(worst < MAX_ROLLING_ERROR_PX, "{worst} px");
    // The error of a global shutter would be larger.
    let point = Vector3::new(0.0, 3.0, 51.0);
    let difference = project(point).unwrap() - from_row(240.0, point).unwrap();
    assert!(difference.norm() > 2.0, "{difference}");
}

fn drive(direction: ViewDirection, effects: Effects, seed: u64) -> Drive {
    let mounts = vec![Mount::facing(direction)];
    let options = DriveOptions {
        seed,
        mounts,
        width: WIDTH,
        height: HEIGHT,
        effects,
        ..DriveOptions::default()
    };
    Drive::new(&options).expect("the options are valid")
}

#[test]
fn surface_points_project_to_their_pixels() {
    // Newton and fixed-point iterations both end below 1e-8 px.
    const TOLERANCE_PX: f64 = 1e-6;
    let mut rng = Rng::stream(3, &[]);
    let with_field = Effects { lens_field_px: 0.15, ..Effects::all() };
    let drives = ViewDirection::ALL.map(|direction| drive(direction, with_field, 5));
    let others = [
        (Motion::of(Carrier::Handheld), RouteKind::Open),
        (Motion::of(Carrier::Drone), RouteKind::Loop),
        (Motion::highway(), RouteKind::Highway),
    ];
    let others = others.map(|(motion, route)| {
        let options = DriveOptions { motion, route, effects: with_field, ..Default::default() };
        Drive::new(&options).unwrap()
    });
    for drive in drives.into_iter().chain(others) {
        let mut seen = 0;
        for _ in 0..300 {
            let exposures = &drive.cameras()[0].exposures;
            let time_s = exposures[rng.below(exposures.len())].time_s;
            let pixel =
                Vector2::new(f64::from(WIDTH) * rng.uniform(), f64::from(HEIGHT) * rng.uniform());
            let Some(surface) = drive.surface_at(0, time_s, &pixel) else { continue };
            let back = drive.project(0, time_s, &surface.point_in_world).unwrap();
            assert!((back - pixel).norm() < TOLERANCE_PX, "{pixel} became {back}");
            seen += 1;
        }
        assert!(seen > 100, "{seen} pixels see anything");
    }
}

fn grey(image: &RgbImage, x: f64, y: f64) -> f64 {
    let (x, y) = (x - 0.5, y - 0.5);
    let (ix, iy) = (x.floor(), y.floor());
    let at = |dx: f64, dy: f64| f64::from(image.get_pixel((ix + dx) as u32, (iy + dy) as u32).0[1]);
    let (fx, fy) = (x - ix, y - iy);
    (1.0 - fy) * ((1.0 - fx) * at(0.0, 0.0) + fx * at(1.0, 0.0))
        + fy * ((1.0 - fx) * at(0.0, 1.0) + fx * at(1.0, 1.0))
}

/// Image shifts of patches that are transferred from one image to another with the true surface,
/// poses, shutter and lens (Lucas & Kanade 1981), in pixels.
fn shifts_between_images_px(drive: &Drive, first: usize, second: usize) -> Vec<Vector2<f64>> {
    const RADIUS: i32 = 6;
    const MARGIN: f64 = 12.0;
    let renderer = drive.renderer(0);
    let exposures = &drive.cameras()[0].exposures;
    let [one, other] = [first, second].map(|k| drive.render(0, &exposures[k], &renderer));
    let is_inside = |p: &Vector2<f64>| {
        (MARGIN..f64::from(WIDTH) - MARGIN).contains(&p.x)
            && (MARGIN..f64::from(HEIGHT) - MARGIN).contains(&p.y)
    };
    let transfer = |pixel: Vector2<f64>| {
        let surface = drive.surface_at(0, exposures[first].time_s, &pixel)?;
        let there = drive.project(0, exposures[second].time_s, &surface.point_in_world)?;
        // Visible in the other image, and not occluded.
        let seen = drive.surface_at(0, exposures[second].time_s, &there)?;
        let is_same =
            (seen.point_in_world - surface.point_in_world).norm() < 0.01 && !surface.is_moving;
        (is_same && is_inside(&there)).then_some(there)
    };
    let mut shifts = Vec::new();
    for y in (20..HEIGHT as i32 - 20).step_by(19) {
        'patch: for x in (20..WIDTH as i32 - 20).step_by(19) {
            let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
            for dy in -RADIUS..=RADIUS {
                for dx in -RADIUS..=RADIUS {
                    let pixel = Vector2::new(f64::from(x + dx) + 0.5, f64::from(y + dy) + 0.5);
                    let Some(there) = transfer(pixel) else { continue 'patch };
                    let gradient = Vector2::new(
                        grey(&other, there.x + 0.5, there.y) - grey(&other, there.x - 0.5, there.y),
                        grey(&other, there.x, there.y + 0.5) - grey(&other, there.x, there.y - 0.5),
                    );
                    let difference = grey(&one, pixel.x, pixel.y) - grey(&other, there.x, there.y);
                    normal += gradient * gradient.transpose();
                    right += gradient * difference;
                }
            }
            // Texture in both directions: one grey level of noise shifts such a patch by less than
            // 0.02 px.
            if normal.symmetric_eigenvalues().min() > 3000.0
                && let Some(inverse) = normal.try_inverse()
            {
                shifts.push(inverse * right);
            }
        }
    }
    shifts
}

#[test]
fn image_motion_agrees_with_the_ground_truth() {
    let rolling = Effects { readout_s: 0.016, has_action_lens: true, ..Effects::default() };
    for (effects, limit) in
        [(Effects::default(), MAX_GLOBAL_ERROR_PX), (rolling, MAX_ROLLING_ERROR_PX)]
    {
        let shifts = shifts_between_images_px(&drive(ViewDirection::Right, effects, 1), 30, 31);
        assert!(shifts.len() > 20, "{} patches", shifts.len());
        for axis in 0..2 {
            let mut along: Vec<f64> = shifts.iter().map(|shift| shift[axis]).collect();
            along.sort_by(f64::total_cmp);
            let median = along[along.len() / 2];
            // Single patches are shifted by the difference of resolution; the median must not be.
            assert!(median.abs() < limit, "median shift along axis {axis}: {median} px");
        }
    }
}

#[test]
fn images_are_independent_of_the_number_of_threads() {
    let drive = drive(ViewDirection::Front, Effects::all(), 2);
    let exposure = &drive.cameras()[0].exposures[20];
    let render = || drive.render(0, exposure, &drive.renderer(0)).into_raw();
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(render)
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_eq!(one, on(5));
}

#[test]
fn seeds_give_different_worlds_and_routes() {
    let of = |seed: u64| drive(ViewDirection::Front, Effects::default(), seed);
    let picture = |drive: &Drive| {
        drive.render(0, &drive.cameras()[0].exposures[5], &drive.renderer(0)).into_raw()
    };
    let (one, again, other) = (of(1), of(1), of(2));
    assert_eq!(picture(&one), picture(&again));
    assert_ne!(picture(&one), picture(&other));
    assert_ne!(one.route().length_m(), other.route().length_m());
}

#[test]
fn effects_are_independent() {
    let plain = drive(ViewDirection::Right, Effects::default(), 4);
    for (name, switch_on) in Effects::PRESETS {
        let mut effects = Effects::default();
        switch_on(&mut effects);
        let with = drive(ViewDirection::Right, effects, 4);
        let (camera, plain_camera) = (&with.cameras()[0], &plain.cameras()[0]);
        let has_lens = ["lens", "lens-field"].contains(&name);
        assert_eq!(camera.lens == plain_camera.lens, !has_lens, "{name}");
        assert_eq!(camera.readout_s == 0.0, name != "rolling-shutter", "{name}");
        assert_eq!(
            camera.cam_from_vehicle == plain_camera.cam_from_vehicle,
            name != "misalignment",
            "{name}"
        );
        let moves_alike =
            with.trajectory().world_from_vehicle(3.0) == plain.trajectory().world_from_vehicle(3.0);
        assert_eq!(moves_alike, name != "vibration", "{name}");
        assert_eq!(with.world().num_quads(), plain.world().num_quads(), "{name}");
        let stamps = |drive: &Drive| drive.timestamps_csv().replace(".jpg", ".png");
        assert_eq!(stamps(&with) == stamps(&plain), name != "clocks", "{name}");
    }
}

#[test]
fn a_highway_has_little_near_it_and_a_drone_sees_the_ground() {
    let of = |motion: Motion, route: RouteKind| {
        let options = DriveOptions { motion, route, length_m: 300.0, ..DriveOptions::default() };
        Drive::new(&options).unwrap()
    };
    // Share of the pixels that see something above the road within 30 m, and of those that see
    // the sky.
    let shares = |drive: &Drive| {
        let (mut near, mut sky) = (0, 0);
        let time_s = 0.5 * drive.trajectory().duration_s();
        let pixels = (0..48).flat_map(|y| (0..64).map(move |x| Vector2::new(x as f64, y as f64)));
        for pixel in pixels {
            let centre = drive.row_pose(0, time_s, 0.0).world_from_cam.translation;
            match drive.surface_at(0, time_s, &(pixel * 10.0)) {
                Some(surface) if surface.point_in_world.z < 0.1 => {}
                Some(surface) => {
                    near += usize::from((surface.point_in_world - centre).norm() < 30.0);
                }
                None => sky += 1,
            }
        }
        [near, sky].map(|count| f64::from(count as u32) / (64.0 * 48.0))
    };
    let [street, _] = shares(&of(Motion::default(), RouteKind::Open));
    let [highway, _] = shares(&of(Motion::highway(), RouteKind::Highway));
    let [_, sky] = shares(&of(Motion::of(Carrier::Drone), RouteKind::Loop));
    assert!(highway < 0.3 * street, "{highway} beside a highway, {street} in a street");
    assert!(sky == 0.0, "{sky} of the view of a drone is sky");
}
