//! Finished models: adjustment, exports, undistortion, localisation, tools.

pub(crate) mod adjust;
pub(crate) mod export;
mod in_crs;
pub(crate) mod kalibr;
pub(crate) mod localize;
pub(crate) mod model_tools;
pub(crate) mod rigid;
pub(crate) mod rolling_shutter;
pub(crate) mod undistort;

pub use adjust::{AdjustReport, AdjustStep, adjust};
pub use export::{ExportFormat, ExportSource, Exported, export, export_detected, export_rigid};
pub use localize::{
    CameraSource, LocalizeOptions, LocalizeReport, LocalizedPhoto, PhotoPose, localize,
};
pub use model_tools::{
    AlignTo, AlignmentInfo, CameraInfo, CropTo, MergedInfo, ModelChange, ModelInfo, SimilarityInfo,
    align_model, crop_model, merge_models, model_info, transform_model,
};
pub use rigid::RigidReport;
pub use tiepoint_dense::undistort::UndistortOptions;
pub use undistort::{UndistortFolderOptions, UndistortLayout, Undistorted, undistort};
