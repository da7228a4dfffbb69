//! Selection of the frames of a video.
//!
//! The sharpest of every N frames is selected, the one with the largest gradient energy. It is left
//! out if there is hardly any image motion since the last selected frame, as at a stop. Image
//! motion is estimated on a thumbnail, as the ratio of temporal to spatial brightness changes of a
//! block; its median over the blocks is insensitive to passing cars. If the frames of another
//! camera with a synchronised clock are given, the frames nearest to them in time are selected
//! instead.

use std::num::NonZeroUsize;

use tiepoint_io::Rgb;
use tiepoint_sfm::geometry::numeric::median;

/// Approximate width of thumbnails.
const THUMBNAIL_WIDTH: u32 = 320;
/// Side of a block, in pixels of the thumbnail.
const BLOCK: usize = 16;
/// Minimum smaller eigenvalue of the structure tensor of a textured block, per pixel.
const MIN_TEXTURE: f64 = 4.0;
/// Minimum number of textured blocks for an estimate of image motion.
const MIN_BLOCKS: usize = 8;
/// Minimum image motion since the last selected frame, as a fraction of the image width (0.8 pixels
/// of the thumbnail).
const MIN_MOVEMENT: f64 = 0.0025;

/// A frame with its sharpness and its thumbnail.
pub(super) struct Candidate {
    pub(super) index: usize,
    pub(super) time_s: f64,
    pub(super) image: Rgb,
    small: Thumbnail,
    sharpness: f64,
}

impl Candidate {
    pub(super) fn new(index: usize, time_s: f64, image: Rgb) -> Self {
        let small = Thumbnail::new(&image);
        Self { index, time_s, sharpness: sharpness(&image), image, small }
    }
}

/// Selects the sharpest of every N frames, unless there is no image motion since the last one.
struct SharpestOfN {
    every: NonZeroUsize,
    /// Number of frames since the last selection.
    seen: usize,
    best: Option<Candidate>,
    /// Thumbnail of the last selected frame.
    last: Option<Thumbnail>,
}

impl SharpestOfN {
    fn new(every: NonZeroUsize) -> Self {
        Self { every, seen: 0, best: None, last: None }
    }

    fn add(&mut self, frame: Candidate) -> Option<Candidate> {
        if self.best.as_ref().is_none_or(|best| frame.sharpness > best.sharpness) {
            self.best = Some(frame);
        }
        self.seen += 1;
        if self.seen == self.every.get() { self.end() } else { None }
    }

    /// The selection among the frames so far.
    fn end(&mut self) -> Option<Candidate> {
        self.seen = 0;
        let best = self.best.take()?;
        let is_static = self
            .last
            .as_ref()
            .and_then(|last| best.small.movement_px(last))
            .is_some_and(|movement| movement < MIN_MOVEMENT * best.small.width as f64);
        if is_static {
            return None;
        }
        self.last = Some(best.small.clone());
        Some(best)
    }
}

/// Selects the frame nearest to each target time. Before the first target time and after the last,
/// or without any, selects the sharpest of every N frames.
pub(super) struct FrameSelector {
    /// Sorted.
    target_times_s: Vec<f64>,
    /// Index of the next target time.
    next: usize,
    /// The frame nearest to the next target time so far.
    nearest: Option<Candidate>,
    /// Selects frames outside the range of the target times.
    others: SharpestOfN,
}

impl FrameSelector {
    pub(super) fn new(every: NonZeroUsize, target_times_s: Vec<f64>) -> Self {
        Self { target_times_s, next: 0, nearest: None, others: SharpestOfN::new(every) }
    }

