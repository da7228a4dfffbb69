//! Selection of the frames of a video.
//!
//! Of every stretch of a video the sharpest frame is selected, the one with the largest gradient
//! energy. A stretch is N frames, or by default a tenth of a second, and less where the image moves
//! fast. The frame is left out if there is hardly any image motion since the last selected frame,
//! as at a stop. Image motion is estimated on a thumbnail, as the ratio of temporal to spatial
//! brightness changes of a block; its median over the blocks is insensitive to passing cars. Where
//! frames of another camera of the drive are selected, the frames nearest to them in time are
//! selected instead.

use std::num::NonZeroUsize;

use tiepoint_geometry::numeric::median;

use crate::Rgb;

/// Approximate width of thumbnails.
const THUMBNAIL_WIDTH: u32 = 320;
/// Approximate width of thumbnails on which the motion between two frames of a video is measured:
/// a block measures motion of up to some four pixels, here 5 % of the width.
const COARSE_WIDTH: u32 = 80;
/// Sides of a block, in pixels of the thumbnail and of the coarse one.
const BLOCK: usize = 16;
const COARSE_BLOCK: usize = 8;
/// Minimum smaller eigenvalue of the structure tensor of a textured block, per pixel.
const MIN_TEXTURE: f64 = 4.0;
/// Minimum number of textured blocks for an estimate of image motion.
const MIN_BLOCKS: usize = 8;
/// Minimum image motion since the last selected frame, as a fraction of the image width (0.8 pixels
/// of the thumbnail).
const MIN_MOVEMENT: f64 = 0.0025;
/// Length of a stretch: every third frame at 30 Hz, as Huang, Elhashash & Qin 2022 take them. Half
/// of it selects twice as many frames; with twice of it, cameras at 10 Hz lose every other frame.
pub const STRETCH_S: f64 = 0.1;
/// A stretch is rounded to whole frames: it ends this share of a frame early. With a half, times in
/// whole milliseconds would decide at the common rates of 15 and 25 Hz.
const ROUNDING: f64 = 0.6;
/// Image motion since the last selected frame that ends a stretch, as a fraction of the image
/// width. A frame then has 90 % in common with the next and 80 % with the next but one, which
/// aerial surveys ask for. Half of it selects up to twice as many frames where the image moves
/// fast, and twice of it half as many.
const MAX_MOVEMENT: f64 = 0.1;

/// A frame with its sharpness and its thumbnails.
pub struct Candidate {
    /// Number of the frame in the video.
    pub index: usize,
    /// Time of the frame, in seconds.
    pub time_s: f64,
    /// The pixels.
    pub image: Rgb,
    small: Thumbnail,
    coarse: Thumbnail,
    sharpness: f64,
    /// Image motion since the beginning of the video, in image widths.
    moved: f64,
}

impl Candidate {
    /// A frame with the time `time_s` in seconds.
    pub fn new(index: usize, time_s: f64, image: Rgb) -> Self {
        let small = Thumbnail::new(&image, THUMBNAIL_WIDTH);
        let coarse = Thumbnail::new(&image, COARSE_WIDTH);
        Self { index, time_s, sharpness: sharpness(&image), image, small, coarse, moved: 0.0 }
    }
}

/// A frame that was added, of the motion between frames.
struct Previous {
    coarse: Thumbnail,
    time_s: f64,
    moved: f64,
}

/// Selects the sharpest frame of each stretch, unless there is no image motion since the last one.
struct SharpestOfStretch {
    /// Number of frames of a stretch; `None`: by time and image motion.
    every: Option<NonZeroUsize>,
    /// Number of frames of this stretch.
    seen: usize,
    /// Time of the first frame of this stretch.
    begin_s: f64,
    best: Option<Candidate>,
    previous: Option<Previous>,
    /// Thumbnail of the last selected frame, and its [`Candidate::moved`].
    last: Option<(Thumbnail, f64)>,
}

impl SharpestOfStretch {
    fn new(every: Option<NonZeroUsize>) -> Self {
        Self { every, seen: 0, begin_s: 0.0, best: None, previous: None, last: None }
    }

    /// Measures the motion from the frame before.
    fn follow(&mut self, frame: &mut Candidate) {
        if let Some(previous) = &self.previous {
            let step = frame.coarse.movement_px(&previous.coarse, COARSE_BLOCK).unwrap_or(0.0);
            frame.moved = previous.moved + step / frame.coarse.width.max(1) as f64;
        }
    }

