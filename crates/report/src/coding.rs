//! Encoding of data in `report.html`: base64 text, and even samples of long lists.

/// RFC 4648, with padding.
pub(super) fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let bits =
            (0..3).fold(0u32, |bits, k| bits << 8 | u32::from(chunk.get(k).copied().unwrap_or(0)));
        for k in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * k) & 63) as usize];
            text.push(if k <= chunk.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

/// Whether an index is among `kept` of `count` indices, evenly; among all if there are fewer.
pub(super) fn evenly(count: usize, kept: usize) -> impl Fn(usize) -> bool {
    let part = move |index: usize| index as u64 * kept.min(count) as u64 / count.max(1) as u64;
    move |index| part(index) != part(index + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_rfc_4648() {
        for (plain, coded) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xbf]), "+/+/");
    }

    #[test]
    fn samples_are_even_and_have_the_wanted_size() {
        for (count, kept) in [(10, 3), (10, 10), (7, 20), (0, 5), (5, 0), (100, 99)] {
            let is_kept = evenly(count, kept);
            let found: Vec<usize> = (0..count).filter(|index| is_kept(*index)).collect();
            assert_eq!(found.len(), kept.min(count), "{count} {kept}");
            let most = count.div_ceil(kept.max(1));
            assert!(found.windows(2).all(|pair| pair[1] - pair[0] <= most), "{found:?}");
        }
    }
}
