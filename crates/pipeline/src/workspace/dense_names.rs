//! Names of the files in a dense workspace of COLMAP.

use crate::workspace::file_names::DENSE;

/// What COLMAP adds to the name of an image for its maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapKind {
    /// `.geometric.bin`: maps that agree with those of other images.
    Geometric,
    /// `.photometric.bin`: maps from the photos alone.
    Photometric,
}

impl MapKind {
    /// The end of the name of a map.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Geometric => ".geometric.bin",
            Self::Photometric => ".photometric.bin",
        }
    }
}

/// Names of the files in a dense workspace, relative to an output folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DenseNames {
    /// The dense workspace in the output folder; `None` if it is the output folder.
    folder: Option<&'static str>,
    kind: MapKind,
}

impl DenseNames {
    /// Of the dense workspace in a workspace of this program.
    pub(crate) const OF_WORKSPACE: Self = Self { folder: Some(DENSE), kind: MapKind::Geometric };

    /// Of an output folder that is the dense workspace.
    pub fn new(kind: MapKind) -> Self {
        Self { folder: None, kind }
    }

    /// A file, by its path in the dense workspace.
    pub fn file(&self, path: &str) -> String {
        self.folder.map_or_else(|| path.to_owned(), |folder| format!("{folder}/{path}"))
    }

    /// An undistorted image.
    pub fn image(&self, image: &str) -> String {
        self.file(&format!("images/{image}"))
    }

    /// The mask of an image: 255 where it is used, 0 where it is not.
    pub(crate) fn mask(&self, image: &str) -> String {
        self.file(&format!("masks/{image}.png"))
    }

    /// Planes at half resolution, until all depth maps are there.
    pub fn planes(&self, image: &str) -> String {
        self.file(&format!("stereo/planes/{image}.bin"))
    }

    /// The depth map of an image.
    pub fn depths(&self, image: &str) -> String {
        self.map("depth_maps", image)
    }

    /// The normals of a depth map.
    pub fn normals(&self, image: &str) -> String {
        self.map("normal_maps", image)
    }

    /// The probabilities that the depths are right. COLMAP has no such file.
    pub fn confidences(&self, image: &str) -> String {
        self.map("confidence_maps", image)
    }

    fn map(&self, folder: &str, image: &str) -> String {
        self.file(&format!("stereo/{folder}/{image}{}", self.kind.suffix()))
    }
}

/// The depth map of an image, relative to a workspace of this program.
pub fn depth_map_path(image: &str) -> String {
    DenseNames::OF_WORKSPACE.depths(image)
}
