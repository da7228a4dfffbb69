//! The dependency graph of the files of a crate. Imports and paths are resolved to the file that
//! defines the item.

use std::collections::{BTreeMap, BTreeSet};

use super::source::{Import, Path, Source, read};

/// Texts of the files of a crate by their paths below `src`.
pub(super) type Files = BTreeMap<String, String>;

/// Dependencies (user, provider) with one occurrence each: `line: path`.
pub(super) type Edges = BTreeMap<(String, String), String>;

/// The edges of a crate between different files.
///
/// # Panics
///
/// A path within the crate cannot be resolved, so that edges would be missing.
pub(super) fn edges(files: &Files) -> Edges {
    let mut graph = Graph { modules: Vec::new(), edges: Edges::new() };
    for root in ["lib.rs", "main.rs"] {
        if let Some(text) = files.get(root) {
            let first = graph.modules.len();
            graph.load(files, Module::new(root, None, first), "", read(text));
        }
    }
    for module in 0..graph.modules.len() {
        graph.follow_all(module);
    }
    graph.edges
}

struct Graph {
    /// The modules of all roots; parents precede children.
    modules: Vec<Module>,
    edges: Edges,
}

struct Module {
    file: String,
    parent: Option<usize>,
    root: usize,
    children: BTreeMap<String, usize>,
    source: Source,
}

/// A meaning of a path. A path may have several: a module and a function with the same name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Named {
    Module(usize),
    /// An item of this module.
    Item(usize),
    /// An item of another crate.
    Elsewhere,
}

/// Names whose lookup is in progress, with their modules. This breaks recursion: an import may name
/// itself if it means a macro.
type Pending = Vec<(usize, String)>;

impl Module {
    fn new(file: &str, parent: Option<usize>, root: usize) -> Self {
        let (file, children, source) = (file.to_owned(), BTreeMap::new(), Source::default());
        Self { file, parent, root, children, source }
    }
}

impl Graph {
    /// Adds a module with its descendants; the files of its children are in `folder`.
    fn load(&mut self, files: &Files, module: Module, folder: &str, mut source: Source) -> usize {
        let (this, file, root) = (self.modules.len(), module.file.clone(), module.root);
        self.modules.push(module);
        for name in &source.files {
            let candidates = [format!("{folder}{name}.rs"), format!("{folder}{name}/mod.rs")];
            let found = candidates.iter().find(|path| files.contains_key(*path));
            let path =
                found.unwrap_or_else(|| panic!("{file}: mod {name} has no file of {candidates:?}"));
            let inner = read(&files[path]);
            let child = Module::new(path, Some(this), root);
            let child = self.load(files, child, &format!("{folder}{name}/"), inner);
            self.modules[this].children.insert(name.clone(), child);
        }
        for (name, inner) in std::mem::take(&mut source.inline) {
            let child = Module::new(&file, Some(this), root);
            let child = self.load(files, child, &format!("{folder}{name}/"), inner);
            self.modules[this].children.insert(name, child);
        }
        self.modules[this].source = source;
        this
    }

    fn follow_all(&mut self, module: usize) {
        let source = std::mem::take(&mut self.modules[module].source);
        let (imports, words, paths) =
            (source.imports.clone(), source.words.clone(), source.paths.clone());
        self.modules[module].source = source;
        for import in &imports {
            let named = self.import(module, import, &mut Vec::new());
            self.add(module, &named, &import.path);
            for &target in named.iter().filter(|_| import.name == "*") {
                let Named::Module(target) = target else { continue };
                for (word, line) in &words {
                    let path = Path { segments: vec![word.clone()], line: *line };
                    let named = self.look_up(target, word, &mut Vec::new());
                    self.add(module, &named, &path);
                }
            }
        }
        for path in &paths {
            let named = self.resolve(module, &path.segments, &mut Vec::new());
            self.add(module, &named, path);
        }
    }