    /// Whether a frame begins a new stretch.
    fn is_next(&self, frame: &Candidate) -> bool {
        let interval_s =
            self.previous.as_ref().map_or(0.0, |previous| frame.time_s - previous.time_s);
        match self.every {
            _ if self.seen == 0 => false,
            Some(every) => self.seen == every.get(),
            None => {
                frame.time_s - self.begin_s >= STRETCH_S - ROUNDING * interval_s
                    || self.last.as_ref().is_some_and(|(_, at)| frame.moved - at >= MAX_MOVEMENT)
            }
        }
    }

    /// Adds the next frame; returns the selection of the stretch that is complete now.
    fn add(&mut self, frame: Candidate) -> Option<Candidate> {
        let selected = if self.is_next(&frame) { self.end() } else { None };
        if self.seen == 0 {
            self.begin_s = frame.time_s;
        }
        self.seen += 1;
        self.pass(&frame);
        if self.best.as_ref().is_none_or(|best| frame.sharpness > best.sharpness) {
            self.best = Some(frame);
        }
        selected
    }

    /// Ends a stretch that is not complete without a selection.
    fn discard(&mut self) {
        self.seen = 0;
        self.best = None;
    }

    /// Notes a frame that the next one follows.
    fn pass(&mut self, frame: &Candidate) {
        self.previous = Some(Previous {
            coarse: frame.coarse.clone(),
            time_s: frame.time_s,
            moved: frame.moved,
        });
    }

    /// Notes a selected frame.
    fn select(&mut self, frame: &Candidate) {
        self.last = Some((frame.small.clone(), frame.moved));
    }

    /// The selection among the frames of this stretch so far.
    fn end(&mut self) -> Option<Candidate> {
        self.seen = 0;
        let best = self.best.take()?;
        let is_static = self
            .last
            .as_ref()
            .and_then(|(last, _)| best.small.movement_px(last, BLOCK))
            .is_some_and(|movement| movement < MIN_MOVEMENT * best.small.width as f64);
        if is_static {
            return None;
        }
        self.select(&best);
        Some(best)
    }
}

/// A selected frame.
pub struct Selected {
    /// The frame.
    pub frame: Candidate,
    /// Whether it is the frame nearest to a target time.
    pub is_target: bool,
}

/// Selects the frame nearest to each target time. Where there are none for longer than their
/// interval, also before the first and after the last, selects the sharpest of each stretch.
pub struct FrameSelector {
    /// Sorted.
    target_times_s: Vec<f64>,
    /// Half of the usual interval of the target times.
    reach_s: f64,
    /// Index of the next target time.
    next: usize,
    /// The frame nearest to the next target time so far.
    nearest: Option<Candidate>,
    /// Selects frames far from all target times.
    others: SharpestOfStretch,
}

impl FrameSelector {
    /// `every`: number of frames of a stretch; `None`: by time and image motion.
    pub fn new(every: Option<NonZeroUsize>, mut target_times_s: Vec<f64>) -> Self {
        target_times_s.sort_by(f64::total_cmp);
        let mut intervals_s: Vec<f64> =
            target_times_s.windows(2).map(|two| two[1] - two[0]).collect();
        let reach_s = 0.5 * median(&mut intervals_s).unwrap_or(STRETCH_S);
        let others = SharpestOfStretch::new(every);
        Self { target_times_s, reach_s, next: 0, nearest: None, others }
    }

    /// Adds the next frame; returns the frames that are selected now.
    pub fn add(&mut self, mut frame: Candidate) -> Vec<Selected> {
        let mut selected = Vec::new();
        self.others.follow(&mut frame);
        if let Some(nearest) = self.nearest.take() {
            let is_nearer = |target_time_s: &f64| {
                (nearest.time_s - target_time_s).abs() <= (frame.time_s - target_time_s).abs()
            };
            // With missing frames, one may be the nearest to several target times.
            let done = self.target_times_s[self.next..].iter().take_while(|t| is_nearer(t)).count();
            self.next += done;
            if done > 0 {
                self.others.select(&nearest);
                selected.push(Selected { frame: nearest, is_target: true });
            }
        }
        let (last_s, next_s) =
            (self.target_times_s[..self.next].last(), self.target_times_s.get(self.next));
        if next_s.is_some_and(|next_s| frame.time_s >= next_s - self.reach_s) {
            // Frames between two targets or before the first are their own stretch if they fill
            // one.
            match self.others.is_next(&frame) {
                true => selected.extend(self.end_of_others()),
                false => self.others.discard(),
            }
            self.others.pass(&frame);
            self.nearest = Some(frame);
        } else if last_s.is_some_and(|last_s| frame.time_s <= last_s + self.reach_s) {
            self.others.pass(&frame);
        } else {
            let own = self.others.add(frame);
            selected.extend(own.map(|frame| Selected { frame, is_target: false }));
        }
        selected
    }

