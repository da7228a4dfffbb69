//! Keypoints and descriptors.

use std::borrow::Cow;

use rusqlite::{OptionalExtension, params};
use tiepoint_features::{
    DescriptorEntries, DescriptorFormat, DescriptorKind, Descriptors, Features, Keypoint,
};
use tiepoint_scene::ImageId;

use super::connection::{Database, error};
use crate::Result;

/// Values of the column `type`: those of COLMAP, whose `UNDEFINED` is -1, and one for floats of
/// methods that COLMAP does not know.
const TYPES: [(i64, DescriptorKind); 5] = [
    (0, DescriptorKind::Sift),
    (1, DescriptorKind::AlikedN16Rot),
    (2, DescriptorKind::AlikedN32),
    (-1, DescriptorKind::Bytes),
    (-2, DescriptorKind::Floats),
];

pub(super) fn type_of(kind: DescriptorKind) -> i64 {
    TYPES.iter().find(|(_, known)| *known == kind).map_or(-1, |(number, _)| *number)
}

/// The format of descriptors of a type with a number of bytes each; `None` for a type that is not
/// known. Before COLMAP 4 all descriptors had no type, and those that are not of SIFT's size are
/// of another kind.
pub(super) fn format_of(number: i64, num_bytes: usize) -> Option<DescriptorFormat> {
    let (_, kind) = TYPES.into_iter().find(|(known, _)| *known == number)?;
    let format = match kind {
        DescriptorKind::Sift if num_bytes != DescriptorFormat::SIFT.dim => {
            DescriptorFormat { kind: DescriptorKind::Bytes, dim: num_bytes }
        }
        kind if kind.has_floats() => DescriptorFormat { kind, dim: num_bytes / size_of::<f32>() },
        kind => DescriptorFormat { kind, dim: num_bytes },
    };
    (format.num_bytes() == num_bytes && num_bytes > 0).then_some(format)
}

/// The entries in the bytes of a row.
pub(super) fn to_entries(format: DescriptorFormat, data: Vec<u8>) -> DescriptorEntries {
    if format.kind.has_floats() {
        let floats = data.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
        DescriptorEntries::Floats(floats.collect())
    } else {
        DescriptorEntries::Bytes(data)
    }
}

/// Inverse of [`to_entries`].
pub(super) fn to_bytes(entries: &DescriptorEntries) -> Cow<'_, [u8]> {
    match entries {
        DescriptorEntries::Bytes(bytes) => bytes.into(),
        DescriptorEntries::Floats(floats) => {
            floats.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>().into()
        }
    }
}

/// The columns of a keypoint: x, y and the affine shape (a11, a12, a21, a22) that maps the unit
/// circle to the keypoint, which is the scale times the rotation by the orientation.
fn to_columns(keypoint: &Keypoint) -> [f32; 6] {
    let (sin, cos) = f64::from(keypoint.orientation).sin_cos();
    let (sin, cos) =
        ((f64::from(keypoint.scale) * sin) as f32, (f64::from(keypoint.scale) * cos) as f32);
    [keypoint.x, keypoint.y, cos, -sin, sin, cos]
}

/// Inverse of [`to_columns`] for the three layouts of COLMAP: x y; x y scale orientation; x y and
/// the affine shape.
fn from_columns(columns: &[f32]) -> Option<Keypoint> {
    if !columns.iter().all(|value| value.is_finite()) {
        return None;
    }
    let (x, y) = (*columns.first()?, *columns.get(1)?);
    match columns[2..] {
        [] => Some(Keypoint { x, y, scale: 1.0, orientation: 0.0 }),
        [scale, orientation] => Some(Keypoint { x, y, scale, orientation }),
        [a11, a12, a21, a22] => {
            let length = |a: f32, b: f32| f64::from(a).hypot(f64::from(b));
            let scale = (0.5 * (length(a11, a21) + length(a12, a22))) as f32;
            Some(Keypoint { x, y, scale, orientation: f64::from(a21).atan2(f64::from(a11)) as f32 })
        }
        _ => None,
    }
}

