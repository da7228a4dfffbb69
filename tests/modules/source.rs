//! The declarations, imports and paths of a module, as syn parses them. Code for tests is left out.

use std::collections::{BTreeMap, BTreeSet};

use proc_macro2::{Ident, Punct, Spacing, TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, UseTree};

/// The segments of a path. One that begins with `::` has an empty first segment.
pub(super) type Path = Vec<String>;

/// A name that a `use` declaration imports.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Import {
    pub(super) path: Path,
    /// `*` for a glob import.
    pub(super) name: String,
    pub(super) line: usize,
}

/// The content of a module, in a file of its own or inline.
#[derive(Default)]
pub(super) struct Source {
    /// Modules inside, without a content if they have files of their own.
    pub(super) modules: Vec<(String, Option<Source>)>,
    pub(super) imports: Vec<Import>,
    /// Names of types, functions and other items.
    pub(super) items: BTreeSet<String>,
    /// Names of `macro_rules!` with `#[macro_export]`.
    pub(super) exported_macros: Vec<String>,
    /// Whether a macro is called in place of an item, which may define any name.
    pub(super) calls_macros: bool,
    /// Paths outside imports, also single names, with the line of the first occurrence.
    pub(super) paths: BTreeMap<Path, usize>,
}

/// Parses a file.
pub(super) fn read(text: &str) -> syn::Result<Source> {
    let mut source = Source::default();
    source.visit_file(&syn::parse_file(text)?);
    Ok(source)
}

fn text(ident: &Ident) -> String {
    ident.to_string().trim_start_matches("r#").to_owned()
}

/// Whether an attribute marks code for tests: `cfg(test)`, `cfg(all(test, …))`.
fn is_for_tests(attributes: &[Attribute]) -> bool {
    let mut conditions = attributes.iter().filter(|attribute| attribute.path().is_ident("cfg"));
    conditions.any(|condition| {
        let syn::Meta::List(list) = &condition.meta else { return false };
        let tokens = list.tokens.to_string().replace(' ', "");
        let mut words = tokens.split(['(', ')', ',']);
        words.any(|word| word == "test")
            && ["not(test", "any("].iter().all(|other| !tokens.contains(other))
    })
}

impl Source {
    fn add_imports(&mut self, tree: &UseTree, prefix: &mut Path) {
        let (ident, name) = match tree {
            UseTree::Path(path) => {
                prefix.push(text(&path.ident));
                self.add_imports(&path.tree, prefix);
                prefix.pop();
                return;
            }
            UseTree::Group(group) => {
                return group.items.iter().for_each(|tree| self.add_imports(tree, prefix));
            }
            UseTree::Glob(glob) => {
                let line = glob.star_token.span.start().line;
                let (path, name) = (prefix.clone(), "*".to_owned());
                return self.imports.push(Import { path, name, line });
            }
            UseTree::Name(name) => (&name.ident, &name.ident),
            UseTree::Rename(rename) => (&rename.ident, &rename.rename),
        };
        let mut path = prefix.clone();
        // `a::{self}` is `a`.
        if ident != "self" || path.is_empty() {
            path.push(text(ident));
        }
        let name = if name == "self" { path[path.len() - 1].clone() } else { text(name) };
        self.imports.push(Import { path, name, line: ident.span().start().line });
    }

    /// The paths in what a macro is given, or expands to.
    fn add_tokens(&mut self, tokens: TokenStream) {
        let (mut path, mut line, mut colons) = (Path::new(), 0, 0);
        // A token that is in no path ends the last one.
        let end: TokenTree = Punct::new(';', Spacing::Alone).into();
        for token in tokens.into_iter().chain([end]) {
            let is_colon = matches!(&token, TokenTree::Punct(mark) if mark.as_char() == ':');
            if is_colon {
                colons += 1;
                continue;
            }
            let continues = colons == 2 && matches!(token, TokenTree::Ident(_));
            if !continues && !path.is_empty() {
                self.paths.entry(std::mem::take(&mut path)).or_insert(line);
            }
            match token {
                // A path after `::` without a name before it is that of another crate, or an item
                // of a generic type.
                TokenTree::Ident(name) if !continues || !path.is_empty() => {
                    line = if continues { line } else { name.span().start().line };
                    path.push(text(&name));
                }
                TokenTree::Group(group) => self.add_tokens(group.stream()),
                _ => {}
            }
            colons = 0;
        }
    }
}

/// Visits nodes that are not for tests, and adds the names of those that are items.
macro_rules! visit_unless_for_tests {
    ($($visit:ident $Node:ident $(($($name:ident).+))?;)*) => {$(
        fn $visit(&mut self, node: &'a syn::$Node) {
            if !is_for_tests(&node.attrs) {
                $(self.items.insert(text(&node.$($name).+));)?
                visit::$visit(self, node);
            }
        }
    )*};
}

