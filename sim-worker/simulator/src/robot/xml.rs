//! Elements of XML, one a line, indented as they nest.

use std::fmt::Write as _;

/// A text that grows.
pub(super) struct Xml {
    text: String,
    depth: usize,
}

impl Xml {
    /// A text that begins so.
    pub(super) fn new(beginning: &str) -> Self {
        Self { text: beginning.to_owned(), depth: 0 }
    }

    fn put(&mut self, element: &str) {
        writeln!(self.text, "{:indent$}<{element}>", "", indent = 2 * self.depth)
            .expect("writing to a string");
    }

    /// An element without content: its name and attributes.
    pub(super) fn line(&mut self, element: &str) {
        self.put(&format!("{element}/"));
    }

    /// Begins an element: its name and attributes.
    pub(super) fn open(&mut self, element: &str) {
        self.put(element);
        self.depth += 1;
    }

    /// Ends the element that was begun last.
    pub(super) fn close(&mut self, name: &str) {
        self.depth -= 1;
        self.put(&format!("/{name}"));
    }

    /// The whole text.
    pub(super) fn into_text(self) -> String {
        self.text
    }
}

/// Shortest decimals that read back to the same numbers.
pub(super) fn numbers(values: &[f64]) -> String {
    values.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
}
