//! The workspace: a folder with a COLMAP project and a few files of this program.

pub(crate) mod control_report;
pub(crate) mod database_scene;
pub(crate) mod dense_names;
pub(crate) mod file_marks;
pub(crate) mod file_names;
pub(crate) mod folder;
pub(crate) mod format;
pub(crate) mod image_names;
pub(crate) mod located_model;
pub(crate) mod model_output;
pub(crate) mod model_photos;
pub(crate) mod option_names;
pub(crate) mod overlay_report;
pub(crate) mod records;
pub(crate) mod report;
pub(crate) mod rig_file;
pub(crate) mod rig_report;
pub(crate) mod shards;
pub(crate) mod sidecar;
pub(crate) mod stage_run;
pub(crate) mod unregistered;
pub(crate) mod verdict;
pub(crate) mod warning;

pub use control_report::{ControlPointReport, ControlReport, PointStatistics};
pub use database_scene::read_scene;
pub use dense_names::{DenseNames, MapKind, depth_map_path};
pub use file_marks::PLY_MARK;
pub use file_names::{RIG, SPARSE, model_path};
pub use folder::{REPORT, Workspace, refuse_workspace};
pub use located_model::{LocatedModel, model_folder};
pub use model_output::{model_files, model_names, stage_model, write_model};
pub use model_photos::{decoder_bytes, fingerprints_of, inputs_of, is_unchanged};
pub use overlay_report::OverlayReport;
pub use report::{
    CalibrationReport, CameraReport, DenseReport, FeaturesReport, MapReport, MatchReport,
    ModelReport, Report, ScaleReport, StageReports,
};
pub use rig_file::{ConstraintKind, RigCamera, RigClock, RigClockState, RigFile};
pub use rig_report::{ExtrinsicsReport, PaperReport, RigCameraReport, RigReport, SplitReport};
pub use shards::ShardReport;
pub use unregistered::{NearestImage, Reason, UnregisteredImage, why_unregistered};
pub use verdict::verdict;
pub use warning::{ModelGap, ParameterChange, ScaledImage, Warning};
