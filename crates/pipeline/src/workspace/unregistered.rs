//! Why images have no pose in the largest model, as data and as lines.

use serde::{Deserialize, Serialize};
use tiepoint_sfm::diagnostics::UnregisteredReason;

/// More images of a reason are counted, not listed.
const MAX_LISTED: usize = 4;

/// An image without a pose in the largest model. Models are folders, relative to the workspace.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct UnregisteredImage {
    /// Its name.
    pub image: String,
    /// The model that it has a pose in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub posed_in: Option<String>,
    /// The model that the reason is about: the largest, or, for an image without any pose, that of
    /// the image with which it has the most verified matches.
    pub model: String,
    /// Why it has no pose there.
    #[serde(flatten)]
    pub reason: Reason,
    /// The image of that model with the most verified matches: photos between the two would help.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nearest: Option<NearestImage>,
}

/// Why an image has no pose in a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(tag = "reason", rename_all = "snake_case")]
pub enum Reason {
    /// No pair with the image is verified.
    NoPair,
    /// The image has verified pairs, but none with an image that has a pose in a model, or in the
    /// largest one if the image itself has a pose in another.
    NoPairWithModel {
        /// Number of verified pairs.
        pairs: usize,
    },
    /// Fewer keypoints match points of the model than a pose needs.
    FewPoints {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number that a pose needs.
        required: usize,
    },
    /// Too few 2D-3D correspondences agree on a pose.
    FewInliers {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number of those that agree.
        inliers: usize,
        /// Number that a pose needs.
        required: usize,
    },
    /// Enough 2D-3D correspondences agree on a pose, but too few did while the model grew.
    Late {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number of those that agree.
        inliers: usize,
    },
    /// Enough 2D-3D correspondences agree on a pose, which most verified matches with images of the
    /// model contradict.
    Contradiction {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number of those that agree.
        inliers: usize,
    },
    /// Enough 2D-3D correspondences agree on a pose that the camera cannot have reached from the
    /// images before and after.
    OutOfReach {
        /// Number of 2D-3D correspondences.
        correspondences: usize,
        /// Number of those that agree.
        inliers: usize,
    },
}

/// An image of a model that another image matches.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct NearestImage {
    /// Its name.
    pub image: String,
    /// Number of verified matches.
    pub matches: usize,
}

impl From<UnregisteredReason> for Reason {
    fn from(reason: UnregisteredReason) -> Self {
        match reason {
            UnregisteredReason::NoPair => Self::NoPair,
            UnregisteredReason::NoPairWithModel { pairs } => Self::NoPairWithModel { pairs },
            UnregisteredReason::FewPoints { correspondences, required } => {
                Self::FewPoints { correspondences, required }
            }
            UnregisteredReason::FewInliers { correspondences, inliers, required } => {
                Self::FewInliers { correspondences, inliers, required }
            }
            UnregisteredReason::Late { correspondences, inliers } => {
                Self::Late { correspondences, inliers }
            }
            UnregisteredReason::Contradiction { correspondences, inliers } => {
                Self::Contradiction { correspondences, inliers }
            }
            UnregisteredReason::OutOfReach { correspondences, inliers } => {
                Self::OutOfReach { correspondences, inliers }
            }
        }
    }
}

impl Reason {
    /// The reason of a group of images.
    fn of_group(&self) -> &'static str {
        match self {
            Self::NoPair => {
                "without a verified pair, as what no other image shows, or as a blurred image"
            }
            Self::NoPairWithModel { .. } => "with verified pairs only with images without a pose",
            Self::FewPoints { .. } => "with verified pairs, but too few matches with points",
            Self::FewInliers { .. } => "with too few matches with points that agree on a pose",
            Self::Late { .. } => {
                "with enough matches with points, but only with those of the finished model"
            }
            Self::Contradiction { .. } => {
                "with a pose that other images contradict, as of things that look alike or move"
            }
            Self::OutOfReach { .. } => {
                "with a pose out of reach of the camera between the images before and after, as \
                 where places look alike, or times are wrong"
            }
        }
    }

    /// The numbers of one image.
    fn numbers(&self) -> Option<String> {
        match self {
            Self::NoPair => None,
            Self::NoPairWithModel { pairs: 1 } => Some("1 pair".to_owned()),
            Self::NoPairWithModel { pairs } => Some(format!("{pairs} pairs")),
            Self::FewPoints { correspondences, required } => {
                Some(format!("{correspondences} points, {required} needed"))
            }
            Self::FewInliers { correspondences, inliers, required } => {
                Some(format!("{inliers} of {correspondences}, {required} needed"))
            }
            Self::Late { correspondences, inliers }
            | Self::Contradiction { correspondences, inliers }
            | Self::OutOfReach { correspondences, inliers } => {
                Some(format!("{inliers} of {correspondences}"))
            }
        }
    }
}

impl UnregisteredImage {
    /// Why it has no pose in the largest model, in a few words.
    pub fn why(&self) -> String {
        let nearest = self.nearest.as_ref().map(|NearestImage { image, matches }| {
            format!("most matches, {matches}, with {image} of {}", self.model)
        });
        let reason = Some(self.reason.of_group().to_owned());
        let facts: Vec<String> =
            [reason, self.reason.numbers(), nearest].into_iter().flatten().collect();
        match &self.posed_in {
            Some(other) => format!("has a pose in {other}"),
            None => facts.join("; "),
        }
    }

