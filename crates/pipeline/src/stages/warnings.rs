//! Warnings on the matches and models of a run.

use std::collections::BTreeMap;

use tiepoint_sfm::RigMode;
use tiepoint_sfm::diagnostics::{self, ImageScale};
use tiepoint_sfm::geometry::CameraModelKind;
use tiepoint_sfm::geometry::numeric::median;
use tiepoint_sfm::scene::{CameraId, ImageId, Reconstruction};

use crate::workspace::report::{CameraReport, ModelReport};
use crate::workspace::rig_report::RigCameraReport;
use crate::workspace::warning::{ModelGap, ParameterChange, ScaledImage, Warning};

/// Smallest deviation of an image's scale from the median of its camera, in standard deviations. Of
/// normal errors one image in 1.7 million deviates by more.
const MIN_SCALE_SIGMAS: f64 = 5.0;
/// Standard deviation of a normal variable over its median absolute deviation.
const SD_OF_MAD: f64 = 1.4826;
/// Largest scatter of the scales of a camera's images, as a standard deviation of the logarithm,
/// that photos of one lens have: 224 cameras of drives and photos have up to 0.0026. Where half of
/// the photos are cropped to 0.7, or all to different parts down to a half, it is 0.007 to 0.06.
/// The first would not be named with double of it; half would name photos of a turntable of 47.
/// A single image that deviates by less is not named either, however small the scatter is: of
/// eleven photos one that was cropped to 0.98, 0.9 or 0.7 deviates by 0.018, 0.10 and 0.008.
const MAX_SCALE_SCATTER: f64 = 0.004;
/// Fewest images of a camera, for a median and a scatter that a third of other photos cannot move.
const MIN_IMAGES_OF_CAMERA: usize = 6;
/// Smallest radial residual that a lens model leaves, relative to half of the image's diagonal:
/// four times what SIMPLE_RADIAL leaves of the action lens of `tiepoint synth` (4e-5; a pinhole
/// leaves 7e-6 at most). With half, that drive is still silent, but KITTI 04 with unknown focal
/// lengths is not (9e-5). Fisheyes with views of 90° to 165° across the longer side leave 1.8e-4 to
/// 4.9e-4 where the poses are wrong by 3 % and more: double would miss some.
const MIN_RADIAL_RESIDUAL: f64 = 1.5e-4;
/// A lens that stretches more where its outermost observations are, or compresses more, is none.
/// The widest rectilinear action cameras have a barrel distortion of a third. In 163 models of
/// drives and photos, 0.99 to 1.29: half would name all of them, double none either.
const MAX_STRETCH: f64 = 2.0;
/// Below this focal length relative to the larger side, a lens with residuals is likely a fisheye:
/// a field of view of 80°. It decides which model a sentence names first. Rendered fisheyes with
/// views of 123°, 98° and 69° across the larger side have 0.28, 0.33 and 0.99 as SIMPLE_RADIAL:
/// with half, that of 98° is told OPENCV first, and with double that of 69° OPENCV_FISHEYE alone.
const FISHEYE_FOCAL: f64 = 0.6;
/// Largest ratio of a focal length and that of EXIF or of the user. EXIF rounds to a millimetre of
/// 24 (2 %), refers to a diagonal or a width (5 %), and leaves out the crop of a stabiliser (10 %).
const MAX_FOCAL_RATIO: f64 = 1.25;
/// Relative standard deviation of a focal length from which on it is told: 95 % of the true values
/// lie in a tenth of it.
const UNCERTAIN_FOCAL: f64 = 0.025;
/// A calibration of which a parameter was refined by more standard deviations is contradicted. By
/// default one of them is a pixel at the border of the image. Not varied.
const MAX_DEVIATIONS: f64 = 5.0;
/// Focal lengths relative to the larger side of perspective lenses: views of 118° to 5°.
const FOCAL_RANGE: [f64; 2] = [0.3, 12.0];
/// Smallest scatter of a rig's relative poses, relative to the baseline.
const MIN_RIG_SCATTER: f64 = 0.1;
/// Smallest relative change of a rig's baseline between the halves of a drive that is a warning,
/// and its smallest ratio to the standard error of that change. The baseline of 60 models of
/// rendered drives with a rig constraint and clocks changes by 0.0001 to 0.003; that of one whose
/// camera model does not describe the lens by 0.13. By these numbers half and double of the first
/// change nothing; the second was not varied.
const MIN_RIG_DRIFT: f64 = 0.02;
const MIN_RIG_DRIFT_SIGMAS: f64 = 5.0;
/// An image with fewer observations is as uncertain as a pair that is not verified.
const MIN_OBSERVATIONS: usize = 15;
/// Largest error of rotations alone relative to that of the model, for a camera that only turned.
/// Chosen with an earlier form of the search for the lens: rendered pans with unknown lenses had
/// 0.5 to 1.1, strips along a wall 4.0 to 9.4, a turn with steps of a hundredth of the depth 5.
/// Half would miss the pan of a fisheye; double would be at the edge of the strips. Features with
/// steps of a hundredth and noise of 0.5 px have 1.5: such photos are warned of although they
/// moved.
const MAX_TURNING_RATIO: f64 = 2.0;
/// Smallest share of observations behind a camera. 163 models of drives and photos have none, so
/// that half and double change nothing on them.
const MIN_SHARE_BEHIND: f64 = 0.001;
/// A model with fewer images is not another scene.
const MIN_IMAGES_OF_SCENE: usize = 3;

