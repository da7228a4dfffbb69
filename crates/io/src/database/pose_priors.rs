//! Measured positions of images, as COLMAP's feature extractor writes them from EXIF.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{ImageId, Place, Position};

use super::connection::{Database, numbers};
use crate::Result;

/// COLMAP's `PosePrior::CoordinateSystem`.
const WGS84: i64 = 0;
const CARTESIAN: i64 = 1;

impl Database {
    /// Reads the table `pose_priors`: latitude, longitude and altitude, or coordinates, with the
    /// deviations of their covariances in metres. Rows without a position, or with one that is
    /// impossible or of an unknown frame, are left out; gravity is not read.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn read_pose_priors(&self) -> Result<Vec<(ImageId, Position)>> {
        let columns = self.columns("pose_priors")?;
        let has = |name: &str| columns.iter().any(|column| column == name);
        if !has("position") || !has("coordinate_system") {
            return Ok(Vec::new());
        }
        let covariance = if has("position_covariance") { "position_covariance" } else { "NULL" };
        // Since 4.0 a row is of any sensor; cameras have type 0.
        let (image, condition) = match has("corr_data_id") {
            true => ("corr_data_id", "WHERE corr_sensor_type = 0"),
            false => ("image_id", ""),
        };
        type Row = (i64, Option<Vec<u8>>, Option<i64>, Option<Vec<u8>>);
        let rows: Vec<Row> = self.rows(
            &format!(
                "SELECT {image}, position, coordinate_system, {covariance} FROM pose_priors \
                 {condition} ORDER BY {image}"
            ),
            |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)),
        )?;
        let mut priors = Vec::new();
        for (file_id, position, system, covariance) in rows {
            let Ok(image) = self.image_id(file_id, || "a pose prior".to_owned()) else { continue };
            let Some(xyz) = position.as_deref().and_then(coordinates) else { continue };
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
            let variances = covariance.and_then(|blob| numbers(&blob, 9));
            let sigma_m =
                |variance: f64| Some(variance.sqrt()).filter(|s| s.is_finite() && *s > 0.0);
            let of = |pick: &dyn Fn(&[f64]) -> f64| sigma_m(pick(variances.as_ref()?));
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

/// Three numbers, of which some may be no number: COLMAP's for what EXIF lacks.
fn coordinates(blob: &[u8]) -> Option<[f64; 3]> {
    let (chunks, rest) = blob.as_chunks::<8>();
    let values: [[u8; 8]; 3] = chunks.try_into().ok()?;
    rest.is_empty().then(|| values.map(f64::from_le_bytes))
}
