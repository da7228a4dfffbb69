//! Quotations of file content in messages.

use std::fmt;

/// Characters of a text that a message quotes. The file and the line are named beside the
/// quotation.
const MAX_QUOTED: usize = 48;

/// Displays the beginning of a text on one line. Control characters, which a terminal would
/// execute, are escaped.
pub(crate) struct Excerpt<'a>(pub(crate) &'a str);

impl fmt::Display for Excerpt<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for c in self.0.chars().take(MAX_QUOTED) {
            if c.is_control() { write!(f, "{}", c.escape_debug())? } else { write!(f, "{c}")? }
        }
        if self.0.chars().nth(MAX_QUOTED).is_some() { write!(f, "…") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::Excerpt;

    #[test]
    fn long_texts_are_cut_and_controls_escaped() {
        assert_eq!(Excerpt("7.5").to_string(), "7.5");
        assert_eq!(Excerpt("a\u{1b}[2J\n").to_string(), r"a\u{1b}[2J\n");
        let long = "é".repeat(10_000_000);
        assert_eq!(Excerpt(&long).to_string(), "é".repeat(48) + "…");
        assert_eq!(Excerpt(&"x".repeat(48)).to_string(), "x".repeat(48));
    }
}
