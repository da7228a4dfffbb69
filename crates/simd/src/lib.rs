#![doc = include_str!("../README.md")]

mod isa;
mod rng;

pub use isa::{Isa, Level};
pub use rng::{Rng, mix};