    /// Adds the next frame; returns a frame if one is selected now.
    pub(super) fn add(&mut self, frame: Candidate) -> Option<Candidate> {
        let Some(target_time_s) = self.target_times_s.get(self.next) else {
            return self.others.add(frame);
        };
        let interval_s =
            self.target_times_s.get(1).map_or(0.0, |second_s| second_s - self.target_times_s[0]);
        if self.next == 0 && frame.time_s < target_time_s - 0.5 * interval_s {
            return self.others.add(frame);
        }
        let is_past = |target_time_s: &f64, last: &Candidate| {
            (last.time_s - target_time_s).abs() <= (frame.time_s - target_time_s).abs()
        };
        let nearest = self.nearest.take().filter(|last| is_past(target_time_s, last));
        if let Some(nearest) = &nearest {
            // With missing frames, one may be the nearest to several target times.
            self.next += self.target_times_s[self.next..]
                .iter()
                .take_while(|target_time_s| is_past(target_time_s, nearest))
                .count();
        }
        if self.next < self.target_times_s.len() {
            self.nearest = Some(frame);
        }
        nearest
    }

    /// The last selection, after the last frame.
    pub(super) fn end(&mut self) -> Option<Candidate> {
        self.nearest.take().or_else(|| self.others.end())
    }
}

/// Mean squared difference of horizontally neighbouring green values, which blur reduces.
fn sharpness(image: &Rgb) -> f64 {
    let width = image.width as usize;
    let rows = image.data.chunks_exact(3 * width.max(1));
    let energy = |row: &[u8]| -> u64 {
        let greens = row.iter().skip(1).step_by(3);
        greens.clone().zip(greens.skip(1)).map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2)).sum()
    };
    let total: u64 = rows.map(energy).sum();
    total as f64 / image.data.len().max(1) as f64
}

/// A downscaled grey image; each pixel is the mean of a square of the green channel.
#[derive(Clone)]
struct Thumbnail {
    width: usize,
    height: usize,
    pixels: Vec<f32>,
}

impl Thumbnail {
    fn new(image: &Rgb) -> Self {
        let side = (image.width / THUMBNAIL_WIDTH).max(1) as usize;
        let (width, height) = (image.width as usize / side, image.height as usize / side);
        let mut pixels = vec![0.0; width * height];
        for (y, row) in
            image.data.chunks_exact(3 * image.width.max(1) as usize).take(height * side).enumerate()
        {
            for (x, green) in row.iter().skip(1).step_by(3).take(width * side).enumerate() {
                pixels[y / side * width + x / side] += f32::from(*green);
            }
        }
        let scale = 1.0 / (side * side) as f32;
        pixels.iter_mut().for_each(|pixel| *pixel *= scale);
        Self { width, height, pixels }
    }

    /// Image motion since `other`, in pixels: accurate if small, a large number otherwise. `None`
    /// if the sizes differ or there is too little texture.
    fn movement_px(&self, other: &Self) -> Option<f64> {
        if (self.width, self.height) != (other.width, other.height) {
            return None;
        }
        let mut movements: Vec<f64> = Vec::new();
        for top in (1..self.height.saturating_sub(BLOCK)).step_by(BLOCK) {
            for left in (1..self.width.saturating_sub(BLOCK)).step_by(BLOCK) {
                movements.extend(self.block_movement_px(other, left, top));
            }
        }
        if movements.len() < MIN_BLOCKS { None } else { median(&mut movements) }
    }

