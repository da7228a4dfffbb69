//! Whether the images of a finished model agree with a camera that only turned.
//!
//! Photos from one spot have no depth. With a lens that is not known, a model of them may still be
//! found: wrong poses and distortions bend rays until points have depths. A camera that turned has
//! a rotation for each pair and nothing else, so the pairs are fitted by rotations under a lens of
//! their own, with fewer parameters than the model has.

use std::collections::BTreeMap;

use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::{ImageId, Reconstruction};

/// Fewest matches of a pair, and most that are used of it.
const MATCHES: [usize; 2] = [15, 60];
/// Most pairs that are used.
const MAX_PAIRS: usize = 150;
/// Focal lengths relative to the larger side that the search begins at, and its bounds. A longer
/// lens that turns and one that is moved along a plane give nearly the same images: at twice the
/// larger side and a displacement of a quarter of the image they differ by 1 px.
const FOCALS: [f64; 6] = [0.3, 0.45, 0.65, 0.9, 1.3, 1.8];
const FOCAL_BOUNDS: [f64; 2] = [0.2, 2.0];
/// Radial distortions that the search begins at.
const DISTORTIONS: [f64; 3] = [0.0, -0.15, -0.3];
/// A lens whose error is larger than that of the model by this factor is not refined.
const MAX_FIRST_RATIO: f64 = 30.0;
/// First steps of the search for a lens, of the logarithm of the focal length and two distortions;
/// its directions, and its last step relative to the first.
const FIRST_STEPS: [f64; 3] = [0.1, 0.05, 0.03];
const DIRECTIONS: [[f64; 3]; 7] = [
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, -1.0, 0.0],
    [1.0, 1.0, 0.0],
    [0.0, 1.0, -1.0],
    [1.0, -1.0, 1.0],
];
const MIN_STEP: f64 = 0.02;

/// A camera that only turned, and how it fits the observations of a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turning {
    /// Median error of the pairs' rotations, relative to that of the same pairs in the model.
    pub error_ratio: f64,
    /// The focal length of its lens, in pixels.
    pub focal_px: f64,
    /// Whether that lens is a fisheye.
    pub is_fisheye: bool,
}

/// Two keypoints that observe the same point.
type Pixels = [Vector2<f64>; 2];
/// Those of a pair of images.
type Pair = Vec<Pixels>;

/// The lens with which rotations fit the pairs of the model's most frequent image size best; `None`
/// if these are less than half of its images, or no lens comes near.
pub fn turning(model: &Reconstruction) -> Option<Turning> {
    let mut sizes: BTreeMap<[u32; 2], usize> = BTreeMap::new();
    let size = |image: ImageId| {
        let camera = model.camera(model.image(image).camera);
        [camera.width, camera.height]
    };
    for (id, ..) in model.registered() {
        *sizes.entry(size(id)).or_default() += 1;
    }
    let (&common, &count) = sizes.iter().max_by_key(|(size, count)| (**count, **size))?;
    if 2 * count < model.num_registered() {
        return None;
    }
    let (pairs, error_px) = pairs_of(model, &|image| size(image) == common);
    if pairs.is_empty() {
        return None;
    }
    let lens = |kind, params: [f64; 3]| Lens { kind, size: common, params };
    let mut best: Option<(Lens, f64)> = None;
    for kind in [CameraModelKind::Radial, CameraModelKind::RadialFisheye] {
        let first =
            FOCALS.iter().flat_map(|focal| DISTORTIONS.map(|k| lens(kind, [focal.ln(), k, 0.0])));
        let first = first.map(|lens| (lens, lens.error_px(&pairs)));
        let Some(first) = first.min_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
        if first.1 > MAX_FIRST_RATIO * error_px {
            continue;
        }
        let found = first.0.refined(&pairs);
        if best.is_none_or(|(_, error)| found.1 < error) {
            best = Some(found);
        }
    }
    let (lens, rotation_px) = best?;
    Some(Turning {
        error_ratio: rotation_px / error_px,
        focal_px: lens.focal_px(),
        is_fisheye: lens.kind == CameraModelKind::RadialFisheye,
    })
}

