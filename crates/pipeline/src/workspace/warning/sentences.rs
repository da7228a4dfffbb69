//! Warnings as sentences.

use std::fmt;

use super::{ModelGap, ParameterChange, ScaledImage, Warning};
use crate::workspace::overlay_report::OverlayReport;

/// More images or regions are counted, not listed.
const MAX_LISTED: usize = 4;

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::StationaryMatches { matches, watermark_pairs, overlays } => {
                f.write_str(&stationary(*matches, *watermark_pairs, overlays))
            }
            Self::SeveralModels { images, gaps } => f.write_str(&several_models(images, gaps)),
            Self::FocalLength {
                model, camera, focal_px, expected_px: Some(expected_px), ..
            } => {
                write!(
                    f,
                    "camera {camera} of {model} has a focal length of {focal_px:.0} px, and \
                    {expected_px:.0} px were expected: check EXIF, or give `features.intrinsics`"
                )
            }
            Self::FocalLength { model, camera, focal_px, side_px, .. } => write!(
                f,
                "camera {camera} of {model} has a focal length of {focal_px:.0} px for images of \
                {side_px} px, which is unlikely: give `features.focal_prior` or \
                `features.intrinsics`"
            ),
            Self::UncertainFocalLength { model, camera, focal_px, sd_px, is_calibrated } => {
                f.write_str(&uncertain_focal(model, *camera, [*focal_px, *sd_px], *is_calibrated))
            }
            Self::ContradictedCalibration { model, camera, change } => {
                f.write_str(&contradicted(model, *camera, change))
            }
            Self::Distortion { model, camera, camera_model, params } => {
                f.write_str(&distortion(model, *camera, camera_model, params))
            }
            Self::LensResiduals { model, camera, camera_model, residual_px, better } => write!(
                f,
                "{camera_model} leaves residuals of {residual_px:.2} px that depend on the \
                distance from the centre of camera {camera} of {model}: try \
                `features.camera_model` {}",
                alternatives(better)
            ),
            Self::ImagesOfOtherFocalLength { model, camera, images } => write!(
                f,
                "images do not have the focal length of their camera {camera} of {model}, as if \
                they were cropped or zoomed: {}: give each camera a folder, or give \
                `features.cameras` image",
                listed(&images.iter().map(scaled).collect::<Vec<_>>())
            ),
            Self::RigScatter { model, cameras, relative } => {
                f.write_str(&rig_scatter(model, cameras, *relative))
            }
            Self::RigDrift { model, cameras, change } => {
                f.write_str(&rig_drift(model, cameras, *change))
            }
            Self::Jumps { model, images } => write!(
                f,
                "poses in {model} jump by more than the usual step between images: {}: these are \
                likely wrong, or their times are",
                listed(images)
            ),
            Self::FewObservations { model, images } => {
                let shown = |(name, count): &(String, usize)| format!("{name} ({count})");
                let names: Vec<String> = images.iter().map(shown).collect();
                write!(
                    f,
                    "images of {model} have few points, and uncertain poses: {}",
                    listed(&names)
                )
            }
            Self::OneSpot { model, focal_px, is_fisheye, .. } => write!(
                f,
                "the images of {model} agree with a {} of {focal_px:.0} px that only turned on one \
                spot, or moved by hardly a hundredth of the distance to the scene, so that its \
                positions and depths are uncertain or wrong: take photos from different places, a \
                tenth of that distance apart",
                if *is_fisheye { "fisheye" } else { "lens" }
            ),
            Self::PointsBehind { model, observations } => write!(
                f,
                "{observations} observations of {model} are of points behind their cameras: the \
                model is likely wrong"
            ),
        }
    }
}

fn rig_scatter(model: &str, [one, other]: &[String; 2], relative: f64) -> String {
    format!(
        "the relative poses of {one} and {other} in {model} scatter by {:.0} % of the baseline: \
        they are not on one rig, their times are wrong, frames were dropped so that numbers do not \
        agree, or the model is wrong",
        100.0 * relative
    )
}

fn rig_drift(model: &str, [one, other]: &[String; 2], change: f64) -> String {
    let direction = if change < 1.0 { "closer to" } else { "farther from" };
    format!(
        "in {model} {one} and {other} are {:.0} % {direction} each other in the second half of the \
        drive than in the first, which cameras on one rig are not: the scale drifts, as it does \
        where a camera model does not describe the lens: try another `features.camera_model`, or \
        give `features.intrinsics`",
        100.0 * (change - 1.0).abs(),
    )
}

