//! Which file of a crate imports from which, read from the sources.
//!
//! A module is a file. A file imports from another if it names an item of it: in a `use`, or in a path in its code. Three rules make that
//! strict and simple:
//!
//! - A name is followed to the file that defines it, through every re-export. `use super::Config` in `config/profile.rs` imports from
//!   `config/station.rs`, where `Config` is defined, and not from `config/mod.rs`, which re-exports it.
//! - A re-export (`pub use`, with any visibility) is no import, and neither is `mod`. It becomes one where the same file uses the name
//!   in its own code.
//! - What is compiled for tests only (`#[cfg(test)]`) does not count: tests may look further than the code that they test.
//!
//! A method call names no path, so it is not seen; the type that it is called on is.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use proc_macro2::{Delimiter, TokenStream, TokenTree};

/// The path of a module below the crate's root, or of an item below a module.
type ModulePath = Vec<String>;

/// Deeper than any chain of re-exports; a circle of re-exports ends here.
const MAX_RE_EXPORTS: usize = 16;

/// The words that stand before the name of an item.
const ITEM_WORDS: &[&str] = &["struct", "enum", "union", "fn", "const", "static", "type", "trait", "macro_rules"];

/// What one module says.
#[derive(Default)]
struct Module {
    file: PathBuf,
    items: BTreeSet<String>,
    uses: Vec<UseLeaf>,
    /// Paths in the code, outside of `use`.
    paths: Vec<ModulePath>,
}

/// Where tokens stand.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Level {
    /// Among the items of a module.
    Module,
    /// In a bracket of one.
    Inside,
}

/// One leaf of a `use`.
struct UseLeaf {
    path: ModulePath,
    /// As what the module knows it; `*` brings everything.
    name: String,
    kind: UseKind,
}

/// Whether others may have the name from here, too.
#[derive(Clone, Copy, PartialEq, Eq)]
enum UseKind {
    Import,
    ReExport,
}

/// The imports of one crate: from which file to which, and one name for each.
pub(crate) struct Imports {
    pub(crate) edges: BTreeMap<PathBuf, BTreeMap<PathBuf, String>>,
}

impl Imports {
    /// Reads the sources below a crate's `src`; the files are named from there.
    pub(crate) fn read(src: &Path) -> Self {
        let mut modules = BTreeMap::new();
        for file in rust_files(src) {
            let relative = file.strip_prefix(src).expect("it lies below the folder").to_owned();
            let text = fs::read_to_string(&file).expect("a source can be read");
            let tokens = TokenStream::from_str(&text).expect("what compiles has balanced brackets");
            add_module(&mut modules, module_path(&relative), &relative, tokens);
        }
        let mut edges: BTreeMap<PathBuf, BTreeMap<PathBuf, String>> = BTreeMap::new();
        for (path, module) in &modules {
            let resolver = Resolver { modules: &modules };
            for named in module.imported_paths() {
                let Some(target) = resolver.file_of(path, &named, 0) else { continue };
                if target != module.file {
                    let name = named.join("::");
                    edges.entry(module.file.clone()).or_default().entry(target).or_insert(name);
                }
            }
        }
        Self { edges }
    }

    /// A circle of files that import each other, in words.
    pub(crate) fn circle(&self) -> Option<String> {
        let mut done = BTreeSet::new();
        let circle = self.edges.keys().find_map(|file| self.circle_from(file, &mut Vec::new(), &mut done))?;
        let steps = circle.windows(2).map(|pair| {
            let name = &self.edges[pair[0]][pair[1]];
            format!("{} imports `{name}` from {}", pair[0].display(), pair[1].display())
        });
        Some(steps.collect::<Vec<_>>().join(", "))
    }

    /// Follows the imports of a file; `trail` holds the files on the way to it, `done` those that lead into no circle.
    fn circle_from<'a>(
        &'a self,
        file: &'a PathBuf,
        trail: &mut Vec<&'a PathBuf>,
        done: &mut BTreeSet<&'a PathBuf>,
    ) -> Option<Vec<&'a PathBuf>> {
        if let Some(start) = trail.iter().position(|before| *before == file) {
            return Some([&trail[start..], &[file]].concat());
        }
        if !done.contains(file) {
            trail.push(file);
            let mut targets = self.edges.get(file).into_iter().flat_map(BTreeMap::keys);
            let circle = targets.find_map(|target| self.circle_from(target, trail, done));
            if circle.is_some() {
                return circle;
            }
            trail.pop();
            done.insert(file);
        }
        None
    }
}

