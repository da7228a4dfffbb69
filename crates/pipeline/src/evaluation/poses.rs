//! Evaluation of the poses of a model against ground truth.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::str::FromStr;

use serde::Serialize;
use tiepoint_eval::geometry::{Rigid3, Sim3};
use tiepoint_eval::{
    Alignment, Statistics, associate, auc, compare_poses, relative_pose_errors_rad,
};
use tiepoint_input::sequences::number;
use tiepoint_io::{strecha, trajectory};
use tiepoint_sfm::scene::{CameraId, Image, Reconstruction};

use crate::Error;
use crate::workspace::image_names::first_stream;
use crate::workspace::located_model::LocatedModel;

/// A file or folder with ground truth poses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Truth {
    /// Its format.
    pub format: TruthFormat,
    /// Its path.
    pub path: PathBuf,
}

/// Formats of ground truth poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TruthFormat {
    /// A folder of `.camera` files, by image name.
    Strecha,
    /// KITTI odometry: one pose per line; the number in an image's name is the line, from 0.
    Kitti,
    /// TUM RGB-D: poses with times.
    Tum,
    /// A COLMAP model, by image name.
    Colmap,
}

/// Formats by their names on the command line.
const FORMATS: [(&str, TruthFormat); 4] = [
    ("strecha", TruthFormat::Strecha),
    ("kitti", TruthFormat::Kitti),
    ("tum", TruthFormat::Tum),
    ("colmap", TruthFormat::Colmap),
];

impl FromStr for Truth {
    type Err = String;

    /// Parses `FORMAT:PATH`.
    fn from_str(text: &str) -> Result<Self, String> {
        let known = || FORMATS.map(|(name, _)| name).join(", ");
        let (name, path) = text
            .split_once(':')
            .ok_or_else(|| format!("expected FORMAT:PATH with FORMAT one of {}", known()))?;
        let format = FORMATS.iter().find(|(known, _)| *known == name).map(|(_, format)| *format);
        let format =
            format.ok_or_else(|| format!("unknown format {name}: use one of {}", known()))?;
        Ok(Self { format, path: path.into() })
    }
}

/// Pose errors of a model after Sim(3) alignment of the camera centres. Lengths are in units of the
/// ground truth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PoseEvaluation {
    /// Number of images with a true pose.
    pub images: usize,
    /// Number of these that are registered.
    pub registered: usize,
    /// Scale of `truth_from_model`.
    pub scale: f64,
    /// Distances between estimated and true centres; `rmse` is the ATE (Sturm et al. 2012).
    pub centre_error: ErrorStatistics,
    /// Angles between estimated and true orientations, in degrees.
    pub rotation_error_deg: ErrorStatistics,
    /// Area under the recall curve of the relative-pose errors over all image pairs. Pairs with an
    /// unregistered image count as wrong.
    pub relative_pose_auc: Vec<Auc>,
    /// Focal lengths of the cameras of these images.
    pub focal_lengths: Vec<FocalLength>,
    /// Centre errors by image name.
    pub centre_errors: BTreeMap<String, f64>,
    /// The alignment.
    #[serde(skip)]
    pub truth_from_model: Sim3,
}

/// Statistics of a list of errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorStatistics {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// Root mean square.
    pub rmse: f64,
    /// Standard deviation.
    pub std: f64,
    /// Largest.
    pub max: f64,
}

impl From<Statistics> for ErrorStatistics {
    fn from(Statistics { mean, median, rmse, std, max, .. }: Statistics) -> Self {
        Self { mean, median, rmse, std, max }
    }
}

/// Area under a recall curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Auc {
    /// Upper limit of the error.
    pub threshold_deg: f64,
    /// Area over the threshold, from 0 to 1.
    pub auc: f64,
}

/// The estimated and the true focal length of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FocalLength {
    /// COLMAP's id of the camera.
    pub camera: u32,
    /// Estimated focal length.
    pub model_px: f64,
    /// True focal length in pixels of the model's images, where it is known.
    pub truth_px: Option<f64>,
}

/// Thresholds of the relative-pose AUC, in degrees.
const AUC_THRESHOLDS_DEG: [f64; 4] = [1.0, 3.0, 5.0, 10.0];
/// Below this distance of two true centres the direction of translation is undefined, in units of
/// the ground truth.
const MIN_BASELINE: f64 = 1e-9;
/// Largest difference between the time of an image and that of its true pose.
const MAX_TIME_DIFFERENCE_S: f64 = 0.02;

/// A true pose, and the true focal length where it is known.
struct TruePose {
    cam_from_world: Rigid3,
    /// With the image width that it is for.
    focal_px: Option<(f64, u32)>,
    /// Name of the image, where the truth has names.
    name: Option<String>,
}

