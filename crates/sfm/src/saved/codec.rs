use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::Reconstruction;

/// Bytes that are being written.
pub(crate) struct Writer<'a> {
    pub(crate) bytes: Vec<u8>,
    /// What models are differences to.
    pub(crate) scene: &'a Reconstruction,
}

/// Bytes that are still to be read.
pub(crate) struct Reader<'a> {
    pub(crate) bytes: &'a [u8],
    /// What models are differences to.
    pub(crate) scene: &'a Reconstruction,
}

/// A value that is written and read again bit for bit.
pub(crate) trait Saved: Sized {
    fn write(&self, to: &mut Writer);

    /// `None` if the bytes are no such value.
    fn read(from: &mut Reader) -> Option<Self>;
}

/// Implements [`Saved`] for a struct by its fields, or for an enum by its variants, each with its
/// first byte. The fields of an enum are named.
macro_rules! saved {
    (struct $name:ident { $($field:ident),* $(,)? }) => {
        impl $crate::saved::Saved for $name {
            fn write(&self, to: &mut $crate::saved::Writer) {
                let Self { $($field),* } = self;
                $($crate::saved::Saved::write($field, to);)*
            }
            fn read(from: &mut $crate::saved::Reader) -> Option<Self> {
                $(let $field = $crate::saved::Saved::read(from)?;)*
                Some(Self { $($field),* })
            }
        }
    };
    (enum $name:ident {
        $($tag:literal = $variant:ident $({ $($field:ident),* $(,)? })?),* $(,)?
    }) => {
        impl $crate::saved::Saved for $name {
            fn write(&self, to: &mut $crate::saved::Writer) {
                match self { $(
                    Self::$variant $({ $($field),* })? => {
                        to.bytes.push($tag);
                        $($($crate::saved::Saved::write($field, to);)*)?
                    }
                )* }
            }
            fn read(from: &mut $crate::saved::Reader) -> Option<Self> {
                match <u8 as $crate::saved::Saved>::read(from)? { $(
                    $tag => {
                        $($(let $field = $crate::saved::Saved::read(from)?;)*)?
                        Some(Self::$variant $({ $($field),* })?)
                    }
                )*
                    _ => None,
                }
            }
        }
    };
}
pub(crate) use saved;

impl<'a> Reader<'a> {
    pub(crate) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.bytes.split_at_checked(count)?;
        self.bytes = rest;
        Some(taken)
    }

    /// A number of items, each of which takes a byte at least.
    fn count(&mut self) -> Option<usize> {
        usize::read(self).filter(|count| *count <= self.bytes.len())
    }
}

macro_rules! saved_numbers {
    ($($number:ty),*) => { $(
        impl Saved for $number {
            fn write(&self, to: &mut Writer) {
                to.bytes.extend_from_slice(&self.to_le_bytes());
            }
            fn read(from: &mut Reader) -> Option<Self> {
                let bytes = from.take(size_of::<Self>())?;
                bytes.try_into().ok().map(Self::from_le_bytes)
            }
        }
    )* };
}
saved_numbers! { u8, u32, u64, f64 }

/// A count, below 2³², so that sums do not overflow.
impl Saved for usize {
    fn write(&self, to: &mut Writer) {
        (*self as u64).write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        u32::try_from(u64::read(from)?).ok().map(|count| count as Self)
    }
}

impl Saved for bool {
    fn write(&self, to: &mut Writer) {
        u8::from(*self).write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        match u8::read(from)? {
            0 => Some(false),
            1 => Some(true),
            _ => None,
        }
    }
}

impl Saved for String {
    fn write(&self, to: &mut Writer) {
        self.len().write(to);
        to.bytes.extend_from_slice(self.as_bytes());
    }

    fn read(from: &mut Reader) -> Option<Self> {
        let count = from.count()?;
        Self::from_utf8(from.take(count)?.to_vec()).ok()
    }
}

impl<T: Saved> Saved for Option<T> {
    fn write(&self, to: &mut Writer) {
        self.is_some().write(to);
        self.iter().for_each(|value| value.write(to));
    }

    fn read(from: &mut Reader) -> Option<Self> {
        if bool::read(from)? { T::read(from).map(Some) } else { Some(None) }
    }
}

/// Writes a list as the `Vec` that is read.
pub(crate) fn write_list<T: Saved>(values: &[T], to: &mut Writer) {
    values.len().write(to);
    values.iter().for_each(|value| value.write(to));
}

impl<T: Saved> Saved for Box<T> {
    fn write(&self, to: &mut Writer) {
        (**self).write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        T::read(from).map(Self::new)
    }
}

impl<T: Saved> Saved for Vec<T> {
    fn write(&self, to: &mut Writer) {
        write_list(self, to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        let count = from.count()?;
        (0..count).map(|_| T::read(from)).collect()
    }
}

impl<T: Saved + Ord> Saved for BTreeSet<T> {
    fn write(&self, to: &mut Writer) {
        self.len().write(to);
        self.iter().for_each(|value| value.write(to));
    }

    fn read(from: &mut Reader) -> Option<Self> {
        Vec::read(from).map(|values: Vec<T>| values.into_iter().collect())
    }
}

impl<K: Saved + Ord, V: Saved> Saved for BTreeMap<K, V> {
    fn write(&self, to: &mut Writer) {
        self.len().write(to);
        for (key, value) in self {
            key.write(to);
            value.write(to);
        }
    }

    fn read(from: &mut Reader) -> Option<Self> {
        Vec::read(from).map(|entries: Vec<(K, V)>| entries.into_iter().collect())
    }
}

impl<A: Saved, B: Saved> Saved for (A, B) {
    fn write(&self, to: &mut Writer) {
        self.0.write(to);
        self.1.write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        Some((A::read(from)?, B::read(from)?))
    }
}
