//! Records of GoPro's telemetry (<https://github.com/gopro/gpmf-parser>).
//!
//! A record has a key of four letters, a type, the size of an element (one byte), the number of
//! elements (two bytes, big-endian) and the elements, padded to four bytes. A record of type 0
//! holds further records. The numbers of an element are of one type, or of those that the letters
//! of a record `TYPE` before it say, and are divided by those of a record `SCAL` before it.

/// Deepest nesting of containers that is read: stream, device, and room.
pub(super) const MAX_DEPTH: usize = 8;

/// A record.
pub(super) struct Record<'a> {
    pub(super) key: [u8; 4],
    kind: u8,
    element_len: usize,
    pub(super) content: &'a [u8],
}

/// The records in `bytes`, up to a damaged one.
pub(super) fn records(mut bytes: &[u8]) -> impl Iterator<Item = Record<'_>> {
    std::iter::from_fn(move || {
        let (head, rest) = bytes.split_first_chunk::<8>()?;
        let [k0, k1, k2, k3, kind, size, high, low] = *head;
        let len = usize::from(size) * usize::from(u16::from_be_bytes([high, low]));
        let content = rest.get(..len)?;
        bytes = rest.get(len.next_multiple_of(4)..).unwrap_or_default();
        Some(Record { key: [k0, k1, k2, k3], kind, element_len: usize::from(size), content })
    })
}

/// Calls for each record that is no container.
pub(super) fn for_each_record(bytes: &[u8], depth: usize, f: &mut impl FnMut(&Record)) {
    for record in records(bytes) {
        match record.is_container() {
            true if depth < MAX_DEPTH => for_each_record(record.content, depth + 1, f),
            true => {}
            false => f(&record),
        }
    }
}

impl Record<'_> {
    /// Whether it holds further records.
    pub(super) fn is_container(&self) -> bool {
        self.kind == 0
    }

    /// The numbers of each element, with the letters of a record `TYPE`. What is no number is NaN.
    pub(super) fn elements(&self, letters: Option<&[u8]>) -> Vec<Vec<f64>> {
        if self.element_len == 0 {
            return Vec::new();
        }
        let letters = match self.kind {
            b'?' => expanded(letters.unwrap_or_default()),
            kind => vec![kind; self.element_len / len_of(kind).max(1)],
        };
        if letters.iter().any(|letter| len_of(*letter) == 0) {
            return Vec::new();
        }
        let element = |mut bytes: &[u8]| {
            let number = |letter: &u8| {
                let (number, rest) = bytes.split_at_checked(len_of(*letter))?;
                bytes = rest;
                Some(number_of(*letter, number))
            };
            letters.iter().map_while(number).collect()
        };
        self.content.chunks_exact(self.element_len).map(element).collect()
    }

    /// All numbers.
    pub(super) fn numbers(&self) -> Vec<f64> {
        self.elements(None).concat()
    }
}

/// Most letters: an element has at most 255 bytes.
const MAX_LETTERS: usize = 255;

/// The letters of a record `TYPE`, in which `f[3]` are three.
fn expanded(letters: &[u8]) -> Vec<u8> {
    let mut expanded: Vec<u8> = Vec::new();
    let mut rest = letters;
    while let Some((&letter, after)) = rest.split_first()
        && expanded.len() <= MAX_LETTERS
    {
        rest = after;
        match letter {
            0 => {}
            b'[' => {
                let Some(end) = rest.iter().position(|byte| *byte == b']') else { break };
                let count: Option<u8> =
                    std::str::from_utf8(&rest[..end]).ok().and_then(|text| text.parse().ok());
                let (Some(count), Some(&repeated)) = (count, expanded.last()) else { break };
                let more = usize::from(count).saturating_sub(1);
                expanded.extend(std::iter::repeat_n(repeated, more));
                rest = &rest[end + 1..];
            }
            letter => expanded.push(letter),
        }
    }
    expanded
}

/// Length in bytes of a value of a type; 0 of an unknown one.
fn len_of(letter: u8) -> usize {
    match letter {
        b'b' | b'B' | b'c' => 1,
        b's' | b'S' => 2,
        b'l' | b'L' | b'f' | b'q' | b'F' => 4,
        b'j' | b'J' | b'd' | b'Q' => 8,
        b'U' | b'G' => 16,
        _ => 0,
    }
}

