//! Logs: lines on standard error, for people in the words of the rest, chosen by `RUST_LOG`.

use std::fmt;
use std::fmt::Write as _;
use std::io::IsTerminal as _;

use output::printable::printable;
use run::report::progress::LogWriter;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt as _;

/// Sends the logs of this program to standard error, around a progress bar if there is one.
///
/// Without `RUST_LOG` these are warnings and errors, and read like the program's own: `warning: …`.
/// Who sets it wants a log, and gets times, levels and fields.
pub fn init() {
    let lines =
        tracing_subscriber::fmt::layer().with_writer(|| LogWriter).log_internal_errors(false);
    if let Some(filter) = process::logging::filter() {
        let lines = lines.with_target(false).with_ansi(std::io::stderr().is_terminal());
        tracing_subscriber::registry().with(filter).with(lines).init();
    } else {
        let filter = Targets::new().with_default(LevelFilter::WARN);
        tracing_subscriber::registry().with(filter).with(lines.event_format(Console)).init();
    }
}

/// Writes an event as the program writes its own notes: `warning: what happened: why (key: value)`.
struct Console;

impl<S, N> FormatEvent<S, N> for Console
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        _context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let mut sentence = Sentence::default();
        event.record(&mut sentence);
        let level = match *event.metadata().level() {
            Level::ERROR => "error",
            Level::WARN => "warning",
            _ => "note",
        };
        writeln!(writer, "{}", printable(&format!("{level}: {sentence}")))
    }
}

/// The fields of an event, put together for a person.
#[derive(Debug, Default)]
struct Sentence {
    message: String,
    reason: String,
    rest: String,
}

impl Sentence {
    fn add(&mut self, name: &str, value: fmt::Arguments<'_>) {
        let written = match name {
            "message" => self.message.write_fmt(value),
            "error" | "reason" => write!(self.reason, ": {value}"),
            _ => {
                let comma = if self.rest.is_empty() { "" } else { ", " };
                write!(self.rest, "{comma}{name}: {value}")
            }
        };
        written.expect("a string takes everything");
    }
}

impl Visit for Sentence {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.add(field.name(), format_args!("{value}"));
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.add(field.name(), format_args!("{value:?}"));
    }
}

impl fmt::Display for Sentence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { message, reason, rest } = self;
        write!(f, "{message}{reason}")?;
        if rest.is_empty() { Ok(()) } else { write!(f, " ({rest})") }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::{Arc, Mutex};

    use super::*;

    #[derive(Clone, Default)]
    struct Page(Arc<Mutex<Vec<u8>>>);

    impl Write for Page {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().expect("not poisoned").write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn warnings_read_like_the_programs_own() {
        let page = Page::default();
        let writer = page.clone();
        let console = tracing_subscriber::fmt()
            .event_format(Console)
            .with_writer(move || writer.clone())
            .finish();
        tracing::subscriber::with_default(console, || {
            let error = std::io::Error::other("is too short");
            tracing::error!(%error, "damaged checkpoint, taking the one before");
            let path = std::path::Path::new("a/catalogue.sqlite");
            tracing::warn!(catalogue = %path.display(), reason = "it is old", "it is rebuilt");
            tracing::warn!(orders = 3, shards = 4, "orders are overdue");
        });
        let text = String::from_utf8(page.0.lock().expect("not poisoned").clone()).expect("UTF-8");
        assert_eq!(
            text,
            "error: damaged checkpoint, taking the one before: is too short\n\
             warning: it is rebuilt: it is old (catalogue: a/catalogue.sqlite)\n\
             warning: orders are overdue (orders: 3, shards: 4)\n"
        );
    }
}
