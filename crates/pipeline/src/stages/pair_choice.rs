//! Which image pairs of a workspace are matched.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tiepoint_input::sequences::camera_images;
use tiepoint_io::database::Database;
use tiepoint_io::features::{DescriptorFormat, Features, SiftDescriptor};
use tiepoint_io::timestamps;
use tiepoint_sfm::frame_names::natural_order;
use tiepoint_sfm::matching::retrieval::{
    GlobalDescriptor, ImageWords, InvertedIndex, RetrievalIndex, Similar, Vocabulary,
    VocabularyOptions, VocabularyTree,
};
use tiepoint_sfm::matching::{
    AutoPairs, PairSelection, Sequence, auto_pairs, may_be_recordings, num_similar,
};
use tiepoint_sfm::scene::{Image, ImageId, ImagePair};

use crate::{Error, Stage, Workspace};

/// Images that are read from the database at a time.
pub(crate) const IMAGES_READ_AT_ONCE: usize = 16;

/// Size of the sample that the visual vocabulary of [`RetrievalIndex`] is learnt from: number of
/// images, and descriptors per image. It gives about 400 descriptors per word.
const SAMPLE_IMAGES: usize = 256;
const SAMPLE_DESCRIPTORS: usize = 200;
/// Descriptors of all images for each word of [`InvertedIndex`]. The number of words follows, so
/// that a query compares the same number of binary vectors in any collection. Of the true pairs of
/// 1,000 rendered photos, the 100 most similar photos hold 0.722 with half as many, 0.730 with 128.
const DESCRIPTORS_PER_WORD: usize = 128;
/// Descriptors in the sample for each of these words.
const SAMPLE_PER_WORD: usize = 8;

/// The image pairs that a selection gives for a workspace.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PairChoice {
    /// The selection in the words of the command line; for `auto` what it chose, as
    /// `sequential:10+loops:20 for 800 images, similar:100 for 200`.
    pub selection: String,
    /// The pairs, in ascending order.
    pub pairs: Vec<ImagePair>,
}

/// The image pairs that matching a workspace with this selection and seed compares.
///
/// # Errors
///
/// The workspace has no features; similar images are asked for, and the descriptors are not those
/// of SIFT; its database or its times cannot be read.
pub fn choose_pairs(
    workspace: &Workspace,
    selection: PairSelection,
    seed: u64,
) -> Result<PairChoice, Error> {
    workspace.fingerprint(Stage::Features)?;
    let database = Database::open(&workspace.database())?;
    let images = database.read_images()?;
    let found = choose_pairs_of_images(workspace, &database, &images, selection, seed);
    database.close()?;
    found
}

/// The selection, with [`PairSelection::Exhaustive`] for [`PairSelection::Auto`] where that is all
/// pairs whatever the images are. `recorded` is the selection in the record of an earlier run: if
/// it has matched all pairs, those that `auto` would choose are among them.
pub(crate) fn resolved(
    selection: PairSelection,
    images: usize,
    recorded: Option<&str>,
) -> PairSelection {
    let is_exhaustive = recorded == Some(&*PairSelection::Exhaustive.to_string());
    match selection {
        PairSelection::Auto if images <= AutoPairs::MAX_ALWAYS_EXHAUSTIVE || is_exhaustive => {
            PairSelection::Exhaustive
        }
        other => other,
    }
}

/// [`resolved`] for the images of a database: without SIFT descriptors, `auto` is all pairs.
pub(crate) fn resolved_in(
    database: &Database,
    selection: PairSelection,
) -> Result<PairSelection, Error> {
    Ok(match resolved(selection, database.num_images(), None) {
        PairSelection::Auto if database.descriptor_format()? != DescriptorFormat::SIFT => {
            PairSelection::Exhaustive
        }
        other => other,
    })
}

/// [`choose_pairs`] with the open database of the workspace and its images.
pub(crate) fn choose_pairs_of_images(
    workspace: &Workspace,
    database: &Database,
    images: &[Image],
    selection: PairSelection,
    seed: u64,
) -> Result<PairChoice, Error> {
    let times = workspace.verified_timestamps()?;
    let times = times.map_or(Ok(BTreeMap::new()), |path| timestamps::read(&path))?;
    let selection = resolved_in(database, selection)?;
    let (selection, pairs) = match selection {
        PairSelection::Auto => automatic(database, images, &times, seed)?,
        given => (given.to_string(), selected(database, images, &times, given, seed)?),
    };
    let pair = |(a, b)| ImagePair::new(ImageId(a), ImageId(b));
    Ok(PairChoice { selection, pairs: pairs.into_iter().filter_map(pair).collect() })
}

