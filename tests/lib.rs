//! Tests of the workspace as a whole: one binary, one file a subject.

#![cfg(test)]
#![allow(clippy::unwrap_used)]

mod architecture;
mod lines;
mod modules;
mod pipeline;
mod skipped;
