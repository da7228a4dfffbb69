//! The dependency graph of the files of a crate. Imports and paths are resolved to the file that
//! defines the item.

use std::collections::{BTreeMap, BTreeSet};

use super::source::{Import, Source, read};

/// Texts of the files of a crate by their paths below `src`.
pub(super) type Files = BTreeMap<String, String>;

/// Dependencies (user, provider) with one occurrence each: `file:line: path`.
pub(super) type Edges = BTreeMap<(String, String), String>;

/// The edges of a crate between different files.
///
/// # Panics
///
/// A file cannot be parsed or a path of an import not be resolved, so that edges would be missing.
pub(super) fn edges(files: &Files) -> Edges {
    let mut graph = Graph { modules: Vec::new() };
    for root in ["lib.rs", "main.rs"].into_iter().filter(|root| files.contains_key(*root)) {
        graph.load(files, root, "", None, parsed(files, root));
    }
    while graph.import_names(false) {}
    graph.name_others();
    // A macro in a module may define any name, but only one that nothing else explains.
    for with_macros in [false, true] {
        while graph.import_names(with_macros) {}
    }
    let mut edges = Edges::new();
    for (at, Module { file: user, source, .. }) in graph.modules.iter().enumerate() {
        let mut add = |named: &BTreeSet<Named>, path: &[String], line: usize| {
            for named in named {
                // A path to a module alone gives no edge; paths to its items do.
                let Named::Item(provider) = *named else { continue };
                let provider = &graph.modules[provider].file;
                if user != provider {
                    let place = format!("{user}:{line}: {}", path.join("::"));
                    edges.entry((user.clone(), provider.clone())).or_insert(place);
                }
            }
        };
        for import in &source.imports {
            let named = graph.resolve(at, &import.path, true);
            graph.check(at, import, &named);
            // Whether the module is meant or an item of the same name, its uses tell.
            if !named.iter().any(|named| matches!(named, Named::Module(_))) {
                add(&named, &import.path, import.line);
            }
        }
        for (path, line) in &source.paths {
            add(&graph.resolve(at, path, true), path, *line);
        }
    }
    edges
}

fn parsed(files: &Files, path: &str) -> Source {
    read(&files[path]).unwrap_or_else(|error| {
        panic!("{path}:{}: {error}", error.span().start().line);
    })
}

struct Graph {
    /// The modules of all roots; parents precede children.
    modules: Vec<Module>,
}

struct Module {
    file: String,
    parent: Option<usize>,
    root: usize,
    source: Source,
    /// The meanings of each name. A module and a function may have the same name.
    names: BTreeMap<String, BTreeSet<Named>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Named {
    Module(usize),
    /// An item of this module.
    Item(usize),
    /// An item of another crate.
    Other,
}

impl Graph {
    /// Adds a module with its descendants; the files of its children are in `folder`.
    fn load(
        &mut self,
        files: &Files,
        file: &str,
        folder: &str,
        parent: Option<usize>,
        mut source: Source,
    ) -> usize {
        let this = self.modules.len();
        let root = parent.map_or(this, |parent| self.modules[parent].root);
        let inside = std::mem::take(&mut source.modules);
        let item = BTreeSet::from([Named::Item(this)]);
        let names = source.items.iter().map(|name| (name.clone(), item.clone())).collect();
        let macros = source.exported_macros.clone();
        self.modules.push(Module { file: file.to_owned(), parent, root, source, names });
        for name in macros {
            self.modules[root].names.entry(name).or_default().insert(Named::Item(this));
        }
        for (name, inner) in inside {
            let mut path = file.to_owned();
            let inner = inner.unwrap_or_else(|| {
                let places = [format!("{folder}{name}.rs"), format!("{folder}{name}/mod.rs")];
                let found = places.iter().find(|path| files.contains_key(*path));
                path.clone_from(found.unwrap_or_else(|| panic!("{file}: mod {name} has no file")));
                parsed(files, &path)
            });
            let child = self.load(files, &path, &format!("{folder}{name}/"), Some(this), inner);
            self.modules[this].names.entry(name).or_default().insert(Named::Module(child));
        }
        this
    }

    /// Gives the modules the names that their imports mean so far. Returns whether there were new
    /// ones.
    fn import_names(&mut self, with_macros: bool) -> bool {
        let mut found = Vec::new();
        for (at, module) in self.modules.iter().enumerate() {
            for Import { path, name, .. } in &module.source.imports {
                for named in self.resolve(at, path, with_macros) {
                    match named {
                        Named::Module(from) if name == "*" => {
                            for (name, all) in &self.modules[from].names {
                                found.extend(all.iter().map(|named| (at, name.clone(), *named)));
                            }
                        }
                        _ => found.push((at, name.clone(), named)),
                    }
                }
            }
        }
        let mut is_new = false;
        for (at, name, named) in found {
            is_new |= self.modules[at].names.entry(name).or_default().insert(named);
        }
        is_new
    }

    /// Names what the modules import from other crates, when all else is named.
    fn name_others(&mut self) {
        for at in 0..self.modules.len() {
            let is_other = |Import { path, .. }: &&Import| {
                !["crate", "self", "super"].contains(&path[0].as_str())
                    && self.resolve(at, path, false).is_empty()
            };
            let imports = self.modules[at].source.imports.iter().filter(is_other);
            let names: Vec<String> = imports.map(|import| import.name.clone()).collect();
            for name in names.into_iter().filter(|name| name != "*") {
                self.modules[at].names.entry(name).or_insert_with(|| [Named::Other].into());
            }
        }
    }

    /// The meanings of a path in a module as far as they are known; none for a path of another
    /// crate.
    fn resolve(&self, from: usize, path: &[String], with_macros: bool) -> BTreeSet<Named> {
        let (mut at, mut is_absolute) = (from, false);
        for (i, segment) in path.iter().enumerate() {
            let module = &self.modules[at];
            let up = match segment.as_str() {
                "crate" => Some(module.root),
                "self" => Some(at),
                "super" => module.parent,
                _ => None,
            };
            if let Some(up) = up {
                (at, is_absolute) = (up, true);
                continue;
            }
            let named = module.names.get(segment).cloned().unwrap_or_default();
            let inner = named.iter().find_map(|named| match named {
                Named::Module(inner) => Some(*inner),
                Named::Item(_) | Named::Other => None,
            });
            match inner {
                Some(inner) if i + 1 < path.len() => (at, is_absolute) = (inner, true),
                None if named.is_empty() && is_absolute && with_macros => {
                    let by_macro = module.source.calls_macros.then_some(Named::Item(at));
                    return by_macro.into_iter().collect();
                }
                // The rest may be a variant of an enum or an item of a trait.
                _ => return named,
            }
        }
        BTreeSet::from([Named::Module(at)])
    }

    /// An import from this crate must mean something.
    fn check(&self, at: usize, Import { path, line, .. }: &Import, named: &BTreeSet<Named>) {
        let Module { file, names, .. } = &self.modules[at];
        // An import may name itself if it means another crate or a macro.
        let is_own = ["crate", "self", "super"].contains(&path[0].as_str())
            || (names.contains_key(&path[0]) && path.len() > 1);
        let is_lost = is_own && named.is_empty();
        assert!(!is_lost, "{file}:{line}: {} leads nowhere", path.join("::"));
    }
}