/// The pairs of consecutive observations of points and of their first and last one, those with the
/// most matches first, and the median of both residuals of a pair: the error of the model that a
/// rotation is compared with.
fn pairs_of(model: &Reconstruction, is_used: &dyn Fn(ImageId) -> bool) -> (Vec<Pair>, f64) {
    let mut matches: BTreeMap<[ImageId; 2], Vec<(Pixels, f64)>> = BTreeMap::new();
    for (_, track) in model.tracks() {
        let observed = track.observations.iter().filter_map(|o| {
            let image = model.image(o.image);
            let pixel = image.keypoints[o.keypoint as usize].pixel;
            let intrinsics = &model.camera(image.camera).intrinsics;
            let projected = intrinsics.project(&(*image.cam_from_world()? * track.xyz))?;
            is_used(o.image).then_some((o.image, pixel, pixel - projected))
        });
        let mut observed: Vec<_> = observed.collect();
        observed.sort_by_key(|(image, ..)| *image);
        let ends = observed.first().zip(observed.last()).filter(|_| observed.len() > 2);
        let consecutive = observed.windows(2).map(|two| (&two[0], &two[1]));
        for (&(a, pixel_a, error_a), &(b, pixel_b, error_b)) in consecutive.chain(ends) {
            if a == b {
                continue;
            }
            let error = error_a.norm().hypot(error_b.norm());
            matches.entry([a, b]).or_default().push(([pixel_a, pixel_b], error));
        }
    }
    let mut pairs: Vec<_> =
        matches.into_iter().filter(|(_, all)| all.len() >= MATCHES[0]).collect();
    pairs.sort_by_key(|(images, all)| (std::cmp::Reverse(all.len()), *images));
    let step = pairs.len().div_ceil(MAX_PAIRS).max(1);
    let mut errors = Vec::new();
    let used = pairs.into_iter().step_by(step).map(|(_, all)| {
        let step = all.len().div_ceil(MATCHES[1]);
        let some = all.into_iter().step_by(step);
        some.map(|(pixels, error)| {
            errors.push(error);
            pixels
        })
        .collect()
    });
    let pairs: Vec<Pair> = used.collect();
    (pairs, median(&mut errors).unwrap_or(0.0))
}

/// A lens: its focal length as the logarithm of that relative to the larger side, and two radial
/// distortions. The principal point is the centre.
#[derive(Clone, Copy, Debug)]
struct Lens {
    kind: CameraModelKind,
    size: [u32; 2],
    params: [f64; 3],
}

impl Lens {
    fn focal_px(&self) -> f64 {
        self.params[0].exp() * f64::from(self.size[0].max(self.size[1]))
    }

    fn intrinsics(&self) -> Option<Intrinsics> {
        let [_, k1, k2] = self.params;
        let [cx, cy] = self.size.map(|side| 0.5 * f64::from(side));
        Intrinsics::new(self.kind, &[self.focal_px(), cx, cy, k1, k2]).ok()
    }

    /// The median error of the pairs in the second image under the rotation of each pair that fits
    /// its rays best; infinite without such rays.
    fn error_px(&self, pairs: &[Pair]) -> f64 {
        let is_inside = (FOCAL_BOUNDS[0].ln()..=FOCAL_BOUNDS[1].ln()).contains(&self.params[0]);
        let Some(intrinsics) = self.intrinsics().filter(|_| is_inside) else {
            return f64::INFINITY;
        };
        let mut errors = Vec::new();
        for pair in pairs {
            let rays: Vec<[Option<Vector3<f64>>; 2]> = pair
                .iter()
                .map(|pixels| pixels.map(|pixel| Some(intrinsics.unproject(&pixel)?.normalize())))
                .collect();
            let rotation = rotation_of(&rays);
            errors.extend(rays.iter().zip(pair).map(|([a, _], [_, pixel])| {
                let projected = a.and_then(|a| intrinsics.project(&(rotation * a)));
                projected.map_or(f64::INFINITY, |projected| (projected - pixel).norm())
            }));
        }
        median(&mut errors).unwrap_or(f64::INFINITY)
    }

    /// The lens with the smallest error that a pattern search finds from this one, and the error.
    /// A longer focal length and more distortion bend rays alike, so that steps are also along two
    /// parameters at once.
    fn refined(self, pairs: &[Pair]) -> (Self, f64) {
        let mut step = 1.0;
        let mut best = (self, self.error_px(pairs));
        while step > MIN_STEP {
            let moved = DIRECTIONS.iter().flat_map(|direction| {
                [step, -step].map(|step| {
                    let mut lens = best.0;
                    let by = direction.iter().zip(FIRST_STEPS);
                    lens.params
                        .iter_mut()
                        .zip(by)
                        .for_each(|(p, (d, first))| *p += step * d * first);
                    (lens, lens.error_px(pairs))
                })
            });
            match moved.min_by(|a, b| a.1.total_cmp(&b.1)) {
                Some(found) if found.1 < best.1 => best = found,
                _ => step *= 0.5,
            }
        }
        best
    }
}

