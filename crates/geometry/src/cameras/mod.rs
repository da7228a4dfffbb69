//! Camera models: projection of a point in the camera frame to a pixel, and unprojection of a pixel
//! to a unit ray.
//!
//! Names, parameter orders and ids are those of COLMAP. To add a model: write `cameras/<name>.rs`
//! with a unit struct that implements [`CameraModel`], and add one line to the `camera_models!`
//! list below. Dispatch, file formats and tests use the list.

mod division;
mod equidistant;
mod equirectangular;
mod eucm;
mod fisheye;
mod fov;
mod full_opencv;
mod model;
mod opencv;
mod opencv_fisheye;
mod pinhole;
mod rad_tan_thin_prism_fisheye;
mod radial;
mod radial_fisheye;
mod thin_prism_fisheye;
mod undistort;

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::Error;
pub use division::{Division, SimpleDivision};
pub use equirectangular::Equirectangular;
pub use eucm::Eucm;
pub use fisheye::{Fisheye, SimpleFisheye};
pub use fov::Fov;
pub use full_opencv::FullOpencv;
pub use model::{CameraModel, MIN_DEPTH, Projection};
pub use opencv::Opencv;
pub use opencv_fisheye::OpencvFisheye;
pub use pinhole::{Pinhole, SimplePinhole};
pub use rad_tan_thin_prism_fisheye::RadTanThinPrismFisheye;
pub use radial::{Radial, SimpleRadial};
pub use radial_fisheye::{RadialFisheye, SimpleRadialFisheye};
pub use thin_prism_fisheye::ThinPrismFisheye;

