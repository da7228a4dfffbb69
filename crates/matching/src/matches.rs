//! Matches and nearest neighbours.

/// Norm of a SIFT descriptor in COLMAP, VLFeat and OpenCV: unit vectors times 512.
pub(crate) const DESCRIPTOR_NORM: f64 = 512.0;

/// Squared diameter of the sphere of descriptors.
pub(crate) const DIAMETER_SQUARED: f64 = 4.0 * DESCRIPTOR_NORM * DESCRIPTOR_NORM;

/// A match of feature `a` of the first image and feature `b` of the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Index into the first image's features.
    pub a: u32,
    /// Index into the second image's features.
    pub b: u32,
    /// Squared Euclidean distance of the descriptors, exact for bytes. Matchers without distances
    /// give 0.
    pub distance: f64,
}

impl Match {
    /// Angle between SIFT descriptors in radians, under the assumption that both have norm 512. It
    /// is at most π/2, because they have no negative entries.
    pub fn angle_rad(&self) -> f64 {
        angle_rad(self.distance)
    }
}

/// The nearest and second nearest neighbour of a SIFT descriptor among the descriptors of another
/// image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Nearest {
    /// Index of the nearest descriptor, the lowest of equally near ones; `u32::MAX` if there is
    /// none.
    pub index: u32,
    /// Squared distance to the nearest; `u32::MAX` if there is none.
    pub distance: u32,
    /// Squared distance to the second nearest; `u32::MAX` if there is none.
    pub second: u32,
}

impl Nearest {
    /// No neighbour.
    pub const NONE: Nearest = Nearest { index: u32::MAX, distance: u32::MAX, second: u32::MAX };

    /// Updates the neighbours with a candidate. Neither the order of candidates nor repetitions
    /// matter.
    #[inline]
    pub(crate) fn update(&mut self, index: u32, distance: u32) {
        if (distance, index) < (self.distance, self.index) {
            *self = Nearest { index, distance, second: self.distance };
        } else if distance < self.second && index != self.index {
            self.second = distance;
        }
    }
}

/// Angle in radians of a chord of the sphere whose squared length is `distance`.
pub(crate) fn angle_rad(distance: f64) -> f64 {
    let half_chord = (distance / DIAMETER_SQUARED).min(0.5).sqrt();
    2.0 * half_chord.asin()
}
