//! SplitMix64 (Steele, Lea, Flood 2014, "Fast splittable pseudorandom number generators").

const GAMMA: u64 = 0x9E37_79B9_7F4A_7C15;

/// A seeded stream of random numbers.
pub(crate) struct SplitMix64(u64);

impl SplitMix64 {
    /// The stream of a task. It depends on the index of the task and not on the thread.
    pub(crate) fn new(seed: u64, task: u64) -> Self {
        SplitMix64(mix(seed).wrapping_add(mix(task.wrapping_add(GAMMA))))
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(GAMMA);
        mix(self.0)
    }

    /// A uniform number below `end`, for `end` > 0. The bias is below `end / 2^64`.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        ((u128::from(self.next()) * end as u128) >> 64) as usize
    }

    /// Random permutation by the Fisher-Yates shuffle.
    pub(crate) fn shuffle(&mut self, list: &mut [u32]) {
        for end in (2..=list.len()).rev() {
            list.swap(end - 1, self.below(end));
        }
    }
}

/// The output function of SplitMix64.
fn mix(z: u64) -> u64 {
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_the_reference_implementation() {
        // The first outputs of the reference implementation (Vigna, splitmix64.c) for the seed
        // 1234567.
        let mut stream = SplitMix64(1_234_567);
        assert_eq!(stream.next(), 6_457_827_717_110_365_317);
        assert_eq!(stream.next(), 3_203_168_211_198_807_973);
    }

    #[test]
    fn shuffles_are_permutations_and_streams_differ() {
        let shuffled = |task| {
            let mut list: Vec<u32> = (0..100).collect();
            SplitMix64::new(7, task).shuffle(&mut list);
            list
        };
        let mut sorted = shuffled(0);
        sorted.sort_unstable();
        assert_eq!(sorted, (0..100).collect::<Vec<_>>());
        assert_eq!(shuffled(0), shuffled(0));
        assert_ne!(shuffled(0), shuffled(1));
    }
}
