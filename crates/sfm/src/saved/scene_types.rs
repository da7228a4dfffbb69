//! Types of the crates below.

use tiepoint_geometry::nalgebra::{Quaternion, SMatrix, UnitQuaternion};
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
use tiepoint_rig::{Clock, RelativePoseStatistics};
use tiepoint_scene::rig::RigSensor;
use tiepoint_scene::{CameraId, Frame, ImageId, ImagePair, Observation, Rig, RigId, Track};

use super::codec::{Reader, Saved, Writer, saved};

saved! { struct Rig { sensors } }
saved! { struct RigSensor { camera, cam_from_rig } }
saved! { struct Frame { rig, rig_from_world, images } }
saved! { struct Observation { image, keypoint } }
saved! { struct Track { xyz, color, observations, is_held_out } }
saved! { struct Rigid3 { rotation, translation } }
saved! { struct Clock { offset_s, drift, pivot_s } }
saved! {
    struct RelativePoseStatistics {
        count,
        median_baseline,
        mean_baseline,
        sd_baseline,
        rms_translation,
        rms_rotation_rad,
        second_over_first_half,
    }
}

/// Ids with the number of items that the scene has.
macro_rules! saved_ids {
    ($($id:ident, $scene:ident => $count:expr);*) => { $(
        impl Saved for $id {
            fn write(&self, to: &mut Writer) {
                self.0.write(to);
            }
            fn read(from: &mut Reader) -> Option<Self> {
                let $scene = from.scene;
                u32::read(from).map(Self).filter(|id| id.index() < $count)
            }
        }
    )* };
}
saved_ids! { CameraId, scene => scene.num_cameras(); ImageId, scene => scene.num_images() }

/// A model with such a rig is checked as a whole.
impl Saved for RigId {
    fn write(&self, to: &mut Writer) {
        self.0.write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        u32::read(from).map(Self)
    }
}

impl Saved for ImagePair {
    fn write(&self, to: &mut Writer) {
        self.a.write(to);
        self.b.write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        // The order of the two is that of their ids.
        Self::new(ImageId::read(from)?, ImageId::read(from)?)
    }
}

impl Saved for [u8; 3] {
    fn write(&self, to: &mut Writer) {
        to.bytes.extend_from_slice(self);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        from.take(3)?.try_into().ok()
    }
}

impl<const R: usize, const C: usize> Saved for SMatrix<f64, R, C> {
    fn write(&self, to: &mut Writer) {
        self.iter().for_each(|value| value.write(to));
    }

    fn read(from: &mut Reader) -> Option<Self> {
        let mut this = Self::zeros();
        for value in this.iter_mut() {
            *value = f64::read(from)?;
        }
        Some(this)
    }
}

impl Saved for UnitQuaternion<f64> {
    fn write(&self, to: &mut Writer) {
        self.coords.iter().for_each(|value| value.write(to));
    }

    fn read(from: &mut Reader) -> Option<Self> {
        // Normalising would change the last bits; a model with this rotation is checked as a whole.
        SMatrix::<f64, 4, 1>::read(from)
            .map(|coords| Self::new_unchecked(Quaternion::from_vector(coords)))
    }
}

impl Saved for Intrinsics {
    fn write(&self, to: &mut Writer) {
        (self.kind().colmap_id() as u32).write(to);
        self.params().iter().for_each(|value| value.write(to));
    }

    fn read(from: &mut Reader) -> Option<Self> {
        let id = i32::try_from(u32::read(from)?).ok()?;
        let kind = CameraModelKind::from_colmap_id(id).ok()?;
        let params: Option<Vec<f64>> = (0..kind.num_params()).map(|_| f64::read(from)).collect();
        Self::new(kind, &params?).ok()
    }
}
