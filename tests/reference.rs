//! The reference of the configuration as a page of the guide, read from the code itself.
//!
//! What a key means is its documentation in `proto/src/config`. Its default is what the presets say. Its
//! range is what the validation answers when it is shown a value beyond all bounds. So nothing of the page
//! is written twice, and a key that is new is on it.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use proto::ConfigError;
use proto::config::{Layers, Preset, TaskName};
use syn::{Attribute, Expr, Fields, Item, Lit, Meta, Type};
use toml::{Table, Value};

/// Where the page lies.
pub fn path() -> PathBuf {
    repository().join("deploy/guide/src/configuration-reference.md")
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

const HEAD: &str = "\
# Every key of the configuration

This page is made from the code by `make guide`, and a test keeps it current.

* **Default** is the value in preset `guided`, for task `trajectory` and algorithm `mappo`. Where another task has another
  value, it follows.
* **`paper`** and **`release`** are the values in those presets, likewise; – means the same as in `guided`.
* Preset `guided` is `tuned` but for what its file says, `deploy/presets/guided.toml`, and `robust` is `guided` but for what its file says.
* **Range** is what is accepted; both ends belong to it. Where an end depends on another key, the range is that of preset `tuned`.
* [Configuration](configuration.md) says how a key is set, and what changes with another algorithm.
";

/// The page.
pub fn page() -> Result<String> {
    let source =
        Source::read(&["config", "tasks"].map(|of| repository().join("proto/src").join(of)))?;
    let defaults = Defaults::new()?;
    let mut page = HEAD.to_owned();
    let mut keys = Vec::new();
    section(&source, &defaults, "Config", "", &mut page, &mut keys)?;
    let known = flat_keys(&defaults.default, "");
    ensure!(
        keys.len() == known.len() && known.iter().all(|key| keys.contains(key)),
        "the documented keys {keys:?} are not those of the presets, {known:?}"
    );
    Ok(page)
}

/// What the texts of the configuration's modules say.
struct Source {
    /// Fields of each struct, in order.
    groups: BTreeMap<String, Vec<Field>>,
    /// Variants of each enumeration: name in a configuration, meaning.
    choices: BTreeMap<String, Vec<(String, String)>>,
}

struct Field {
    name: String,
    kind: String,
    meaning: String,
}

impl Source {
    fn read(folders: &[PathBuf]) -> Result<Self> {
        let mut source = Self { groups: BTreeMap::new(), choices: BTreeMap::new() };
        let mut paths = Vec::new();
        for folder in folders {
            let entries =
                std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
            for entry in entries {
                paths.push(entry?.path());
            }
        }
        for path in paths {
            if path.extension().is_none_or(|extension| extension != "rs") {
                continue;
            }
            let text = std::fs::read_to_string(&path)?;
            let file = syn::parse_file(&text).with_context(|| path.display().to_string())?;
            for item in file.items {
                source.take(item);
            }
        }
        // Named by a macro.
        let tasks = TaskName::ALL.iter();
        let tasks = tasks.map(|t| (t.as_str().to_owned(), format!("{}.", t.definition().about())));
        source.choices.insert("TaskName".to_owned(), tasks.collect());
        Ok(source)
    }

    fn take(&mut self, item: Item) {
        match item {
            Item::Struct(item) => {
                let Fields::Named(fields) = item.fields else { return };
                let fields = fields.named.into_iter().filter_map(|field| {
                    let name = field.ident?.to_string();
                    Some(Field { name, kind: kind(&field.ty), meaning: doc(&field.attrs) })
                });
                self.groups.insert(item.ident.to_string(), fields.collect());
            }
            Item::Enum(item) => {
                let style = rename_all(&item.attrs);
                let choices = item.variants.iter().map(|variant| {
                    (renamed(&variant.ident.to_string(), &style), doc(&variant.attrs))
                });
                self.choices.insert(item.ident.to_string(), choices.collect());
            }
            _ => {}
        }
    }
}

/// Last part of a type's path.
fn kind(of: &Type) -> String {
    let Type::Path(path) = of else { return String::new() };
    path.path.segments.last().map(|segment| segment.ident.to_string()).unwrap_or_default()
}

/// A documentation comment as one line.
fn doc(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter_map(|attribute| {
        let Meta::NameValue(pair) = &attribute.meta else { return None };
        let Expr::Lit(literal) = &pair.value else { return None };
        match &literal.lit {
            Lit::Str(text) if pair.path.is_ident("doc") => Some(text.value().trim().to_owned()),
            _ => None,
        }
    });
    lines.collect::<Vec<_>>().join(" ").trim().to_owned()
}

/// How serde writes the variants of an enumeration.
fn rename_all(attributes: &[Attribute]) -> String {
    let mut style = String::new();
    for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("serde")) {
        let _ = attribute.parse_nested_meta(|meta| {
            if meta.path.is_ident("rename_all") {
                style = meta.value()?.parse::<syn::LitStr>()?.value();
            }
            Ok(())
        });
    }
    style
}

