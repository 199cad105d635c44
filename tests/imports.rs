//! Which files of a crate import each other in a circle, as their tokens say.
//!
//! What a file takes by a name that another one only passes on (`pub use`) counts as taken from where it is defined.
//! Code for tests is left out. Where the tokens alone do not tell, an import is assumed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use proc_macro2::{Delimiter, Group, TokenStream, TokenTree};

/// The words of a path, such as `crate`, `config`, `Config`.
type Words = Vec<String>;

/// Names that lead through others that are passed on, at most.
const DEEPEST: usize = 20;

/// The circles among the files of the crate whose root is `root`, each as its imports: `FILE imports FILE by PATH`.
///
/// # Errors
/// If a file cannot be read.
pub fn circles(root: &Path) -> Result<Vec<Vec<String>>> {
    let mut source = Source::default();
    let folder = root.parent().context("a file lies in a folder")?;
    source.read(&[], root, folder)?;
    let imports = source.imports();
    let reachable: BTreeMap<&Path, BTreeSet<&Path>> =
        imports.keys().map(|file| (*file, reachable(file, &imports))).collect();
    let mut told = BTreeSet::new();
    let mut circles = Vec::new();
    for (file, reached) in &reachable {
        if !reached.contains(file) || told.contains(file) {
            continue;
        }
        let returns = |other: &&&Path| reachable.get(**other).is_some_and(|of| of.contains(file));
        let circle: BTreeSet<&Path> = reached.iter().filter(returns).copied().collect();
        let name = |file: &Path| file.strip_prefix(folder).unwrap_or(file).display().to_string();
        let mut lines = Vec::new();
        for one in &circle {
            for (other, path) in imports[one].iter().filter(|(other, _)| circle.contains(*other)) {
                lines.push(format!("{} imports {} by `{path}`", name(one), name(other)));
            }
        }
        told.extend(circle);
        circles.push(lines);
    }
    Ok(circles)
}

/// What a file imports: other files, and one path by which it does.
type Imports<'a> = BTreeMap<&'a Path, BTreeMap<&'a Path, String>>;

/// The files that imports lead to from `file`.
fn reachable<'a>(file: &Path, imports: &Imports<'a>) -> BTreeSet<&'a Path> {
    let mut reached = BTreeSet::new();
    let mut waiting = vec![file];
    while let Some(file) = waiting.pop() {
        for other in imports.get(file).into_iter().flat_map(BTreeMap::keys) {
            if reached.insert(*other) {
                waiting.push(*other);
            }
        }
    }
    reached
}

/// A module, in a file of its own or in another one.
#[derive(Debug, Default)]
struct Module {
    file: PathBuf,
    /// Names of what is defined here, but for modules.
    items: BTreeSet<String>,
    /// What is taken from elsewhere, by the name that it has here.
    uses: BTreeMap<String, Words>,
    /// What all names are taken from.
    globs: Vec<Words>,
    /// All paths of two words or more.
    paths: BTreeSet<Words>,
}

/// A crate's modules by their paths; the root's is empty.
#[derive(Debug, Default)]
struct Source(BTreeMap<Words, Module>);

impl Source {
    /// Reads a module's file, and those of the modules in it, which lie in `folder`.
    fn read(&mut self, at: &[String], file: &Path, folder: &Path) -> Result<()> {
        let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
        let tokens: TokenStream =
            text.parse().map_err(|error| anyhow::anyhow!("{}: {error}", file.display()))?;
        self.0.insert(at.to_vec(), Module { file: file.to_owned(), ..Module::default() });
        self.walk(at, tokens, folder, true)
    }

    /// Takes what `tokens` say, at the top of a module or somewhere within.
    fn walk(&mut self, at: &[String], tokens: TokenStream, folder: &Path, top: bool) -> Result<()> {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut next = 0;
        while let Some(token) = tokens.get(next) {
            let rest = &tokens[next + 1..];
            next += 1;
            match (token, rest) {
                (TokenTree::Punct(mark), [TokenTree::Group(attribute), ..])
                    if mark.as_char() == '#' =>
                {
                    next += 1;
                    if is_for_tests(attribute) {
                        next += item_length(&tokens[next..]);
                    }
                }
                (TokenTree::Ident(word), [TokenTree::Ident(name), body, ..])
                    if top && word == "mod" =>
                {
                    let name = name.to_string();
                    let (path, inner) =
                        ([at, std::slice::from_ref(&name)].concat(), folder.join(&name));
                    if let TokenTree::Group(body) = body {
                        let file = self.module(at).file.clone();
                        self.0.insert(path.clone(), Module { file, ..Module::default() });
                        self.walk(&path, body.stream(), &inner, true)?;
                    } else {
                        let files = [folder.join(format!("{name}.rs")), inner.join("mod.rs")];
                        let file = files.iter().find(|file| file.is_file());
                        let file = file.with_context(|| format!("no {}", files[0].display()))?;
                        self.read(&path, file, &inner)?;
                    }
                    next += 2;
                }
                (TokenTree::Ident(word), [first, ..]) if word == "use" && !is(first, '<') => {
                    let length = rest.iter().take_while(|token| !is(token, ';')).count();
                    self.take_use(at, Vec::new(), &rest[..length]);
                    next += length;
                }
                (TokenTree::Ident(word), _) => {
                    if top && DEFINING.iter().any(|defining| word == defining) {
                        let name = rest.iter().find_map(word_of);
                        self.module(at).items.extend(name);
                    }
                    let path = path(&tokens[next - 1..]);
                    // What follows `::` is the end of another path, or that of another crate.
                    let before = &tokens[..next - 1];
                    let follows = matches!(before, [.., a, b] if is(a, ':') && is(b, ':'));
                    if path.len() > 1 && !follows {
                        next += 3 * (path.len() - 1);
                        self.module(at).paths.insert(path);
                    }
                }
                (TokenTree::Group(group), _) => self.walk(at, group.stream(), folder, false)?,
                _ => {}
            }
        }
        Ok(())
    }

