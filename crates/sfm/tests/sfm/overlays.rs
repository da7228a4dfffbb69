//! Matches on overlays: what is found, and where nothing must be.

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_scene::{ImageId, ImagePair, Keypoint, Match};
use tiepoint_sfm::two_view::{MovedPairs, Stationary, StationarySearch, VerifyOptions};

const SEED: u64 = 1;
/// The image, in pixels.
const SIZE_PX: [f64; 2] = [640.0, 480.0];
/// Points of the scene.
const POINTS: usize = 300;
/// Displacement of a point of depth 1 from one image to the next, in pixels.
const STEP_PX: f64 = 12.0;
/// Noise of a keypoint along each axis, in pixels: that of SIFT at its finest scales.
const NOISE_PX: f64 = 0.25;
/// Spots of a logo, and where it is.
const SPOTS: usize = 20;
const LOGO_PX: [f64; 4] = [500.0, 20.0, 80.0, 40.0];

/// Images of one camera with their matches: all pairs, every point of the scene and of the overlay
/// where it is seen.
struct Photos {
    keypoints: Vec<Vec<Keypoint>>,
    /// The point of each keypoint.
    points: Vec<Vec<usize>>,
    /// Number of the first point of the overlay.
    first_spot: usize,
}

impl Photos {
    /// `places`: the place of the camera of each image along its path, in steps. `has_logo`:
    /// whether an image has the overlay.
    fn new(places: &[f64], spots: usize, noise_px: f64, has_logo: impl Fn(usize) -> bool) -> Self {
        let mut rng = Rng::stream(SEED, &[]);
        // Depths from a half to two, and pixels that cover the image all along the path.
        let reach = 2.0 * STEP_PX * places.iter().fold(0.0f64, |max, place| max.max(*place));
        let points: Vec<(Vector2<f64>, f64)> = (0..POINTS)
            .map(|_| {
                let x = rng.uniform() * (SIZE_PX[0] + reach);
                (Vector2::new(x, rng.uniform() * SIZE_PX[1]), 0.5 + 1.5 * rng.uniform())
            })
            .collect();
        let [left, top, width, height] = LOGO_PX;
        let logo: Vec<Vector2<f64>> = (0..spots)
            .map(|_| Vector2::new(left + width * rng.uniform(), top + height * rng.uniform()))
            .collect();
        let mut photos =
            Self { keypoints: Vec::new(), points: Vec::new(), first_spot: points.len() };
        for (image, place) in places.iter().enumerate() {
            let scene = points.iter().enumerate().filter_map(|(point, (pixel, inverse_depth))| {
                let pixel = pixel - Vector2::new(STEP_PX * inverse_depth * place, 0.0);
                (0.0..SIZE_PX[0]).contains(&pixel.x).then_some((point, pixel))
            });
            let logo = logo.iter().enumerate().map(|(spot, pixel)| (POINTS + spot, *pixel));
            let logo = logo.filter(|_| has_logo(image));
            let (mut keypoints, mut of) = (Vec::new(), Vec::new());
            for (point, pixel) in scene.chain(logo) {
                let noise = Vector2::new(rng.normal(), rng.normal()) * noise_px;
                keypoints.push(Keypoint { pixel: pixel + noise, scale_px: 2.0 });
                of.push(point);
            }
            photos.keypoints.push(keypoints);
            photos.points.push(of);
        }
        photos
    }

    fn matches(&self, pair: ImagePair) -> Vec<Match> {
        let [one, other] = [pair.a, pair.b].map(|image| &self.points[image.index()]);
        let place = |(a, point): (usize, &usize)| {
            let b = other.iter().position(|of| of == point)?;
            Some(Match { a: a as u32, b: b as u32 })
        };
        one.iter().enumerate().filter_map(place).collect()
    }

