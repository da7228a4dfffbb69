//! Descriptors of any kind.

use crate::{DescriptorFormat, DescriptorKind, Error, SiftDescriptor};

/// The entries of descriptors, one descriptor behind the other.
#[derive(Clone, Debug, PartialEq)]
pub enum DescriptorEntries {
    /// Bytes.
    Bytes(Vec<u8>),
    /// 32-bit floats.
    Floats(Vec<f32>),
}

impl DescriptorEntries {
    /// Number of entries.
    pub fn len(&self) -> usize {
        match self {
            Self::Bytes(entries) => entries.len(),
            Self::Floats(entries) => entries.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// The descriptors of an image, all of the same kind and dimension.
#[derive(Clone, Debug, PartialEq)]
pub struct Descriptors {
    format: DescriptorFormat,
    entries: DescriptorEntries,
}

impl Descriptors {
    /// Descriptors from their entries.
    ///
    /// # Errors
    /// [`Error::Descriptors`] if the dimension is 0 or not that of the kind, if the kind has other
    /// entries, and if their number is no multiple of the dimension.
    pub fn new(format: DescriptorFormat, entries: DescriptorEntries) -> Result<Self, Error> {
        let has_floats = matches!(entries, DescriptorEntries::Floats(_));
        let is_valid = format.dim > 0
            && (format.kind != DescriptorKind::Sift || format == DescriptorFormat::SIFT)
            && format.kind.has_floats() == has_floats
            && entries.len().is_multiple_of(format.dim);
        if !is_valid {
            let (count, entries) = (entries.len(), if has_floats { "floats" } else { "bytes" });
            return Err(Error::Descriptors { format, count, entries });
        }
        Ok(Self { format, entries })
    }

    /// No descriptors of a format.
    pub fn none(format: DescriptorFormat) -> Self {
        let entries = match format.kind.has_floats() {
            true => DescriptorEntries::Floats(Vec::new()),
            false => DescriptorEntries::Bytes(Vec::new()),
        };
        Self { format, entries }
    }

    /// Kind and dimension.
    pub fn format(&self) -> DescriptorFormat {
        self.format
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.entries.len() / self.format.dim.max(1)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The entries, one descriptor behind the other.
    pub fn entries(&self) -> &DescriptorEntries {
        &self.entries
    }

    /// The descriptors of SIFT; `None` if they are of another kind.
    pub fn as_sift(&self) -> Option<&[SiftDescriptor]> {
        match &self.entries {
            DescriptorEntries::Bytes(bytes) if self.format == DescriptorFormat::SIFT => {
                Some(bytes.as_chunks().0)
            }
            _ => None,
        }
    }

    /// The descriptors with the given indices.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn select(&self, indices: &[usize]) -> Self {
        fn chosen<T: Copy>(entries: &[T], dim: usize, indices: &[usize]) -> Vec<T> {
            indices.iter().flat_map(|&i| &entries[i * dim..(i + 1) * dim]).copied().collect()
        }
        let dim = self.format.dim;
        let entries = match &self.entries {
            DescriptorEntries::Bytes(all) => DescriptorEntries::Bytes(chosen(all, dim, indices)),
            DescriptorEntries::Floats(all) => DescriptorEntries::Floats(chosen(all, dim, indices)),
        };
        Self { format: self.format, entries }
    }
}

/// No descriptors of SIFT.
impl Default for Descriptors {
    fn default() -> Self {
        Self::none(DescriptorFormat::SIFT)
    }
}

impl From<Vec<SiftDescriptor>> for Descriptors {
    fn from(descriptors: Vec<SiftDescriptor>) -> Self {
        let entries = DescriptorEntries::Bytes(descriptors.into_flattened());
        Self { format: DescriptorFormat::SIFT, entries }
    }
}

impl FromIterator<SiftDescriptor> for Descriptors {
    fn from_iter<I: IntoIterator<Item = SiftDescriptor>>(descriptors: I) -> Self {
        descriptors.into_iter().collect::<Vec<_>>().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_that_do_not_fit_are_refused() {
        let format = |kind, dim| DescriptorFormat { kind, dim };
        let bytes = |count| DescriptorEntries::Bytes(vec![0; count]);
        let floats = |count| DescriptorEntries::Floats(vec![0.0; count]);
        for (format, entries, number) in [
            (DescriptorFormat::SIFT, bytes(256), Some(2)),
            (format(DescriptorKind::Bytes, 32), bytes(96), Some(3)),
            (format(DescriptorKind::Floats, 64), floats(64), Some(1)),
            (format(DescriptorKind::AlikedN32, 128), floats(0), Some(0)),
            (format(DescriptorKind::Floats, 64), floats(65), None),
            (format(DescriptorKind::Floats, 64), bytes(64), None),
            (format(DescriptorKind::Bytes, 0), bytes(0), None),
            (format(DescriptorKind::Sift, 64), bytes(64), None),
            (DescriptorFormat::SIFT, floats(128), None),
        ] {
            let found = Descriptors::new(format, entries);
            assert_eq!(found.ok().map(|found| found.len()), number, "{format}");
        }
    }

    #[test]
    fn only_sift_is_borrowed_as_sift() {
        let sift: Descriptors = vec![[1; 128], [2; 128]].into();
        assert_eq!(sift.as_sift().unwrap(), [[1; 128], [2; 128]]);
        assert_eq!(sift.select(&[1, 1, 0]), [[2; 128], [2; 128], [1; 128]].into_iter().collect());
        let other = DescriptorFormat { kind: DescriptorKind::Bytes, dim: 128 };
        let other = Descriptors::new(other, sift.entries().clone()).unwrap();
        assert_eq!((other.len(), other.as_sift()), (2, None));
    }
}
