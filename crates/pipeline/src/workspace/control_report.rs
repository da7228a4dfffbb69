//! Errors of control points and check points.

use serde::{Deserialize, Serialize};

/// A control point or check point in a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object that describes a control point")]
pub struct ControlPointReport {
    /// Its name.
    pub name: String,
    /// Whether it only tells of errors.
    pub is_check: bool,
    /// Whether the others contradict it and no other point explains that; it was not used.
    pub is_wrong: bool,
    /// If the others contradict it and it was not used, the names of the points one of which may be
    /// wrong in its place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alternatives: Vec<String>,
    /// Number of marks in images with a pose.
    pub marks: usize,
    /// Number of those that agree on one point.
    pub inlier_marks: usize,
    /// Images with a pose whose marks do not agree with the others.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub wrong_marks: Vec<String>,
    /// Root mean square distance of the marks that agree from the projections of the point, in
    /// pixels; `None` if the marks do not determine it.
    pub rms_px: Option<f64>,
    /// Its place in the model minus the measured one, in metres: east, north and up, or along the
    /// axes of the coordinates; `None` if the marks do not determine it.
    pub error_m: Option<[f64; 3]>,
    /// Standard deviations of the error along the axes, by those of marks and coordinates, without
    /// errors of the model; `None` without an error.
    pub sigmas_m: Option<[f64; 3]>,
    /// Sizes of errors of the measured coordinates along the axes that are detected in 80 % of
    /// cases, in metres; `None` where nothing tests a coordinate.
    #[serde(default, skip_serializing_if = "is_untested")]
    pub detectable_m: [Option<f64>; 3],
    /// As `detectable_m`, of errors that no other point explains, so that the point is named.
    #[serde(default, skip_serializing_if = "is_untested")]
    pub separable_m: [Option<f64>; 3],
}

impl ControlPointReport {
    /// Whether it is a control point that did not take part.
    pub fn is_left_out(&self) -> bool {
        self.is_wrong || !self.alternatives.is_empty()
    }
}

fn is_untested(sizes: &[Option<f64>; 3]) -> bool {
    sizes.iter().all(Option::is_none)
}

/// Errors of the points of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object with errors")]
pub struct PointStatistics {
    /// Number of points.
    pub points: usize,
    /// Root mean square errors along the axes, in metres.
    pub rms_m: [f64; 3],
}

impl PointStatistics {
    /// Of the control points that took part, or of the check points; `None` without any that the
    /// marks determine.
    pub fn of(points: &[ControlPointReport], is_check: bool) -> Option<Self> {
        let is_of_kind =
            |point: &&ControlPointReport| point.is_check == is_check && !point.is_left_out();
        let errors: Vec<[f64; 3]> =
            points.iter().filter(is_of_kind).filter_map(|point| point.error_m).collect();
        let count = errors.len();
        let rms = |axis: usize| {
            let squares: f64 = errors.iter().map(|error| error[axis].powi(2)).sum();
            (squares / count as f64).sqrt()
        };
        (count > 0).then(|| Self { points: count, rms_m: [0, 1, 2].map(rms) })
    }
}

/// The control points and check points of a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object with control points")]
pub struct ControlReport {
    /// Of the control points that are used; `None` without any.
    pub control: Option<PointStatistics>,
    /// Of the check points; `None` without any.
    pub check: Option<PointStatistics>,
    /// All points, in their order.
    pub points: Vec<ControlPointReport>,
}

impl From<Vec<ControlPointReport>> for ControlReport {
    fn from(points: Vec<ControlPointReport>) -> Self {
        let of = |is_check| PointStatistics::of(&points, is_check);
        Self { control: of(false), check: of(true), points }
    }
}
