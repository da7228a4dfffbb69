//! Measured positions of images, as COLMAP's feature extractor writes them from EXIF.

use rusqlite::params;
use rusqlite::types::ValueRef;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{ImageId, Place, Position};

use super::connection::{Database, bytes};
use crate::Result;

/// COLMAP's `PosePrior::CoordinateSystem`.
const WGS84: i64 = 0;
const CARTESIAN: i64 = 1;

impl Database {
    /// Reads the table `pose_priors`: latitude, longitude and altitude, or coordinates, with the
    /// deviations of their covariances in metres. Rows without a position, or with one that is
    /// impossible or of an unknown frame, or with cells of other types, are left out; gravity is
    /// not read.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn read_pose_priors(&self) -> Result<Vec<(ImageId, Position)>> {
        let columns = self.columns("pose_priors")?;
        let has = |name: &str| columns.iter().any(|column| column == name);
        // Since 4.0 a row is of any sensor; cameras have type 0.
        let (image, condition) = match has("corr_data_id") && has("corr_sensor_type") {
            true => ("corr_data_id", "WHERE corr_sensor_type = 0"),
            false => ("image_id", ""),
        };
        if !has("position") || !has("coordinate_system") || !has(image) {
            return Ok(Vec::new());
        }
        let covariance = if has("position_covariance") { "position_covariance" } else { "NULL" };
        let blob = |cell: ValueRef| cell.as_blob().ok().map(<[u8]>::to_vec);
        let integer = |cell: ValueRef| cell.as_i64().ok();
        let rows = self.rows(
            &format!(
                "SELECT {image}, position, coordinate_system, {covariance} FROM pose_priors \
                 {condition} ORDER BY {image}"
            ),
            |row| {
                let [image, position, system, covariance] =
                    [row.get_ref(0)?, row.get_ref(1)?, row.get_ref(2)?, row.get_ref(3)?];
                Ok((integer(image), blob(position), integer(system), blob(covariance)))
            },
        )?;
        let mut priors = Vec::new();
        for (file_id, position, system, covariance) in rows {
            let image = file_id.map(|id| self.image_id(id, || "a pose prior".to_owned()));
            let Some(Ok(image)) = image else { continue };
            let Some(xyz) = position.as_deref().and_then(values::<3>) else { continue };
            let place = match system {
                Some(WGS84) => Place::Geodetic {
                    latitude_deg: xyz[0],
                    longitude_deg: xyz[1],
                    altitude_m: Some(xyz[2]).filter(|altitude_m| altitude_m.is_finite()),
                },
                Some(CARTESIAN) => Place::Cartesian(Vector3::from(xyz)),
                _ => continue,
            };
            if place.validate().is_err() || place.is_null() {
                continue;
            }
            let variances = covariance.as_deref().and_then(values::<9>);
            let sigma_m =
                |variance: f64| Some(variance.sqrt()).filter(|s| s.is_finite() && *s > 0.0);
            let of = |pick: &dyn Fn(&[f64; 9]) -> f64| sigma_m(pick(variances.as_ref()?));
            priors.push((
                image,
                Position {
                    place,
                    sigma_horizontal_m: of(&|v| v[0].max(v[4])),
                    sigma_vertical_m: of(&|v| v[8]),
                },
            ));
        }
        Ok(priors)
    }
}

impl Database {
    /// Replaces the table `pose_priors` of a database that this program made. What is not known is
    /// no number, as COLMAP writes it.
    ///
    /// # Errors
    ///
    /// If an image is not in the file, and if the file cannot be written.
    pub fn write_pose_priors(&mut self, positions: &[(ImageId, Position)]) -> Result<()> {
        const NONE: f64 = f64::NAN;
        let mut rows = Vec::new();
        for (image, position) in positions {
            let (place, system) = match position.place {
                Place::Geodetic { latitude_deg, longitude_deg, altitude_m } => {
                    ([latitude_deg, longitude_deg, altitude_m.unwrap_or(NONE)], WGS84)
                }
                Place::Cartesian(xyz) => (xyz.into(), CARTESIAN),
            };
            let variance = |sigma_m: Option<f64>| sigma_m.map_or(NONE, |sigma_m| sigma_m * sigma_m);
            let horizontal = variance(position.sigma_horizontal_m);
            let vertical = variance(position.sigma_vertical_m);
            let [none, h, v] = [0.0, horizontal, vertical];
            let covariance = [h, none, none, none, h, none, none, none, v];
            let file_id = self.file_id(*image)?;
            let camera = self.camera_of[image.index()];
            rows.push((file_id, self.cameras[camera.index()], place, covariance, system));
        }
        self.transaction(|db| {
            db.run("DELETE FROM pose_priors")?;
            for (image, camera, place, covariance, system) in &rows {
                let sql = "INSERT INTO pose_priors(pose_prior_id, corr_data_id, corr_sensor_id, \
                           corr_sensor_type, position, position_covariance, gravity, \
                           coordinate_system) VALUES (?1, ?1, ?2, 0, ?3, ?4, ?5, ?6)";
                let [place, covariance, gravity] = [&place[..], covariance, &[NONE; 3]].map(bytes);
                db.execute(sql, params![image, camera, place, covariance, gravity, system])?;
            }
            Ok(())
        })
    }
}

/// Numbers, of which some may be no number: COLMAP's for what EXIF lacks.
fn values<const N: usize>(blob: &[u8]) -> Option<[f64; N]> {
    let (chunks, rest) = blob.as_chunks::<8>();
    let values: [[u8; 8]; N] = chunks.try_into().ok()?;
    rest.is_empty().then(|| values.map(f64::from_le_bytes))
}