fn renamed(variant: &str, style: &str) -> String {
    let separator = match style {
        "kebab-case" => "-",
        "snake_case" => "_",
        _ => "",
    };
    let mut name = String::new();
    for (at, letter) in variant.chars().enumerate() {
        if at > 0 && letter.is_uppercase() {
            name.push_str(separator);
        }
        name.extend(letter.to_lowercase());
    }
    name
}

const PRESETS: [Preset; 3] = [Preset::DEFAULT, Preset::Paper, Preset::Release];

/// The presets, resolved.
struct Defaults {
    default: Table,
    /// For each preset its tables for the tasks that it has settings for.
    all: [Vec<(TaskName, Table)>; 3],
}

impl Defaults {
    fn new() -> Result<Self> {
        let table = |preset, task| -> Result<Table> {
            Ok(Layers::new(preset, Some(task)).resolve()?.to_toml().parse()?)
        };
        let of_tasks = |preset| -> Result<Vec<(TaskName, Table)>> {
            let papers = |task: &&TaskName| {
                preset == Preset::DEFAULT
                    || [TaskName::Trajectory, TaskName::Reorientation].contains(task)
            };
            let tasks = TaskName::ALL.iter().filter(papers);
            tasks.map(|&task| Ok((task, table(preset, task)?))).collect()
        };
        let all = [of_tasks(PRESETS[0])?, of_tasks(PRESETS[1])?, of_tasks(PRESETS[2])?];
        Ok(Self { default: all[0][0].1.clone(), all })
    }

    /// How the columns of a key read.
    fn columns(&self, key: &str) -> Result<[String; 3]> {
        let said = |tables: &[(TaskName, Table)]| -> Result<String> {
            let first = lookup(&tables[0].1, key)?;
            let mut text = shown(first);
            for (task, table) in &tables[1..] {
                let other = lookup(table, key)?;
                if other != first && key != "task.name" {
                    let _ = write!(text, "; `{}` {}", task.as_str(), shown(other));
                }
            }
            Ok(text)
        };
        let [default, paper, release] =
            [said(&self.all[0])?, said(&self.all[1])?, said(&self.all[2])?];
        let unless_same = |text: String| if text == default { "–".to_owned() } else { text };
        Ok([default.clone(), unless_same(paper), unless_same(release)])
    }
}

fn lookup<'a>(table: &'a Table, key: &str) -> Result<&'a Value> {
    let (groups, last) = key.rsplit_once('.').context("every key is in a group")?;
    let mut at = table;
    for group in groups.split('.') {
        at = at
            .get(group)
            .and_then(Value::as_table)
            .with_context(|| format!("no group of {key}"))?;
    }
    at.get(last).with_context(|| format!("no key {key}"))
}

fn flat_keys(table: &Table, prefix: &str) -> Vec<String> {
    let keys = table.iter().flat_map(|(key, value)| match value {
        Value::Table(inner) => flat_keys(inner, &format!("{prefix}{key}.")),
        _ => vec![format!("{prefix}{key}")],
    });
    keys.collect()
}

/// A value as a reader writes it.
fn shown(value: &Value) -> String {
    match value {
        Value::Float(number) => format!("`{}`", float(*number)),
        Value::Integer(number) => format!("`{}`", grouped(*number)),
        Value::Array(items) => {
            let items: Vec<String> = items.iter().map(ToString::to_string).collect();
            format!("`[{}]`", items.join(", "))
        }
        other => format!("`{other}`"),
    }
}

/// Digits in threes, as TOML allows them.
fn grouped(number: i64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) && digits.len() > 4 {
            text.push('_');
        }
        text.push(digit);
    }
    text
}

fn float(number: f64) -> String {
    let size = number.abs();
    if number == 0.0 || (1e-3..1e6).contains(&size) {
        format!("{number:?}")
    } else {
        format!("{number:e}")
    }
}

