#![doc = include_str!("../README.md")]

mod adjust;
mod cloud;
pub mod colmap;
mod colors;
mod database_scene;
mod dense;
mod dense_options;
mod depth_pictures;
mod error;
mod evaluate;
mod event;
mod export;
mod extractors;
mod features;
mod file_marks;
mod file_names;
mod foreign_database;
mod format;
mod image_names;
mod input_model;
mod kalibr;
mod keypoints;
mod loaded_features;
mod localize;
mod mapping;
mod matching;
mod model_location;
mod model_photos;
mod model_tools;
mod option_keys;
mod page_file;
mod pair_choice;
mod reconstruct;
mod records;
mod report;
mod rig_calibration;
mod rig_evaluation;
mod rig_file;
mod rig_hints;
mod rig_report;
mod rigid;
mod rolling_shutter;
mod scale;
mod stage;
mod staged_model;
mod surface;
mod table;
mod undistort;
mod video;
mod view;
mod workspace;

pub use adjust::{AdjustReport, AdjustStep, adjust};
pub use cloud::{CloudEvaluation, RegisteredCloud, evaluate_cloud, read_cloud, register_cloud};
pub use dense::dense;
pub use dense_options::DenseOptions;
pub use depth_pictures::DenseView;
pub use error::Error;
pub use evaluate::{
    Auc, ErrorStatistics, FocalLength, PoseEvaluation, Truth, TruthFormat, evaluate_poses,
    model_folder,
};
pub(crate) use event::emit;
pub use event::{DenseStep, Event, Watch};
pub use export::{
    ExportFormat, ExportSource, Exported, export, export_detected, export_rigid, write_model,
};
pub use features::{FeatureOptions, extract_features};
pub use foreign_database::import_features;
pub use input_model::InputModel;
pub use localize::{
    CameraSource, LocalizeOptions, LocalizeReport, LocalizedPhoto, PhotoPose, localize,
};
pub use mapping::{MapOptions, map};
pub use matching::{MatchOptions, match_images};
pub use model_tools::{
    AlignTo, AlignmentInfo, CameraInfo, CropTo, MergedInfo, ModelChange, ModelInfo, SimilarityInfo,
    align_model, crop_model, merge_models, model_info, transform_model,
};
pub use page_file::{refuse_foreign_page, write_page};
pub use pair_choice::{PairChoice, choose_pairs};
pub use reconstruct::{Options, reconstruct};
pub use report::{
    CameraReport, DenseReport, FeaturesReport, MapReport, MatchReport, ModelReport, Report,
    StageReports,
};
pub use rig_evaluation::{RigEvaluation, evaluate_rig};
pub use rig_file::{ConstraintKind, RigCamera, RigClock, RigClockState, RigFile};
pub use rig_report::{ExtrinsicsReport, PaperReport, RigCameraReport, RigReport, SplitReport};
pub use rigid::RigidReport;
pub use rolling_shutter::rolling_shutters;
pub use scale::ScaleReport;
pub use stage::Stage;
pub use surface::{SurfaceEvaluation, evaluate_surface};
pub use table::{Table, TableRow};
pub use tiepoint_dense::undistort::UndistortOptions;
pub use tiepoint_eval as eval;
pub use tiepoint_input as input;
pub use tiepoint_input::{
    Calibration, CalibrationSource, CameraGrouping, Photos, Size, SkippedImage,
};
pub use tiepoint_io as io;
pub use tiepoint_sfm as sfm;
pub use tiepoint_store as store;
pub use undistort::{UndistortFolderOptions, UndistortLayout, Undistorted, undistort};
pub use video::{OpenedInput, open_input};
pub use view::{
    CameraError, CloudError, ReportModel, ReportSection, Thumbnails, report_html, view,
};
pub use workspace::Workspace;
