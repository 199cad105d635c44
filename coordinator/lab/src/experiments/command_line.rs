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

/// Words as a shell takes them: those with other characters than plain ones in quotes.
pub fn typed(words: &[OsString]) -> String {
    let words = words.iter().map(|word| {
        let word = word.to_string_lossy();
        let plain = |c: char| c.is_alphanumeric() || "-_=./,:+".contains(c);
        if word.chars().all(plain) {
            word.into_owned()
        } else {
            format!("'{}'", word.replace('\'', "'\\''"))
        }
    });
    words.collect::<Vec<_>>().join(" ")
}
