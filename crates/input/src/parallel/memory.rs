//! Memory budget for parallel work.

/// Budget where the available memory is unknown: half of a small machine's memory.
const DEFAULT_BYTES: u64 = 4 << 30;

/// Half of the memory that is available now.
pub fn budget_bytes() -> u64 {
    available_bytes().map_or(DEFAULT_BYTES, |bytes| bytes / 2)
}

/// `MemAvailable` of Linux: the memory that can be used without swapping.
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
    fn budget_is_positive() {
        assert!(budget_bytes() > 1 << 20);
        assert_eq!(available_bytes().is_some(), cfg!(target_os = "linux"));
    }
}