/// A big-endian number, whose length is that of its type.
fn number_of(letter: u8, bytes: &[u8]) -> f64 {
    let unsigned = bytes.iter().take(8).fold(0u64, |sum, byte| sum << 8 | u64::from(*byte));
    let shift = 64 - 8 * bytes.len().min(8) as u32;
    let signed = (unsigned << shift) as i64 >> shift;
    match letter {
        b'b' | b's' | b'l' | b'j' => signed as f64,
        b'B' | b'S' | b'L' | b'J' => unsigned as f64,
        b'f' => f64::from(f32::from_bits(unsigned as u32)),
        b'd' => f64::from_bits(unsigned),
        // Fixed point, with half of the bits behind the point.
        b'q' => signed as f64 / f64::from(1u32 << 16),
        b'Q' => signed as f64 / (1u64 << 32) as f64,
        _ => f64::NAN,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// The bytes of a record.
    pub(in super::super) fn record(name: &[u8; 4], kind: u8, len: u8, content: &[u8]) -> Vec<u8> {
        let count = (content.len() / usize::from(len)) as u16;
        let mut bytes = [name.as_slice(), &[kind, len], &count.to_be_bytes(), content].concat();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    }

    fn numbers_of(kind: u8, len: u8, content: &[u8]) -> Vec<f64> {
        let bytes = record(b"ABCD", kind, len, content);
        records(&bytes).flat_map(|record| record.numbers()).collect()
    }

    #[test]
    fn numbers_of_all_types_are_read() {
        assert_eq!(numbers_of(b'b', 1, &[0x80, 1]), [-128.0, 1.0]);
        assert_eq!(numbers_of(b'B', 1, &[0x80, 1]), [128.0, 1.0]);
        assert_eq!(numbers_of(b's', 4, &[0xFF, 0xFE, 0, 7]), [-2.0, 7.0]);
        assert_eq!(numbers_of(b'S', 2, &[0xFF, 0xFE]), [65534.0]);
        assert_eq!(numbers_of(b'l', 4, &(-5i32).to_be_bytes()), [-5.0]);
        assert_eq!(numbers_of(b'L', 4, &4_000_000_000u32.to_be_bytes()), [4e9]);
        assert_eq!(numbers_of(b'j', 8, &(-5i64).to_be_bytes()), [-5.0]);
        assert_eq!(numbers_of(b'J', 8, &(1u64 << 40).to_be_bytes()), [(1u64 << 40) as f64]);
        assert_eq!(numbers_of(b'f', 4, &1.5f32.to_be_bytes()), [1.5]);
        assert_eq!(numbers_of(b'd', 8, &(-0.1f64).to_be_bytes()), [-0.1]);
        assert_eq!(numbers_of(b'q', 4, &(-3i32 << 15).to_be_bytes()), [-1.5]);
        assert_eq!(numbers_of(b'Q', 8, &(5i64 << 31).to_be_bytes()), [2.5]);
        assert!(numbers_of(b'F', 4, b"SNOW")[0].is_nan());
        assert_eq!(numbers_of(b'x', 4, &[0; 4]), [0.0; 0]);
    }

    #[test]
    fn elements_of_several_types_have_the_numbers_of_their_letters() {
        let content = [&(-7i32).to_be_bytes()[..], &[0, 3], &[0, 1, 0, 2, 0, 3], &[9, 9]].concat();
        let bytes = record(b"KEYS", b'?', 14, &content);
        let found = records(&bytes).next().unwrap();
        assert_eq!(
            found.elements(Some(b"lSs[3]B[2]\0")),
            [vec![-7.0, 3.0, 1.0, 2.0, 3.0, 9.0, 9.0]]
        );
        // Of an element that ends early, those before; of an unknown letter, none.
        assert_eq!(found.elements(Some(b"lSU")), [vec![-7.0, 3.0]]);
        assert!(found.elements(Some(b"lz")).is_empty());
        assert_eq!(found.elements(None), [vec![0.0; 0]]);
        assert!(expanded(&b"f[255]".repeat(1000)).len() < 3 * MAX_LETTERS);
    }
}
