//! Tests of the whole workspace in one binary, one file per subject.

#![cfg(test)]
#![allow(clippy::unwrap_used)]

mod architecture;
mod flags;
mod functions;
mod lines;
mod metadata;
mod modules;
mod pipeline;
mod skipped;