    fn text(&self) -> String {
        let nearest = self.nearest.as_ref().map(|NearestImage { image, matches }| {
            format!("most matches, {matches}, with {image} of {}", self.model)
        });
        let facts: Vec<String> = self.reason.numbers().into_iter().chain(nearest).collect();
        match facts.is_empty() {
            true => self.image.clone(),
            false => format!("{} ({})", self.image, facts.join("; ")),
        }
    }

    fn matches(&self) -> usize {
        self.nearest.as_ref().map_or(0, |nearest| nearest.matches)
    }
}

/// The images without a pose in the largest model: a line for those of other models, a line for
/// each reason of those without any pose, the images with the most matches first, and a line that
/// says which photos would help.
pub fn why_unregistered(images: &[UnregisteredImage]) -> Vec<String> {
    let (elsewhere, nowhere): (Vec<_>, Vec<_>) =
        images.iter().partition(|image| image.posed_in.is_some());
    let count = |group: &Vec<&UnregisteredImage>| {
        Some(format!("{} in {}", group.len(), group.first()?.posed_in.as_ref()?))
    };
    let groups = grouped(&elsewhere, |image| &image.posed_in);
    let in_others: Vec<String> = groups.iter().filter_map(count).collect();
    let mut lines = Vec::new();
    if !in_others.is_empty() {
        lines.push(in_others.join(", "));
    }
    for mut group in grouped(&nowhere, |image| std::mem::discriminant(&image.reason)) {
        group.sort_by_key(|image| std::cmp::Reverse(image.matches()));
        let shown: Vec<String> = group.iter().take(MAX_LISTED).map(|image| image.text()).collect();
        let more = match group.len() - shown.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let reason = group[0].reason.of_group();
        lines.push(format!("{} {reason}: {}{more}", group.len(), shown.join(", ")));
    }
    let closest = nowhere.iter().max_by_key(|image| image.matches());
    if let Some((image, nearest)) = closest.and_then(|image| Some((image, image.nearest.as_ref()?)))
    {
        let (one, other) = (&image.image, &nearest.image);
        lines.push(format!("photos between {one} and {other} would help most"));
    }
    lines
}

/// The images by a key, each group in order, the group of the first image first.
fn grouped<'a, K: PartialEq>(
    images: &[&'a UnregisteredImage],
    key: impl Fn(&'a UnregisteredImage) -> K,
) -> Vec<Vec<&'a UnregisteredImage>> {
    let mut groups: Vec<(K, Vec<&UnregisteredImage>)> = Vec::new();
    for &image in images {
        let key = key(image);
        match groups.iter_mut().find(|(other, _)| *other == key) {
            Some((_, group)) => group.push(image),
            None => groups.push((key, vec![image])),
        }
    }
    groups.into_iter().map(|(_, group)| group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(index: usize, posed_in: Option<&str>, reason: Reason) -> UnregisteredImage {
        let nearest = match reason {
            Reason::NoPair | Reason::NoPairWithModel { .. } => None,
            _ => Some(NearestImage { image: "a.jpg".to_owned(), matches: index }),
        };
        UnregisteredImage {
            image: format!("{index}.jpg"),
            posed_in: posed_in.map(str::to_owned),
            model: "sparse/0".to_owned(),
            reason,
            nearest,
        }
    }

    /// One of each reason.
    const REASONS: [Reason; 7] = [
        Reason::NoPair,
        Reason::NoPairWithModel { pairs: 2 },
        Reason::FewPoints { correspondences: 3, required: 30 },
        Reason::FewInliers { correspondences: 40, inliers: 9, required: 30 },
        Reason::Late { correspondences: 50, inliers: 45 },
        Reason::Contradiction { correspondences: 50, inliers: 44 },
        Reason::OutOfReach { correspondences: 50, inliers: 43 },
    ];

    #[test]
    fn many_images_are_few_lines() {
        let of_reasons = |index: usize| image(index, None, REASONS[index % REASONS.len()]);
        let mut images: Vec<UnregisteredImage> = (0..700).map(of_reasons).collect();
        images.push(image(700, Some("sparse/1"), REASONS[2]));
        images.push(image(701, Some("sparse/1"), REASONS[2]));
        images.push(image(702, Some("sparse/2"), REASONS[2]));
        let lines = why_unregistered(&images);
        assert_eq!(lines.len(), 2 + REASONS.len(), "{lines:#?}");
        assert_eq!(lines[0], "2 in sparse/1, 1 in sparse/2");
        for line in &lines[1..=REASONS.len()] {
            assert!(line.starts_with("100 with") && line.ends_with(" and 96 more"), "{line}");
        }
        let shown = "695.jpg (3 points, 30 needed; most matches, 695, with a.jpg of sparse/0)";
        assert!(lines[3].contains(shown), "{}", lines[3]);
        assert_eq!(lines[1 + REASONS.len()], "photos between 699.jpg and a.jpg would help most");
        assert_eq!(why_unregistered(&[]), [""; 0]);
    }

    #[test]
    fn the_report_is_read_as_it_was_written() {
        for (index, reason) in REASONS.into_iter().enumerate() {
            let written = image(index, Some("sparse/1"), reason);
            let text = serde_json::to_string(&written).unwrap();
            assert_eq!(serde_json::from_str::<UnregisteredImage>(&text).unwrap(), written);
        }
    }
}