impl<'a> Visit<'a> for Source {
    visit_unless_for_tests! {
        visit_item_const ItemConst (ident);
        visit_item_enum ItemEnum (ident);
        visit_item_fn ItemFn (sig.ident);
        visit_item_impl ItemImpl;
        visit_item_static ItemStatic (ident);
        visit_item_struct ItemStruct (ident);
        visit_item_trait ItemTrait (ident);
        visit_item_type ItemType (ident);
        visit_item_union ItemUnion (ident);
        visit_impl_item_const ImplItemConst;
        visit_impl_item_fn ImplItemFn;
        visit_field Field;
        visit_variant Variant;
        visit_field_value FieldValue;
        visit_arm Arm;
        visit_local Local;
        visit_expr_if ExprIf;
        visit_expr_block ExprBlock;
    }

    fn visit_item_mod(&mut self, item: &'a syn::ItemMod) {
        if !is_for_tests(&item.attrs) {
            let inner = item.content.as_ref().map(|(_, items)| {
                let mut source = Source::default();
                items.iter().for_each(|item| source.visit_item(item));
                source
            });
            self.modules.push((text(&item.ident), inner));
        }
    }

    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        if !is_for_tests(&item.attrs) {
            // `::name` is another crate, whatever this one holds.
            let mut prefix = item.leading_colon.iter().map(|_| String::new()).collect();
            self.add_imports(&item.tree, &mut prefix);
        }
    }

    fn visit_item_macro(&mut self, item: &'a syn::ItemMacro) {
        if is_for_tests(&item.attrs) {
            return;
        }
        let is_exported = item.attrs.iter().any(|it| it.path().is_ident("macro_export"));
        match &item.ident {
            Some(name) if is_exported => self.exported_macros.push(text(name)),
            Some(name) => _ = self.items.insert(text(name)),
            None => self.calls_macros = true,
        }
        self.visit_macro(&item.mac);
    }

    fn visit_path(&mut self, path: &'a syn::Path) {
        // `::a` is another crate, and `<T>::a` an item of a type.
        if path.leading_colon.is_none() {
            let line = path.segments[0].ident.span().start().line;
            let segments = path.segments.iter().map(|segment| text(&segment.ident));
            self.paths.entry(segments.collect()).or_insert(line);
        }
        visit::visit_path(self, path);
    }

    /// A pattern may be the name of a constant.
    fn visit_pat_ident(&mut self, pattern: &'a syn::PatIdent) {
        let line = pattern.ident.span().start().line;
        self.paths.entry(vec![text(&pattern.ident)]).or_insert(line);
        visit::visit_pat_ident(self, pattern);
    }

    fn visit_token_stream(&mut self, tokens: &'a TokenStream) {
        self.add_tokens(tokens.clone());
    }

    /// The links in documentation are no dependencies.
    fn visit_attribute(&mut self, _: &'a Attribute) {}

    /// `pub(in super::super)` is no dependency.
    fn visit_vis_restricted(&mut self, _: &'a syn::VisRestricted) {}
}

#[test]
fn nested_imports_are_parsed() {
    let source = read(
        "use crate::a::{self, b::{C as D, e}, f::*};\n pub(crate) use super::super::g;\n use \
        ::std::h;\n use self::i as _;",
    );
    let shown = |import: &Import| format!("{} {}", import.path.join("::"), import.name);
    let found: Vec<_> = source.unwrap().imports.iter().map(shown).collect();
    assert_eq!(
        found,
        [
            "crate::a a",
            "crate::a::b::C D",
            "crate::a::b::e e",
            "crate::a::f *",
            "super::super::g g",
            "::std::h h",
            "self::i _",
        ]
    );
}

#[test]
fn code_for_tests_is_left_out() {
    let source = read(
        "#[cfg(test)] mod tests; #[cfg(test)] mod more { use crate::a; }\n\
         #[cfg(test)] #[allow(x)] pub(crate) fn f<A, B>(x: [A; 2]) -> B { crate::b::c() }\n\
         #[cfg(not(test))] fn g() { crate::d::e(); #[cfg(test)] if h { crate::f::g() } \
         crate::h::i() }\n\
         #[cfg(all(test, unix))] use crate::{j, k};\n\
         struct S { #[cfg(test)] pub(crate) a: crate::l::M, b: crate::n::O }\n\
         mod inner { pub(in super::super) const P: u8 = super::q::R; }\n\
         m! { /* crate::s */ \"crate::t\" crate::u::<crate::v>::w [::x, crate :: y!(z)] }",
    )
    .unwrap();
    let paths = |source: &Source| -> Vec<String> {
        source.paths.keys().filter(|it| it.len() > 1).map(|it| it.join("::")).collect()
    };
    let found = ["crate::d::e", "crate::h::i", "crate::n::O", "crate::u", "crate::v", "crate::y"];
    assert_eq!(paths(&source), found);
    let (_, Some(inner)) = &source.modules[0] else { panic!("it is inline") };
    assert_eq!(paths(inner), ["super::q::R"]);
    assert!(source.modules.len() == 1 && source.imports.is_empty() && source.calls_macros);
    assert_eq!(source.items, BTreeSet::from(["g", "S"].map(str::to_owned)));
    assert_eq!(inner.items, BTreeSet::from(["P".to_owned()]));
}
