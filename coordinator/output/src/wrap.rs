//! Sentences that fit.

use unicode_width::UnicodeWidthStr as _;

/// A text in lines of at most `columns` characters, of which all but the first begin with `indent` spaces. The first
/// is part of a line that has `begun` characters already. A word that is longer than a line, as a path may be, stays
/// whole.
pub fn wrap_within(columns: usize, begun: usize, indent: usize, text: &str) -> String {
    let mut wrapped = String::with_capacity(text.len() + 16);
    let mut column = begun;
    for (index, line) in text.lines().enumerate() {
        if index > 0 {
            wrapped.push('\n');
            wrapped.push_str(&" ".repeat(indent));
            column = indent;
        }
        for (word_index, word) in line.split(' ').enumerate() {
            let len = word.width();
            if word_index > 0 && column + 1 + len > columns {
                wrapped.push('\n');
                wrapped.push_str(&" ".repeat(indent));
                column = indent;
            } else if word_index > 0 {
                wrapped.push(' ');
                column += 1;
            }
            wrapped.push_str(word);
            column += len;
        }
    }
    wrapped
}

/// The same for standard output, from the beginning of a line.
pub fn wrap(text: &str) -> String {
    wrap_within(super::columns(), 0, 0, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_filled_and_no_word_is_broken() {
        let text = "one two three /a/long/path/without/spaces four";
        assert_eq!(
            wrap_within(14, 0, 2, text),
            "one two three\n  /a/long/path/without/spaces\n  four"
        );
        assert_eq!(wrap_within(14, 4, 4, "one two three"), "one two\n    three");
        assert_eq!(wrap_within(80, 0, 0, text), text);
        assert_eq!(wrap_within(80, 0, 2, "one\n\ntwo"), "one\n  \n  two");
    }
}
