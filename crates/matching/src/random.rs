//! Random streams of tasks.

use tiepoint_simd::{Rng, mix};

/// The stream of a task. It depends on the index of the task and not on the thread.
pub(crate) fn stream(seed: u64, task: u64) -> Rng {
    Rng::from_state(mix(seed).wrapping_add(Rng::from_state(task).next_u64()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shuffles_are_permutations_and_streams_differ() {
        let shuffled = |task| {
            let mut list: Vec<u32> = (0..100).collect();
            stream(7, task).shuffle(&mut list);
            list
        };
        let mut sorted = shuffled(0);
        sorted.sort_unstable();
        assert_eq!(sorted, (0..100).collect::<Vec<_>>());
        assert_eq!(shuffled(0), shuffled(0));
        assert_ne!(shuffled(0), shuffled(1));
    }
}