    fn end_of_others(&mut self) -> Option<Selected> {
        self.others.end().map(|frame| Selected { frame, is_target: false })
    }

    /// The last selection, after the last frame.
    pub fn end(&mut self) -> Option<Selected> {
        match self.nearest.take() {
            Some(frame) => Some(Selected { frame, is_target: true }),
            None => self.end_of_others(),
        }
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
    fn new(image: &Rgb, about_width: u32) -> Self {
        let side = (image.width / about_width).max(1) as usize;
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
    fn movement_px(&self, other: &Self, block: usize) -> Option<f64> {
        if (self.width, self.height) != (other.width, other.height) {
            return None;
        }
        let mut movements: Vec<f64> = Vec::new();
        for top in (1..self.height.saturating_sub(block)).step_by(block) {
            for left in (1..self.width.saturating_sub(block)).step_by(block) {
                movements.extend(self.block_movement_px(other, [left, top], block));
            }
        }
        if movements.len() < MIN_BLOCKS { None } else { median(&mut movements) }
    }

    /// Root mean square brightness change over root mean square gradient of a block, if it has
    /// texture in all directions. A constant brightness change is ignored.
    fn block_movement_px(
        &self,
        other: &Self,
        [left, top]: [usize; 2],
        block: usize,
    ) -> Option<f64> {
        let (mut xx, mut xy, mut yy, mut change, mut change2) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for y in top..top + block {
            for x in left..left + block {
                let at = |x: usize, y: usize| f64::from(other.pixels[y * self.width + x]);
                let (dx, dy) =
                    (0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1)));
                let difference = f64::from(self.pixels[y * self.width + x]) - at(x, y);
                (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
                (change, change2) = (change + difference, change2 + difference * difference);
            }
        }
        let area = (block * block) as f64;
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
        textured(1.0, moved, smear)
    }

    /// The same with texture of so many times its size.
    fn textured(scale: f64, moved: f64, smear: usize) -> Rgb {
        let value = |x: f64, y: f64| {
            let (x, y) = (x / scale, y / scale);
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

    /// Indices of the selected frames; each is given by its time, position and blur.
    fn kept(
        every: Option<usize>,
        target_times_s: &[f64],
        frames: &[(f64, f64, usize)],
    ) -> Vec<usize> {
        let every = every.and_then(NonZeroUsize::new);
        let mut chooser = FrameSelector::new(every, target_times_s.to_vec());
        let mut kept: Vec<usize> = Vec::new();
        for (index, &(time_s, moved, smear)) in frames.iter().enumerate() {
            let selected = chooser.add(Candidate::new(index, time_s, picture(moved, smear)));
            kept.extend(selected.iter().map(|selected| selected.frame.index));
        }
        kept.extend(chooser.end().map(|selected| selected.frame.index));
        kept
    }

    /// Frames at this rate, which move by so many pixels each.
    fn steady(count: usize, rate_hz: f64, step_px: f64) -> Vec<(f64, f64, usize)> {
        (0..count).map(|k| (k as f64 / rate_hz, step_px * k as f64, 1)).collect()
    }

    fn at_no_time(frames: &[(f64, usize)]) -> Vec<(f64, f64, usize)> {
        frames.iter().map(|&(moved, smear)| (0.0, moved, smear)).collect()
    }

    #[test]
    fn sharpest_of_n_frames_is_selected() {
        let frames = [(0.0, 9), (8.0, 1), (16.0, 9), (24.0, 9), (32.0, 9), (40.0, 1), (48.0, 1)];
        assert_eq!(kept(Some(3), &[], &at_no_time(&frames)), [1, 5, 6]);
        assert_eq!(kept(Some(1), &[], &at_no_time(&frames[..3])), [0, 1, 2]);
    }

    #[test]
    fn static_frames_are_left_out() {
        // The threshold is 0.0025 of 640 pixels, 1.6. Slow motion adds up.
        let frames = [0.0, 0.0, 0.5, 1.2, 2.4, 2.4, 60.0].map(|moved| (moved, 1));
        assert_eq!(kept(Some(1), &[], &at_no_time(&frames)), [0, 4, 6]);
    }

    #[test]
    fn frames_without_texture_are_selected() {
        let grey = |level: u8| Rgb { width: 64, height: 48, data: vec![level; 64 * 48 * 3] };
        let mut chooser = SharpestOfStretch::new(Some(NonZeroUsize::MIN));
        for index in 0..3 {
            let selected = chooser.add(Candidate::new(index, 0.0, grey(9)));
            assert_eq!(selected.is_some(), index > 0, "the one before");
        }
        assert!(chooser.end().is_some());
    }

    #[test]
    fn a_stretch_is_a_tenth_of_a_second_at_any_rate() {
        // Number of frames of a stretch: the nearest number to a tenth of a second.
        for (rate_hz, of_stretch) in
            [(5.0, 1), (10.0, 1), (15.0, 1), (20.0, 2), (24.0, 2), (25.0, 2), (30.0, 3), (60.0, 6)]
        {
            let frames = steady(13, rate_hz, 3.0);
            let expected = 13_usize.div_ceil(of_stretch);
            let found = kept(None, &[], &frames).len();
            assert_eq!(found, expected, "{rate_hz} Hz");
        }
        // Times in milliseconds, as many files have them.
        let rounded = |(time_s, moved, smear): (f64, f64, usize)| {
            ((time_s * 1e3).round() / 1e3, moved, smear)
        };
        let ntsc: Vec<_> = steady(90, 29.97, 3.0).into_iter().map(rounded).collect();
        assert_eq!(kept(None, &[], &ntsc).len(), 30);
    }

    #[test]
    fn fast_motion_makes_stretches_shorter() {
        // 64 pixels are a tenth of the width. At 60 Hz a stretch has six frames.
        let kept = |step_px: f64| {
            let mut chooser = FrameSelector::new(None, Vec::new());
            let add = |k: usize| {
                let image = textured(6.0, step_px * k as f64, 1);
                chooser.add(Candidate::new(k, k as f64 / 60.0, image)).len()
            };
            (0..24).map(add).sum::<usize>()
        };
        // The last stretch is not complete.
        assert_eq!(kept(4.0), 3);
        let fast = kept(22.0);
        assert!((7..=12).contains(&fast), "one or two of three frames: {fast}");
    }

    #[test]
    fn frames_nearest_to_target_times_are_selected() {
        let frames = |times_s: &[f64]| -> Vec<(f64, f64, usize)> {
            // Every second frame is blurred.
            let frame = |(index, &time_s): (usize, &f64)| {
                (time_s, 13.0 * index as f64, 1 + 8 * (index % 2))
            };
            times_s.iter().enumerate().map(frame).collect()
        };
        let kept = |target_times_s: &[f64], times_s: &[f64]| {
            super::tests::kept(Some(2), target_times_s, &frames(times_s))
        };
        let times_s: Vec<f64> = (0..12).map(|k| 0.04 + 0.1 * f64::from(k)).collect();
        // One of the two frames before, 0.34 s for 0.31, 0.64 s for 0.61, and one of every two
        // frames after.
        assert_eq!(kept(&[0.31, 0.61], &times_s), [0, 3, 6, 8, 10]);
        assert_eq!(kept(&[0.04, 0.36, 0.66], &times_s[..7]), [0, 3, 6]);
        // Missing frames.
        assert_eq!(kept(&[0.04, 0.14, 0.24, 0.34, 0.44], &[0.04, 0.14, 0.45]), [0, 1, 2]);
    }

    #[test]
    fn a_camera_that_moves_while_the_first_stands_keeps_its_frames() {
        let targets = [0.0, 0.1, 0.2, 0.8, 0.9];
        assert_eq!(kept(None, &targets, &steady(10, 10.0, 13.0)), (0..10).collect::<Vec<_>>());
        let stop = |(time_s, _, smear): (f64, f64, usize)| {
            (time_s, 130.0 * f64::max(time_s.min(0.2), time_s - 0.6), smear)
        };
        let both_stop: Vec<_> = steady(10, 10.0, 0.0).into_iter().map(stop).collect();
        assert_eq!(kept(None, &targets, &both_stop), [0, 1, 2, 8, 9]);
    }
}