macro_rules! camera_models {
    // `$d` is a dollar sign, for the macro inside the macro.
    ($d:tt; $($model:ident $dof:literal),* $(,)?) => {
        /// The camera models.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum CameraModelKind { $(
            #[doc = concat!("[`", stringify!($model), "`]")]
            $model,
        )* }

        impl CameraModelKind {
            /// All models, in the order of their COLMAP ids.
            pub const ALL: &'static [CameraModelKind] = &[$(CameraModelKind::$model),*];
            /// Name in COLMAP.
            pub fn name(self) -> &'static str {
                match self { $(Self::$model => <$model as CameraModel>::NAME),* }
            }
            /// Model id in COLMAP.
            pub fn colmap_id(self) -> i32 {
                match self { $(Self::$model => <$model as CameraModel>::COLMAP_ID),* }
            }
            /// Names of the parameters, in order.
            pub fn param_names(self) -> &'static [&'static str] {
                match self { $(Self::$model => <$model as CameraModel>::PARAM_NAMES),* }
            }
            /// Indices of the focal lengths.
            pub fn focal_indices(self) -> &'static [usize] {
                match self { $(Self::$model => <$model as CameraModel>::FOCAL),* }
            }
            /// Indices of the distortion parameters that are nearly degenerate with a rotation of
            /// the camera: see [`CameraModel::ROTATION_DEGENERATE`].
            pub fn rotation_degenerate_indices(self) -> &'static [usize] {
                match self { $(Self::$model => <$model as CameraModel>::ROTATION_DEGENERATE),* }
            }
            /// Indices of the principal point.
            pub fn principal_point_indices(self) -> &'static [usize] {
                match self { $(Self::$model => <$model as CameraModel>::PRINCIPAL_POINT),* }
            }
            /// Indices of the parameters that are never refined: see [`CameraModel::METADATA`].
            pub fn metadata_indices(self) -> &'static [usize] {
                match self { $(Self::$model => <$model as CameraModel>::METADATA),* }
            }
            /// Whether the model is a fisheye: see [`CameraModel::IS_FISHEYE`].
            pub fn is_fisheye(self) -> bool {
                match self { $(Self::$model => <$model as CameraModel>::IS_FISHEYE),* }
            }
            /// Initial distortion where it is not zero: see [`CameraModel::INITIAL_DISTORTION`].
            pub fn initial_distortion(self) -> &'static [(usize, f64)] {
                match self { $(Self::$model => <$model as CameraModel>::INITIAL_DISTORTION),* }
            }
        }

        /// A camera model and its parameters.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum Intrinsics { $(
            #[doc = concat!("[`", stringify!($model), "`]")]
            $model(<$model as CameraModel>::Params),
        )* }

        impl Intrinsics {
            /// The model.
            pub fn kind(&self) -> CameraModelKind {
                match self { $(Self::$model(_) => CameraModelKind::$model),* }
            }
            /// The parameters.
            pub fn params(&self) -> &[f64] { match self { $(Self::$model(p) => p.as_slice()),* } }
            /// The parameters, mutable.
            pub fn params_mut(&mut self) -> &mut [f64] {
                match self { $(Self::$model(p) => p.as_mut_slice()),* }
            }
            /// All parameters are zero, to be set through [`Intrinsics::params_mut`].
            fn zeroed(kind: CameraModelKind) -> Self {
                match kind {
                    $(CameraModelKind::$model => {
                        Self::$model(nalgebra::SVector::<f64, $dof>::zeros())
                    })*
                }
            }
            /// Projects a point in the camera frame to a pixel; `None` if the model does not
            /// project it, for example a point behind a perspective camera.
            pub fn project(&self, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
                match self { $(Self::$model(p) => <$model>::project(p, point_in_cam)),* }
            }
            /// The unit ray of a pixel in the camera frame; `None` if the pixel has no ray.
            pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
                match self { $(Self::$model(p) => <$model>::unproject(p, pixel)),* }
            }
            /// The focal lengths fx and fy, in pixels; see [`CameraModel::focal_lengths_px`].
            pub fn focal_lengths_px(&self) -> [f64; 2] {
                match self { $(Self::$model(p) => <$model>::focal_lengths_px(p)),* }
            }
            /// (cx, cy) in pixels.
            pub fn principal_point(&self) -> Vector2<f64> {
                match self { $(Self::$model(p) => <$model>::principal_point(p)),* }
            }
            /// `projected` − `observed` in pixels, or the shorter way around where the image is
            /// periodic. See [`CameraModel::displacement`].
            pub fn displacement(
                &self,
                projected: &Vector2<f64>,
                observed: &Vector2<f64>,
            ) -> Vector2<f64> {
                match self { $(
                    Self::$model(p) => <$model>::displacement(p, projected, observed)
                ),* }
            }
            /// The squared reprojection error, in pixels²; `None` if the model does not project
            /// the point. See [`CameraModel::squared_error_px2`].
            pub fn squared_error_px2(
                &self,
                point_in_cam: &Vector3<f64>,
                observed: &Vector2<f64>,
            ) -> Option<f64> {
                match self { $(
                    Self::$model(p) => <$model>::squared_error_px2(p, point_in_cam, observed)
                ),* }
            }
        }

        /// Runs generic code for the model of an [`Intrinsics`]:
        /// `with_camera_model!(intrinsics, M, params => expression)` binds the type
        /// `M: CameraModel` and `params: &M::Params`.
        #[macro_export]
        macro_rules! with_camera_model {
            ($d intrinsics:expr, $d M:ident, $d params:ident => $d body:expr) => {
                match $d intrinsics { $(
                    $crate::Intrinsics::$model($d params) => {
                        type $d M = $crate::cameras::$model;
                        $d body
                    }
                ),* }
            };
        }
    };
}

// Model, number of parameters.
camera_models! { $;
    SimplePinhole 3,
    Pinhole 4,
    SimpleRadial 4,
    Radial 5,
    Opencv 8,
    OpencvFisheye 8,
    FullOpencv 12,
    Fov 5,
    SimpleRadialFisheye 4,
    RadialFisheye 5,
    ThinPrismFisheye 12,
    RadTanThinPrismFisheye 16,
    SimpleDivision 4,
    Division 5,
    SimpleFisheye 3,
    Fisheye 4,
    Eucm 6,
    Equirectangular 2,
}

impl CameraModelKind {
    /// The model of a COLMAP name, in upper case.
    ///
    /// # Errors
    /// [`Error::UnknownCameraModel`] if there is no model of this name.
    pub fn from_name(name: &str) -> Result<Self, Error> {
        Self::ALL.iter().copied().find(|kind| kind.name() == name).ok_or_else(|| {
            Error::UnknownCameraModel {
                name: name.to_owned(),
                known: Self::ALL.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(", "),
            }
        })
    }

    /// The model of a COLMAP model id.
    ///
    /// # Errors
    /// [`Error::UnknownCameraModel`] if there is no model of this id.
    pub fn from_colmap_id(id: i32) -> Result<Self, Error> {
        Self::ALL.iter().copied().find(|kind| kind.colmap_id() == id).ok_or_else(|| {
            Error::UnknownCameraModel {
                name: id.to_string(),
                known: Self::ALL
                    .iter()
                    .map(|kind| format!("{} = {}", kind.colmap_id(), kind.name()))
                    .collect::<Vec<_>>()
                    .join(", "),
            }
        })
    }

