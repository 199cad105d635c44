//! The text format of Prometheus, version 0.0.4.
//!
//! Crates that write it want to own the numbers, as counters that the program turns. Here they are read off a status
//! that exists anyway, once a request.

use std::fmt::Write as _;

/// Content type of the format.
pub(super) const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// A page of metrics, family after family.
#[derive(Debug, Default)]
pub(super) struct Exposition(String);

/// A metric's name and labels, see [`Exposition::sample`].
type Labels<'a> = &'a [(&'a str, &'a str)];

impl Exposition {
    /// Begins a family; its samples must follow before the next one begins.
    pub(super) fn family(&mut self, name: &str, kind: &str, help: &str) {
        let help = help.replace('\\', "\\\\").replace('\n', "\\n");
        self.push(format_args!("# HELP {name} {help}\n# TYPE {name} {kind}\n"));
    }

    /// Adds a sample of the family begun last.
    pub(super) fn sample(&mut self, name: &str, labels: Labels<'_>, value: f64) {
        self.push(format_args!("{name}"));
        for (index, (label, text)) in labels.iter().enumerate() {
            let text = text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
            let open = if index == 0 { '{' } else { ',' };
            self.push(format_args!("{open}{label}=\"{text}\""));
        }
        let close = if labels.is_empty() { "" } else { "}" };
        // Go's names of the special values, which Rust spells differently.
        match value {
            f64::INFINITY => self.push(format_args!("{close} +Inf\n")),
            f64::NEG_INFINITY => self.push(format_args!("{close} -Inf\n")),
            value => self.push(format_args!("{close} {value}\n")),
        }
    }

    /// A family of one sample.
    pub(super) fn single(&mut self, name: &str, kind: &str, help: &str, value: f64) {
        self.family(name, kind, help);
        self.sample(name, &[], value);
    }

    /// A family with one sample for each value of one label.
    pub(super) fn by<'a>(
        &mut self,
        (name, kind, help): (&str, &str, &str),
        label: &str,
        samples: impl IntoIterator<Item = (&'a str, f64)>,
    ) {
        self.family(name, kind, help);
        for (text, value) in samples {
            self.sample(name, &[(label, text)], value);
        }
    }

    /// The page.
    pub(super) fn into_text(self) -> String {
        self.0
    }

    fn push(&mut self, arguments: std::fmt::Arguments<'_>) {
        self.0.write_fmt(arguments).expect("a String takes every text");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_format_escapes() {
        let mut page = Exposition::default();
        page.family("a_total", "counter", "one\ntwo \\ three");
        page.sample("a_total", &[("path", "C:\\\"x\"\n"), ("b", "")], 1.5);
        page.single("b", "gauge", "none", f64::INFINITY);
        page.sample("b", &[], f64::NAN);
        assert_eq!(
            page.into_text(),
            "# HELP a_total one\\ntwo \\\\ three\n# TYPE a_total counter\n\
             a_total{path=\"C:\\\\\\\"x\\\"\\n\",b=\"\"} 1.5\n\
             # HELP b none\n# TYPE b gauge\nb +Inf\nb NaN\n"
        );
    }
}
