//! Features and matches as files of their own, for processes that share the work of a database.
//!
//! A *tile* is what one process contributes. It begins with a text that says what it is. Then it
//! has features of images, or matches and two-view geometries of pairs, bit for bit, and a hash of
//! its content. Written into a database, the rows of all tiles are those that one process writes.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::PathBuf;

use tiepoint_features::{Descriptors, Features, Keypoint};
use tiepoint_geometry::nalgebra::Matrix3;
use tiepoint_scene::{ImageId, ImagePair, Match, TwoView};
use tiepoint_store::disk::Folder;
use tiepoint_store::{HashedFile, open_hashed, open_unchecked};

use super::features::{format_of, to_bytes, to_entries, type_of};
use super::pairs::{KINDS, match_bytes};
use crate::binary::{Reader, WriteLe, pose_numbers};
use crate::{Error, Result};

/// First bytes of a tile.
const MAGIC: &[u8; 16] = b"tiepoint tile 1\n";
/// Longest text at the begin, in bytes: options of a stage.
const MAX_TEXT_BYTES: u64 = 1 << 20;

/// Writes a tile, which gets its name in [`TileWriter::finish`].
#[derive(Debug)]
pub struct TileWriter {
    file: HashedFile,
    path: PathBuf,
}

impl TileWriter {
    /// Begins a tile of a folder; its own folder must exist. `text`: what it is.
    ///
    /// # Errors
    ///
    /// If a part of the name is a link, another process writes the tile, and if the file cannot be
    /// written.
    pub fn create(folder: &Folder, name: &str, text: &[u8]) -> Result<Self> {
        let file = HashedFile::create(folder, name)?;
        let mut this = Self { file, path: folder.join(name) };
        this.write(|file| {
            file.write_all(MAGIC)?;
            file.u64(text.len() as u64)?;
            file.write_all(text)
        })?;
        Ok(this)
    }

    fn write(&mut self, content: impl FnOnce(&mut HashedFile) -> io::Result<()>) -> Result<()> {
        content(&mut self.file).map_err(Error::io(&self.path))
    }

    /// Adds the features of an image.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_features(&mut self, image: ImageId, features: &Features) -> Result<()> {
        let Features { keypoints, descriptors } = features;
        let format = descriptors.format();
        self.write(|file| {
            file.u32(image.0)?;
            file.u64(keypoints.len() as u64)?;
            for Keypoint { x, y, scale, orientation } in keypoints {
                let numbers = [*x, *y, *scale, *orientation].map(f32::to_le_bytes);
                file.write_all(numbers.as_flattened())?;
            }
            file.i32(type_of(format.kind) as i32)?;
            file.u32(format.num_bytes() as u32)?;
            let data = to_bytes(descriptors.entries());
            file.u64(data.len() as u64)?;
            file.write_all(&data)
        })
    }

    /// Adds the matches and the two-view geometry of a pair.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_pair(&mut self, pair: ImagePair, matches: &[Match], view: &TwoView) -> Result<()> {
        self.write(|file| {
            file.u32(pair.a.0)?;
            file.u32(pair.b.0)?;
            file.u8(view.kind as u8)?;
            for matrix in [&view.fundamental, &view.essential, &view.homography] {
                file.u8(u8::from(matrix.is_some()))?;
                file.f64s(matrix.as_ref().map_or(&[], |matrix| matrix.as_slice()))?;
            }
            file.u8(u8::from(view.cam2_from_cam1.is_some()))?;
            file.f64s(view.cam2_from_cam1.as_ref().map(pose_numbers).as_ref().map_or(&[], |p| p))?;
            for matches in [matches, &view.matches] {
                file.u64(matches.len() as u64)?;
                file.write_all(&match_bytes(matches))?;
            }
            Ok(())
        })
    }

    /// Adds the state of a sub-map, the only content of its tile.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_state(&mut self, state: &[u8]) -> Result<()> {
        self.write(|file| file.write_all(state))
    }

    /// Writes the hash, and gives the tile its name.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn finish(self) -> Result<()> {
        Ok(self.file.commit()?)
    }
}

/// Reads a tile.
pub struct TileReader {
    reader: Reader<BufReader<File>>,
    text: Vec<u8>,
}

impl TileReader {
    /// Opens a tile of a folder; `None` if it is damaged: its content does not have its hash.
    ///
    /// # Errors
    ///
    /// If a part of the name is a link, and if the file cannot be read.
    pub fn open(folder: &Folder, name: &str) -> Result<Option<Self>> {
        let Some((file, length)) = open_hashed(folder, name)? else { return Ok(None) };
        Self::begin(folder, name, file, length)
    }

    /// As [`TileReader::open`], without reading the content: for a tile that was checked before,
    /// and for the text of one. `None` if its begin is damaged.
    ///
    /// # Errors
    ///
    /// Those of [`TileReader::open`].
    pub fn open_unchecked(folder: &Folder, name: &str) -> Result<Option<Self>> {
        let Some((file, length)) = open_unchecked(folder, name)? else { return Ok(None) };
        Self::begin(folder, name, file, length)
    }

