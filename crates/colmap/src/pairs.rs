//! The matchers: adds matches and two-view geometries of image pairs to a database.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Instant;

use tiepoint_pipeline::io::database::Database;
use tiepoint_pipeline::sfm::scene::{Image, ImageId, ImagePair};
use tiepoint_pipeline::stages::{
    MatchOptions, PairChoice, Removal, all_ids, learn_retrieval, match_pairs,
};
use tiepoint_pipeline::workspace::MatchReport;
use tiepoint_pipeline::{Error, Event, Stage, Watch, emit};

use super::scene::open_to_add;

/// Which pairs of the images of a database are matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DatabasePairs {
    /// All.
    Exhaustive,
    /// Each image with the next ones in the order of their names.
    Sequential {
        /// Number of next images.
        overlap: u32,
        /// Whether also with the image that is 2, 4, 8, ... further, as many as `overlap`.
        is_quadratic: bool,
        /// Number of similar images for loop closures; 0 for none.
        loops: u32,
    },
    /// Each image with its most similar ones.
    Similar(u32),
}

impl DatabasePairs {
    fn name(self) -> String {
        match self {
            Self::Exhaustive => "exhaustive".to_owned(),
            Self::Sequential { overlap, loops: 0, .. } => format!("sequential:{overlap}"),
            Self::Sequential { overlap, loops, .. } => {
                format!("sequential:{overlap}+loops:{loops}")
            }
            Self::Similar(count) => format!("similar:{count}"),
        }
    }

    /// The pairs that follow from the names, and the number of similar images of each image.
    fn of_names(self, images: &[Image]) -> (BTreeSet<(u32, u32)>, u32) {
        let mut order: Vec<u32> = (0..).take(images.len()).collect();
        order.sort_by(|a, b| images[*a as usize].name.cmp(&images[*b as usize].name));
        let mut pairs = BTreeSet::new();
        let mut add = |place: usize, step: usize| {
            if let Some(&other) = place.checked_add(step).and_then(|place| order.get(place)) {
                let one = order[place];
                pairs.insert((one.min(other), one.max(other)));
            }
        };
        let (overlap, is_quadratic, similar) = match self {
            Self::Exhaustive => (images.len() as u32, false, 0),
            Self::Sequential { overlap, is_quadratic, loops } => (overlap, is_quadratic, loops),
            Self::Similar(count) => (0, false, count),
        };
        for place in 0..images.len() {
            (1..=overlap.min(images.len() as u32)).for_each(|step| add(place, step as usize));
            let powers = if is_quadratic { overlap.min(u32::BITS - 1) } else { 0 };
            (1..=powers).for_each(|power| add(place, 1 << power));
        }
        (pairs, similar)
    }
}

/// Matches pairs of images of a database and verifies them. Pairs that have matches are kept.
///
/// # Errors
///
/// The options are invalid; the file is not a database of COLMAP, has no images, or has features
/// without descriptors; similar images are asked for, and the descriptors are not those of SIFT; it
/// cannot be read or written; `watch` returns `Break`.
pub fn match_database(
    path: &Path,
    pairs: DatabasePairs,
    options: &MatchOptions,
    watch: Watch,
) -> Result<MatchReport, Error> {
    let start = Instant::now();
    options.verify.validate()?;
    let mut database = open_to_add(path)?;
    if let Some(image) = database.image_without_descriptors()? {
        return Err(Error::NoDescriptors { path: path.to_owned(), image });
    }
    let images = database.read_images()?;
    if images.is_empty() {
        let what = "holds no images: run feature_extractor first".to_owned();
        return Err(Error::Colmap { path: path.to_owned(), what });
    }
    let choice = choice(&database, &images, pairs, options.seed)?;
    let matched = match_pairs(&mut database, choice, options, watch)
        .and_then(|report| remove_overlays(&mut database, report, options));
    database.close()?;
    let seconds = start.elapsed().as_secs_f64();
    let report = MatchReport { seconds, ..matched? };
    emit(watch, &Event::StageDone { stage: Stage::Match, seconds })?;
    Ok(report)
}

/// Replaces the geometries of pairs with matches on overlays.
fn remove_overlays(
    database: &mut Database,
    report: MatchReport,
    options: &MatchOptions,
) -> Result<MatchReport, Error> {
    let removal = Removal::find(database, &options.verify, options.seed)?;
    let report = removal.added_to(report, database)?;
    database.write_two_views(removal.into_views().iter().map(|(pair, view)| (*pair, view)))?;
    Ok(report)
}

fn choice(
    database: &Database,
    images: &[Image],
    pairs: DatabasePairs,
    seed: u64,
) -> Result<PairChoice, Error> {
    let (mut chosen, similar) = pairs.of_names(images);
    if similar > 0 {
        let (_, index) = learn_retrieval(database, &all_ids(images.len()), seed)?;
        let known: Vec<(u32, u32)> = chosen.iter().copied().collect();
        chosen.extend(index.pairs(similar as usize, &known));
    }
    let pair = |(a, b)| ImagePair::new(ImageId(a), ImageId(b));
    Ok(PairChoice { selection: pairs.name(), pairs: chosen.into_iter().filter_map(pair).collect() })
}

#[cfg(test)]
mod tests {
    use tiepoint_pipeline::sfm::scene::CameraId;

    use super::*;

    #[test]
    fn sequences_follow_the_names() {
        let names = ["c", "a", "b", "d"];
        let images = names.map(|name| Image::new(name, CameraId(0), Vec::new()));
        let pairs = |pairs: DatabasePairs| -> Vec<(u32, u32)> {
            pairs.of_names(&images).0.into_iter().collect()
        };
        let sequential = |overlap, is_quadratic| {
            pairs(DatabasePairs::Sequential { overlap, is_quadratic, loops: 0 })
        };
        assert_eq!(sequential(1, false), [(0, 2), (0, 3), (1, 2)]);
        assert_eq!(sequential(1, true), [(0, 1), (0, 2), (0, 3), (1, 2), (2, 3)]);
        assert_eq!(pairs(DatabasePairs::Exhaustive).len(), 6);
        assert_eq!(sequential(u32::MAX, true).len(), 6);
        assert!(pairs(DatabasePairs::Similar(3)).is_empty());
    }
}
