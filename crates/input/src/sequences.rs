//! The images of a folder in the order in which they were taken, where times or numbers tell.

use std::collections::BTreeMap;

use tiepoint_matching::{CameraImages, Sequence, SequenceOrder};
use tiepoint_scene::Image;

use crate::Error;

/// Largest ratio of the upper quartile of the intervals to the lower one in a sequence. It is 1
/// for an interval timer and 1.9 for the sharpest frame of each stretch of a video. It is 4.8 for
/// photos that were taken at random moments, with exponential intervals.
const MAX_QUARTILE_RATIO: f64 = 2.0;
/// Resolution of capture times in EXIF. Nobody takes photos by hand at shorter intervals.
const TIME_RESOLUTION_S: f64 = 1.0;
/// Fewest images of a sequence: two intervals.
const MIN_IMAGES: usize = 3;

/// The images in groups: those of a stream whose names differ in the last number only. A group has
/// an order if its images have times at regular intervals, or no times and regular numbers.
///
/// # Errors
///
/// A time is not finite.
pub fn camera_images(
    images: &[Image],
    times: &BTreeMap<String, f64>,
) -> Result<Vec<CameraImages>, Error> {
    let mut groups: BTreeMap<(&str, &str), Vec<u32>> = BTreeMap::new();
    for (id, image) in (0..).zip(images) {
        groups.entry((&*image.stream, prefix(&image.name))).or_default().push(id);
    }
    let name = |id: u32| &images[id as usize].name;
    let group = |ids: Vec<u32>| {
        let of_all = |value: &dyn Fn(u32) -> Option<f64>| -> Option<Vec<f64>> {
            ids.iter().map(|&id| value(id)).collect()
        };
        let found = of_all(&|id| times.get(name(id)).copied())
            .map(|times_s| (times_s, SequenceOrder::Times, TIME_RESOLUTION_S))
            .or_else(|| {
                let numbers = of_all(&|id| number(name(id)).map(|number| number as f64));
                numbers.map(|numbers| (numbers, SequenceOrder::Numbers, 0.0))
            });
        if let Some((values, order, resolution)) = found {
            let mut all: Vec<(f64, u32)> = values.into_iter().zip(ids.iter().copied()).collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let (values, ordered): (Vec<f64>, Vec<u32>) = all.into_iter().unzip();
            if is_regular(&values, resolution) {
                let sequence = Sequence::with_times(ordered, values)?;
                return Ok(CameraImages { sequence, order });
            }
        }
        Ok(CameraImages { sequence: Sequence::new(ids), order: SequenceOrder::Unknown })
    };
    groups.into_values().map(group).collect()
}

/// The last number in a file name without extension.
pub fn number(name: &str) -> Option<usize> {
    let stem = name.rsplit('/').next()?.split('.').next()?;
    stem.rsplit(|c: char| !c.is_ascii_digit()).find(|digits| !digits.is_empty())?.parse().ok()
}

/// A name up to its last number: `left/IMG_` of `left/IMG_0012.jpg`.
pub fn prefix(name: &str) -> &str {
    let start = name.rfind('/').map_or(0, |slash| slash + 1);
    let stem = name[start..].split('.').next().unwrap_or("");
    let before = stem.trim_end_matches(|c: char| !c.is_ascii_digit());
    &name[..start + before.trim_end_matches(|c: char| c.is_ascii_digit()).len()]
}

/// Whether values in ascending order have equal intervals, apart from gaps.
fn is_regular(values: &[f64], resolution: f64) -> bool {
    let mut intervals: Vec<f64> = values.windows(2).map(|two| two[1] - two[0]).collect();
    intervals.sort_by(f64::total_cmp);
    let quartile = |quarters: usize| intervals[quarters * (intervals.len() - 1) / 4];
    values.len() >= MIN_IMAGES && quartile(3) <= MAX_QUARTILE_RATIO * quartile(1) + resolution
}

#[cfg(test)]
mod tests {
    use tiepoint_scene::CameraId;

    use super::*;

    fn images(names: &[String]) -> Vec<Image> {
        names.iter().map(|name| Image::new(name.as_str(), CameraId(0), Vec::new())).collect()
    }

    fn orders(names: &[String], times: &[f64]) -> Vec<SequenceOrder> {
        let times = names.iter().cloned().zip(times.iter().copied()).collect();
        let found = camera_images(&images(names), &times).unwrap();
        found.into_iter().map(|camera| camera.order).collect()
    }

    fn numbered(prefix: &str, numbers: impl Iterator<Item = u32>) -> Vec<String> {
        numbers.map(|number| format!("{prefix}{number:04}.jpg")).collect()
    }

    #[test]
    fn numbers_are_an_order_if_they_are_consecutive_apart_from_gaps() {
        let gap = numbered("a/IMG_", (0..20).chain(95..110));
        assert_eq!(orders(&gap, &[]), [SequenceOrder::Numbers]);
        let every_fifth = numbered("frame", (0..20).map(|k| 5 * k));
        assert_eq!(orders(&every_fifth, &[]), [SequenceOrder::Numbers]);
        // Squares: the upper quartile of their differences is three times the lower one.
        assert_eq!(orders(&numbered("", (0..40).map(|k| k * k)), &[]), [SequenceOrder::Unknown]);
        let names = ["tower.jpg", "gate.jpg", "yard.jpg"].map(str::to_owned);
        assert_eq!(orders(&names, &[]), [SequenceOrder::Unknown]);
    }

    #[test]
    fn times_decide_where_all_images_have_one() {
        let names = numbered("", 0..40);
        let regular: Vec<f64> = (0..40).map(|k| 2.0 * f64::from(k)).collect();
        assert_eq!(orders(&names, &regular), [SequenceOrder::Times]);
        // Bursts and breaks, as a person takes photos: exponential intervals of a minute.
        let mut time_s = 0.0;
        let by_hand: Vec<f64> = (0..40)
            .map(|k| {
                time_s -= 60.0 * (1.0 - (f64::from(k * 7 % 40) + 0.5) / 40.0).ln();
                time_s
            })
            .collect();
        assert_eq!(orders(&names, &by_hand), [SequenceOrder::Unknown]);
        assert_eq!(orders(&names, &by_hand[..39]), [SequenceOrder::Numbers], "one has no time");
        // A video at 25 frames a second with the times of EXIF.
        let seconds: Vec<f64> = (0..40).map(|k| f64::from(k / 25)).collect();
        assert_eq!(orders(&names, &seconds), [SequenceOrder::Times]);
    }

    #[test]
    fn groups_are_folders_and_prefixes() {
        let mut names = numbered("left/", 0..5);
        names.extend(numbered("right/", 0..5));
        names.extend(numbered("right/DSC", 3..9));
        let found = camera_images(&images(&names), &BTreeMap::new()).unwrap();
        assert_eq!(found.len(), 3);
        assert_eq!(prefix("a.b/IMG_20260101_120000-edit.x.jpg"), "a.b/IMG_20260101_");
        assert_eq!((prefix("7.jpg"), prefix("a/b.jpg")), ("", "a/"));
    }
}
