//! What a parser says of a description, in words of the file's line and keys instead of this program's types.

use proto::config::in_line;

/// The line of `text` at fault, and what is wrong with it.
pub(super) fn in_words(error: &toml::de::Error, text: &str) -> String {
    in_line(error, text, &without_types(error.message()))
}

fn without_types(message: &str) -> String {
    let mut said = message.replace('\n', " ").trim().to_owned();
    for (typed, words) in [
        ("invalid type: ", ""),
        ("invalid value: ", ""),
        ("missing field", "there is no key"),
        ("unknown field", "unknown key"),
        ("duplicate field", "twice the key"),
        ("expected f64", "expected a number"),
        ("expected usize", "expected a whole number that is not negative"),
        ("expected a sequence", "expected a list in brackets"),
        ("expected an array of length", "expected a list of length"),
        ("floating point `", "number `"),
        ("integer `", "number `"),
        ("sequence, expected", "list, expected"),
        ("map, expected", "table, expected"),
    ] {
        said = said.replace(typed, words);
    }
    match said.split_once("expected struct ") {
        Some((before, _)) => format!("{before}expected a table"),
        None => said,
    }
}