/// Evaluates the poses of a model. With `prefix`, only images whose names
/// start with it are compared. Without, all images are, except with ground truth that is the
/// trajectory of one camera (KITTI, TUM): then those of the camera of the first image.
///
/// # Errors
///
/// The ground truth cannot be read, fewer than three images have both poses, or the
/// camera centres are collinear.
pub fn evaluate_poses(
    located: &LocatedModel,
    truth: &Truth,
    prefix: Option<&str>,
) -> Result<PoseEvaluation, Error> {
    let model = &located.reconstruction;
    let is_trajectory = matches!(truth.format, TruthFormat::Kitti | TruthFormat::Tum);
    let first = first_stream(model);
    let is_compared = |image: &&Image| match prefix {
        Some(prefix) => image.name.starts_with(prefix),
        None => !is_trajectory || *image.stream == *first,
    };
    let images: Vec<&Image> = model.images().map(|(_, image)| image).filter(is_compared).collect();
    let pairs = associate_images(&images, truth)?;
    let error = |reason: String| Error::Evaluation {
        model: located.folder().to_owned(),
        truth: truth.path.clone(),
        reason,
    };
    let found: Vec<Option<Rigid3>> = pairs
        .iter()
        .map(|(image, _)| image.and_then(|image| image.cam_from_world().copied()))
        .collect();
    let true_poses: Vec<Rigid3> = pairs.iter().map(|(_, truth)| truth.cam_from_world).collect();
    let registered = found.iter().flatten().count();
    if registered < 3 {
        let names = match (registered, images.first(), pairs.first()) {
            (0, Some(image), Some((None, TruePose { name: Some(name), .. }))) => {
                format!("; the model has {}, the truth {name}", image.name)
            }
            _ => String::new(),
        };
        return Err(error(format!(
            "only {registered} images have a pose in both, and three are needed{names}"
        )));
    }
    let comparison =
        compare_poses(&found, &true_poses, Alignment::Similarity).ok_or_else(|| {
            error(
                "the camera centres are collinear, so that the alignment is undetermined"
                    .to_owned(),
            )
        })?;
    let relative = relative_pose_errors_rad(&found, &true_poses, MIN_BASELINE);
    let statistics = |errors: &[Option<f64>], unit: f64| {
        let errors: Vec<f64> = errors.iter().flatten().map(|error| error * unit).collect();
        ErrorStatistics::from(Statistics::of(&errors).expect("three or more"))
    };
    let centres = pairs.iter().zip(&comparison.centre_errors);
    Ok(PoseEvaluation {
        images: pairs.len(),
        registered,
        scale: comparison.truth_from_model.scale,
        centre_error: statistics(&comparison.centre_errors, 1.0),
        rotation_error_deg: statistics(&comparison.rotation_errors_rad, 1f64.to_degrees()),
        relative_pose_auc: AUC_THRESHOLDS_DEG
            .map(|threshold_deg| Auc {
                threshold_deg,
                auc: auc(&relative, threshold_deg.to_radians()),
            })
            .to_vec(),
        focal_lengths: focal_lengths(model, &pairs),
        centre_errors: centres
            .filter_map(|((image, _), error)| Some(((*image)?.name.clone(), (*error)?)))
            .collect(),
        truth_from_model: comparison.truth_from_model,
    })
}

/// The true poses, each with the image of the model if there is one.
fn associate_images<'a>(
    images: &[&'a Image],
    truth: &Truth,
) -> Result<Vec<(Option<&'a Image>, TruePose)>, Error> {
    let pose = |cam_from_world| TruePose { cam_from_world, focal_px: None, name: None };
    let by_name = |poses: Vec<(String, TruePose)>| {
        let names: Vec<&str> = poses.iter().map(|(name, _)| name.as_str()).collect();
        let found = images_of_names(images, &names);
        found.into_iter().zip(poses).map(|(image, (_, pose))| (image, pose)).collect()
    };
    let path = &truth.path;
    Ok(match truth.format {
        TruthFormat::Strecha => by_name(
            strecha::read(path)?
                .into_iter()
                .map(|camera| {
                    let mean_px = 0.5 * (camera.calibration[(0, 0)] + camera.calibration[(1, 1)]);
                    let (cam_from_world, name) = (camera.cam_from_world, Some(camera.name.clone()));
                    let focal_px = Some((mean_px, camera.width));
                    (camera.name, TruePose { cam_from_world, focal_px, name })
                })
                .collect(),
        ),
        TruthFormat::Colmap => {
            let model = LocatedModel::open(path)?.reconstruction;
            let poses = model.registered().map(|(id, image, cam_from_world)| {
                let camera = model.camera_of(id);
                let focal_px = Some((camera.intrinsics.mean_focal_px(), camera.width));
                let (cam_from_world, name) = (*cam_from_world, Some(image.name.clone()));
                (image.name.clone(), TruePose { cam_from_world, focal_px, name })
            });
            by_name(poses.collect())
        }
        TruthFormat::Kitti => {
            let numbers: BTreeMap<usize, &Image> =
                images.iter().filter_map(|image| Some((number(&image.name)?, *image))).collect();
            let poses = trajectory::read_kitti(path)?.into_iter().enumerate();
            poses
                .map(|(line, cam_from_world)| (numbers.get(&line).copied(), pose(cam_from_world)))
                .collect()
        }
        TruthFormat::Tum => {
            let mut poses = trajectory::read_tum(path)?;
            poses.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
            let mut timed: Vec<(f64, &Image)> =
                images.iter().filter_map(|image| Some((image.time_s?, *image))).collect();
            timed.sort_by(|a, b| a.0.total_cmp(&b.0));
            let image_times: Vec<f64> = timed.iter().map(|(time_s, _)| *time_s).collect();
            let true_times: Vec<f64> = poses.iter().map(|pose| pose.time_s).collect();
            let pairs = associate(&image_times, &true_times, MAX_TIME_DIFFERENCE_S);
            pairs
                .into_iter()
                .map(|(a, b)| (Some(timed[a].1), pose(poses[b].cam_from_world)))
                .collect()
        }
    })
}

