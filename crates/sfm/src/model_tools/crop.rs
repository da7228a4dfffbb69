//! Crop: the part of a model whose points are in a box.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{ImageId, PointId, Reconstruction};

/// A box along the axes of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundingBox {
    /// Least coordinates.
    pub min: Vector3<f64>,
    /// Largest coordinates.
    pub max: Vector3<f64>,
}

impl BoundingBox {
    /// The box of the points between two quantiles of each coordinate, from 0 to 1; `None` without
    /// points. The lower index is rounded down and the upper one up, as in COLMAP.
    pub fn of_points(model: &Reconstruction, low: f64, high: f64) -> Option<Self> {
        let last = model.num_tracks().checked_sub(1)?;
        let mut sorted: [Vec<f64>; 3] =
            std::array::from_fn(|axis| model.tracks().map(|(_, track)| track.xyz[axis]).collect());
        sorted.iter_mut().for_each(|values| values.sort_by(f64::total_cmp));
        let index = |position: f64| (position.max(0.0) as usize).min(last);
        let (first, end) = (index((low * last as f64).floor()), index((high * last as f64).ceil()));
        Some(Self {
            min: Vector3::from_fn(|axis, _| sorted[axis][first]),
            max: Vector3::from_fn(|axis, _| sorted[axis][end]),
        })
    }

    /// Whether a point is in the box or on its border.
    pub fn contains(&self, xyz: &Vector3<f64>) -> bool {
        (0..3).all(|axis| (self.min[axis]..=self.max[axis]).contains(&xyz[axis]))
    }
}

/// Removes the points outside of a box, and the poses of images that see none of the others. An
/// image of a frame stays if any image of the frame sees one, as in COLMAP.
pub fn crop(model: &mut Reconstruction, bounds: &BoundingBox) {
    let outside: Vec<PointId> = model
        .tracks()
        .filter(|(_, track)| !bounds.contains(&track.xyz))
        .map(|(point, _)| point)
        .collect();
    outside.into_iter().for_each(|point| model.delete_track(point));
    let sees = |id: ImageId| model.image(id).num_points() > 0;
    let is_kept = |id: ImageId| {
        let frame = model.frames.iter().find(|frame| frame.images.contains(&id));
        sees(id) || frame.is_some_and(|frame| frame.images.iter().any(|image| sees(*image)))
    };
    let blind: Vec<ImageId> =
        model.registered().map(|(id, ..)| id).filter(|id| !is_kept(*id)).collect();
    blind.into_iter().for_each(|id| model.deregister(id));
}