/// Writes the table of a group, then those of the groups in it.
fn section(
    source: &Source,
    defaults: &Defaults,
    group: &str,
    prefix: &str,
    page: &mut String,
    keys: &mut Vec<String>,
) -> Result<()> {
    let fields = source.groups.get(group).with_context(|| format!("no struct {group}"))?;
    let is_group = |field: &&Field| source.groups.contains_key(&field.kind);
    let mut choices = String::new();
    let mut rows = String::new();
    for field in fields.iter().filter(|field| !is_group(field)) {
        let key = format!("{prefix}{}", field.name);
        ensure!(!field.meaning.is_empty(), "{key} has no documentation in proto/src/config");
        let [default, paper, release] = defaults.columns(&key)?;
        let value = lookup(&defaults.default, &key)?;
        let range = match source.choices.get(&field.kind) {
            Some(variants) => {
                let _ = writeln!(choices, "\n`{key}` is one of");
                for (name, meaning) in variants {
                    let _ = writeln!(choices, "* `{name}`: {meaning}");
                }
                let names: Vec<String> =
                    variants.iter().map(|(name, _)| format!("`{name}`")).collect();
                names.join(", ")
            }
            None => range(&key, value)?,
        };
        let unit = unit(&field.name, value, &field.meaning);
        let meaning = field.meaning.replace('|', "\\|");
        let _ = writeln!(
            rows,
            "| `{key}` | {default} | {paper} | {release} | {unit} | {range} | {meaning} |"
        );
        keys.push(key);
    }
    if !rows.is_empty() {
        let name = prefix.trim_end_matches('.');
        let _ = write!(
            page,
            "\n## `{name}`\n\n| key | default | `paper` | `release` | unit | range | meaning |\n\
             |---|---|---|---|---|---|---|\n{rows}{choices}"
        );
    }
    for field in fields.iter().filter(is_group) {
        let inner = format!("{prefix}{}.", field.name);
        section(source, defaults, &field.kind, &inner, page, keys)?;
    }
    Ok(())
}

/// What a number is counted or measured in, as its documentation says; – where it is a pure number.
fn unit(name: &str, value: &Value, meaning: &str) -> &'static str {
    if !matches!(value, Value::Integer(_) | Value::Float(_)) {
        return "–";
    }
    let said = [
        ("(rad/s)", "rad/s"),
        ("(m/s)", "m/s"),
        ("(N m)", "N m"),
        ("(rad)", "rad"),
        ("(s)", "s"),
        ("(m)", "m"),
        ("(nats)", "nats"),
        ("Control steps", "control steps"),
        ("so many iterations", "iterations"),
        ("Env-steps", "env-steps"),
        ("env-steps", "env-steps"),
    ];
    if name.ends_with("_s") {
        return "s";
    }
    said.iter().find(|(words, _)| meaning.contains(words)).map_or("–", |(_, unit)| unit)
}

/// The values that are accepted.
fn range(key: &str, value: &Value) -> Result<String> {
    match value {
        Value::Boolean(_) => Ok("`true`, `false`".to_owned()),
        Value::String(_) => Ok("text".to_owned()),
        Value::Integer(_) => match bounds(key, &i64::MAX.to_string())? {
            Some(found) => Ok(found),
            // A smaller kind of integer, or one that has no upper bound.
            None => Ok(bounds(key, &u32::MAX.to_string())?.unwrap_or("0 or more".to_owned())),
        },
        Value::Float(_) => {
            let found = bounds(key, "1e300")?.with_context(|| format!("{key} has no bounds"))?;
            let zero_is_special = !found.starts_with("0 to")
                && !found.starts_with('-')
                && Layers::new(Preset::Tuned, None).set(&format!("{key}=0.0"))?.resolve().is_ok();
            Ok(if zero_is_special { format!("0, or {found}") } else { found })
        }
        Value::Array(_) => {
            let many = format!("[{}]", vec!["1"; 1000].join(", "));
            let count = bounds(key, &many)?.with_context(|| format!("{key}: any length?"))?;
            let width =
                bounds(key, "[999999999]")?.with_context(|| format!("{key}: any width?"))?;
            Ok(format!("{count} numbers, each {width}"))
        }
        other => bail!("{key} is {other}, which this page cannot describe"),
    }
}

/// The bounds that the refusal of a value tells; none if it is accepted, or is of another type.
fn bounds(key: &str, beyond: &str) -> Result<Option<String>> {
    let layers = Layers::new(Preset::Tuned, Some(TaskName::Trajectory));
    match layers.set(&format!("{key}={beyond}"))?.resolve() {
        Err(ConfigError::Invalid { key: refused, cure, .. }) if key.starts_with(refused) => {
            // `choose a value from 1 to 16`, or of a list `give 1 to 16 widths, such as …`.
            let ends = ["choose a value from ", "give "]
                .into_iter()
                .find_map(|words| cure.strip_prefix(words)?.split_once(" to "))
                .map(|(low, high)| (low, high.split(' ').next().unwrap_or(high)));
            let (low, high) = ends.with_context(|| format!("{key}: no range in `{cure}`"))?;
            let [low, high] = [low.parse::<f64>()?, high.parse::<f64>()?].map(plain);
            Ok(Some(format!("{low} to {high}")))
        }
        Ok(_) | Err(_) => Ok(None),
    }
}

/// A bound: whole numbers without a point, large and small ones with an exponent.
fn plain(number: f64) -> String {
    let size = number.abs();
    let bare = number == 0.0 || (1e-3..1e6).contains(&size);
    if bare { format!("{number}") } else { format!("{number:e}") }
}
