//! A contact sheet of a loop: images of five viewing directions, the street from above, and the
//! reference cloud from above, coloured by height.
//!
//! cargo run --release -p tiepoint-synth --example sheet -- FILE.jpg [SEED]

use std::f64::consts::PI;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_synth::image::{Rgb, RgbImage, imageops};
use tiepoint_synth::lens::Lens;
use tiepoint_synth::photometry::{Development, develop};
use tiepoint_synth::render::{Renderer, RowPose};
use tiepoint_synth::{Drive, DriveOptions, LidarOptions, Mount, ViewDirection, reference_cloud};

const WIDTH: u32 = 400;
const HEIGHT: u32 = 300;
/// The view from above: height of the camera, and the focal length of a field of 240 m.
const ALTITUDE_M: f64 = 300.0;
const FOCAL_PX: f64 = WIDTH as f64 / 240.0 * ALTITUDE_M;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments.next().unwrap_or_else(|| "sheet.jpg".to_owned());
    let seed = arguments.next().map_or(Ok(1), |seed| seed.parse())?;
    let options = DriveOptions {
        seed,
        length_m: 320.0,
        mounts: ViewDirection::ALL.map(Mount::facing).to_vec(),
        width: WIDTH,
        height: HEIGHT,
        effects: "lens+rolling-shutter+vibration+traffic".parse()?,
        ..DriveOptions::default()
    };
    let drive = Drive::new(&options)?;
    let mut pictures = Vec::new();
    for (index, camera) in drive.cameras().iter().enumerate() {
        let exposure = &camera.exposures[camera.exposures.len() * (index + 1) / 7];
        pictures.push(drive.render(index, exposure, &drive.renderer(index)));
    }
    let last = &drive.cameras()[0].exposures[drive.cameras()[0].exposures.len() * 6 / 7];
    pictures.push(drive.render(0, last, &drive.renderer(0)));
    let down = Rigid3::from_axis_angle(Vector3::x() * PI, Vector3::new(0.0, 0.0, ALTITUDE_M));
    let lens = Lens::pinhole(FOCAL_PX, WIDTH, HEIGHT);
    let above = Renderer::new(drive.world(), &lens, WIDTH, HEIGHT);
    let light = above.render(|_| RowPose { world_from_cam: down, time_s: 0.0 });
    pictures.push(develop(&light, &Development::default()));

    let mut cloud =
        reference_cloud(&drive, &LidarOptions { every_turns: 10, ..LidarOptions::default() })?;
    cloud.sort_by(|a, b| a.z.total_cmp(&b.z));
    let mut map = RgbImage::from_pixel(WIDTH, HEIGHT, Rgb([16, 16, 20]));
    for point in &cloud {
        let Some(pixel) = lens.project(&(down.inverse() * *point)) else { continue };
        if pixel.x >= 0.0
            && pixel.y >= 0.0
            && pixel.x < f64::from(WIDTH)
            && pixel.y < f64::from(HEIGHT)
        {
            let height = (point.z / 12.0).clamp(0.0, 1.0);
            let color = [
                40.0 + 215.0 * height,
                70.0 + 150.0 * (1.0 - (2.0 * height - 1.0).abs()),
                200.0 - 160.0 * height,
            ];
            map.put_pixel(pixel.x as u32, pixel.y as u32, Rgb(color.map(|c| c as u8)));
        }
    }
    pictures.push(map);

    let columns = 4;
    let rows = pictures.len().div_ceil(columns) as u32;
    let mut sheet = RgbImage::new(columns as u32 * WIDTH, rows * HEIGHT);
    for (k, picture) in pictures.iter().enumerate() {
        let (column, row) = ((k % columns) as i64, (k / columns) as i64);
        imageops::replace(&mut sheet, picture, column * i64::from(WIDTH), row * i64::from(HEIGHT));
    }
    sheet.save(file)?;
    Ok(())
}