    fn begin(folder: &Folder, name: &str, file: File, length: u64) -> Result<Option<Self>> {
        let path = folder.join(name);
        let mut reader = Reader::new(BufReader::with_capacity(1 << 16, file), &path, length);
        let mut text = || -> Result<Option<Vec<u8>>> {
            if reader.bytes("the begin")? != *MAGIC {
                return Ok(None);
            }
            let count = reader.count(1, "the length of the text")?;
            if count as u64 > MAX_TEXT_BYTES {
                return Ok(None);
            }
            let mut text = vec![0; count];
            reader.fill(&mut text, "the text")?;
            Ok(Some(text))
        };
        match text() {
            Ok(text) => Ok(text.map(|text| Self { reader, text })),
            // It ends there.
            Err(Error::Bytes { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// What it is.
    pub fn text(&self) -> &[u8] {
        &self.text
    }

    fn is_at_end(&self) -> bool {
        self.reader.remaining() == 0
    }

    /// All content, as one.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn read_state(&mut self) -> Result<Vec<u8>> {
        let length = self.reader.check_count(self.reader.remaining(), 1, "the length")?;
        let mut state = self.reader.list(length)?;
        state.resize(length, 0);
        self.reader.fill(&mut state, "the state")?;
        Ok(state)
    }

    /// The next features of an image; `None` at the end.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or has other content.
    pub fn next_features(&mut self) -> Result<Option<(ImageId, Features)>> {
        if self.is_at_end() {
            return Ok(None);
        }
        let reader = &mut self.reader;
        let image = ImageId(reader.u32("an image")?);
        let count = reader.count(16, "the number of keypoints")?;
        let mut keypoints = reader.list(count)?;
        for _ in 0..count {
            let numbers: [u8; 16] = reader.bytes("a keypoint")?;
            let number = |index: usize| {
                let bytes = numbers.as_chunks::<4>().0;
                f32::from_le_bytes(bytes[index])
            };
            let [x, y, scale, orientation] = [0, 1, 2, 3].map(number);
            keypoints.push(Keypoint { x, y, scale, orientation });
        }
        let (kind, num_bytes) = (reader.i32("a kind")?, reader.u32("a size")?);
        let format = format_of(kind.into(), num_bytes as usize)
            .ok_or_else(|| reader.error("these descriptors are of no known kind"))?;
        let length = reader.count(1, "the size of the descriptors")?;
        let mut data = reader.list(length)?;
        data.resize(length, 0);
        reader.fill(&mut data, "the descriptors")?;
        let descriptors = Descriptors::new(format, to_entries(format, data));
        let descriptors = descriptors.map_err(|cause| reader.error(cause.to_string()))?;
        if descriptors.len() != count {
            return Err(reader.error("the numbers of keypoints and descriptors differ"));
        }
        Ok(Some((image, Features { keypoints, descriptors })))
    }

    /// The next matches and two-view geometry of a pair; `None` at the end.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or has other content.
    pub fn next_pair(&mut self) -> Result<Option<(ImagePair, Vec<Match>, TwoView)>> {
        if self.is_at_end() {
            return Ok(None);
        }
        let reader = &mut self.reader;
        let [a, b] = [ImageId(reader.u32("an image")?), ImageId(reader.u32("an image")?)];
        let pair = ImagePair::new(a, b).filter(|pair| pair.a == a);
        let pair = pair.ok_or_else(|| reader.error("the images of a pair are not in order"))?;
        let kind = KINDS.get(usize::from(reader.u8("a kind")?)).copied();
        let kind = kind.ok_or_else(|| reader.error("this kind of geometry is not known"))?;
        let mut matrix = || -> Result<Option<Matrix3<f64>>> {
            if reader.u8("whether there is a matrix")? == 0 {
                return Ok(None);
            }
            let mut matrix = Matrix3::zeros();
            for entry in matrix.iter_mut() {
                *entry = reader.raw_f64("an entry of a matrix")?;
            }
            Ok(Some(matrix))
        };
        let (fundamental, essential, homography) = (matrix()?, matrix()?, matrix()?);
        let cam2_from_cam1 = match reader.u8("whether there is a pose")? {
            0 => None,
            _ => Some(reader.pose("a pose")?),
        };
        let (matches, inliers) = (matches(reader)?, matches(reader)?);
        let view =
            TwoView { kind, fundamental, essential, homography, cam2_from_cam1, matches: inliers };
        Ok(Some((pair, matches, view)))
    }
}

fn matches<R: Read>(reader: &mut Reader<R>) -> Result<Vec<Match>> {
    let count = reader.count(8, "the number of matches")?;
    let mut found = reader.list(count)?;
    for _ in 0..count {
        found.push(Match { a: reader.u32("a match")?, b: reader.u32("a match")? });
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use tiepoint_features::{DescriptorEntries, DescriptorFormat, DescriptorKind};
    use tiepoint_geometry::Rigid3;
    use tiepoint_geometry::nalgebra::{Quaternion, UnitQuaternion, Vector3};
    use tiepoint_scene::TwoViewKind;

    use super::*;

    fn folder() -> (tempfile::TempDir, Folder) {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::open(dir.path()).unwrap();
        (dir, folder)
    }

    #[test]
    fn features_come_back_bit_for_bit() {
        let (_dir, folder) = folder();
        let keypoint = Keypoint { x: 0.1, y: 7.3, scale: 1.7, orientation: -2.9 };
        let floats = DescriptorFormat { kind: DescriptorKind::Floats, dim: 2 };
        let of = |format, entries, count| Features {
            keypoints: vec![keypoint; count],
            descriptors: Descriptors::new(format, entries).unwrap(),
        };
        let all = [
            of(DescriptorFormat::SIFT, DescriptorEntries::Bytes((0..=255).collect()), 2),
            of(DescriptorFormat::SIFT, DescriptorEntries::Bytes(Vec::new()), 0),
            of(floats, DescriptorEntries::Floats(vec![0.1, f32::MIN_POSITIVE]), 1),
        ];
        let mut tile = TileWriter::create(&folder, "a", b"some text").unwrap();
        for (index, features) in all.iter().enumerate() {
            tile.write_features(ImageId::from_index(3 * index), features).unwrap();
        }
        tile.finish().unwrap();
        let mut tile = TileReader::open(&folder, "a").unwrap().unwrap();
        assert_eq!(tile.text(), b"some text");
        for (index, features) in all.into_iter().enumerate() {
            let found = tile.next_features().unwrap().unwrap();
            assert_eq!(found, (ImageId::from_index(3 * index), features));
        }
        assert!(tile.next_features().unwrap().is_none());
    }

    #[test]
    fn pairs_come_back_bit_for_bit() {
        let (_dir, folder) = folder();
        // Not of unit length to the last bit, as products of rotations are.
        let quaternion = Quaternion::new(0.5, 0.5, 0.5, 0.5 + 3e-16);
        let rotation = UnitQuaternion::new_unchecked(quaternion);
        let view = TwoView {
            kind: TwoViewKind::Calibrated,
            fundamental: Some(Matrix3::from_fn(|row, column| row as f64 / 7.0 - column as f64)),
            homography: Some(Matrix3::identity() * 0.1),
            cam2_from_cam1: Some(Rigid3::new(rotation, Vector3::new(0.1, 0.2, -0.3))),
            matches: vec![Match { a: 1, b: 2 }],
            ..TwoView::default()
        };
        let matches = [Match { a: 1, b: 2 }, Match { a: 5, b: u32::MAX }];
        let pairs = [(0, 4), (2, 3)].map(|(a, b)| ImagePair { a: ImageId(a), b: ImageId(b) });
        let mut tile = TileWriter::create(&folder, "a", b"").unwrap();
        tile.write_pair(pairs[0], &matches, &view).unwrap();
        tile.write_pair(pairs[1], &[], &TwoView::default()).unwrap();
        tile.finish().unwrap();
        let mut tile = TileReader::open(&folder, "a").unwrap().unwrap();
        let first = tile.next_pair().unwrap().unwrap();
        let bits = |view: &TwoView| view.cam2_from_cam1.map(|pose| pose_numbers(&pose));
        assert_eq!(
            bits(&first.2).unwrap().map(f64::to_bits),
            bits(&view).unwrap().map(f64::to_bits)
        );
        assert_eq!(first, (pairs[0], matches.to_vec(), view));
        let second = tile.next_pair().unwrap().unwrap();
        assert_eq!(second, (pairs[1], Vec::new(), TwoView::default()));
        assert!(tile.next_pair().unwrap().is_none());
    }

    #[test]
    fn a_tile_without_its_begin_is_damaged() {
        let (dir, folder) = folder();
        TileWriter::create(&folder, "a", b"some text").unwrap().finish().unwrap();
        let good = std::fs::read(dir.path().join("a")).unwrap();
        let is_open = |content: &[u8]| {
            std::fs::write(dir.path().join("a"), content).unwrap();
            TileReader::open_unchecked(&folder, "a").unwrap().is_some()
        };
        assert!(is_open(&good));
        let announced = [&MAGIC[..], &u64::MAX.to_le_bytes(), &[0; 64]].concat();
        for bad in [&good[1..], &good[..good.len() - 1], &good[..40], &[], &announced] {
            assert!(!is_open(bad), "{} bytes", bad.len());
        }
    }

    /// Whoever wrote a tile: what it announces is not believed.
    #[test]
    fn content_that_is_none_is_an_error() {
        let (_dir, folder) = folder();
        let write = |content: &[u8]| {
            let mut tile = TileWriter::create(&folder, "a", b"").unwrap();
            tile.write(|file| file.write_all(content)).unwrap();
            tile.finish().unwrap();
            TileReader::open(&folder, "a").unwrap().unwrap()
        };
        let many = [&0u32.to_le_bytes()[..], &u64::MAX.to_le_bytes()].concat();
        assert!(write(&many).next_features().is_err());
        assert!(write(&[0; 9]).next_pair().is_err(), "a pair of one image");
        assert!(write(&[0; 3]).next_pair().is_err());
    }
}