    /// Root mean square brightness change over root mean square gradient of a block, if it has
    /// texture in all directions. A constant brightness change is ignored.
    fn block_movement_px(&self, other: &Self, left: usize, top: usize) -> Option<f64> {
        let (mut xx, mut xy, mut yy, mut change, mut change2) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for y in top..top + BLOCK {
            for x in left..left + BLOCK {
                let at = |x: usize, y: usize| f64::from(other.pixels[y * self.width + x]);
                let (dx, dy) =
                    (0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1)));
                let difference = f64::from(self.pixels[y * self.width + x]) - at(x, y);
                (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
                (change, change2) = (change + difference, change2 + difference * difference);
            }
        }
        let area = (BLOCK * BLOCK) as f64;
        let (half_trace, determinant) = (0.5 * (xx + yy), xx * yy - xy * xy);
        let least = half_trace - (half_trace * half_trace - determinant).max(0.0).sqrt();
        let variance = (change2 - change * change / area).max(0.0);
        (least >= MIN_TEXTURE * area).then(|| (variance / half_trace).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (u32, u32) = (640, 480);

    /// A textured image, moved to the right by `moved` pixels and blurred over `smear` pixels.
    fn picture(moved: f64, smear: usize) -> Rgb {
        let value = |x: f64, y: f64| {
            127.0 + 50.0 * ((0.11 * x).sin() * (0.13 * y).cos() + (0.31 * x + 0.17 * y).sin())
        };
        let mut data = Vec::new();
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                let of = |k: usize| value(f64::from(x) - moved - k as f64, f64::from(y));
                let mean = (0..smear.max(1)).map(of).sum::<f64>() / smear.max(1) as f64;
                data.extend([mean as u8; 3]);
            }
        }
        Rgb { width: SIZE.0, height: SIZE.1, data }
    }

    fn kept(every: usize, frames: &[(f64, usize)]) -> Vec<usize> {
        let mut chooser = SharpestOfN::new(NonZeroUsize::new(every).unwrap());
        let mut kept: Vec<usize> = frames
            .iter()
            .enumerate()
            .filter_map(|(index, &(moved, smear))| {
                chooser
                    .add(Candidate::new(index, 0.0, picture(moved, smear)))
                    .map(|frame| frame.index)
            })
            .collect();
        kept.extend(chooser.end().map(|frame| frame.index));
        kept
    }

    #[test]
    fn sharpest_of_n_frames_is_selected() {
        let frames = [(0.0, 9), (8.0, 1), (16.0, 9), (24.0, 9), (32.0, 9), (40.0, 1), (48.0, 1)];
        assert_eq!(kept(3, &frames), [1, 5, 6]);
        assert_eq!(kept(1, &frames[..3]), [0, 1, 2]);
    }

    #[test]
    fn static_frames_are_left_out() {
        // The threshold is 0.0025 of 640 pixels, 1.6. Slow motion adds up.
        assert_eq!(
            kept(1, &[(0.0, 1), (0.0, 1), (0.5, 1), (1.2, 1), (2.4, 1), (2.4, 1), (60.0, 1)]),
            [0, 4, 6]
        );
    }

    #[test]
    fn frames_without_texture_are_selected() {
        let grey = |level: u8| Rgb { width: 64, height: 48, data: vec![level; 64 * 48 * 3] };
        let mut chooser = SharpestOfN::new(NonZeroUsize::MIN);
        for index in 0..3 {
            assert!(chooser.add(Candidate::new(index, 0.0, grey(9))).is_some());
        }
    }

    #[test]
    fn frames_nearest_to_target_times_are_selected() {
        let kept = |target_times_s: &[f64], times_s: &[f64]| -> Vec<usize> {
            let mut chooser =
                FrameSelector::new(NonZeroUsize::new(2).unwrap(), target_times_s.to_vec());
            let frame = |(index, &time_s): (usize, &f64)| {
                // Every second frame is blurred.
                Candidate::new(index, time_s, picture(13.0 * index as f64, 1 + 8 * (index % 2)))
            };
            let mut kept: Vec<usize> = Vec::new();
            for candidate in times_s.iter().enumerate().map(frame) {
                kept.extend(chooser.add(candidate).map(|frame| frame.index));
            }
            kept.extend(chooser.end().map(|frame| frame.index));
            kept
        };
        let times_s: Vec<f64> = (0..12).map(|k| 0.04 + 0.1 * f64::from(k)).collect();
        // One of the two frames before, 0.34 s for 0.31, 0.64 s for 0.61, and one of every two
        // frames after.
        assert_eq!(kept(&[0.31, 0.61], &times_s), [0, 3, 6, 8, 10]);
        assert_eq!(kept(&[0.04, 0.36, 0.66], &times_s[..7]), [0, 3, 6]);
        // A stop of the first camera; then missing frames of the second.
        assert_eq!(kept(&[0.04, 0.94], &times_s[..10]), [0, 9]);
        assert_eq!(kept(&[0.04, 0.14, 0.24, 0.34, 0.44], &[0.04, 0.14, 0.45]), [0, 1, 2]);
    }
}
