//! Progress on standard error: a bar on a terminal, a plain line every few seconds elsewhere.

use std::io::{IsTerminal as _, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle, WeakProgressBar};
use output::grouped;
use proto::config::{Config, TaskName};

use super::{Eta, Line, eta, margin};

/// The bar on the terminal, if there is one, so that log lines can step around it.
static SHOWN: Mutex<Option<WeakProgressBar>> = Mutex::new(None);

/// Time between plain lines.
const PLAIN_INTERVAL: Duration = Duration::from_secs(5);

/// Shows how a run goes on.
#[derive(Debug)]
pub struct Progress {
    form: Form,
    task: TaskName,
    planned_iterations: u64,
    planned_steps: u64,
    time_limit: Option<Duration>,
    eta: Eta,
    last: Option<String>,
}

#[derive(Debug)]
enum Form {
    Bar(ProgressBar),
    Plain { shown_at: Option<Instant> },
    Nothing,
}

impl Progress {
    /// A bar over the budget of `config`, of which `env_steps` are done already.
    pub fn new(config: &Config, env_steps: u64, quiet: bool) -> Self {
        let planned_iterations = config.planned_iterations();
        let planned_steps = planned_iterations * config.steps_per_iteration();
        let form = if quiet {
            Form::Nothing
        } else if std::io::stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(Some(planned_steps), margin::stderr());
            let style = ProgressStyle::with_template(
                "{bar:24.cyan/black.bright} {percent:>3} %  {msg}  {prefix}",
            )
            .expect("the template is valid")
            .progress_chars("━╸─");
            bar.set_style(style);
            bar.set_position(env_steps);
            bar.set_message("starting");
            bar.tick();
            *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = Some(bar.downgrade());
            Form::Bar(bar)
        } else {
            Form::Plain { shown_at: None }
        };
        Self {
            form,
            task: config.task.name,
            planned_iterations,
            planned_steps,
            time_limit: config.run.time_limit(),
            eta: Eta::default(),
            last: None,
        }
    }

    /// Shows an iteration that has ended, so many seconds after this session began.
    pub fn iteration(&mut self, line: &Line, session_s: f64) {
        self.eta.iteration(line.accounting.trained, line.env_steps_per_s);
        let left = self.planned_steps.saturating_sub(line.env_steps);
        let session = Duration::from_secs_f64(session_s.clamp(0.0, 1e9));
        let limit = self.time_limit.map(|limit| limit.saturating_sub(session));
        let eta = eta::shown(self.eta.estimate(left, limit));
        let text = describe(line, self.task, self.planned_iterations);
        match &mut self.form {
            Form::Bar(bar) => {
                bar.set_prefix(eta);
                bar.set_message(text);
                bar.set_position(line.env_steps.min(self.planned_steps));
            }
            Form::Plain { shown_at } => {
                if shown_at.is_none_or(|at| at.elapsed() >= PLAIN_INTERVAL) {
                    *shown_at = Some(Instant::now());
                    self.last = None;
                    write_line(&format!("{text}  {eta}"));
                } else {
                    self.last = Some(text);
                }
            }
            Form::Nothing => {}
        }
    }

    /// Shows a line of its own.
    pub fn note(&mut self, line: &str) {
        match &self.form {
            Form::Bar(bar) => bar.println(line),
            Form::Plain { .. } | Form::Nothing => write_line(line),
        }
    }

    /// Leaves the last state on the screen.
    pub fn finish(&mut self) {
        match &self.form {
            Form::Bar(bar) => {
                if !bar.is_finished() {
                    bar.abandon();
                }
                *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = None;
            }
            Form::Plain { .. } => {
                if let Some(text) = self.last.take() {
                    write_line(&text);
                }
            }
            Form::Nothing => {}
        }
    }
}

/// Shows which of several stages is under way, where how long they take is not known.
#[derive(Debug)]
pub struct Stages {
    bar: Option<ProgressBar>,
}

