//! Lists of terms.

use tiepoint_adjust::Term;

/// The same terms, borrowed for a shorter time.
pub(crate) fn reborrow<'a>(terms: &'a mut [&mut dyn Term]) -> Vec<&'a mut dyn Term> {
    terms.iter_mut().map(|term| &mut **term as &mut dyn Term).collect()
}

/// A term, then further ones.
pub(crate) fn with_terms<'a>(
    first: &'a mut dyn Term,
    others: &'a mut [&mut dyn Term],
) -> Vec<&'a mut dyn Term> {
    let mut terms = reborrow(others);
    terms.insert(0, first);
    terms
}
