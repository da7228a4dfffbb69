//! A parser for the declarations, imports and paths in a file of Rust source.

use super::tokens::{Kind, Token, tokens};

/// A path in the source, with the line on which it begins.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Path {
    pub(super) segments: Vec<String>,
    pub(super) line: usize,
}

/// A name that a `use` declaration imports.
#[derive(Clone, Debug)]
pub(super) struct Import {
    pub(super) path: Path,
    /// `*` for a glob import.
    pub(super) name: String,
}

/// The content of a module, in a file of its own or inline.
#[derive(Debug, Default)]
pub(super) struct Source {
    /// `mod name;`
    pub(super) files: Vec<String>,
    /// `mod name { … }`
    pub(super) inline: Vec<(String, Source)>,
    pub(super) imports: Vec<Import>,
    /// Names of types, functions and other items.
    pub(super) items: Vec<String>,
    /// Names of `macro_rules!` with `#[macro_export]`.
    pub(super) exported_macros: Vec<String>,
    /// Whether a macro is called at module level, which may define any name.
    pub(super) calls_macros: bool,
    /// Paths outside imports.
    pub(super) paths: Vec<Path>,
    /// All words with their lines, which may be names of glob imports.
    pub(super) words: Vec<(String, usize)>,
}

/// Keywords before the name of an item.
const ITEMS: [&str; 9] =
    ["struct", "enum", "union", "trait", "fn", "const", "static", "type", "macro_rules"];
/// Other keywords that an item may begin with.
const ITEM_STARTS: [&str; 6] = ["mod", "use", "impl", "unsafe", "extern", "async"];

/// Parses a file. Code for tests is left out.
pub(super) fn read(text: &str) -> Source {
    let tokens = tokens(text);
    let mut reader = Reader { tokens: &tokens, at: 0 };
    let source = reader.module();
    assert_eq!(reader.at, tokens.len(), "line {:?}: an unmatched bracket", reader.line());
    source
}