/// The rotation with the least squares between rays (Kabsch 1976).
fn rotation_of(rays: &[[Option<Vector3<f64>>; 2]]) -> Rotation3<f64> {
    let both = rays.iter().filter_map(|[a, b]| Some(b.as_ref()? * a.as_ref()?.transpose()));
    let svd = both.sum::<Matrix3<f64>>().svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Rotation3::identity() };
    let sign = (u * v_t).determinant().signum();
    Rotation3::from_matrix_unchecked(
        u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t,
    )
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::UnitQuaternion;
    use tiepoint_geometry::{Rigid3, Rng};
    use tiepoint_scene::{Camera, Image, Keypoint, Observation, Track};

    use super::*;

    const FOCAL_PX: f64 = 500.0;
    const SIZE: [u32; 2] = [800, 600];
    const NUM_IMAGES: usize = 6;
    /// Of keypoints along each axis.
    const NOISE_PX: f64 = 0.5;

    /// A camera that turns by 0.1 rad from image to image and moves by `step` to the side. Points
    /// are 5 to 10 away.
    fn model(kind: CameraModelKind, k: f64, step: f64) -> Reconstruction {
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::new(kind, &[FOCAL_PX, 400.0, 300.0, k, 0.0]).unwrap();
        let [width, height] = SIZE;
        let camera = model.add_camera(Camera { intrinsics, width, height, has_focal_prior: false });
        let mut rng = Rng::stream(1, &[]);
        let poses: Vec<Rigid3> = (0..NUM_IMAGES)
            .map(|image| {
                let rotation =
                    UnitQuaternion::from_scaled_axis(Vector3::y() * (0.1 * image as f64));
                let centre = Vector3::x() * (step * image as f64);
                Rigid3::new(rotation, -(rotation * centre))
            })
            .collect();
        let mut seen: Vec<(Vector3<f64>, Vec<Vector2<f64>>)> = Vec::new();
        while seen.len() < 400 {
            let mut coordinate = |low: f64, high: f64| low + (high - low) * rng.uniform();
            let depth = coordinate(5.0, 10.0);
            let point = Vector3::new(coordinate(-1.5, 0.5), coordinate(-0.6, 0.6), 1.0) * depth;
            let pixels = poses.iter().filter_map(|pose| intrinsics.project(&(*pose * point)));
            let noisy =
                pixels.map(|pixel| pixel + Vector2::new(rng.normal(), rng.normal()) * NOISE_PX);
            let pixels: Vec<_> = noisy.collect();
            if pixels.len() == NUM_IMAGES {
                seen.push((point, pixels));
            }
        }
        for (image, pose) in poses.iter().enumerate() {
            let keypoint = |pixel: Vector2<f64>| Keypoint { pixel, scale_px: 1.0 };
            let keypoints = seen.iter().map(|(_, pixels)| keypoint(pixels[image])).collect();
            let id = model.add_image(Image::new(format!("{image}.png"), camera, keypoints));
            model.register(id, *pose);
        }
        for (keypoint, (point, _)) in (0..).zip(&seen) {
            let of = |image| Observation { image: ImageId::from_index(image), keypoint };
            model.add_track(Track::new(*point, (0..NUM_IMAGES).map(of).collect()));
        }
        model
    }

    /// Both lenses are strong: at the corner they bend by a fifth and more.
    #[test]
    fn camera_that_turned_is_known_from_one_that_moved() {
        for (kind, k, is_fisheye) in
            [(CameraModelKind::Radial, -0.2, false), (CameraModelKind::RadialFisheye, 0.05, true)]
        {
            let found = turning(&model(kind, k, 0.0)).unwrap();
            // The errors of both are the noise. The search is no exact minimum, and a narrow strip
            // of points hardly tells a focal length from distortion.
            assert!(found.error_ratio < 1.5, "{found:?}");
            assert!((found.focal_px / FOCAL_PX - 1.0).abs() < 0.1, "{found:?}");
            assert_eq!(found.is_fisheye, is_fisheye);
            // Six hundredths of the least depth from image to image: between points, a parallax of
            // up to 15 px to the next image. Under 0.15 the ratio is 2.3.
            let moved = turning(&model(kind, k, 0.3));
            assert!(moved.is_none_or(|moved| moved.error_ratio > 2.5), "{moved:?}");
        }
    }
}