    fn pairs(&self) -> Vec<ImagePair> {
        let count = self.keypoints.len();
        let all = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
        let pair = |(a, b)| ImagePair::new(ImageId::from_index(a), ImageId::from_index(b));
        all.filter_map(pair).collect()
    }

    /// Asserts that `check` holds of what is found. A pair's scene moves if enough of its matches
    /// do: here no match is wrong.
    fn find<T>(&self, check: impl FnOnce(&Stationary) -> T) -> T {
        self.find_with(None, check)
    }

    /// [`Photos::find`] where all pairs have these epipoles.
    fn find_with<T>(
        &self,
        epipoles: Option<[Vector2<f64>; 2]>,
        check: impl FnOnce(&Stationary) -> T,
    ) -> T {
        let keypoints: Vec<&[Keypoint]> = self.keypoints.iter().map(Vec::as_slice).collect();
        let groups = vec![0; keypoints.len()];
        let mut search = StationarySearch::new(&keypoints, &groups);
        for pair in self.pairs() {
            let matches = self.matches(pair);
            search.add(pair, &matches, &matches);
        }
        let candidates = search.candidates();
        let enough = VerifyOptions::default().min_num_inliers;
        let moves =
            |pair: &ImagePair| candidates.moving(*pair, &self.matches(*pair)).len() >= enough;
        let pairs = candidates.pairs().into_iter().filter(moves);
        let moved: MovedPairs = pairs.map(|pair| (pair, epipoles)).collect();
        check(&candidates.select(&moved))
    }

    /// Shares of the keypoints on the overlay and of the others that are found.
    fn shares(&self) -> [f64; 2] {
        self.find(|found| {
            let mut counts = [[0.0; 2]; 2];
            for (image, points) in self.points.iter().enumerate() {
                for (keypoint, point) in points.iter().enumerate() {
                    let is_found = found.contains(ImageId::from_index(image), keypoint as u32);
                    counts[usize::from(*point < self.first_spot)][usize::from(is_found)] += 1.0;
                }
            }
            counts.map(|[missed, found]| found / f64::max(1.0, missed + found))
        })
    }
}

/// Places of images at equal steps.
fn drive(images: usize) -> Vec<f64> {
    (0..images).map(|image| image as f64).collect()
}

/// What a camera drives to stands still at the epipoles, whatever its depth. The limit is an eighth
/// of the larger side of the keypoints' extent, 80 px, from each spot; the logo is 80 px wide.
#[test]
fn what_stands_still_at_the_epipoles_is_no_overlay() {
    let photos = Photos::new(&drive(12), SPOTS, NOISE_PX, |_| true);
    let [left, top, width, height] = LOGO_PX;
    let centre = Vector2::new(left + 0.5 * width, top + 0.5 * height);
    for (aside, is_found) in [(0.0, false), (30.0, false), (125.0, true)] {
        let epipole = centre - Vector2::new(aside, 0.0);
        let found = photos.find_with(Some([epipole; 2]), |found| !found.is_empty());
        assert_eq!(found, is_found, "{aside}");
    }
    // Where one image alone is driven to, the overlay does not stand at the other's epipole.
    let far = centre - Vector2::new(300.0, 0.0);
    assert!(photos.find_with(Some([centre, far]), |found| !found.is_empty()));
}

#[test]
fn a_logo_is_found_and_nothing_else() {
    let photos = Photos::new(&drive(8), SPOTS, NOISE_PX, |_| true);
    // One keypoint of the scene in a hundred is within two scales of a spot by chance.
    let [logo, scene] = photos.shares();
    assert!(logo == 1.0 && scene < 0.02, "{logo} {scene}");
    photos.find(|found| {
        for pair in photos.pairs() {
            let kept = found.without(pair, &photos.matches(pair));
            let of = |m: &Match| photos.points[pair.a.index()][m.a as usize];
            assert!(kept.iter().all(|m| of(m) < photos.first_spot));
        }
        let [overlay] = &*found.overlays else { panic!("one camera: {:?}", found.overlays) };
        assert_eq!((overlay.images, overlay.spots), (8, SPOTS));
        let [region] = &*overlay.regions else { panic!("one region: {:?}", overlay.regions) };
        let [left, top, width, height] = LOGO_PX;
        assert!(region[0] > left - 5.0 && region[1] > top - 5.0, "{region:?}");
        assert!(region[2] < left + width + 5.0 && region[3] < top + height + 5.0, "{region:?}");
    });
}