/// The images with these names, else those of the same file, whatever its folder. Two cameras may
/// have photos of one file name, which then says nothing.
fn images_of_names<'a>(images: &[&'a Image], names: &[&str]) -> Vec<Option<&'a Image>> {
    let file = |name: &str| name.rsplit('/').next().unwrap_or(name).to_owned();
    let mut by_file: BTreeMap<String, Vec<&Image>> = BTreeMap::new();
    for image in images {
        by_file.entry(file(&image.name)).or_default().push(image);
    }
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for name in names {
        *counts.entry(file(name)).or_default() += 1;
    }
    let find = |name: &&str| {
        let same = by_file.get(&file(name))?;
        let exact = same.iter().find(|image| image.name == *name).copied();
        exact.or(match same[..] {
            [only] if counts[&file(name)] == 1 => Some(only),
            _ => None,
        })
    };
    names.iter().map(find).collect()
}

fn focal_lengths(model: &Reconstruction, pairs: &[(Option<&Image>, TruePose)]) -> Vec<FocalLength> {
    let mut cameras: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for (image, truth) in pairs.iter().filter_map(|(image, truth)| Some(((*image)?, truth))) {
        // The photos of the model may be smaller copies of those of the truth.
        let width = f64::from(model.camera(image.camera).width);
        let scaled = truth.focal_px.map(|(focal_px, of)| match of {
            0 => focal_px,
            of => focal_px * (width / f64::from(of)),
        });
        cameras.entry(image.camera.0).or_default().extend(scaled);
    }
    let focal = |(id, truth): (u32, Vec<f64>)| FocalLength {
        camera: id + 1,
        model_px: model.camera(CameraId(id)).intrinsics.mean_focal_px(),
        truth_px: Statistics::of(&truth).map(|truth| truth.mean),
    };
    cameras.into_iter().map(focal).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ground_truth_is_parsed_from_format_and_path() {
        let truth: Truth = "kitti:data/poses:1.txt".parse().unwrap();
        assert_eq!(truth, Truth { format: TruthFormat::Kitti, path: "data/poses:1.txt".into() });
        assert!("poses.txt".parse::<Truth>().unwrap_err().contains("FORMAT:PATH"));
        assert!("euler:poses.txt".parse::<Truth>().unwrap_err().contains("unknown format euler"));
    }

    #[test]
    fn a_file_name_of_two_cameras_is_of_neither() {
        let image = |name: &str| Image::new(name, CameraId(0), Vec::new());
        let images = ["left/1.png", "left/2.png", "3.png"].map(image);
        let images: Vec<&Image> = images.iter().collect();
        let names = ["left/1.png", "right/1.png", "right/2.png", "a/3.png", "4.png"];
        let found = images_of_names(&images, &names);
        let found: Vec<Option<&str>> =
            found.into_iter().map(|image| image.map(|image| image.name.as_str())).collect();
        // right/2.png is the only one of its file name in both lists.
        let expected = [Some("left/1.png"), None, Some("left/2.png"), Some("3.png"), None];
        assert_eq!(found, expected);
    }

    #[test]
    fn number_of_a_name_is_its_last_one() {
        for (name, expected) in [
            ("left/000012.png", Some(12)),
            ("cam2/frame_7.color.jpg", Some(7)),
            ("a3b.png", Some(3)),
            ("b.png", None),
        ] {
            assert_eq!(number(name), expected, "{name}");
        }
    }
}