/// The warnings on all models. `initial`: the scene before mapping. `gaps`: where the models come
/// closest to each other.
pub(crate) fn warnings_of_models<'a>(
    initial: &Reconstruction,
    models: impl IntoIterator<Item = (&'a Reconstruction, &'a ModelReport)>,
    gaps: Vec<ModelGap>,
) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut sizes = Vec::new();
    for (model, report) in models {
        sizes.push(report.registered);
        let place = Place { model, path: &report.path };
        warnings.extend(place.focal_lengths(initial));
        warnings.extend(place.uncertain_focal_lengths(report));
        warnings.extend(place.contradicted_calibrations(report));
        warnings.extend(place.lenses());
        warnings.extend(place.scaled_images());
        warnings.extend(place.rig(report));
        warnings.extend(place.images());
    }
    sizes.retain(|images| *images >= MIN_IMAGES_OF_SCENE);
    if sizes.len() > 1 {
        warnings.insert(0, Warning::SeveralModels { images: sizes, gaps });
    }
    warnings
}

/// A model and its folder.
struct Place<'a> {
    model: &'a Reconstruction,
    path: &'a str,
}

impl Place<'_> {
    fn path(&self) -> String {
        self.path.to_owned()
    }

    fn name(&self, image: ImageId) -> String {
        self.model.image(image).name.clone()
    }

    fn focal_lengths(&self, initial: &Reconstruction) -> Vec<Warning> {
        let used = self.model.registered_cameras();
        let warning = |id: CameraId| {
            let camera = self.model.camera(id);
            let kind = camera.intrinsics.kind();
            if kind.focal_indices().is_empty() {
                return None;
            }
            let focal_px = camera.intrinsics.mean_focal_px();
            let side_px = camera.width.max(camera.height);
            let before = (id.index() < initial.num_cameras()).then(|| initial.camera(id));
            let expected_px = before
                .filter(|before| before.has_focal_prior)
                .map(|before| before.intrinsics.mean_focal_px());
            let is_far = match expected_px {
                Some(expected_px) => {
                    let ratio = focal_px / expected_px;
                    ratio.max(1.0 / ratio) > MAX_FOCAL_RATIO
                }
                None => {
                    let relative = focal_px / f64::from(side_px);
                    !kind.is_fisheye() && !(FOCAL_RANGE[0]..=FOCAL_RANGE[1]).contains(&relative)
                }
            };
            let (model, camera) = (self.path(), id.0 + 1);
            is_far.then_some(Warning::FocalLength { model, camera, focal_px, expected_px, side_px })
        };
        used.into_iter().filter_map(warning).collect()
    }

    fn uncertain_focal_lengths(&self, report: &ModelReport) -> Vec<Warning> {
        let warning = |camera: &CameraReport| {
            let kind = CameraModelKind::from_name(&camera.model).ok()?;
            let index = *kind.focal_indices().first()?;
            let (focal_px, sd_px) = (*camera.params.get(index)?, *camera.params_sd.get(index)?);
            let (model, is_calibrated) = (self.path(), camera.calibration.is_some());
            (sd_px > UNCERTAIN_FOCAL * focal_px).then_some(Warning::UncertainFocalLength {
                model,
                camera: camera.id,
                focal_px,
                sd_px,
                is_calibrated,
            })
        };
        report.cameras.iter().filter_map(warning).collect()
    }

    fn contradicted_calibrations(&self, report: &ModelReport) -> Vec<Warning> {
        let warning = |camera: &CameraReport| {
            let calibration = camera.calibration.as_ref()?;
            let names = CameraModelKind::from_name(&camera.model).ok()?.param_names();
            let size = |index: &usize| calibration.deviations[*index].abs();
            let most = (0..calibration.deviations.len().min(names.len()))
                .max_by(|a, b| size(a).total_cmp(&size(b)))?;
            let (model, deviations) = (self.path(), calibration.deviations[most]);
            (deviations.abs() > MAX_DEVIATIONS).then_some(Warning::ContradictedCalibration {
                model,
                camera: camera.id,
                change: ParameterChange {
                    parameter: names[most].to_owned(),
                    given: calibration.params[most],
                    found: camera.params[most],
                    deviations,
                },
            })
        };
        report.cameras.iter().filter_map(warning).collect()
    }

    fn lenses(&self) -> Vec<Warning> {
        let mut warnings = Vec::new();
        for lens in diagnostics::lens_residuals(self.model) {
            let camera = self.model.camera(lens.camera);
            let kind = camera.intrinsics.kind();
            let (model, id) = (self.path(), lens.camera.0 + 1);
            let camera_model = kind.name().to_owned();
            let is_lens =
                lens.stretch.is_some_and(|s| (1.0 / MAX_STRETCH..=MAX_STRETCH).contains(&s));
            if !is_lens {
                let params = camera.intrinsics.params().to_vec();
                let (model, camera_model) = (model.clone(), camera_model.clone());
                warnings.push(Warning::Distortion { model, camera: id, camera_model, params });
            }
            if lens.relative > MIN_RADIAL_RESIDUAL {
                let side = f64::from(camera.width.max(camera.height));
                let is_wide = camera.intrinsics.mean_focal_px() < FISHEYE_FOCAL * side;
                let better = match is_wide && !kind.is_fisheye() {
                    _ if camera.width == 2 * camera.height => "EQUIRECTANGULAR",
                    true => "OPENCV_FISHEYE",
                    false if kind.is_fisheye() => "THIN_PRISM_FISHEYE",
                    false => "OPENCV",
                };
                warnings.push(Warning::LensResiduals {
                    model,
                    camera: id,
                    camera_model,
                    residual_px: lens.radial_rms_px,
                    better: better.to_owned(),
                });
            }
        }
        warnings
    }

    fn scaled_images(&self) -> Vec<Warning> {
        let mut by_camera: BTreeMap<CameraId, Vec<ImageScale>> = BTreeMap::new();
        for found in diagnostics::image_scales(self.model) {
            by_camera.entry(found.camera).or_default().push(found);
        }
        let warning = |(camera, found): (CameraId, Vec<ImageScale>)| {
            let image = |scale: &ImageScale| {
                let &ImageScale { image, scale, sd, .. } = scale;
                ScaledImage { name: self.name(image), scale, sd }
            };
            let images: Vec<ScaledImage> = deviating(&found).into_iter().map(image).collect();
            let (model, camera) = (self.path(), camera.0 + 1);
            let any = !images.is_empty();
            any.then_some(Warning::ImagesOfOtherFocalLength { model, camera, images })
        };
        by_camera.into_iter().filter_map(warning).collect()
    }

    fn rig(&self, report: &ModelReport) -> Vec<Warning> {
        // Without a rig no clock is estimated: frames are images up to half an interval apart.
        let rig = report.rig.iter().filter(|rig| rig.mode != RigMode::Off.name());
        let cameras = rig.flat_map(|rig| &rig.cameras);
        let warning = |camera: &RigCameraReport| {
            let (model, cameras) = (self.path(), camera.names.clone());
            let (relative, change) =
                (camera.relative_translation_rms, camera.second_over_first_half);
            // The standard error of the difference of two means, each over half of the frames.
            let sd = 2.0 * camera.relative_baseline_sd / (camera.reconstructed_pairs as f64).sqrt();
            // Without a constraint, images of one frame may be of different times.
            if relative >= MIN_RIG_SCATTER {
                Some(Warning::RigScatter { model, cameras, relative })
            } else if camera.sigma_translation.is_some()
                && (change - 1.0).abs() > MIN_RIG_DRIFT.max(MIN_RIG_DRIFT_SIGMAS * sd)
            {
                Some(Warning::RigDrift { model, cameras, change })
            } else {
                None
            }
        };
        cameras.filter_map(warning).collect()
    }

    fn images(&self) -> Vec<Warning> {
        let mut warnings = Vec::new();
        if let Some(turning) = diagnostics::turning(self.model)
            && turning.error_ratio < MAX_TURNING_RATIO
        {
            let diagnostics::Turning { error_ratio, focal_px, is_fisheye } = turning;
            warnings.push(Warning::OneSpot {
                model: self.path(),
                error_ratio,
                focal_px,
                is_fisheye,
            });
        }
        let jumps = diagnostics::jumps(self.model);
        if !jumps.is_empty() {
            let images = jumps.iter().map(|jump| self.name(jump.image)).collect();
            warnings.push(Warning::Jumps { model: self.path(), images });
        }
        let few = diagnostics::images_with_few_observations(self.model, MIN_OBSERVATIONS);
        if !few.is_empty() {
            let images = few.into_iter().map(|(image, count)| (self.name(image), count)).collect();
            warnings.push(Warning::FewObservations { model: self.path(), images });
        }
        let observations = diagnostics::num_points_behind(self.model);
        if observations as f64 > MIN_SHARE_BEHIND * self.model.num_observations() as f64 {
            warnings.push(Warning::PointsBehind { model: self.path(), observations });
        }
        warnings
    }
}

