#![doc = include_str!("../README.md")]

pub mod colmap;
mod error;
mod evaluation;
mod event;
mod models;
mod page;
mod stage;
mod stages;
mod workspace;

pub use error::Error;
pub use evaluation::cloud::{
    CloudEvaluation, RegisteredCloud, evaluate_cloud, read_cloud, register_cloud,
};
pub use evaluation::poses::{
    Auc, ErrorStatistics, FocalLength, PoseEvaluation, Truth, TruthFormat, evaluate_poses,
};
pub use evaluation::rig::{RigEvaluation, evaluate_rig};
pub use evaluation::surface::{SurfaceEvaluation, evaluate_surface};
pub(crate) use event::emit;
pub use event::{DenseStep, Event, Watch};
pub use models::adjust::{AdjustReport, AdjustStep, adjust};
pub use models::export::{
    ExportFormat, ExportSource, Exported, export, export_detected, export_rigid,
};
pub use models::localize::{
    CameraSource, LocalizeOptions, LocalizeReport, LocalizedPhoto, PhotoPose, localize,
};
pub use models::model_tools::{
    AlignTo, AlignmentInfo, CameraInfo, CropTo, MergedInfo, ModelChange, ModelInfo, SimilarityInfo,
    align_model, crop_model, merge_models, model_info, transform_model,
};
pub use models::rigid::RigidReport;
pub use models::rolling_shutter::rolling_shutters;
pub use models::undistort::{UndistortFolderOptions, UndistortLayout, Undistorted, undistort};
pub use page::depth_pictures::DenseView;
pub use page::page_file::{refuse_foreign_page, write_page};
pub use page::photos::Thumbnails;
pub use page::table::{Table, TableRow};
pub use page::{CameraError, CloudError, ReportModel, ReportSection, report_html, view};
pub use stage::Stage;
pub use stages::dense::dense;
pub use stages::dense::options::DenseOptions;
pub use stages::features::{FeatureOptions, extract_features};
pub use stages::foreign_database::import_features;
pub use stages::input_model::InputModel;
pub use stages::mapping::{MapOptions, map};
pub use stages::matching::{MatchOptions, match_images};
pub use stages::pair_choice::{PairChoice, choose_pairs};
pub use stages::reconstruct::{Options, reconstruct};
pub use stages::video::{OpenedInput, open_input};
pub use tiepoint_dense::undistort::UndistortOptions;
pub use tiepoint_eval as eval;
pub use tiepoint_input as input;
pub use tiepoint_input::{
    Calibration, CalibrationSource, CameraGrouping, Photos, Size, SkippedImage,
};
pub use tiepoint_io as io;
pub use tiepoint_sfm as sfm;
pub use tiepoint_store as store;
pub use workspace::Workspace;
pub use workspace::model_location::model_folder;
pub use workspace::model_output::write_model;
pub use workspace::report::ScaleReport;
pub use workspace::report::{
    CameraReport, DenseReport, FeaturesReport, MapReport, MatchReport, ModelReport, Report,
    StageReports,
};
pub use workspace::rig_file::{ConstraintKind, RigCamera, RigClock, RigClockState, RigFile};
pub use workspace::rig_report::{
    ExtrinsicsReport, PaperReport, RigCameraReport, RigReport, SplitReport,
};