impl Stages {
    /// A spinner on a terminal, a line a stage elsewhere.
    pub fn new() -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(None, margin::stderr());
            let style = ProgressStyle::with_template("{spinner:.cyan} {msg}  {elapsed}");
            bar.set_style(style.expect("the template is valid"));
            bar.enable_steady_tick(Duration::from_millis(250));
            *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = Some(bar.downgrade());
            bar
        });
        Self { bar }
    }

    /// The next stage begins.
    pub fn begin(&self, stage: String) {
        match &self.bar {
            Some(bar) => bar.set_message(stage),
            None => write_line(&stage),
        }
    }

    /// The terminal is free for what comes next.
    pub fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
            *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
    }
}

impl Default for Stages {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Stages {
    fn drop(&mut self) {
        self.end();
    }
}

/// One line about an iteration: what a person watches.
fn describe(line: &Line, task: TaskName, planned_iterations: u64) -> String {
    let errors = match task {
        TaskName::Trajectory => format!(
            "error {:.0} mm {:.0} mrad",
            1e3 * line.errors.position,
            1e3 * line.errors.orientation
        ),
        TaskName::Reorientation => format!("error {:.1} mrad", 1e3 * line.errors.base),
    };
    format!(
        "iteration {}/{planned_iterations}  {} env-steps/s  return {:.2}  {errors}",
        line.iteration + 1,
        grouped(line.env_steps_per_s.max(0.0) as u64),
        line.return_mean,
    )
}

/// Shows how far a work of known length has come: a bar on a terminal, a line a part elsewhere.
#[derive(Debug)]
pub struct Parts {
    bar: Option<ProgressBar>,
    /// Whether the bar is over all parts together.
    whole: bool,
}

impl Parts {
    /// Nothing done yet; each part has a bar of its own.
    pub fn new() -> Self {
        Self::with_length(None)
    }

    /// Nothing done yet of parts that have `steps` steps together, which one bar is over.
    pub fn over(steps: u64) -> Self {
        Self::with_length(Some(steps))
    }

    fn with_length(steps: Option<u64>) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let length = steps.unwrap_or(0);
            let bar = ProgressBar::with_draw_target(Some(length), margin::stderr());
            let style = ProgressStyle::with_template(
                "{bar:24.cyan/black.bright} {percent:>3} %  {msg}  eta {eta}",
            )
            .expect("the template is valid")
            .progress_chars("━╸─");
            bar.set_style(style);
            *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = Some(bar.downgrade());
            bar
        });
        Self { bar, whole: steps.is_some() }
    }

    /// The next part begins, of so many steps.
    pub fn begin(&self, part: &str, steps: u64) {
        match &self.bar {
            Some(bar) if self.whole => bar.set_message(part.to_owned()),
            Some(bar) => {
                bar.set_length(steps);
                bar.set_position(0);
                bar.reset_eta();
                bar.set_message(part.to_owned());
            }
            None => write_line(part),
        }
    }

    /// A step of the part is done.
    pub fn advance(&self) {
        if let Some(bar) = &self.bar {
            bar.inc(1);
        }
    }

    /// The terminal is free for what comes next.
    pub fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
            *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
    }
}

impl Default for Parts {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Parts {
    fn drop(&mut self) {
        self.end();
    }
}

/// Standard error may be closed; a run goes on without its spectators.
fn write_line(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Standard error for logs: a line that is written while a bar is shown appears above it.
#[derive(Debug, Clone, Copy, Default)]
pub struct LogWriter;

impl Write for LogWriter {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let bar = SHOWN
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .as_ref()
            .and_then(WeakProgressBar::upgrade);
        // A log that cannot be written, as on a terminal that is closed, is none to complain about there.
        let _ = match bar {
            Some(bar) => bar.suspend(|| std::io::stderr().write_all(bytes)),
            None => std::io::stderr().write_all(bytes),
        };
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().flush()
    }
}
