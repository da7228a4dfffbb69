//! Values as bytes, bit for bit: what a checkpoint of the mapper is made of.
//!
//! Whoever sent a folder may have written its checkpoint. Reading therefore fails, with `None`,
//! where the bytes end early, an id is not one of the scene, or a model is not consistent.

mod codec;
mod model;
mod scene_types;

pub(crate) use codec::{Reader, Saved, Writer, saved, write_list};