/// The images whose scale contradicts that of the others of their camera, the largest deviation
/// first. What all images deviate by (the lens model, correlated points) is in their scatter,
/// unless it is larger than that of one lens.
fn deviating(found: &[ImageScale]) -> Vec<&ImageScale> {
    if found.len() < MIN_IMAGES_OF_CAMERA {
        return Vec::new();
    }
    let logs = || found.iter().map(|image| image.scale.ln());
    let centre = median(&mut logs().collect::<Vec<_>>()).unwrap_or(0.0);
    let mut deviations: Vec<f64> = logs().map(|log| (log - centre).abs()).collect();
    let scatter = SD_OF_MAD * median(&mut deviations).unwrap_or(0.0);
    let of_lens = match scatter > MAX_SCALE_SCATTER {
        true => MAX_SCALE_SCATTER,
        false => (MIN_SCALE_SIGMAS * scatter).max(MAX_SCALE_SCATTER),
    };
    let deviation = |image: &&ImageScale| (image.scale.ln() - centre).abs();
    let is_other = |image: &&ImageScale| {
        deviation(image) > of_lens.hypot(MIN_SCALE_SIGMAS * image.sd / image.scale)
    };
    let mut others: Vec<&ImageScale> = found.iter().filter(is_other).collect();
    others.sort_by(|a, b| deviation(b).total_cmp(&deviation(a)));
    others
}