/// The pairs of `auto` for more images than [`AutoPairs::MAX_ALWAYS_EXHAUSTIVE`].
fn automatic(
    database: &Database,
    images: &[Image],
    times: &BTreeMap<String, f64>,
    seed: u64,
) -> Result<(String, Vec<(u32, u32)>), Error> {
    let cameras = camera_images(images, times)?;
    let is_few = images.len() <= AutoPairs::MAX_EXHAUSTIVE;
    let exhaustive = PairSelection::Exhaustive.to_string();
    if is_few && !may_be_recordings(&cameras) {
        let pairs = selected(database, images, times, PairSelection::Exhaustive, seed)?;
        return Ok((exhaustive, pairs));
    }
    let similar = similar_images(database, &all_ids(images.len()), num_similar(&cameras), seed)?;
    let chosen = auto_pairs(&cameras, &similar);
    let of_sequences = cameras.iter().zip(&chosen.is_sequence).filter(|(_, is)| **is);
    let in_order: usize = of_sequences.map(|(camera, _)| camera.sequence.len()).sum();
    let sequential =
        format!("sequential:{}+loops:{}", AutoPairs::OVERLAP, AutoPairs::NUM_LOOP_IMAGES);
    let of_others =
        if is_few { exhaustive } else { format!("similar:{}", AutoPairs::NUM_SIMILAR_IMAGES) };
    let selection = match images.len() - in_order {
        0 => sequential,
        others if others == images.len() => of_others,
        others => format!("{sequential} for {in_order} images, {of_others} for {others}"),
    };
    Ok((selection, chosen.pairs))
}

/// The most similar images to every image, by an inverted index of visual words that are learnt
/// from all images.
fn similar_images(
    database: &Database,
    images: &[ImageId],
    count: usize,
    seed: u64,
) -> Result<Vec<Vec<Similar>>, Error> {
    let counts = database.keypoint_counts()?;
    let leading = counts.iter().flatten().map(|&count| count.min(Vocabulary::LEADING));
    let words = leading.sum::<usize>().div_ceil(DESCRIPTORS_PER_WORD);
    let of_image = (SAMPLE_PER_WORD * words).div_ceil(images.len().max(1));
    let some = |descriptors: &[SiftDescriptor]| -> Vec<SiftDescriptor> {
        Vocabulary::sample(descriptors, of_image).copied().collect()
    };
    let mut sample = Vec::new();
    for_all_images(database, images, some, |of_image| sample.extend(of_image))?;
    let vocabulary = VocabularyTree::learn(&sample, words, seed);
    drop(sample);
    let mut described: Vec<ImageWords> = Vec::with_capacity(images.len());
    let describe = |descriptors: &[SiftDescriptor]| vocabulary.describe(descriptors);
    for_all_images(database, images, describe, |image| described.push(image))?;
    Ok(InvertedIndex::new(&vocabulary, &described).most_similar(count))
}

/// The pairs of an explicit selection. The images of a stream are a sequence, whatever settings its
/// camera had; they are ordered by time if all times are known, else by name, numbers by value.
fn selected(
    database: &Database,
    images: &[Image],
    times: &BTreeMap<String, f64>,
    selection: PairSelection,
    seed: u64,
) -> Result<Vec<(u32, u32)>, Error> {
    let images_of_all = images;
    // Of each camera: the first camera of its stream, that of its first image.
    let mut firsts: BTreeMap<u32, u32> = BTreeMap::new();
    let mut first_of_stream: BTreeMap<&str, u32> = BTreeMap::new();
    for image in images {
        firsts
            .entry(image.camera.0)
            .or_insert_with(|| *first_of_stream.entry(&*image.stream).or_insert(image.camera.0));
    }
    let mut streams: BTreeMap<u32, Vec<(f64, u32)>> = BTreeMap::new();
    let are_timed = images.iter().all(|image| times.contains_key(&image.name));
    for (id, image) in (0..).zip(images) {
        let time_s = times.get(&image.name).copied().unwrap_or_default();
        streams.entry(firsts[&image.camera.0]).or_default().push((time_s, id));
    }
    let sequences = streams.into_values().map(|mut images| {
        if !are_timed {
            let name = |id: u32| images_of_all[id as usize].name.as_str();
            images.sort_by(|a, b| natural_order(name(a.1), name(b.1)));
            return Ok(Sequence::new(images.into_iter().map(|(_, id)| id).collect()));
        }
        images.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (times_s, ids) = images.into_iter().unzip();
        Sequence::with_times(ids, times_s)
    });
    let sequences: Vec<Sequence> = sequences.collect::<Result<_, _>>()?;
    let mut pairs = selection.pairs(&sequences);
    if selection.similar() > 0 {
        let (_, index) = learn_retrieval(database, &all_ids(images.len()), seed)?;
        let similar = index.pairs(selection.similar() as usize, &pairs);
        pairs.extend(similar);
        pairs.sort_unstable();
    }
    Ok(pairs)
}