    /// Number of parameters.
    pub fn num_params(self) -> usize {
        self.param_names().len()
    }

    /// Indices of the distortion parameters, without those that act like a rotation
    /// ([`CameraModelKind::rotation_degenerate_indices`]).
    pub fn distortion_indices(self) -> Vec<usize> {
        let others = [
            self.focal_indices(),
            self.principal_point_indices(),
            self.metadata_indices(),
            self.rotation_degenerate_indices(),
        ];
        let is_other = |index: &usize| others.iter().any(|indices| indices.contains(index));
        (0..self.num_params()).filter(|index| !is_other(index)).collect()
    }
}

impl Intrinsics {
    /// From a model and its parameters, in the order of [`CameraModelKind::param_names`].
    ///
    /// # Errors
    /// [`Error::CameraParamCount`] if the number of parameters is wrong;
    /// [`Error::CameraParamRange`] if one is not finite, or a focal length or an image side is not
    /// positive.
    pub fn new(kind: CameraModelKind, params: &[f64]) -> Result<Self, Error> {
        let names = kind.param_names();
        if params.len() != names.len() {
            return Err(Error::CameraParamCount {
                model: kind.name(),
                expected: names.len(),
                names: names.join(", "),
                found: params.len(),
            });
        }
        for (index, (&name, &value)) in names.iter().zip(params).enumerate() {
            let must_be_positive =
                kind.focal_indices().contains(&index) || kind.metadata_indices().contains(&index);
            if !value.is_finite() || (must_be_positive && value <= 0.0) {
                return Err(Error::CameraParamRange { model: kind.name(), name, value });
            }
        }
        let mut intrinsics = Self::zeroed(kind);
        intrinsics.params_mut().copy_from_slice(params);
        Ok(intrinsics)
    }

    /// From a COLMAP model name and the parameters.
    ///
    /// # Errors
    /// [`Error::UnknownCameraModel`] if there is no model of this name, and the errors of
    /// [`Intrinsics::new`].
    pub fn from_name(name: &str, params: &[f64]) -> Result<Self, Error> {
        Self::new(CameraModelKind::from_name(name)?, params)
    }

    /// Focal length `focal_px`, the principal point at the centre of a `width` × `height` image,
    /// and the initial distortion. A spherical model takes the image size alone.
    pub fn centred(kind: CameraModelKind, focal_px: f64, width: u32, height: u32) -> Self {
        let mut intrinsics = Self::zeroed(kind);
        let params = intrinsics.params_mut();
        let size = [f64::from(width), f64::from(height)];
        for &index in kind.focal_indices() {
            params[index] = focal_px;
        }
        for (&index, side) in kind.principal_point_indices().iter().zip(size) {
            params[index] = side / 2.0;
        }
        for (&index, side) in kind.metadata_indices().iter().zip(size) {
            params[index] = side;
        }
        for &(index, value) in kind.initial_distortion() {
            params[index] = value;
        }
        intrinsics
    }

    /// The same projection by a model with distortion: of OPENCV for a pinhole camera, of
    /// OPENCV_FISHEYE for an equidistant one. Others have distortion parameters and stay.
    pub fn with_distortion(&self) -> Self {
        let kind = match self.kind() {
            CameraModelKind::SimplePinhole | CameraModelKind::Pinhole => CameraModelKind::Opencv,
            CameraModelKind::SimpleFisheye | CameraModelKind::Fisheye => {
                CameraModelKind::OpencvFisheye
            }
            _ => return *self,
        };
        let mut intrinsics = Self::zeroed(kind);
        let (focal, centre) = (self.focal_lengths_px(), self.principal_point());
        let params = [focal[0], focal[1], centre.x, centre.y];
        intrinsics.params_mut()[..params.len()].copy_from_slice(&params);
        intrinsics
    }

    /// The mean of the focal lengths, in pixels.
    pub fn mean_focal_px(&self) -> f64 {
        let [fx, fy] = self.focal_lengths_px();
        0.5 * (fx + fy)
    }

    /// The calibration matrix K of the focal lengths and the principal point, without distortion.
    pub fn calibration_matrix(&self) -> Matrix3<f64> {
        let ([fx, fy], centre) = (self.focal_lengths_px(), self.principal_point());
        Matrix3::new(fx, 0.0, centre.x, 0.0, fy, centre.y, 0.0, 0.0, 1.0)
    }
}
