//! How much memory may be used at once for what can wait.

/// What is taken where the system does not tell: half of a small machine's.
const UNKNOWN_BYTES: u64 = 4 << 30;

/// Half of the memory that is free now: the rest is for what else grows.
pub(crate) fn budget_bytes() -> u64 {
    available_bytes().map_or(UNKNOWN_BYTES, |bytes| bytes / 2)
}

/// What Linux reckons can be used without swapping.
fn available_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1 << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_some() {
        assert!(budget_bytes() > 1 << 20);
        assert_eq!(available_bytes().is_some(), cfg!(target_os = "linux"));
    }
}