#[cfg(test)]
mod tests {
    use tiepoint_sfm::geometry::nalgebra::{UnitQuaternion, Vector2, Vector3};
    use tiepoint_sfm::geometry::{CameraModelKind, Intrinsics, Rigid3, Rng};
    use tiepoint_sfm::scene::{Camera, Image, Keypoint, Observation, Track};

    use super::*;
    use crate::workspace::rig_report::RigReport;

    const FOCAL_PX: f64 = 500.0;
    /// Width of the images.
    const SIDE_PX: u32 = 640;
    const NUM_IMAGES: usize = 8;
    /// More than a ring of the residuals needs, and than an image.
    const NUM_POINTS: usize = 400;

    fn radial(focal_px: f64, k: f64) -> Intrinsics {
        let params = [focal_px, f64::from(SIDE_PX) / 2.0, 240.0, k];
        Intrinsics::new(CameraModelKind::SimpleRadial, &params).unwrap()
    }

    /// A camera that drives along x and looks to the side, an image a second, one unit apart; its
    /// points are 6 to 10 units away, and its observations are exact.
    fn drive(intrinsics: Intrinsics) -> Reconstruction {
        images_at(intrinsics, |k| Rigid3::new(UnitQuaternion::identity(), -Vector3::x() * k as f64))
    }

