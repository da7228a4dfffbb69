//! Names of images that look equal, as masks, times and positions name them.
//!
//! A name that is written as the image's counts first. Where there is none, one counts that differs
//! in what nobody sees or means: composed or decomposed accents (macOS stores `é` as two
//! characters), the case of ASCII letters, `\` for `/`, `./` at the beginning.

use std::collections::BTreeMap;

use unicode_normalization::UnicodeNormalization;

/// The form that names which look equal have in common.
pub fn normalized(name: &str) -> String {
    let slashes = name.replace('\\', "/");
    let bare = slashes.trim_start_matches("./");
    bare.nfc().map(|c| c.to_ascii_lowercase()).collect()
}

/// Values by name.
#[derive(Clone, Debug)]
pub struct ByName<T> {
    values: BTreeMap<String, T>,
    /// The names of each normalised form.
    by_form: BTreeMap<String, Vec<String>>,
}

impl<T> ByName<T> {
    /// The values of these names.
    pub fn new(values: BTreeMap<String, T>) -> Self {
        let mut by_form: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for name in values.keys() {
            by_form.entry(normalized(name)).or_default().push(name.clone());
        }
        Self { values, by_form }
    }

    /// The value of a name, or else of the only one that by_form equal.
    pub fn get(&self, name: &str) -> Option<&T> {
        self.values.get(name).or_else(|| match self.by_form.get(&normalized(name))?.as_slice() {
            [only] => self.values.get(only),
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_look_equal_are_found_where_they_are_one() {
        let names = ["a/Ge\u{308}b.JPG", "b\\1.png", "./c.png", "D.png", "d.PNG", "e.png"];
        let values = names.iter().enumerate().map(|(k, name)| ((*name).to_owned(), k)).collect();
        let found = ByName::new(values);
        assert_eq!(found.get("a/G\u{eb}b.jpg"), Some(&0));
        assert_eq!((found.get("b/1.png"), found.get("c.png")), (Some(&1), Some(&2)));
        // Of two that look equal, only the one that is written so.
        assert_eq!((found.get("D.png"), found.get("d.png")), (Some(&3), None));
        assert_eq!((found.get("E.png"), found.get("f.png")), (Some(&5), None));
    }
}
