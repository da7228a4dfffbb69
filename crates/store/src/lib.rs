#![doc = include_str!("../README.md")]

mod atomic;
pub mod disk;
mod error;
mod hashed_file;
mod manifest;
mod named_file;
mod output_folder;
mod regular_file;
mod run_state;

pub use atomic::AtomicFile;
pub use error::{Error, Result, of_system};
pub use hashed_file::{HashedFile, open_hashed, open_unchecked};
pub use manifest::{MANIFEST, Manifest, is_inside, manifest_files};
pub use named_file::{Mark, Replace, may_be_replaced, write_file};
pub use output_folder::OutputFolder;
pub use regular_file::{escaped, irregular_kind, require_regular_file};