    /// [`drive`] with other poses.
    fn images_at(intrinsics: Intrinsics, pose: impl Fn(usize) -> Rigid3) -> Reconstruction {
        let mut model = Reconstruction::default();
        let camera = model.add_camera(Camera {
            intrinsics,
            width: SIDE_PX,
            height: 480,
            has_focal_prior: false,
        });
        let mut rng = Rng::stream(1, &[]);
        let mut between = |low: f64, high: f64| low + (high - low) * rng.uniform();
        let points: Vec<Vector3<f64>> = (0..NUM_POINTS)
            .map(|_| Vector3::new(between(-5.0, 12.0), between(-4.0, 4.0), between(6.0, 10.0)))
            .collect();
        let poses: Vec<Rigid3> = (0..NUM_IMAGES).map(pose).collect();
        let mut observations = vec![Vec::new(); NUM_POINTS];
        for (k, pose) in poses.iter().enumerate() {
            let is_inside = |pixel: &Vector2<f64>| {
                (0.0..f64::from(SIDE_PX)).contains(&pixel.x) && (0.0..480.0).contains(&pixel.y)
            };
            let mut keypoints = Vec::new();
            for (point, xyz) in points.iter().enumerate() {
                let pixel = intrinsics.project(&(*pose * *xyz)).filter(is_inside);
                if let Some(pixel) = pixel {
                    let (image, keypoint) = (ImageId::from_index(k), keypoints.len() as u32);
                    observations[point].push(Observation { image, keypoint });
                    keypoints.push(Keypoint { pixel, scale_px: 1.0 });
                }
            }
            let image = model.add_image(Image::new(format!("{k}.png"), camera, keypoints));
            model.set_time(image, Some(k as f64));
            model.register(image, *pose);
        }
        for (xyz, seen) in points.into_iter().zip(observations) {
            if seen.len() > 1 {
                model.add_track(Track::new(xyz, seen));
            }
        }
        model
    }

    /// Keypoints that are a tenth of a pixel off to the right in every second image, so that
    /// neither rotations nor the model fit exactly.
    #[test]
    fn camera_that_only_turned_is_named() {
        for (step, is_named) in [(0.0, true), (0.05, false)] {
            let mut model = images_at(radial(FOCAL_PX, -0.1), |k| {
                let turn = UnitQuaternion::from_scaled_axis(Vector3::y() * (0.1 * k as f64));
                Rigid3::new(turn, -(turn * Vector3::x() * (step * k as f64)))
            });
            for k in (0..NUM_IMAGES).step_by(2) {
                let image = ImageId::from_index(k);
                let keypoints = model.image(image).keypoints.iter();
                let pixels: Vec<_> = keypoints.map(|k| k.pixel + 0.1 * Vector2::x()).collect();
                model.move_keypoints(image, &pixels);
            }
            let found = warnings(&model, &model);
            let text = found.iter().map(Warning::to_string).collect::<String>();
            assert_eq!(text.contains("only turned on one spot"), is_named, "{step}: {text}");
        }
    }

    fn warnings(initial: &Reconstruction, model: &Reconstruction) -> Vec<Warning> {
        let report = ModelReport { registered: model.num_registered(), ..ModelReport::default() };
        warnings_of_models(initial, [(model, &report)], Vec::new())
    }

    #[test]
    fn a_model_that_is_right_has_none() {
        let model = drive(radial(FOCAL_PX, 0.0));
        assert_eq!(warnings(&model, &model), []);
    }

