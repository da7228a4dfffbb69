//! Tests of dense reconstruction.

mod drive;
mod undistort;