/// The ids of the images of a database.
pub fn all_ids(images: usize) -> Vec<ImageId> {
    (0..images).map(ImageId::from_index).collect()
}

/// The SIFT descriptors of an image, which retrieval is made for.
fn sift_of<'a>(database: &Database, features: &'a Features) -> Result<&'a [SiftDescriptor], Error> {
    features.descriptors.as_sift().ok_or_else(|| Error::NoRetrieval {
        path: database.path().to_owned(),
        format: features.descriptors.format(),
    })
}

/// Learns a visual vocabulary from a sample of the images, and indexes the global descriptors of
/// all.
///
/// # Errors
///
/// The descriptors are not those of SIFT; the database cannot be read.
pub fn learn_retrieval(
    database: &Database,
    images: &[ImageId],
    seed: u64,
) -> Result<(Vocabulary, RetrievalIndex), Error> {
    let mut sample = Vec::new();
    for image in images.iter().step_by(images.len().div_ceil(SAMPLE_IMAGES).max(1)) {
        let features = database.read_features(*image)?;
        let descriptors = sift_of(database, &features)?;
        sample.extend(Vocabulary::sample(descriptors, SAMPLE_DESCRIPTORS).copied());
    }
    let vocabulary = Vocabulary::learn(&sample, &VocabularyOptions { seed, ..Default::default() });
    let mut index = RetrievalIndex::default();
    let describe = |descriptors: &[SiftDescriptor]| vocabulary.describe(descriptors);
    for_all_images(database, images, describe, |image: GlobalDescriptor| index.push(&image))?;
    Ok((vocabulary, index))
}

