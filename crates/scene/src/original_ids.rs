//! Ids of the files that a model was read from.

use crate::{CameraId, ImageId, PointId};

/// Ids of cameras, images and points in the files that a model was read from. Writers keep them, so
/// that the model agrees with the database that it was made from. Where there are none, the ids
/// count from 1; what is added to a model has the ids after the largest one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OriginalIds {
    cameras: IdList,
    images: IdList,
    points: IdList,
}

impl OriginalIds {
    /// Ids in the order of the model's lists.
    pub fn new(cameras: Vec<u64>, images: Vec<u64>, points: Vec<u64>) -> Self {
        Self {
            cameras: IdList::new(cameras),
            images: IdList::new(images),
            points: IdList::new(points),
        }
    }

    /// The id of a camera.
    pub fn camera(&self, camera: CameraId) -> u64 {
        self.cameras.get(camera.index())
    }

    /// The id of an image.
    pub fn image(&self, image: ImageId) -> u64 {
        self.images.get(image.index())
    }

    /// The id of a point.
    pub fn point(&self, point: PointId) -> u64 {
        self.points.get(point.index())
    }

    /// Gives the last camera of a model the id that it had in another model, if none has it.
    pub fn set_last_camera(&mut self, last: CameraId, id: u64) {
        self.cameras.set_last(last.index(), id);
    }

    /// Gives the last image of a model the id that it had in another model, if none has it.
    pub fn set_last_image(&mut self, last: ImageId, id: u64) {
        self.images.set_last(last.index(), id);
    }
}

/// The ids of a list. Those beyond its end follow the largest one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct IdList {
    /// Empty for ids that count from 1.
    ids: Vec<u64>,
    max: u64,
}

impl IdList {
    fn new(ids: Vec<u64>) -> Self {
        if ids.iter().zip(1..).all(|(id, expected)| *id == expected) {
            return Self::default();
        }
        let max = ids.iter().copied().max().unwrap_or(0);
        Self { ids, max }
    }

    fn get(&self, index: usize) -> u64 {
        let beyond = || self.max.saturating_add((index - self.ids.len()) as u64 + 1);
        self.ids.get(index).copied().unwrap_or_else(beyond)
    }

    fn set_last(&mut self, last: usize, id: u64) {
        let mut ids: Vec<u64> = (0..last).map(|index| self.get(index)).collect();
        ids.push(if ids.contains(&id) { self.get(last) } else { id });
        *self = Self::new(ids);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_kept_and_added_ones_follow_the_largest() {
        let camera = |ids: &OriginalIds, index| ids.camera(CameraId(index));
        let default = OriginalIds::default();
        assert_eq!([0, 1, 7].map(|index| camera(&default, index)), [1, 2, 8]);
        assert_eq!(OriginalIds::new(vec![1, 2], vec![1], vec![]), default);

        let mut ids = OriginalIds::new(vec![3, 9], vec![], vec![u64::MAX - 1]);
        assert_eq!([0, 1, 2, 3].map(|index| camera(&ids, index)), [3, 9, 10, 11]);
        assert_eq!([0, 1, 2].map(|index| ids.point(PointId(index)) - (u64::MAX - 1)), [0, 1, 1]);
        ids.set_last_camera(CameraId(2), 5);
        assert_eq!([0, 1, 2, 3].map(|index| camera(&ids, index)), [3, 9, 5, 10]);
        ids.set_last_camera(CameraId(3), 9);
        assert_eq!(camera(&ids, 3), 10, "9 is taken");
        ids.set_last_image(ImageId(2), 40);
        assert_eq!([0, 1, 2, 3].map(|index| ids.image(ImageId(index))), [1, 2, 40, 41]);
    }
}
