//! Parallel work within a memory budget, in order.

mod memory;
mod ordered;

pub use memory::budget_bytes;
pub use ordered::{for_each_in_order, for_each_within_budget};
