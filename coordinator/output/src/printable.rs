//! Text from outside on its way to a terminal.
//!
//! Names and messages may quote files, archives, and what a service answered. A terminal obeys what
//! stands in them: it moves, hides, recolours, and some answer as if the user had typed. So whatever
//! is shown to a person goes through here; nothing that this program says itself needs such characters.

use std::borrow::Cow;
use std::fmt::Write as _;

/// The text with every control character but line ends and tabs written as Rust writes it, `\u{1b}`,
/// and those that turn the direction of what follows.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.chars().any(is_hidden) {
        return text.into();
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_hidden(c) {
            write!(shown, "{}", c.escape_default()).expect("a string takes everything");
        } else {
            shown.push(c);
        }
    }
    shown.into()
}

/// JSON with such characters written as it writes them, `\u001b`: the same values. Those of ASCII are
/// written so already.
pub fn printable_json(text: &str) -> Cow<'_, str> {
    let is_hidden = |c: char| c != '\n' && is_hidden(c);
    if !text.chars().any(is_hidden) {
        return text.into();
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_hidden(c) {
            write!(shown, "\\u{:04x}", u32::from(c)).expect("a string takes everything");
        } else {
            shown.push(c);
        }
    }
    shown.into()
}

/// Whether a terminal would obey a character instead of showing it.
fn is_hidden(c: char) -> bool {
    let turns = matches!(
        c,
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
    );
    // Some terminals and pagers begin a line there.
    let ends_a_line = matches!(c, '\u{2028}' | '\u{2029}');
    (c.is_control() && c != '\n' && c != '\t') || turns || ends_a_line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terminals_are_told_nothing() {
        let plain = "5 µm · ‖Δ‖ → 2.4 mm\n\titeration-00000001\n";
        assert!(matches!(printable(plain), Cow::Borrowed(text) if text == plain));
        for (text, shown) in [
            ("a\u{1b}[2Jb", "a\\u{1b}[2Jb"),
            ("a\rb\u{8}\u{7f}\0", "a\\rb\\u{8}\\u{7f}\\u{0}"),
            // A control sequence in one character.
            ("\u{9b}31m", "\\u{9b}31m"),
            // Shown from right to left: `exe.txt`.
            ("\u{202e}txt.exe", "\\u{202e}txt.exe"),
            ("a\u{61c}b\u{2028}c\u{2029}d", "a\\u{61c}b\\u{2028}c\\u{2029}d"),
        ] {
            assert_eq!(printable(text), shown);
        }
    }

    #[test]
    fn json_stays_the_same_value() {
        let value = serde_json::json!({ "a\u{1b}": "\u{9b}31m\u{202e}x\u{7f}\t\n" });
        let text = serde_json::to_string_pretty(&value).expect("JSON");
        let shown = printable_json(&text);
        assert!(!shown.chars().any(|c| c != '\n' && is_hidden(c)), "{shown:?}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&shown).expect("JSON"), value);
    }
}