impl Module {
    /// The paths that this module uses itself, each from where a `use` has it.
    fn imported_paths(&self) -> Vec<ModulePath> {
        let private = self.uses.iter().filter(|one| one.kind == UseKind::Import).map(|one| one.path.clone());
        let in_code = self.paths.iter().filter_map(|path| {
            let (first, rest) = path.split_first()?;
            match self.uses.iter().find(|one| one.name == *first) {
                Some(one) => Some([one.path.as_slice(), rest].concat()),
                None => (!rest.is_empty()).then(|| path.clone()),
            }
        });
        private.chain(in_code).collect()
    }
}

/// Finds the file that defines what a path names.
struct Resolver<'a> {
    modules: &'a BTreeMap<ModulePath, Module>,
}

impl Resolver<'_> {
    /// `None` for what is of another crate, and for a module: what is used of it counts.
    fn file_of(&self, from: &[String], named: &[String], depth: usize) -> Option<PathBuf> {
        if depth > MAX_RE_EXPORTS {
            return None;
        }
        let (first, rest) = named.split_first()?;
        let (mut at, mut rest) = match first.as_str() {
            "crate" => (Vec::new(), rest),
            "self" => (from.to_vec(), rest),
            "super" => (from.split_last()?.1.to_vec(), rest),
            child if self.modules.contains_key(&joined(from, child)) => (joined(from, child), rest),
            _ => return None,
        };
        while let Some((name, after)) = rest.split_first() {
            if name == "super" {
                at.pop();
            } else if self.modules.contains_key(&joined(&at, name)) {
                at.push(name.clone());
            } else {
                return self.file_of_item(&at, name, after, depth);
            }
            rest = after;
        }
        None
    }

    /// The file of an item of a module: where it is defined, or where a re-export has it from.
    fn file_of_item(&self, at: &[String], name: &str, after: &[String], depth: usize) -> Option<PathBuf> {
        let module = self.modules.get(at)?;
        if module.items.contains(name) || name == "*" {
            return Some(module.file.clone());
        }
        if let Some(one) = module.uses.iter().find(|one| one.name == name) {
            let path = [one.path.as_slice(), after].concat();
            // A name of another crate that is re-exported belongs to who re-exports it.
            return self.file_of(at, &path, depth + 1).or_else(|| Some(module.file.clone()));
        }
        let globs = module.uses.iter().filter(|one| one.name == "*");
        let mut found = globs.filter_map(|glob| {
            let of_module = glob.path.split_last()?.1;
            let path = [of_module, &[name.to_owned()]].concat();
            let target = self.file_of(at, &path, depth + 1)?;
            let defines = |module: &&Module| module.file == target && module.items.contains(name);
            self.modules.values().any(|module| defines(&module)).then_some(target)
        });
        found.next().or_else(|| Some(module.file.clone()))
    }
}

fn joined(path: &[String], name: &str) -> ModulePath {
    [path, &[name.to_owned()]].concat()
}

/// `config/mod.rs` and `config.rs` are `config`; `lib.rs` is the root, and `main.rs` a crate of its own that nobody imports.
fn module_path(relative: &Path) -> ModulePath {
    let mut path: ModulePath =
        relative.with_extension("").components().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect();
    if path.last().is_some_and(|name| ["mod", "lib"].contains(&name.as_str())) {
        path.pop();
    }
    path
}

/// Adds a module and those that are written inside it.
fn add_module(modules: &mut BTreeMap<ModulePath, Module>, path: ModulePath, file: &Path, tokens: TokenStream) {
    let mut module = Module { file: file.to_owned(), ..Module::default() };
    let mut inner = Vec::new();
    read_tokens(&mut module, &mut inner, tokens, Level::Module);
    for (name, tokens) in inner {
        add_module(modules, joined(&path, &name), file, tokens);
    }
    modules.insert(path, module);
}

