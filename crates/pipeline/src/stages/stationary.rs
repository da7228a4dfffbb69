//! Matches on overlays are removed after all pairs are matched, because only many images of a
//! camera tell them from distant points. Pairs that have some are verified again without them.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use tiepoint_io::database::Database;
use tiepoint_sfm::geometry::epipolar::epipoles;
use tiepoint_sfm::scene::{
    Camera, CameraId, ImageId, ImagePair, Keypoint, Match, Reconstruction, TwoView, TwoViewKind,
};
use tiepoint_sfm::two_view::{
    Candidates, ImageObservations, MovedPairs, Stationary, StationarySearch, VerifyOptions,
};

use crate::Error;
use crate::stages::verification::{of_keypoints, verify};
use crate::workspace::database_scene::read_scene;
use crate::workspace::overlay_report::OverlayReport;
use crate::workspace::report::MatchReport;

/// Pairs whose matches are in memory at a time.
const PAIRS_AT_ONCE: usize = 64;
/// A camera with fewer images is compared with all other such images of the same size.
const MIN_IMAGES_OF_CAMERA: usize = 4;

/// New two-view geometries of pairs with matches on overlays, and what was found.
#[derive(Debug, Default)]
pub struct Removal {
    views: BTreeMap<ImagePair, TwoView>,
    overlays: Vec<OverlayReport>,
    matches: usize,
    watermarks: usize,
}

impl Removal {
    /// Finds matches on overlays in a database with matches and two-view geometries of all pairs.
    ///
    /// # Errors
    ///
    /// The database cannot be read.
    pub fn find(database: &Database, options: &VerifyOptions, seed: u64) -> Result<Self, Error> {
        let scene = read_scene(database)?;
        let keypoints: Vec<&[Keypoint]> = scene.images().map(|(_, i)| &*i.keypoints).collect();
        let groups = groups(&scene);
        let verification = Verification { scene: &scene, options, seed };
        let pairs = pairs_of(database)?;
        let mut search = StationarySearch::new(&keypoints, &groups);
        for pair in pairs.iter().copied() {
            search.add(
                pair,
                &matches_of(database, &scene, pair)?,
                &database.read_inliers_of(pair)?,
            );
        }
        let candidates = search.candidates();
        let moved = verification.moved(database, &candidates)?;
        let stationary = candidates.select(&moved);
        if stationary.is_empty() {
            return Ok(Self::default());
        }
        let mut removal =
            Self { overlays: reports(&scene, &groups, &stationary), ..Self::default() };
        let touched: Vec<ImagePair> = pairs
            .into_iter()
            .filter(|pair| stationary.is_in(pair.a) || stationary.is_in(pair.b))
            .collect();
        for pairs in touched.chunks(PAIRS_AT_ONCE) {
            let mut tasks = Vec::new();
            for &pair in pairs {
                let all = matches_of(database, &scene, pair)?;
                let kept = stationary.without(pair, &all);
                if kept.len() < all.len() {
                    tasks.push((pair, all.len() - kept.len(), kept));
                }
            }
            let views = tasks.into_par_iter().map(|(pair, removed, kept)| {
                let view = verification.verify(pair, &kept);
                let is_watermark = !view.is_verified() && removed >= options.min_num_inliers;
                let watermark = || TwoView { kind: TwoViewKind::Watermark, ..TwoView::default() };
                (pair, removed, if is_watermark { watermark() } else { view })
            });
            for (pair, removed, view) in views.collect::<Vec<_>>() {
                removal.matches += removed;
                removal.watermarks += usize::from(view.kind == TwoViewKind::Watermark);
                removal.views.insert(pair, view);
            }
        }
        Ok(removal)
    }

    /// The new geometries.
    pub fn into_views(self) -> BTreeMap<ImagePair, TwoView> {
        self.views
    }

    /// The report with the counts after the removal. `database`: as it was in [`Removal::find`].
    ///
    /// # Errors
    ///
    /// The database cannot be read.
    pub fn added_to(
        &self,
        mut report: MatchReport,
        database: &Database,
    ) -> Result<MatchReport, Error> {
        for (pair, before) in database.inlier_counts()? {
            if let Some(view) = self.views.get(&pair) {
                report.verified_pairs -= usize::from(before.is_some());
                report.inlier_matches -= before.unwrap_or(0);
                report.verified_pairs += usize::from(view.is_verified());
                report.inlier_matches += if view.is_verified() { view.matches.len() } else { 0 };
            }
        }
        report.stationary_matches = self.matches;
        report.watermark_pairs = self.watermarks;
        report.overlays.clone_from(&self.overlays);
        Ok(report)
    }
}