    #[test]
    fn a_focal_length_is_compared_with_the_expected_one_or_with_those_of_lenses() {
        let model = drive(radial(FOCAL_PX, 0.0));
        let before = |focal_px: f64, has_focal_prior| {
            let mut before = model.clone();
            let camera = before.camera_mut(CameraId(0));
            (camera.intrinsics, camera.has_focal_prior) = (radial(focal_px, 0.0), has_focal_prior);
            before
        };
        for (share, is_near) in
            [(1.05 * MAX_FOCAL_RATIO, false), (0.95 * MAX_FOCAL_RATIO, true), (0.7, false)]
        {
            let found = warnings(&before(FOCAL_PX * share, true), &model);
            assert_eq!(found.is_empty(), is_near, "{share}: {found:?}");
            assert!(
                found.iter().all(|found| matches!(
                    found,
                    Warning::FocalLength { expected_px: Some(_), .. }
                ))
            );
            // What was a guess is not compared.
            assert_eq!(warnings(&before(FOCAL_PX * share, false), &model), []);
        }
        let [shortest, longest] = FOCAL_RANGE.map(|relative| relative * f64::from(SIDE_PX));
        for (focal_px, is_of_a_lens) in
            [(0.95 * shortest, false), (1.05 * shortest, true), (0.95 * longest, true)]
        {
            let model = drive(radial(focal_px, 0.0));
            let found = warnings(&model, &model);
            assert_eq!(
                found.iter().any(|found| matches!(found, Warning::FocalLength { .. })),
                !is_of_a_lens,
                "{focal_px}: {found:?}"
            );
        }
    }

    /// The corner is at r = 0.8 of the focal length. Without distortion it is at u, where
    /// r = u (1 + k u²): at u = 0.29 for k = 20, a stretch of more than two, and at u = 0.7 for
    /// k = 0.3.
    #[test]
    fn a_distortion_that_no_lens_has_is_named() {
        for (k, is_lens) in [(0.3, true), (20.0, false)] {
            let model = drive(radial(FOCAL_PX, k));
            let found = warnings(&model, &model);
            let is_distortion = |found: &Warning| matches!(found, Warning::Distortion { .. });
            assert_eq!(found.iter().any(is_distortion), !is_lens, "{k}: {found:?}");
        }
    }

    /// A drive whose keypoints have the radial distortions k1 and k2 that the lens model lacks.
    fn drive_of_another_lens(k: [f64; 2]) -> Reconstruction {
        let params = [FOCAL_PX, f64::from(SIDE_PX) / 2.0, 240.0, k[0], k[1]];
        let mut model = drive(Intrinsics::new(CameraModelKind::Radial, &params).unwrap());
        model.camera_mut(CameraId(0)).intrinsics = radial(FOCAL_PX, 0.0);
        model
    }

    /// At the corner, 0.8 of the focal length from the centre, k2 is 500 px · 0.8⁵ k2. Of that a
    /// focal length and a first distortion leave the Zernike polynomial of the fifth degree, over
    /// ten: a root mean square of 0.04, 6.7 px · k2. The limit is 0.06 px (400 px from centre to
    /// corner).
    #[test]
    fn residuals_that_depend_on_the_distance_from_the_centre_are_named() {
        for (k, is_calibrated, is_silent) in [
            ([0.0, 2e-3], false, true),
            ([0.0, 3e-2], false, false),
            // Any fit would have taken it into its k1: a radial residual of the poses.
            ([4e-3, 0.0], false, true),
            ([4e-3, 0.0], true, false),
        ] {
            let mut model = drive_of_another_lens(k);
            model.calibrated.extend(is_calibrated.then_some(CameraId(0)));
            let found = warnings(&model, &model);
            let is_of_lens = |found: &Warning| matches!(found, Warning::LensResiduals { .. });
            assert_eq!(found.iter().any(is_of_lens), !is_silent, "{k:?}: {found:?}");
            // A focal length of 0.8 of the width may be that of a fisheye in another model.
            let text = found.iter().map(Warning::to_string).collect::<String>();
            assert_eq!(text.contains("OPENCV, or OPENCV_FISHEYE"), !is_silent, "{text}");
        }
    }

    #[test]
    fn images_twice_as_wide_as_high_may_be_panoramas() {
        for (height, is_panorama) in [(SIDE_PX / 2, true), (SIDE_PX / 2 + 1, false)] {
            let mut model = drive_of_another_lens([0.0, 0.1]);
            model.camera_mut(CameraId(0)).height = height;
            let text = warnings(&model, &model).iter().map(Warning::to_string).collect::<String>();
            assert_eq!(
                text.contains("EQUIRECTANGULAR if they are panoramas all around"),
                is_panorama,
                "{text}"
            );
        }
    }