    /// Adds edges to the modules of named items. A path to a module alone gives no edge; paths to
    /// its items do.
    fn add(&mut self, user: usize, named: &BTreeSet<Named>, path: &Path) {
        for &named in named {
            let Named::Item(provider) = named else { continue };
            let (user, provider) = (&self.modules[user].file, &self.modules[provider].file);
            if user != provider {
                let place = format!("{}: {}", path.line, path.segments.join("::"));
                self.edges.entry((user.clone(), provider.clone())).or_insert(place);
            }
        }
    }

    fn import(&self, module: usize, import: &Import, pending: &mut Pending) -> BTreeSet<Named> {
        let named = self.resolve(module, &import.path.segments, pending);
        let is_lost = named.is_empty() && pending.is_empty();
        assert!(
            !is_lost,
            "{}:{}: {} leads nowhere",
            self.modules[module].file,
            import.path.line,
            import.path.segments.join("::")
        );
        named
    }

    /// The meanings of a path in a module.
    fn resolve(
        &self,
        module: usize,
        segments: &[String],
        pending: &mut Pending,
    ) -> BTreeSet<Named> {
        let mut at = module;
        let mut rest = segments;
        while let [first, others @ ..] = rest {
            at = match first.as_str() {
                "crate" => self.modules[at].root,
                "self" => at,
                "super" => self.modules[at].parent.unwrap_or_else(|| {
                    panic!(
                        "{}: {} leaves the crate",
                        self.modules[module].file,
                        segments.join("::")
                    )
                }),
                _ => break,
            };
            rest = others;
        }
        let is_absolute = rest.len() < segments.len();
        let Some((last, before)) = rest.split_last() else {
            return BTreeSet::from([Named::Module(at)]);
        };
        for (i, segment) in before.iter().enumerate() {
            let named = self.look_up(at, segment, pending);
            let module = named.iter().find_map(|named| match named {
                Named::Module(module) => Some(*module),
                _ => None,
            });
            match module {
                Some(module) => at = module,
                // A variant of an enum, an item of a trait, or an item of another crate.
                None if !named.is_empty() => return named,
                None if i == 0 && !is_absolute => return BTreeSet::from([Named::Elsewhere]),
                None => return self.undefined(at),
            }
        }
        let named = self.look_up(at, last, pending);
        let is_known = !named.is_empty() || pending.contains(&(at, last.clone()));
        match is_known {
            true => named,
            false if rest.len() == 1 && !is_absolute => BTreeSet::from([Named::Elsewhere]),
            false => self.undefined(at),
        }
    }

    /// The meaning of a name that a module does not define: a macro in the module may define it.
    fn undefined(&self, module: usize) -> BTreeSet<Named> {
        self.modules[module]
            .source
            .calls_macros
            .then_some(Named::Item(module))
            .into_iter()
            .collect()
    }

    /// The meanings of a single name in a module.
    fn look_up(&self, module: usize, name: &str, pending: &mut Pending) -> BTreeSet<Named> {
        let key = (module, name.to_owned());
        if pending.contains(&key) {
            return BTreeSet::new();
        }
        pending.push(key);
        let Module { source, children, root, .. } = &self.modules[module];
        let mut found: BTreeSet<Named> =
            children.get(name).map(|&child| Named::Module(child)).into_iter().collect();
        if source.items.iter().any(|item| item == name) {
            found.insert(Named::Item(module));
        }
        for import in source.imports.iter().filter(|import| import.name == name) {
            found.extend(self.import(module, import, pending));
        }
        if found.is_empty() {
            for import in source.imports.iter().filter(|import| import.name == "*") {
                for named in self.import(module, import, pending) {
                    if let Named::Module(target) = named {
                        found.extend(self.look_up(target, name, pending));
                    }
                }
            }
        }
        if found.is_empty() && module == *root {
            let of_crate = |other: &usize| self.modules[*other].root == module;
            let exports = |other: &usize| {
                self.modules[*other].source.exported_macros.iter().any(|exported| exported == name)
            };
            found.extend((0..self.modules.len()).filter(of_crate).find(exports).map(Named::Item));
        }
        pending.pop();
        found
    }
}
