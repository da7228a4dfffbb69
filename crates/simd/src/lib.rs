#![doc = include_str!("../README.md")]

mod rng;

pub use rng::{Rng, mix};
