//! Tests of the workspace as a whole: one binary, one file a subject.

#![cfg(test)]

mod architecture;