/// Reads the items of a module, and goes into every bracket in search of paths.
fn read_tokens(module: &mut Module, inner: &mut Vec<(String, TokenStream)>, tokens: TokenStream, level: Level) {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    let mut index = 0;
    let mut kind = UseKind::Import;
    while let Some(token) = tokens.get(index) {
        index += 1;
        match token {
            TokenTree::Ident(word) if *word == "pub" => {
                index += usize::from(matches!(tokens.get(index), Some(TokenTree::Group(_))));
                kind = UseKind::ReExport;
                continue;
            }
            TokenTree::Ident(word) if *word == "use" => {
                let end = end_of_use(&tokens, index);
                read_use(module, &tokens[index..end], &[], kind);
                index = end;
            }
            TokenTree::Ident(word) if *word == "mod" => {
                if let (Some(name), Some(TokenTree::Group(body))) = (tokens.get(index), tokens.get(index + 1)) {
                    inner.push((name.to_string(), body.stream()));
                }
                index += 2;
            }
            TokenTree::Ident(word) => {
                if level == Level::Module && ITEM_WORDS.contains(&word.to_string().as_str()) {
                    // `macro_rules! name`
                    let name = index + usize::from(*word == "macro_rules");
                    module.items.extend(tokens.get(name).map(ToString::to_string));
                }
                let path = path_from(&tokens, index - 1);
                index += 3 * (path.len() - 1);
                module.paths.push(path);
            }
            TokenTree::Group(group) => read_tokens(module, inner, group.stream(), Level::Inside),
            TokenTree::Punct(mark) if mark.as_char() == '#' && is_test_only(tokens.get(index)) => {
                index = end_of_item(&tokens, index + 1);
            }
            // Behind a single dot stands a field or a method.
            TokenTree::Punct(mark) if mark.as_char() == '.' && !is_dot(tokens.get(index)) => {
                let is_range = index > 1 && is_dot(tokens.get(index - 2));
                index += usize::from(!is_range && matches!(tokens.get(index), Some(TokenTree::Ident(_))));
            }
            TokenTree::Punct(_) | TokenTree::Literal(_) => {}
        }
        kind = UseKind::Import;
    }
}

fn is_dot(token: Option<&TokenTree>) -> bool {
    matches!(token, Some(TokenTree::Punct(mark)) if mark.as_char() == '.')
}

/// Whether what stands behind a `#` is `[cfg(test)]`.
fn is_test_only(attribute: Option<&TokenTree>) -> bool {
    let text = attribute.map(ToString::to_string).unwrap_or_default();
    text.replace(' ', "") == "[cfg(test)]"
}

/// Behind the next `;` or `{..}`.
fn end_of_item(tokens: &[TokenTree], from: usize) -> usize {
    let ends = |token: &TokenTree| match token {
        TokenTree::Punct(mark) => mark.as_char() == ';',
        TokenTree::Group(group) => group.delimiter() == Delimiter::Brace,
        TokenTree::Ident(_) | TokenTree::Literal(_) => false,
    };
    tokens[from..].iter().position(ends).map_or(tokens.len(), |length| from + length + 1)
}

/// At the `;` of a `use`.
fn end_of_use(tokens: &[TokenTree], from: usize) -> usize {
    let ends = |token: &TokenTree| matches!(token, TokenTree::Punct(mark) if mark.as_char() == ';');
    tokens[from..].iter().position(ends).map_or(tokens.len(), |length| from + length)
}

/// The path that begins at a token: names with `::` between them.
fn path_from(tokens: &[TokenTree], start: usize) -> ModulePath {
    let mut path = vec![tokens[start].to_string()];
    let mut index = start + 1;
    while is_double_colon(tokens, index) {
        let Some(TokenTree::Ident(name)) = tokens.get(index + 2) else { break };
        path.push(name.to_string());
        index += 3;
    }
    path
}

fn is_double_colon(tokens: &[TokenTree], index: usize) -> bool {
    let is_colon = |index: usize| matches!(tokens.get(index), Some(TokenTree::Punct(mark)) if mark.as_char() == ':');
    is_colon(index) && is_colon(index + 1)
}

/// Takes a tree of `use` to pieces, one for each leaf.
fn read_use(module: &mut Module, tokens: &[TokenTree], before: &[String], kind: UseKind) {
    let mut path = before.to_vec();
    let mut alias = None;
    for (index, token) in tokens.iter().enumerate() {
        match token {
            TokenTree::Ident(ident) if *ident == "as" => {
                alias = tokens.get(index + 1).map(ToString::to_string);
                break;
            }
            TokenTree::Ident(ident) => path.push(ident.to_string()),
            TokenTree::Group(group) => {
                let leaves: Vec<TokenTree> = group.stream().into_iter().collect();
                let is_comma = |token: &TokenTree| matches!(token, TokenTree::Punct(mark) if mark.as_char() == ',');
                for leaf in leaves.split(is_comma).filter(|leaf| !leaf.is_empty()) {
                    read_use(module, leaf, &path, kind);
                }
                return;
            }
            TokenTree::Punct(mark) if mark.as_char() == '*' => path.push("*".to_owned()),
            TokenTree::Punct(_) | TokenTree::Literal(_) => {}
        }
    }
    // `use a::{self, b}` brings `a`.
    if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
        path.pop();
    }
    let name = alias.or_else(|| path.last().cloned()).unwrap_or_default();
    module.uses.push(UseLeaf { path, name, kind });
}

/// Every Rust file below a folder, except files that hold nothing but unit tests.
pub(crate) fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a source folder can be listed") {
            let path = entry.expect("a source folder can be listed").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|end| end == "rs") && !path.ends_with("tests.rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}