/// Computes something from the descriptors of every image, and takes the results in order. Few
/// images are in memory at a time.
fn for_all_images<T: Send>(
    database: &Database,
    images: &[ImageId],
    compute: impl Fn(&[SiftDescriptor]) -> T + Sync,
    mut take: impl FnMut(T),
) -> Result<(), Error> {
    for batch in images.chunks(IMAGES_READ_AT_ONCE) {
        let features = batch.iter().map(|&image| database.read_features(image));
        let features = features.collect::<Result<Vec<_>, _>>()?;
        let descriptors = features.iter().map(|features| sift_of(database, features));
        let descriptors = descriptors.collect::<Result<Vec<_>, _>>()?;
        let computed: Vec<T> = descriptors.into_par_iter().map(&compute).collect();
        computed.into_iter().for_each(&mut take);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use tiepoint_io::features::Keypoint;
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Rng};
    use tiepoint_sfm::scene::{Camera, CameraId};

    use super::*;

    const FEATURES: u32 = 40;

    /// A workspace of features. `descriptors` gives for each image and feature the number of a
    /// descriptor; each image sees it with other noise.
    fn database(
        folder: &std::path::Path,
        names: &[String],
        descriptors: impl Fn(u32, u32) -> u64,
    ) -> Database {
        let mut database = Database::create(&folder.join("database.db")).unwrap();
        let intrinsics = Intrinsics::new(CameraModelKind::Pinhole, &[9.0, 9.0, 5.0, 5.0]).unwrap();
        let camera = Camera { intrinsics, width: 10, height: 10, has_focal_prior: false };
        database.write_cameras(&[camera]).unwrap();
        let image = |name: &String| Image::new(name.as_str(), CameraId(0), Vec::new());
        database.write_images(&names.iter().map(image).collect::<Vec<_>>()).unwrap();
        for k in 0..names.len() as u32 {
            let mut noise = Rng::stream(8, &[u64::from(k)]);
            let mut seen = |feature: u32| -> SiftDescriptor {
                let mut place = Rng::stream(7, &[descriptors(k, feature)]);
                std::array::from_fn(|_| (place.below(80) + noise.below(8)) as u8)
            };
            let features = Features {
                keypoints: vec![
                    Keypoint { x: 1.0, y: 2.0, scale: 1.0, orientation: 0.0 };
                    FEATURES as usize
                ],
                descriptors: (0..FEATURES).map(&mut seen).collect(),
            };
            database.write_features([(ImageId(k), &features)]).unwrap();
        }
        database
    }

    #[test]
    fn similar_images_are_paired() {
        /// More than are read at a time; two images per place.
        const PLACES: u32 = 50;
        let folder = tempfile::tempdir().unwrap();
        let names: Vec<String> = (0..2 * PLACES).map(|k| format!("{k}.jpg")).collect();
        let place = |image: u32, feature: u32| u64::from(image % PLACES * FEATURES + feature);
        let database = database(folder.path(), &names, place);
        let expected: Vec<(u32, u32)> = (0..PLACES).map(|k| (k, k + PLACES)).collect();
        let pairs = learn_retrieval(&database, &all_ids(names.len()), 0).unwrap().1.pairs(1, &[]);
        assert_eq!(pairs, expected);
        let similar = similar_images(&database, &all_ids(names.len()), 1, 0).unwrap();
        for (a, others) in (0..).zip(similar) {
            assert_eq!(others[0].image, (a + PLACES) % (2 * PLACES));
        }
    }

    /// Images along a street; those up to 20 positions apart share features.
    #[test]
    fn a_sequence_is_told_from_photos_in_no_order() {
        const IMAGES: u32 = 240;
        let along = |place: u32, feature: u32| u64::from(2 * place + feature);
        let mut shuffled: Vec<u32> = (0..IMAGES).collect();
        let mut random = Rng::stream(1, &[]);
        for end in (2..=shuffled.len()).rev() {
            shuffled.swap(end - 1, random.below(end));
        }
        let numbered: Vec<String> = (0..IMAGES).map(|k| format!("a/{k:03}.jpg")).collect();
        for (is_shuffled, selection) in [(false, "sequential:10+loops:20"), (true, "similar:100")] {
            let folder = tempfile::tempdir().unwrap();
            let place = |image: u32| if is_shuffled { shuffled[image as usize] } else { image };
            let database =
                database(folder.path(), &numbered, |k, feature| along(place(k), feature));
            let images = database.read_images().unwrap();
            let (chosen, pairs) = automatic(&database, &images, &BTreeMap::new(), 0).unwrap();
            assert_eq!(chosen, selection);
            let places: Vec<(u32, u32)> = pairs
                .iter()
                .map(|&(a, b)| (place(a).min(place(b)), place(a).max(place(b))))
                .collect();
            for at in 0..IMAGES - 5 {
                assert!((1..=5).all(|gap| places.contains(&(at, at + gap))), "{is_shuffled} {at}");
            }
        }
    }

    #[test]
    fn few_photos_have_all_pairs_and_recordings_do_not() {
        const IMAGES: u32 = 80;
        let along = |place: u32, feature: u32| u64::from(2 * place + feature);
        let photos: Vec<String> = (0..IMAGES).map(|k| format!("a/{k:03}.jpg")).collect();
        let of_two = |k: u32| format!("{}/{:03}.jpg", ["left", "right"][k as usize % 2], k / 2);
        let recording: Vec<String> = (0..IMAGES).map(of_two).collect();
        let all = (IMAGES * (IMAGES - 1) / 2) as usize;
        for (names, expected) in [(photos, "exhaustive"), (recording, "sequential:10+loops:20")] {
            let folder = tempfile::tempdir().unwrap();
            let database = database(folder.path(), &names, along);
            let images = database.read_images().unwrap();
            let (chosen, pairs) = automatic(&database, &images, &BTreeMap::new(), 0).unwrap();
            assert_eq!(chosen, expected);
            assert_eq!(pairs.len() == all, expected == "exhaustive", "{} pairs", pairs.len());
        }
    }

    #[test]
    fn auto_is_exhaustive_for_few_images_and_where_all_pairs_were_matched() {
        let [auto, exhaustive] = [PairSelection::Auto, PairSelection::Exhaustive];
        const MOST: usize = AutoPairs::MAX_ALWAYS_EXHAUSTIVE;
        assert_eq!(resolved(auto, MOST, None), exhaustive);
        assert_eq!(resolved(auto, MOST + 1, None), auto);
        assert_eq!(resolved(auto, MOST + 1, Some("exhaustive")), exhaustive);
        assert_eq!(resolved(auto, MOST + 1, Some("sequential:5")), auto);
        let similar = PairSelection::Similar { count: 3 };
        assert_eq!(resolved(similar, 5, Some("exhaustive")), similar);
    }
}
