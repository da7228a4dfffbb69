//! The order and the instant of images by their names.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

/// Compares names as people count: numbers in them by value, so that `2.png` is before `10.png`.
/// Names with numbers of equal length are in byte order.
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut rest_a, mut rest_b) = (a.as_bytes(), b.as_bytes());
    while let (Some(&first_a), Some(&first_b)) = (rest_a.first(), rest_b.first()) {
        let order = if first_a.is_ascii_digit() && first_b.is_ascii_digit() {
            let (number_a, number_b) = (take_number(&mut rest_a), take_number(&mut rest_b));
            number_a.len().cmp(&number_b.len()).then_with(|| number_a.cmp(number_b))
        } else {
            (rest_a, rest_b) = (&rest_a[1..], &rest_b[1..]);
            first_a.cmp(&first_b)
        };
        if order != Ordering::Equal {
            return order;
        }
    }
    rest_a.len().cmp(&rest_b.len()).then_with(|| a.cmp(b))
}

/// Takes the digits at the beginning; returns them without leading zeros.
fn take_number<'a>(rest: &mut &'a [u8]) -> &'a [u8] {
    let end = rest.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(rest.len());
    let (digits, after) = rest.split_at(end);
    *rest = after;
    let zeros = digits.iter().take_while(|digit| **digit == b'0').count();
    &digits[zeros..]
}

/// The file name without folders and extension.
fn stem(name: &str) -> &str {
    let file = file_name(name);
    file.rsplit_once('.').map_or(file, |(stem, _)| stem)
}

fn file_name(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// The numbers in a file name, without leading zeros.
fn numbers(name: &str) -> Vec<&[u8]> {
    let mut rest = stem(name).as_bytes();
    let mut found = Vec::new();
    while let Some(start) = rest.iter().position(u8::is_ascii_digit) {
        rest = &rest[start..];
        found.push(take_number(&mut rest));
    }
    found
}

/// Pairs the images of one instant of two cameras by their names, as indices: those with the same
/// file name, or else those with the same number, where all names of a camera have as many numbers,
/// and all that vary or one of them tell its images apart (`left_0001` and `right_0001`,
/// `LeftRun1_7` and `RightRun1_7`). In natural order of the names of the first camera.
pub fn pairs_by_name(references: &[&str], others: &[&str]) -> Vec<(usize, usize)> {
    let files = |names: &[&str]| -> Vec<Vec<u8>> {
        names.iter().map(|name| file_name(name).as_bytes().to_vec()).collect()
    };
    let mut pairs = equal(&files(references), &files(others));
    if pairs.is_empty() {
        let of_others = number_keys(others);
        for a in number_keys(references) {
            for b in &of_others {
                let found = equal(&a, b);
                if found.len() > pairs.len() {
                    pairs = found;
                }
            }
        }
    }
    pairs.sort_by(|a, b| natural_order(file_name(references[a.0]), file_name(references[b.0])));
    pairs
}

/// The digits of the numbers in a name.
type Numbers<'a> = Vec<&'a [u8]>;

/// The numbers in each name, and the places of those that vary from name to name; `None` without a
/// name, or if names have different counts of numbers.
fn varying_numbers<'a>(names: &[&'a str]) -> Option<(Vec<Numbers<'a>>, Vec<usize>)> {
    let of_names: Vec<Numbers> = names.iter().map(|name| numbers(name)).collect();
    let first = of_names.first()?;
    if of_names.iter().any(|numbers| numbers.len() != first.len()) {
        return None;
    }
    let varies = |field: &usize| of_names.iter().any(|numbers| numbers[*field] != first[*field]);
    let varying = (0..first.len()).filter(varies).collect();
    Some((of_names, varying))
}

/// The numbers of the frames of one stream, from their file names; `None` if not exactly one number
/// varies from name to name, or two names have the same one.
pub(crate) fn frame_numbers(names: &[&str]) -> Option<Vec<f64>> {
    let (of_names, varying) = varying_numbers(names)?;
    let [field] = varying[..] else { return None };
    let value = |numbers: &Vec<&[u8]>| {
        let digits = numbers[field].iter().map(|digit| f64::from(digit - b'0'));
        digits.fold(0.0, |value, digit| 10.0 * value + digit)
    };
    let values: Vec<f64> = of_names.iter().map(value).collect();
    let unique: BTreeSet<u64> = values.iter().map(|value| value.to_bits()).collect();
    (unique.len() == values.len()).then_some(values)
}

