//! Commands as a person would type them.

use std::ffi::OsString;
use std::fmt::Display;
use std::path::Path;

/// `--flag=value`.
pub fn option(flag: &str, value: impl Display) -> OsString {
    format!("{flag}={value}").into()
}

/// `--flag=a,b,c`.
pub fn list_option(flag: &str, values: &[f64]) -> OsString {
    let values: Vec<String> = values.iter().map(ToString::to_string).collect();
    option(flag, values.join(","))
}

/// `--flag=path`, whatever bytes the path has.
pub fn path_option(flag: &str, path: &Path) -> OsString {
    let mut option = OsString::from(format!("{flag}="));
    option.push(path);
    option
}

/// Words as a shell takes them.
pub fn typed(words: &[OsString]) -> String {
    words.iter().map(output::quoted).collect::<Vec<_>>().join(" ")
}
