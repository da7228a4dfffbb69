//! Seeded random numbers: SplitMix64 (Steele, Lea, Flood 2014). Every task has its own stream. The
//! key of a stream names the task and not the thread, so that results do not depend on the number
//! of threads.

/// The increment of the state: 2⁶⁴ over the golden ratio, as an odd number.
const GAMMA: u64 = 0x9E37_79B9_7F4A_7C15;

/// A seeded random number generator. It is not cryptographically secure.
#[derive(Clone, Debug)]
pub struct Rng {
    state: u64,
}

impl Rng {
    /// The stream of a state. Streams of states that are multiples of the generator's increment
    /// apart are the same numbers at another place: pass a state through [`mix`] if in doubt.
    #[inline]
    pub fn from_state(state: u64) -> Self {
        Self { state }
    }

    /// The stream of (`seed`, `key`). The key names the task, for example
    /// `&[stage, image1, image2]`.
    pub fn stream(seed: u64, key: &[u64]) -> Self {
        let mut rng = Self { state: seed };
        for &part in key {
            rng.state = rng.next_u64() ^ part.wrapping_mul(GAMMA);
        }
        rng.next_u64();
        rng
    }

    /// 64 uniform bits.
    #[inline]
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GAMMA);
        mix(self.state)
    }

    /// Uniform in 0..n, for n > 0, by multiply-shift. The bias is below n / 2⁶⁴.
    #[inline]
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.next_u64()) * n as u128) >> 64) as usize
    }

    /// Uniform in [0, 1).
    #[inline]
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Standard normal (Box-Muller).
    #[inline]
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// Random permutation by the Fisher-Yates shuffle.
    pub fn shuffle<T>(&mut self, list: &mut [T]) {
        for end in (2..=list.len()).rev() {
            list.swap(end - 1, self.below(end));
        }
    }
}

/// The output function of SplitMix64: a bijection of 64 bits that changes half of them on average
/// if one changes.
#[inline]
pub fn mix(z: u64) -> u64 {
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}