impl Database {
    /// Writes the keypoints and descriptors of images; replaces those in the file.
    ///
    /// Scale and orientation are stored as an affine shape: after reading, the last digits may
    /// differ.
    ///
    /// # Errors
    ///
    /// If an image is not in the database, if descriptors are not those of SIFT and the file is of
    /// a version that knows no others, and if the file cannot be written.
    pub fn write_features<'a>(
        &mut self,
        batch: impl IntoIterator<Item = (ImageId, &'a Features)>,
    ) -> Result<()> {
        self.transaction(|db| {
            let has_kind = db.has_descriptor_kinds()?;
            batch.into_iter().try_for_each(|(image, features)| {
                db.put_features(db.file_id(image)?, features, has_kind)
            })
        })
    }

    /// Before COLMAP 4, all descriptors were SIFT and the column `type` did not exist.
    pub(super) fn has_descriptor_kinds(&self) -> Result<bool> {
        Ok(self.columns("descriptors")?.iter().any(|name| name == "type"))
    }

    /// Writes the features of the image with an id in the file.
    pub(super) fn put_features(&self, id: i64, features: &Features, has_kind: bool) -> Result<()> {
        let Features { keypoints, descriptors } = features;
        if !has_kind && descriptors.format() != DescriptorFormat::SIFT {
            return Err(self.content(format!(
                "it has no column for the type of descriptors, and these are {}",
                descriptors.format()
            )));
        }
        let data: Vec<u8> =
            keypoints.iter().flat_map(to_columns).flat_map(f32::to_le_bytes).collect();
        let sql = "INSERT OR REPLACE INTO keypoints(image_id, rows, cols, data) VALUES (?1, ?2, 6, \
        ?3)";
        self.execute(sql, params![id, keypoints.len() as i64, data])?;
        let (kind, value) = if has_kind { ("type, ", "?5, ") } else { ("", "") };
        let sql = format!(
            "INSERT OR REPLACE INTO descriptors(image_id, {kind}rows, cols, data) \
            VALUES (?1, {value}?2, ?3, ?4)"
        );
        let (rows, format) = (descriptors.len() as i64, descriptors.format());
        let (cols, data) = (format.num_bytes() as i64, to_bytes(descriptors.entries()));
        let values: [&dyn rusqlite::ToSql; 5] = [&id, &rows, &cols, &data, &type_of(format.kind)];
        self.execute(&sql, &values[..if has_kind { 5 } else { 4 }])
    }