/// The pairs with matches or a two-view geometry.
fn pairs_of(database: &Database) -> Result<BTreeSet<ImagePair>, Error> {
    let counts = database.inlier_counts()?;
    let matched = database.matched_pairs()?;
    Ok(matched.into_iter().chain(counts.into_iter().map(|(pair, _)| pair)).collect())
}

/// The descriptor matches of a pair. Databases of other programs may have inliers alone.
fn matches_of(
    database: &Database,
    scene: &Reconstruction,
    pair: ImagePair,
) -> Result<Vec<Match>, Error> {
    let matches = database.read_matches_of(pair)?;
    let matches = if matches.is_empty() { database.read_inliers_of(pair)? } else { matches };
    Ok(of_keypoints(pair, matches, |image| scene.image(image).keypoints.len()))
}

/// What a pair is verified with.
struct Verification<'a> {
    scene: &'a Reconstruction,
    options: &'a VerifyOptions,
    seed: u64,
}

impl Verification<'_> {
    fn verify(&self, pair: ImagePair, matches: &[Match]) -> TwoView {
        let view = |image: ImageId| ImageObservations::new(self.scene, image);
        verify(pair, view, matches, self.options, self.seed)
    }

    /// The pairs of candidates whose other matches have a geometry that moves.
    fn moved(&self, database: &Database, candidates: &Candidates) -> Result<MovedPairs, Error> {
        let enough = self.options.min_num_inliers;
        let mut moved = MovedPairs::new();
        for pairs in candidates.pairs().chunks(PAIRS_AT_ONCE) {
            let mut tasks = Vec::new();
            for &pair in pairs {
                let matches = matches_of(database, self.scene, pair)?;
                let moving = candidates.moving(pair, &matches);
                if moving.len() >= enough {
                    tasks.push((pair, matches.len(), moving));
                }
            }
            let has_moved = |(pair, num_matches, moving): (ImagePair, usize, Vec<Match>)| {
                let view = self.verify(pair, &moving);
                let num_inliers = view.matches.len();
                let is_moved =
                    num_inliers >= enough && Candidates::is_moved(num_inliers, num_matches);
                is_moved.then(|| (pair, view.fundamental.as_ref().and_then(epipoles)))
            };
            moved.extend(tasks.into_par_iter().filter_map(has_moved).collect::<Vec<_>>());
        }
        Ok(moved)
    }
}

/// The group of each image: its camera, or the images of its size whose cameras have few images.
fn groups(scene: &Reconstruction) -> Vec<usize> {
    let mut counts: BTreeMap<CameraId, usize> = BTreeMap::new();
    for (_, image) in scene.images() {
        *counts.entry(image.camera).or_default() += 1;
    }
    let mut numbers: BTreeMap<(Option<CameraId>, u32, u32), usize> = BTreeMap::new();
    let group = |(_, image): (ImageId, &tiepoint_sfm::scene::Image)| {
        let Camera { width, height, .. } = *scene.camera(image.camera);
        let own = (counts[&image.camera] >= MIN_IMAGES_OF_CAMERA).then_some(image.camera);
        let next = numbers.len();
        *numbers.entry((own, width, height)).or_insert(next)
    };
    scene.images().map(group).collect()
}

fn reports(scene: &Reconstruction, groups: &[usize], found: &Stationary) -> Vec<OverlayReport> {
    let report = |overlay: &tiepoint_sfm::two_view::Overlay| {
        let is_of = |(_, group): &(_, &usize)| **group == overlay.group;
        let cameras: BTreeSet<CameraId> =
            scene.images().zip(groups).filter(is_of).map(|((_, image), _)| image.camera).collect();
        let first = cameras.first().map(|camera| scene.camera(*camera));
        let round = |value: f64| (10.0 * value).round() / 10.0;
        OverlayReport {
            camera: cameras.first().filter(|_| cameras.len() == 1).map(|camera| camera.0 + 1),
            width: first.map_or(0, |camera| camera.width),
            height: first.map_or(0, |camera| camera.height),
            images: overlay.images,
            spots: overlay.spots,
            regions: overlay.regions.iter().map(|bounds| bounds.map(round)).collect(),
        }
    };
    found.overlays.iter().map(report).collect()
}