    /// Takes the tree of a `use` below the words `from`.
    fn take_use(&mut self, at: &[String], mut from: Words, tree: &[TokenTree]) {
        if from.is_empty() && tree.first().is_some_and(|token| is(token, ':')) {
            return; // another crate
        }
        for (index, token) in tree.iter().enumerate() {
            match token {
                TokenTree::Ident(word) if word == "as" => {
                    if let Some(name) = tree.get(index + 1).and_then(word_of) {
                        self.module(at).uses.insert(name, from);
                    }
                    return;
                }
                TokenTree::Ident(word) if word == "self" && !from.is_empty() => {}
                TokenTree::Ident(word) => from.push(word.to_string()),
                TokenTree::Group(group) => {
                    let inner: Vec<TokenTree> = group.stream().into_iter().collect();
                    for tree in inner.split(|token| is(token, ',')).filter(|tree| !tree.is_empty())
                    {
                        self.take_use(at, from.clone(), tree);
                    }
                    return;
                }
                token if is(token, '*') => return self.module(at).globs.push(from),
                _ => {}
            }
        }
        if let Some(name) = from.last() {
            self.module(at).uses.insert(name.clone(), from);
        }
    }

    fn module(&mut self, at: &[String]) -> &mut Module {
        self.0.get_mut(at).expect("a module is there before what is in it")
    }

    /// What every file imports.
    fn imports(&self) -> Imports<'_> {
        let mut imports = Imports::new();
        for (at, module) in &self.0 {
            let globs = module.globs.iter().map(|from| [&from[..], &["*".to_owned()]].concat());
            let paths = module.uses.values().chain(&module.paths).cloned().chain(globs);
            for path in paths {
                let Some(other) = self.place(at, &path, DEEPEST) else { continue };
                if other.file != module.file {
                    let of_file = imports.entry(module.file.as_path()).or_default();
                    of_file.insert(other.file.as_path(), path.join("::"));
                }
            }
        }
        imports
    }

    /// The module that defines the item that `path` names in the module `at`. None if that is another crate's, or a module,
    /// which is imported by what is taken through it.
    fn place(&self, at: &[String], path: &[String], deep: usize) -> Option<&Module> {
        let deep = deep.checked_sub(1)?;
        let mut at = at.to_vec();
        for (index, word) in path.iter().enumerate() {
            let here = &self.0[&at];
            let inner = [&at[..], std::slice::from_ref(word)].concat();
            let is_last = index + 1 == path.len();
            // A function may have the name of a module.
            let named = here.items.contains(word) || here.uses.contains_key(word);
            match word.as_str() {
                "crate" => at.clear(),
                "self" => {}
                "super" => drop(at.pop()),
                _ if self.0.contains_key(&inner) && !(is_last && named) => at = inner,
                _ if here.items.contains(word) => return Some(here),
                _ => {
                    let rest = &path[index + 1..];
                    if let Some(from) = here.uses.get(word).filter(|from| from != &path) {
                        return self.place(&at, &[from, rest].concat(), deep);
                    }
                    let of_glob = |from: &Words| {
                        let of = self.place(
                            &at,
                            &[&from[..], std::slice::from_ref(word)].concat(),
                            deep,
                        )?;
                        of.items.contains(word).then_some(of)
                    };
                    // A first word that is not known names another crate, or something of this module's own.
                    return here.globs.iter().find_map(of_glob).or((index > 0).then_some(here));
                }
            }
        }
        None
    }
}

/// Words before the name of what they define.
const DEFINING: [&str; 9] =
    ["fn", "struct", "enum", "trait", "type", "const", "static", "union", "macro_rules"];

fn is(token: &TokenTree, mark: char) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == mark)
}

fn word_of(token: &TokenTree) -> Option<String> {
    if let TokenTree::Ident(word) = token { Some(word.to_string()) } else { None }
}

/// The path that `tokens` begin with.
fn path(tokens: &[TokenTree]) -> Words {
    let words = tokens.chunks(3).map_while(|chunk| {
        let follows = matches!(chunk, [_, a, b] if is(a, ':') && is(b, ':'));
        word_of(&chunk[0]).map(|word| (word, follows))
    });
    let mut path = Words::new();
    for (word, follows) in words {
        path.push(word);
        if !follows {
            break;
        }
    }
    path
}

/// Whether an attribute leaves an item to tests: `[cfg(test)]`.
fn is_for_tests(attribute: &Group) -> bool {
    let text = attribute.to_string().replace(' ', "");
    text.starts_with("[cfg(test") || text.starts_with("[cfg(all(test")
}

/// Tokens until the end of an item, at least as far as it is sure to go.
fn item_length(tokens: &[TokenTree]) -> usize {
    let ends = |token: &TokenTree| match token {
        TokenTree::Group(group) => group.delimiter() == Delimiter::Brace,
        token => is(token, ';') || is(token, ','),
    };
    tokens.iter().position(ends).map_or(tokens.len(), |end| end + 1)
}
