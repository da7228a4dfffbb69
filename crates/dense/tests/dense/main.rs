//! Tests of dense reconstruction.

mod undistort;