struct Reader<'a> {
    tokens: &'a [Token<'a>],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Kind of the token `ahead` tokens after the next one.
    fn peek(&self, ahead: usize) -> Option<Kind<'a>> {
        self.tokens.get(self.at + ahead).map(|token| token.kind)
    }

    /// Line of the next token, or of the last one at the end of the file.
    fn line(&self) -> usize {
        self.tokens.get(self.at).or(self.tokens.last()).map_or(0, |token| token.line)
    }

    fn word(&self, ahead: usize) -> Option<&'a str> {
        match self.peek(ahead) {
            Some(Kind::Word(word)) => Some(word),
            _ => None,
        }
    }

    fn is(&self, ahead: usize, character: char) -> bool {
        self.peek(ahead) == Some(Kind::Punctuation(character))
    }

    /// Skips the next token if it is this character.
    fn take(&mut self, character: char) -> bool {
        let is_there = self.is(0, character);
        self.at += usize::from(is_there);
        is_there
    }

    /// Parses to the end of the file or the module.
    fn module(&mut self) -> Source {
        let mut source = Source::default();
        let mut depth = 0;
        let mut exports_macro = false;
        while let Some(kind) = self.peek(0) {
            match kind {
                Kind::Punctuation('#')
                    if self.is(1, '[') || (self.is(1, '!') && self.is(2, '[')) =>
                {
                    let words = self.attribute();
                    exports_macro |= words.contains(&"macro_export");
                    if is_for_tests(&words) {
                        self.skip_item();
                    }
                }
                Kind::Punctuation(open @ ('{' | '(' | '[')) => {
                    let after_bang =
                        self.at > 0 && self.tokens[self.at - 1].kind == Kind::Punctuation('!');
                    source.calls_macros |= depth == 0 && after_bang && open != '[';
                    depth += 1;
                    self.at += 1;
                }
                Kind::Punctuation('}' | ')' | ']') if depth == 0 => return source,
                Kind::Punctuation('}' | ')' | ']') => {
                    depth -= 1;
                    self.at += 1;
                }
                Kind::Word("pub") if self.is(1, '(') => {
                    // `pub(in super::super)` is no dependency.
                    self.at += 1;
                    self.skip_group();
                }
                Kind::Word("mod") if self.word(1).is_some() => self.submodule(&mut source),
                Kind::Word("use") if !self.is(1, '<') => {
                    self.at += 1;
                    self.imports(&mut Vec::new(), &mut source.imports);
                    assert!(self.take(';'), "line {}: an import that does not end", self.line());
                }
                Kind::Word(word) => {
                    if depth == 0 && ITEMS.contains(&word) {
                        let name =
                            (1..3).find_map(|ahead| self.word(ahead).filter(|name| *name != "mut"));
                        let names = if exports_macro && word == "macro_rules" {
                            &mut source.exported_macros
                        } else {
                            &mut source.items
                        };
                        names.extend(name.map(str::to_owned));
                        exports_macro = false;
                    }
                    self.path(&mut source);
                }
                _ => self.at += 1,
            }
        }
        source
    }

    /// Skips an attribute `#[…]` and returns its words.
    fn attribute(&mut self) -> Vec<&'a str> {
        self.at += if self.is(1, '!') { 2 } else { 1 };
        let from = self.at;
        self.skip_group();
        let words = self.tokens[from..self.at].iter().filter_map(|token| match token.kind {
            Kind::Word(word) => Some(word),
            _ => None,
        });
        words.collect()
    }

    /// Skips from an opening bracket to behind the matching closing one.
    fn skip_group(&mut self) {
        let mut depth = 0;
        while let Some(kind) = self.peek(0) {
            depth += match kind {
                Kind::Punctuation('{' | '(' | '[') => 1,
                Kind::Punctuation('}' | ')' | ']') => -1,
                _ => 0,
            };
            self.at += 1;
            if depth == 0 {
                return;
            }
        }
    }

    /// Skips an item or statement, or a field, argument or match arm, which may end with a comma.
    fn skip_item(&mut self) {
        while self.is(0, '#') {
            self.attribute();
        }
        if self.word(0) == Some("pub") {
            self.at += 1;
            if self.is(0, '(') {
                self.skip_group();
            }
        }
        let is_item =
            self.word(0).is_some_and(|word| ITEMS.contains(&word) || ITEM_STARTS.contains(&word));
        let is_import = self.word(0) == Some("use");
        while let Some(kind) = self.peek(0) {
            match kind {
                Kind::Punctuation('}' | ')' | ']') => return,
                Kind::Punctuation('{') => {
                    self.skip_group();
                    if !is_import {
                        // `= [const { … }, …];`
                        self.take(';');
                        return;
                    }
                }
                Kind::Punctuation('(' | '[') => self.skip_group(),
                Kind::Punctuation(';') => {
                    self.at += 1;
                    return;
                }
                Kind::Punctuation(',') if !is_item => {
                    self.at += 1;
                    return;
                }
                _ => self.at += 1,
            }
        }
    }

    fn submodule(&mut self, source: &mut Source) {
        let name = self.word(1).expect("a name was seen").to_owned();
        self.at += 2;
        if self.take(';') {
            source.files.push(name);
        } else {
            assert!(
                self.take('{'),
                "line {}: mod {name} has neither a file nor a body",
                self.line()
            );
            let inner = self.module();
            assert!(self.take('}'), "line {}: mod {name} does not end", self.line());
            source.inline.push((name, inner));
        }
    }

    /// Parses a tree of imports below `prefix`.
    fn imports(&mut self, prefix: &mut Vec<String>, into: &mut Vec<Import>) {
        let (depth, line) = (prefix.len(), self.line());
        if self.peek(0) == Some(Kind::Colons) {
            // `::name` is another crate, whatever this one holds.
            prefix.push(String::new());
            self.at += 1;
        }
        loop {
            if self.take('{') {
                while !self.take('}') {
                    self.imports(prefix, into);
                    self.take(',');
                }
                break;
            }
            let name = if self.take('*') {
                "*".to_owned()
            } else {
                let word =
                    self.word(0).unwrap_or_else(|| panic!("line {line}: an import without a name"));
                self.at += 1;
                // `a::{self}` is `a`.
                if word != "self" || prefix.is_empty() {
                    prefix.push(word.to_owned());
                }
                if self.peek(0) == Some(Kind::Colons) {
                    self.at += 1;
                    continue;
                }
                let renamed = (self.word(0) == Some("as")).then(|| self.word(1)).flatten();
                self.at += if renamed.is_some() { 2 } else { 0 };
                renamed.unwrap_or(prefix.last().expect("a name was pushed")).to_owned()
            };
            into.push(Import { path: Path { segments: prefix.clone(), line }, name });
            break;
        }
        prefix.truncate(depth);
    }

    /// Parses a word and the path that it begins.
    fn path(&mut self, source: &mut Source) {
        let line = self.line();
        let continues = self.at > 0 && self.tokens[self.at - 1].kind == Kind::Colons;
        let mut segments = Vec::new();
        while let Some(word) = self.word(0) {
            source.words.push((word.to_owned(), line));
            segments.push(word.to_owned());
            self.at += 1;
            if self.peek(0) != Some(Kind::Colons) || self.word(1).is_none() {
                break;
            }
            self.at += 1;
        }
        // A path after `::` without a name before it is that of another crate, or an item of a
        // generic type.
        if segments.len() > 1 && !continues {
            source.paths.push(Path { segments, line });
        }
    }
}

/// Whether an attribute marks code for tests: `cfg(test)`, `cfg(all(test, …))`.
fn is_for_tests(words: &[&str]) -> bool {
    words.first() == Some(&"cfg")
        && words
            .iter()
            .zip(words.iter().skip(1))
            .any(|(before, word)| *word == "test" && *before != "not")
        && !words.contains(&"any")
}

#[test]
fn nested_imports_are_parsed() {
    let source = read(
        "use crate::a::{self, b::{C as D, e}, f::*};\n pub(crate) use super::super::g;\n use \
        ::std::h;\n \
         use self::i as _;",
    );
    let shown = |import: &Import| format!("{} {}", import.path.segments.join("::"), import.name);
    let found: Vec<_> = source.imports.iter().map(shown).collect();
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
         mod inner { pub(in super::super) const P: u8 = super::q::R; }",
    );
    let paths = |source: &Source| -> Vec<String> {
        source.paths.iter().map(|path| path.segments.join("::")).collect()
    };
    assert_eq!(paths(&source), ["crate::d::e", "crate::h::i", "crate::n::O"]);
    assert_eq!(paths(&source.inline[0].1), ["super::q::R"]);
    assert!(source.files.is_empty() && source.imports.is_empty());
    assert_eq!(source.items, ["g", "S"]);
    assert_eq!(source.inline[0].1.items, ["P"]);
}