/// Keys of the images of a camera from the numbers in their names: all numbers that vary, and each
/// of them. A list in which two images have the same key is empty.
fn number_keys(names: &[&str]) -> Vec<Vec<Vec<u8>>> {
    let Some((of_names, varying)) = varying_numbers(names) else { return Vec::new() };
    let single = varying.iter().map(|&field| vec![field]);
    let choices = [varying.clone()].into_iter().chain(single);
    choices
        .map(|fields| {
            let key = |numbers: &Vec<&[u8]>| -> Vec<u8> {
                fields.iter().map(|&field| numbers[field]).collect::<Vec<_>>().join(&b' ')
            };
            let keys: Vec<Vec<u8>> = of_names.iter().map(key).collect();
            let is_unique = keys.iter().collect::<BTreeSet<_>>().len() == keys.len();
            if is_unique && !fields.is_empty() { keys } else { Vec::new() }
        })
        .collect()
}

/// Indices of equal keys.
fn equal(references: &[Vec<u8>], others: &[Vec<u8>]) -> Vec<(usize, usize)> {
    let index_of: BTreeMap<&Vec<u8>, usize> =
        others.iter().enumerate().map(|(index, key)| (key, index)).collect();
    let pair = |(index, key)| Some((index, *index_of.get(key)?));
    references.iter().enumerate().filter_map(pair).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_have_the_one_number_that_varies() {
        let numbers = |names: &[&str]| frame_numbers(names);
        assert_eq!(numbers(&["a/cam1_000.png", "a/cam1_010.png"]), Some(vec![0.0, 10.0]));
        assert_eq!(numbers(&["3.jpg", "20.png", "100.png"]), Some(vec![3.0, 20.0, 100.0]));
        for unnumbered in [&["1_2.png", "2_3.png"][..], &["a.png", "b.png"], &["1.png", "1.jpg"]] {
            assert_eq!(numbers(unnumbered), None, "{unnumbered:?}");
        }
        assert_eq!(numbers(&["1.png", "x.png"]), None);
        assert_eq!(numbers(&[]), None);
    }

    #[test]
    fn numbers_count_by_value() {
        let mut names = ["b/10.png", "b/2.png", "b/a1.png", "b/1.png", "b/02.png", "a/3b.png"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["a/3b.png", "b/1.png", "b/02.png", "b/2.png", "b/10.png", "b/a1.png"]);
        // Longer than any integer.
        let long = ["9".repeat(40), "1".to_owned() + &"0".repeat(40)];
        assert_eq!(natural_order(&long[0], &long[1]), Ordering::Less);
        assert_eq!(natural_order("a", "a"), Ordering::Equal);
    }

    #[test]
    fn names_of_cameras_have_the_number_of_the_frame() {
        type Named = fn(usize) -> String;
        let cameras: [(Named, Named); 7] = [
            (|k| format!("left/{k:06}.png"), |k| format!("right/{k:06}.png")),
            (|k| format!("left/left_{k:04}.png"), |k| format!("right/right_{k:04}.jpg")),
            (|k| format!("a/cam0_{k}.png"), |k| format!("b/cam1_{k}.png")),
            (|k| format!("l/LeftRun1_{k}.png"), |k| format!("r/RightRun1_{k:03}.png")),
            (|k| format!("l/{k:04}_cam0.png"), |k| format!("r/{k:04}_cam1.png")),
            // The clock of each camera beside the number.
            (|k| format!("l/{k}_{}.png", 1000 + 7 * k), |k| format!("r/{k}_{}.png", 1003 + 7 * k)),
            (
                |k| format!("l/run{}_{}.png", k / 5, k % 5),
                |k| format!("r/r{}_{}.png", k / 5, k % 5),
            ),
        ];
        for (reference, other) in cameras {
            // The other camera misses frame 3; the order of neither is that of the frames.
            let references: Vec<String> = (0..12).rev().map(reference).collect();
            let others: Vec<String> = (0..12).filter(|k| *k != 3).map(other).collect();
            let of = |names: &[String]| {
                pairs_by_name(
                    &names.iter().map(String::as_str).collect::<Vec<_>>(),
                    &others.iter().map(String::as_str).collect::<Vec<_>>(),
                )
            };
            let pairs = of(&references);
            let expected: Vec<(usize, usize)> =
                (0..12).filter(|k| *k != 3).enumerate().map(|(at, k)| (11 - k, at)).collect();
            assert_eq!(pairs, expected, "{}", references[0]);
        }
    }

    #[test]
    fn names_without_a_common_number_are_of_no_instant() {
        for others in [
            &["r/9.png", "r/10.png"][..],
            &["r/a.png", "r/b.png"],
            &["r/1_a.png", "r/1_b.png"],
            &["r/1.png", "r/2_3.png"],
            &[],
        ] {
            assert!(pairs_by_name(&["l/x1.png", "l/x2.png"], others).is_empty(), "{others:?}");
        }
        // One image: no number varies.
        assert!(pairs_by_name(&["l/x1.png"], &["r/y1.png"]).is_empty());
        // Equal names count alone.
        assert_eq!(pairs_by_name(&["l/1.png", "l/2.png"], &["r/1.png", "r/2.jpg"]), [(0, 0)]);
    }
}