    /// In a long drive one image that is off leaves the usual step as it is.
    #[test]
    fn an_image_a_step_off_jumps() {
        for (steps, is_silent) in [(0.9, true), (1.1, false)] {
            let mut model = drive(radial(FOCAL_PX, 0.0));
            for k in NUM_IMAGES..5 * NUM_IMAGES {
                let name = format!("{k}.png");
                let image = model.add_image(Image::new(name, CameraId(0), Vec::new()));
                model.set_time(image, Some(k as f64));
                let aside = if k == 2 * NUM_IMAGES { steps } else { 0.0 };
                let centre = Vector3::new(k as f64, aside, 0.0);
                model.register(image, Rigid3::new(UnitQuaternion::identity(), -centre));
            }
            let found = warnings(&model, &model);
            let jumps = found.iter().find_map(|found| match found {
                Warning::Jumps { images, .. } => Some(images.clone()),
                _ => None,
            });
            assert_eq!(jumps, (!is_silent).then(|| vec!["16.png".to_owned()]), "{steps}");
        }
    }

    #[test]
    fn images_with_few_observations_are_named_with_their_number() {
        let mut model = drive(radial(FOCAL_PX, 0.0));
        let image = ImageId(2);
        let observed: Vec<u32> =
            (0u32..).zip(model.image(image).points()).filter_map(|(k, p)| p.map(|_| k)).collect();
        let (dropped, kept) = observed.split_at(observed.len() - MIN_OBSERVATIONS);
        dropped
            .iter()
            .for_each(|&keypoint| model.remove_observation(Observation { image, keypoint }));
        assert_eq!(warnings(&model, &model), []);
        model.remove_observation(Observation { image, keypoint: kept[0] });
        let images = vec![("2.png".to_owned(), MIN_OBSERVATIONS - 1)];
        assert_eq!(
            warnings(&model, &model),
            [Warning::FewObservations { model: String::new(), images }]
        );
    }

    #[test]
    fn points_behind_cameras_are_counted() {
        let mut model = drive(radial(FOCAL_PX, 0.0));
        let (id, observations) =
            model.tracks().map(|(id, track)| (id, track.observations.len())).next().unwrap();
        model.track_mut(id).unwrap().xyz.z *= -1.0;
        let share = observations as f64 / model.num_observations() as f64;
        assert!(share > MIN_SHARE_BEHIND, "{share}");
        let found = warnings(&model, &model);
        assert_eq!(found, [Warning::PointsBehind { model: String::new(), observations }]);
    }

    #[test]
    fn relative_poses_that_scatter_by_a_tenth_are_named() {
        let model = drive(radial(FOCAL_PX, 0.0));
        for (relative, is_silent) in [(0.99 * MIN_RIG_SCATTER, true), (MIN_RIG_SCATTER, false)] {
            let names = ["left", "right"].map(str::to_owned);
            let camera = RigCameraReport {
                names: names.clone(),
                relative_translation_rms: relative,
                second_over_first_half: 1.0,
                ..RigCameraReport::default()
            };
            let rig = RigReport { cameras: vec![camera], ..RigReport::default() };
            let report = ModelReport { rig: Some(rig), registered: 8, ..ModelReport::default() };
            let found = warnings_of_models(&model, [(&model, &report)], Vec::new());
            let expected = Warning::RigScatter { model: String::new(), cameras: names, relative };
            assert_eq!(found, if is_silent { vec![] } else { vec![expected] });
            let rig = report.rig.map(|rig| RigReport { mode: "off".to_owned(), ..rig });
            let report = ModelReport { rig, ..report };
            assert_eq!(warnings_of_models(&model, [(&model, &report)], Vec::new()), []);
        }
    }

    #[test]
    fn a_baseline_that_changes_from_half_to_half_is_named() {
        let model = drive(radial(FOCAL_PX, 0.0));
        let names = ["left", "right"].map(str::to_owned);
        let of = |second_over_first_half: f64, relative_baseline_sd: f64| {
            let camera = RigCameraReport {
                names: names.clone(),
                reconstructed_pairs: 100,
                relative_baseline_sd,
                sigma_translation: Some(0.001),
                second_over_first_half,
                ..RigCameraReport::default()
            };
            let rig = RigReport { cameras: vec![camera], ..RigReport::default() };
            let report = ModelReport { rig: Some(rig), registered: 8, ..ModelReport::default() };
            warnings_of_models(&model, [(&model, &report)], Vec::new())
        };
        for sign in [-1.0, 1.0] {
            let change = 1.0 + sign * 1.01 * MIN_RIG_DRIFT;
            let expected =
                Warning::RigDrift { model: String::new(), cameras: names.clone(), change };
            assert_eq!(of(change, 0.0), [expected]);
            assert_eq!(of(1.0 + sign * 0.99 * MIN_RIG_DRIFT, 0.0), []);
            // Of 100 frames the standard error is a fifth of the deviation, 5 of which are told.
            assert_eq!(of(change, 1.1 * MIN_RIG_DRIFT), []);
        }
    }

