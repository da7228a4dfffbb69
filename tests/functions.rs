//! Lengths of functions.

use syn::visit::{self, Visit};

/// The functions in a file of Rust source, also those inside others, each with the number of lines
/// between the braces of its body.
///
/// # Panics
///
/// The text cannot be parsed.
pub(crate) fn lengths(text: &str) -> Vec<(String, usize)> {
    let mut functions = Functions(Vec::new());
    functions.visit_file(&syn::parse_file(text).expect("sources can be parsed"));
    functions.0
}

struct Functions(Vec<(String, usize)>);

impl Functions {
    fn add(&mut self, name: &syn::Ident, body: &syn::Block) {
        let braces = body.brace_token.span;
        let lines = braces.close().start().line - braces.open().start().line;
        let lines = lines.saturating_sub(1);
        self.0.push((name.to_string(), lines));
    }
}

impl<'a> Visit<'a> for Functions {
    fn visit_item_fn(&mut self, item: &'a syn::ItemFn) {
        self.add(&item.sig.ident, &item.block);
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'a syn::ImplItemFn) {
        self.add(&item.sig.ident, &item.block);
        visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'a syn::TraitItemFn) {
        if let Some(body) = &item.default {
            self.add(&item.sig.ident, body);
        }
        visit::visit_trait_item_fn(self, item);
    }
}

#[test]
fn lengths_are_those_between_the_braces() {
    let text = "fn a() {\n b();\n\n fn c() {}\n}\n\
                impl D { fn e()\n where F: G {\n } }\n trait H { fn i(); fn j() { k()\n } }";
    let found = lengths(text);
    let found: Vec<_> = found.iter().map(|(name, lines)| (name.as_str(), *lines)).collect();
    assert_eq!(found, [("a", 3), ("c", 0), ("e", 0), ("j", 0)]);
}
