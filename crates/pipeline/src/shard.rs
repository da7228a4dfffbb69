use std::fmt;
use std::str::FromStr;

/// Most shards of a stage: more than that have less than a second of work.
const MAX_SHARDS: usize = 100_000;

/// One of several parts of a stage. Its text form is `2/8`: the second of eight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shard {
    /// From 1 to `count`.
    pub(crate) number: usize,
    pub(crate) count: usize,
}

impl Shard {
    /// All shards of a number of them.
    pub(crate) fn all(count: usize) -> impl Iterator<Item = Self> {
        (1..=count).map(move |number| Self { number, count })
    }

    /// The part of `total` tasks that it has, in their order. Those of all shards differ by one
    /// task at most.
    pub(crate) fn range(self, total: usize) -> std::ops::Range<usize> {
        let bound = |number: usize| (total as u128 * number as u128 / self.count as u128) as usize;
        bound(self.number - 1)..bound(self.number)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |digits: &str| -> Option<usize> {
            let is_plain = digits.bytes().all(|byte| byte.is_ascii_digit());
            digits.parse().ok().filter(|number| is_plain && (1..=MAX_SHARDS).contains(number))
        };
        let numbers = text.split_once('/');
        let numbers = numbers.and_then(|(a, b)| Some((number(a)?, number(b)?)));
        numbers
            .filter(|(number, count)| number <= count)
            .map(|(number, count)| Self { number, count })
            .ok_or_else(|| {
                format!("expected i/n with i from 1 to n, and n up to {MAX_SHARDS}, as 2/8")
            })
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_have_every_task_once() {
        for (total, count) in [(0, 3), (1, 4), (10, 3), (9, 9), (1000, 7)] {
            let shards = Shard::all(count);
            let all: Vec<usize> = shards.flat_map(|shard| shard.range(total)).collect();
            assert_eq!(all, (0..total).collect::<Vec<_>>());
        }
    }

    #[test]
    fn texts_round_trip_and_others_are_refused() {
        assert_eq!("2/8".parse::<Shard>().unwrap().to_string(), "2/8");
        for text in ["", "2", "0/3", "4/3", "+1/3", "1/3/4", "1/100001", "a/b"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }
}