    /// Deletes all keypoints and descriptors.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn clear_features(&mut self) -> Result<()> {
        self.transaction(|db| db.run("DELETE FROM keypoints; DELETE FROM descriptors;"))
    }

    /// The number of keypoints of each image; `None` if none were written.
    ///
    /// # Errors
    ///
    /// If a row belongs to an image that does not exist, and if the file cannot be read.
    pub fn keypoint_counts(&self) -> Result<Vec<Option<usize>>> {
        let mut counts = vec![None; self.num_images()];
        let rows: Vec<(i64, i64)> = self
            .rows("SELECT image_id, rows FROM keypoints", |row| Ok((row.get(0)?, row.get(1)?)))?;
        for (id, count) in rows {
            let image = self.image_id(id, || "a row of keypoints".to_owned())?;
            counts[image.index()] = usize::try_from(count).ok();
        }
        Ok(counts)
    }

    /// Reads the keypoints of an image; empty if none were written.
    ///
    /// # Errors
    ///
    /// If the image is not in the database, if its row has an unknown layout or a value that is not
    /// finite, and if the file cannot be read.
    pub fn read_keypoints(&self, image: ImageId) -> Result<Vec<Keypoint>> {
        let Some((_, cols, data)) = self.feature_row("keypoints", "0", image)? else {
            return Ok(Vec::new());
        };
        let values: Vec<f32> =
            data.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let keypoints: Option<Vec<_>> = match cols {
            2 | 4 | 6 => values.chunks_exact(cols).map(from_columns).collect(),
            _ => {
                return Err(
                    self.content(format!("keypoints of {} have {cols} columns", self.shown(image)))
                );
            }
        };
        keypoints.ok_or_else(|| {
            self.content(format!("a keypoint of {} is not finite", self.shown(image)))
        })
    }

    /// Reads the keypoints and descriptors of an image; empty if none were written.
    ///
    /// # Errors
    ///
    /// The errors of [`Database::read_keypoints`], descriptors of a type that is not known, and
    /// different numbers of keypoints and descriptors.
    pub fn read_features(&self, image: ImageId) -> Result<Features> {
        let keypoints = self.read_keypoints(image)?;
        let kind = if self.has_descriptor_kinds()? { "type" } else { "0" };
        let descriptors = match self.feature_row("descriptors", kind, image)? {
            None => Descriptors::default(),
            Some((number, cols, data)) => {
                let format = format_of(number, cols).ok_or_else(|| {
                    self.content(format!(
                        "descriptors of {} have {cols} bytes and type {number}, which is not known",
                        self.shown(image)
                    ))
                })?;
                Descriptors::new(format, to_entries(format, data))
                    .map_err(|cause| self.content(format!("{}: {cause}", self.shown(image))))?
            }
        };
        if keypoints.len() != descriptors.len() {
            return Err(self.content(format!(
                "{} has {} keypoints but {} descriptors",
                self.shown(image),
                keypoints.len(),
                descriptors.len()
            )));
        }
        Ok(Features { keypoints, descriptors })
    }

    /// The first image with another number of descriptors than keypoints; `None` if all keypoints
    /// have a descriptor.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn image_without_descriptors(&self) -> Result<Option<String>> {
        let sql = "SELECT images.name FROM images JOIN keypoints USING (image_id) LEFT JOIN \
            descriptors USING (image_id) WHERE keypoints.rows > 0 AND (descriptors.rows IS NULL OR \
            descriptors.rows <> keypoints.rows) ORDER BY image_id LIMIT 1";
        Ok(self.rows(sql, |row| row.get(0))?.into_iter().next())
    }

    /// The format of the descriptors of all images; SIFT if there are none.
    ///
    /// # Errors
    ///
    /// If images have descriptors of different formats or of a type that is not known, and if the
    /// file cannot be read.
    pub fn descriptor_format(&self) -> Result<DescriptorFormat> {
        let kind = if self.has_descriptor_kinds()? { "type" } else { "0" };
        let sql =
            format!("SELECT DISTINCT {kind}, cols FROM descriptors WHERE rows > 0 ORDER BY 1, 2");
        let found: Vec<(i64, i64)> = self.rows(&sql, |row| Ok((row.get(0)?, row.get(1)?)))?;
        let format = |(number, cols): &(i64, i64)| {
            usize::try_from(*cols).ok().and_then(|cols| format_of(*number, cols)).ok_or_else(|| {
                self.content(format!(
                    "its descriptors have {cols} bytes and type {number}, which is not known"
                ))
            })
        };
        let formats = found.iter().map(format).collect::<Result<Vec<_>>>()?;
        match formats[..] {
            [] => Ok(DescriptorFormat::SIFT),
            [format] => Ok(format),
            [one, other, ..] => Err(self.content(format!(
                "some of its images have descriptors of {one}, others of {other}"
            ))),
        }
    }

    /// Type, number of columns and data of the row of an image. The data have the length that rows
    /// · columns give.
    fn feature_row(
        &self,
        table: &str,
        kind: &str,
        image: ImageId,
    ) -> Result<Option<(i64, usize, Vec<u8>)>> {
        let sql = format!("SELECT {kind}, rows, cols, data FROM {table} WHERE image_id = ?1");
        self.guard.begin();
        let mut statement = self.connection.prepare_cached(&sql).map_err(error(&self.path))?;
        let row: Option<(i64, i64, i64, Option<Vec<u8>>)> = statement
            .query_row([self.file_id(image)?], |row| {
                Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?))
            })
            .optional()
            .map_err(error(&self.path))?;
        let Some((kind, rows, cols, data)) = row else { return Ok(None) };
        let data = data.unwrap_or_default();
        let width = if table == "keypoints" { size_of::<f32>() as i64 } else { 1 };
        if cols < 0
            || rows.checked_mul(cols).and_then(|n| n.checked_mul(width)) != Some(data.len() as i64)
        {
            let found = data.len();
            return Err(self.content(format!(
                "{table} of {}: {found} bytes for {rows} × {cols}",
                self.shown(image)
            )));
        }
        Ok(Some((kind, cols as usize, data)))
    }
}