/// A camera model that may fit better, and those to try if it does not.
fn alternatives(better: &str) -> String {
    let others = match better {
        // A fisheye as a perspective camera may have any focal length.
        "OPENCV" => ", or OPENCV_FISHEYE if the lens is a fisheye",
        "EQUIRECTANGULAR" => " if they are panoramas all around, else OPENCV or OPENCV_FISHEYE",
        _ => "",
    };
    format!("{better}{others}")
}

fn distortion(model: &str, camera: u32, camera_model: &str, params: &[f64]) -> String {
    let params: Vec<String> = params.iter().map(|value| format!("{value:.4}")).collect();
    format!(
        "camera {camera} of {model} has a distortion that no lens has ({camera_model} {}): give \
        another `features.camera_model` or `features.intrinsics`",
        params.join(", ")
    )
}

fn uncertain_focal(
    model: &str,
    camera: u32,
    [focal_px, sd_px]: [f64; 2],
    is_calibrated: bool,
) -> String {
    let (low, high) = ((focal_px - 2.0 * sd_px).max(0.0), focal_px + 2.0 * sd_px);
    let what_to_do = match is_calibrated {
        true => "keep the calibration by `mapper.refine` none",
        false => "give `features.calibration`",
    };
    format!(
        "the images hardly determine the focal length of camera {camera} of {model}, {low:.0} to \
        {high:.0} px (95 %), nor how long the way is in relation to its width: take images that \
        rotate, or {what_to_do}"
    )
}

fn contradicted(model: &str, camera: u32, change: &ParameterChange) -> String {
    let ParameterChange { parameter, given, found, deviations } = change;
    format!(
        "the images contradict the calibration of camera {camera} of {model}: {parameter} \
        {given:.4} was given, and {found:.4} is found ({deviations:+.0} standard deviations): \
        check its image size and camera model, or keep it by `mapper.refine` none"
    )
}

fn several_models(images: &[usize], gaps: &[ModelGap]) -> String {
    let sizes: Vec<String> = images.iter().map(usize::to_string).collect();
    let connected: Vec<String> = gaps
        .iter()
        .filter_map(|gap| {
            let ([one, other], nearest) = (gap.images.as_ref()?, gap.nearest.as_ref()?);
            let ModelGap { model, matches, .. } = gap;
            Some(format!("{model} and {nearest} between {other} and {one} ({matches} matches)"))
        })
        .collect();
    let connected = match connected.is_empty() {
        true => String::new(),
        false => format!("; photos would connect {}", listed(&connected)),
    };
    format!(
        "the images give {} models without a common point, of {} images: they show several places, \
        or photos between them are missing{connected}",
        images.len(),
        sizes.join(", ")
    )
}

fn stationary(matches: usize, watermark_pairs: usize, overlays: &[OverlayReport]) -> String {
    let places: Vec<String> = overlays.iter().map(place).collect();
    let others = match watermark_pairs {
        0 => String::new(),
        pairs => format!("; {pairs} pairs have no other matches"),
    };
    format!(
        "{matches} matches stand still while the scene moves and were left out, as of a logo, a \
        time stamp, a bonnet or dirt: {}{others}",
        places.join("; ")
    )
}

fn scaled(image: &ScaledImage) -> String {
    let ScaledImage { name, scale, sd } = image;
    format!("{name} ({scale:.3} \u{b1} {sd:.3})")
}

fn place(overlay: &OverlayReport) -> String {
    let OverlayReport { camera, width, height, images, spots, regions } = overlay;
    let of = match camera {
        Some(camera) => format!("camera {camera}"),
        None => format!("photos of {width} x {height} px"),
    };
    let regions: Vec<String> = regions
        .iter()
        .map(|[left, top, right, bottom]| format!("{left:.0},{top:.0} to {right:.0},{bottom:.0}"))
        .collect();
    format!("{spots} spots in {images} images of {of}, at {}", listed(&regions))
}

fn listed(all: &[String]) -> String {
    let shown = all[..all.len().min(MAX_LISTED)].join(", ");
    match all.len() - all.len().min(MAX_LISTED) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}
