#![doc = include_str!("../README.md")]

mod camera_table;
mod coding;
mod depth_pictures;
mod page;
mod page_file;
mod photos;
mod rig_table;
mod table;

pub use depth_pictures::DenseView;
pub use page::{CameraError, CloudError, ReportModel, ReportSection, report_html, view};
pub use page_file::{refuse_foreign_page, write_page};
pub use photos::Thumbnails;
pub use table::{Table, TableRow};
pub use tiepoint_pipeline as pipeline;
