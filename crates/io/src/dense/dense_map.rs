//! Depth and normal maps of COLMAP (`stereo/depth_maps/*.bin`, `stereo/normal_maps/*.bin`): width,
//! height and number of channels as text, `W&H&C&`, then single-precision numbers, the channels one
//! after the other, each by rows.

use std::io::Write;
use std::path::Path;

use crate::Result;
use crate::atomic::write_atomic;
use crate::binary::Reader;

/// Longest text of a number in the header, in bytes.
const MAX_DIGITS: usize = 10;

/// A map of one or more numbers a pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseMap {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Numbers of each pixel: 1 in depth maps, 3 in normal maps.
    pub channels: usize,
    /// `channels` planes of `width * height` numbers by rows.
    pub values: Vec<f32>,
}

impl DenseMap {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or its length is not that of its header.
    pub fn read(path: &Path) -> Result<Self> {
        let mut file = Reader::open(path)?;
        let mut number = |what: &str| {
            let mut text = String::new();
            loop {
                match file.u8(what)? {
                    b'&' => break,
                    digit if digit.is_ascii_digit() && text.len() < MAX_DIGITS => {
                        text.push(char::from(digit));
                    }
                    _ => return Err(file.error(format!("{what} is no number"))),
                }
            }
            text.parse::<u64>().map_err(|_| file.error(format!("{what} is no number")))
        };
        let [width, height, channels] =
            [number("the width")?, number("the height")?, number("the number of channels")?];
        let count = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(channels));
        let count = count.filter(|count| count.checked_mul(4) == Some(file.remaining()));
        let Some(count) = count else {
            let left = file.remaining();
            return Err(file.error(format!(
                "the header says {width} × {height} × {channels} numbers, but {left} bytes follow"
            )));
        };
        let mut values = file.list(count as usize)?;
        let mut bytes = vec![0; 1 << 16];
        while values.len() < count as usize {
            let left = 4 * (count as usize - values.len());
            let part = left.min(bytes.len());
            file.fill(&mut bytes[..part], "a number")?;
            let numbers = bytes[..part].as_chunks().0.iter();
            values.extend(numbers.map(|bytes| f32::from_le_bytes(*bytes)));
        }
        let [width, height, channels] = [width, height, channels].map(|size| size as usize);
        Ok(Self { width, height, channels, values })
    }

    /// Writes a file.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_atomic(path, |file| {
            write!(file, "{}&{}&{}&", self.width, self.height, self.channels)?;
            self.values.iter().try_for_each(|value| file.write_all(&value.to_le_bytes()))
        })
    }
}