/// No keypoint may be found.
fn assert_nothing(photos: &Photos) {
    assert_eq!(photos.shares(), [0.0, 0.0]);
    photos.find(|found| assert!(found.is_empty()));
}

#[test]
fn a_drive_without_overlay_changes_nothing() {
    assert_nothing(&Photos::new(&drive(20), 0, NOISE_PX, |_| false));
}

/// A vehicle that stops for a third of its images, at the beginning, on its way and at the end.
#[test]
fn a_stop_changes_nothing() {
    for first in [0, 8, 16] {
        let place = |image: usize| (image.min(first) + image.saturating_sub(first + 8)) as f64;
        let places: Vec<f64> = (0..24).map(place).collect();
        assert_nothing(&Photos::new(&places, 0, NOISE_PX, |_| false));
    }
}

#[test]
fn photos_from_one_spot_stay() {
    assert_nothing(&Photos::new(&[0.0; 12], 0, NOISE_PX, |_| false));
    // From two spots, one after the other, and from one with a logo, which cannot be told.
    let places: Vec<f64> = (0..12).map(|image| if image < 6 { 0.0 } else { 4.0 }).collect();
    assert_nothing(&Photos::new(&places, 0, NOISE_PX, |_| false));
    assert_nothing(&Photos::new(&[0.0; 12], SPOTS, NOISE_PX, |_| true));
}

#[test]
fn fewer_than_four_images_decide_nothing() {
    assert_nothing(&Photos::new(&drive(3), SPOTS, NOISE_PX, |_| true));
    assert_eq!(Photos::new(&drive(4), SPOTS, NOISE_PX, |_| true).shares()[0], 1.0);
}

/// Keypoints of a real overlay scatter by less than half a pixel, all axes together; what drifts
/// does by more.
#[test]
fn spots_scatter_by_less_than_half_a_pixel() {
    let share = |noise_px| Photos::new(&drive(12), SPOTS, noise_px, |_| true).shares()[0];
    assert_eq!(share(0.2), 1.0);
    assert_eq!(share(0.8), 0.0);
}

/// The overlay of another camera's photos among them: on a third of the images or more it is found.
#[test]
fn an_overlay_is_on_a_third_of_the_images() {
    let shares = |every: usize| {
        Photos::new(&drive(18), SPOTS, NOISE_PX, |image| image % every == 0).shares()
    };
    assert_eq!(shares(2)[0], 1.0);
    assert_eq!(shares(4)[0], 0.0);
}

/// On less than half of the images eight spots are an overlay, and seven may be a vehicle ahead.
#[test]
fn few_spots_are_on_half_of_the_images() {
    let share = |spots, every: usize| {
        Photos::new(&drive(18), spots, NOISE_PX, |image| image % every == 0).shares()[0]
    };
    // On 6 of 18 images each spot stands still in 15 of 102 - 15 pairs: too few, whatever it is.
    assert_eq!(share(4, 1), 1.0);
    let two_of_five =
        |spots| Photos::new(&drive(20), spots, NOISE_PX, |image| image % 5 < 2).shares()[0];
    assert_eq!([two_of_five(7), two_of_five(8)], [0.0, 1.0]);
    // On a few images, a few spots may be distant.
    let short = |spots| Photos::new(&drive(15), spots, NOISE_PX, |_| true).shares()[0];
    assert_eq!([short(4), short(8)], [0.0, 1.0]);
}
