//! What crosses from matching to everything else.

/// Length of a SIFT descriptor as quantised by COLMAP, VLFeat and OpenCV: unit vectors times 512.
pub(crate) const DESCRIPTOR_NORM: f64 = 512.0;

/// Squared length of the chord between opposite points of the sphere that descriptors lie on.
pub(crate) const DIAMETER_SQUARED: f64 = 4.0 * DESCRIPTOR_NORM * DESCRIPTOR_NORM;

/// Feature `a` of the first image looks like feature `b` of the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Match {
    /// Index into the first image's features.
    pub a: u32,
    /// Index into the second image's features.
    pub b: u32,
    /// Squared Euclidean distance of the two descriptors, exact.
    pub distance: u32,
}

impl Match {
    /// Angle between the two descriptors in radians, taking both to have length 512; at most a
    /// right angle, because descriptors have no negative entries.
    pub fn angle_rad(&self) -> f64 {
        angle_rad(self.distance)
    }
}

/// The best and the second best partner of one descriptor among those of another image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Nearest {
    /// Index of the nearest descriptor, the lowest among equals; `u32::MAX` where the other image
    /// has none.
    pub index: u32,
    /// Squared distance to it; `u32::MAX` where there is none.
    pub distance: u32,
    /// Squared distance to the second nearest; `u32::MAX` where there is none.
    pub second: u32,
}

impl Nearest {
    /// No partner at all.
    pub const NONE: Nearest = Nearest { index: u32::MAX, distance: u32::MAX, second: u32::MAX };

    /// Takes one more candidate into account, in any order.
    #[inline]
    pub(crate) fn offer(&mut self, index: u32, distance: u32) {
        if (distance, index) < (self.distance, self.index) {
            *self = Nearest { index, distance, second: self.distance };
        } else if distance < self.second {
            self.second = distance;
        }
    }
}

/// Angle subtended by a chord whose squared length is `distance`.
pub(crate) fn angle_rad(distance: u32) -> f64 {
    let half_chord = (f64::from(distance) / DIAMETER_SQUARED).min(0.5).sqrt();
    2.0 * half_chord.asin()
}