    #[test]
    fn a_split_names_the_photos_that_nearly_connect_it() {
        let gap = |model: &str, images: Option<[&str; 2]>| ModelGap {
            model: model.to_owned(),
            nearest: images.map(|_| "sparse/0".to_owned()),
            images: images.map(|images| images.map(str::to_owned)),
            matches: 224,
        };
        // No pair of the third model with the others is verified.
        let gaps = vec![gap("sparse/1", Some(["15.jpg", "16.jpg"])), gap("sparse/2", None)];
        let text = Warning::SeveralModels { images: vec![15, 6, 3], gaps }.to_string();
        let end = "; photos would connect sparse/1 and sparse/0 between 16.jpg and 15.jpg (224 \
                   matches)";
        assert!(text.ends_with(end), "{text}");
    }

    #[test]
    fn two_scenes_are_several_models_of_three_images_or_more() {
        let model = Reconstruction::default();
        let of = |sizes: [usize; 2]| {
            let reports =
                sizes.map(|registered| ModelReport { registered, ..ModelReport::default() });
            warnings_of_models(&model, reports.iter().map(|report| (&model, report)), Vec::new())
        };
        let images = vec![9, MIN_IMAGES_OF_SCENE];
        assert_eq!(
            of([9, MIN_IMAGES_OF_SCENE]),
            [Warning::SeveralModels { images, gaps: Vec::new() }]
        );
        assert_eq!(of([9, MIN_IMAGES_OF_SCENE - 1]), []);
    }

    /// Scales of images that agree to a thousandth, but for the last one.
    fn scales(last: f64, count: usize) -> Vec<ImageScale> {
        let log = |k: usize| if k + 1 == count { last } else { 1e-3 * (k as f64 % 3.0 - 1.0) };
        let scale = |k: usize| {
            let (image, camera) = (ImageId::from_index(k), CameraId(0));
            ImageScale { image, camera, scale: log(k).exp(), sd: 1e-3 }
        };
        (0..count).map(scale).collect()
    }

    /// The median is 0 and the median deviation a thousandth, so that one standard deviation is
    /// the root of 1 + 1.4826², 1.788 thousandths.
    #[test]
    fn an_image_deviates_by_five_standard_deviations() {
        let limit = MIN_SCALE_SIGMAS * 1e-3 * SD_OF_MAD.hypot(1.0);
        assert!(deviating(&scales(0.95 * limit, 12)).is_empty());
        for log in [1.05 * limit, -1.05 * limit] {
            let found = scales(log, 12);
            let images: Vec<ImageId> = deviating(&found).iter().map(|found| found.image).collect();
            assert_eq!(images, [ImageId(11)]);
        }
    }

    /// Scales at equal steps: of the distances 0, 1, 1, 2, 2, … 5, 5 the median is 3.
    #[test]
    fn a_zoom_of_each_image_is_no_scatter() {
        for (share, is_silent) in [(0.9, true), (1.1, false)] {
            let step = share * MAX_SCALE_SCATTER / SD_OF_MAD / 3.0;
            let mut found = scales(0.0, 11);
            for (k, image) in found.iter_mut().enumerate() {
                (image.scale, image.sd) = ((step * (k as f64 - 5.0)).exp(), 1e-5);
            }
            assert_eq!(deviating(&found).is_empty(), is_silent, "{share}");
        }
    }

    #[test]
    fn few_images_of_a_camera_contradict_nothing() {
        assert!(deviating(&scales(0.1, MIN_IMAGES_OF_CAMERA - 1)).is_empty());
        assert_eq!(deviating(&scales(0.1, MIN_IMAGES_OF_CAMERA)).len(), 1);
    }
}
