//! Progress on standard error: a bar on a terminal, a plain line every few seconds elsewhere.

use std::io::{IsTerminal as _, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle, WeakProgressBar};
use output::grouped;
use output::printable::printable;
use proto::config::{Config, TaskName};

use super::eta::Eta;
use super::line::Line;
use super::{eta, margin};

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
            let bar = run_bar(planned_steps, env_steps, margin::stderr());
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
        let estimate = self.eta.estimate(left, limit);
        match &mut self.form {
            Form::Bar(bar) => {
                bar.set_prefix(eta::brief(estimate));
                bar.set_message(describe_briefly(line, self.task, self.planned_iterations));
                bar.set_position(line.env_steps.min(self.planned_steps));
            }
            Form::Plain { shown_at } => {
                let text = describe(line, self.task, self.planned_iterations);
                if shown_at.is_none_or(|at| at.elapsed() >= PLAIN_INTERVAL) {
                    *shown_at = Some(Instant::now());
                    self.last = None;
                    output::note(&format!("{text}  {}", eta::shown(estimate)));
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
            Form::Bar(bar) => bar.println(printable(line)),
            Form::Plain { .. } | Form::Nothing => output::note(line),
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
                    output::note(&text);
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
    pub fn begin(&self, stage: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(printable(stage).into_owned()),
            None => output::note(stage),
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

/// The bar of a run, of which `env_steps` are done. It fits on a narrow terminal; what has no room is cut.
fn run_bar(planned_steps: u64, env_steps: u64, target: ProgressDrawTarget) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(planned_steps), target);
    bar.set_style(style("{bar:12.cyan/black.bright} {percent:>3} %  {prefix}  {wide_msg}"));
    bar.set_position(env_steps);
    bar.set_message("starting");
    bar.tick();
    bar
}

/// The bar of [`Parts`], with a time that says nothing before anything is known.
fn parts_bar(length: u64, target: ProgressDrawTarget) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), target);
    let left = |state: &ProgressState, to: &mut dyn std::fmt::Write| {
        let length = state.len().unwrap_or(0);
        let left = match state.pos() {
            0 => String::new(),
            done if done < length => eta::brief(Some(state.eta())),
            _ => eta::brief(None),
        };
        // A text that cannot be written is not shown.
        let _ = write!(to, "{left:7}");
    };
    let style = style("{bar:12.cyan/black.bright} {percent:>3} %  {left}  {wide_msg}");
    bar.set_style(style.with_key("left", left));
    bar
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).expect("the template is valid").progress_chars("━╸─")
}

/// One line about an iteration: what a person watches.
fn describe(line: &Line, task: TaskName, planned_iterations: u64) -> String {
    format!(
        "iteration {}/{planned_iterations}  {} env-steps/s  return {:.2}  error {}",
        line.iteration + 1,
        grouped(line.env_steps_per_s.max(0.0) as u64),
        line.return_mean,
        errors(line, task),
    )
}

/// The same beside a bar.
fn describe_briefly(line: &Line, task: TaskName, planned_iterations: u64) -> String {
    format!(
        "{}/{planned_iterations}  {}/s  return {:.1}  {}",
        line.iteration + 1,
        grouped(line.env_steps_per_s.max(0.0) as u64),
        line.return_mean,
        errors(line, task),
    )
}

fn errors(line: &Line, task: TaskName) -> String {
    let errors = &line.errors;
    let hands = format!("{:.0} mm {:.0} mrad", 1e3 * errors.position, 1e3 * errors.orientation);
    let base = format!("{:.1} mrad", 1e3 * errors.base);
    match (task.reaches(), task.turns()) {
        (true, true) => format!("{hands}, base {base}"),
        (true, false) => hands,
        (false, _) => base,
    }
}

/// Shows how far a work of known length has come: a bar on a terminal, a line a part elsewhere.
#[derive(Debug)]
pub struct Parts {
    bar: Option<ProgressBar>,
    /// Whether the bar is over all parts together.
    whole: bool,
    /// Whether nothing is said of parts.
    silent: bool,
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

    /// Says nothing: several are under way beside each other, or others show how far they are.
    pub fn silent() -> Self {
        Self { bar: None, whole: false, silent: true }
    }

    fn with_length(steps: Option<u64>) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = parts_bar(steps.unwrap_or(0), margin::stderr());
            *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = Some(bar.downgrade());
            bar
        });
        Self { bar, whole: steps.is_some(), silent: false }
    }

    /// The next part begins, of so many steps.
    pub fn begin(&self, part: &str, steps: u64) {
        match &self.bar {
            Some(bar) if self.whole => bar.set_message(printable(part).into_owned()),
            Some(bar) => {
                bar.set_length(steps);
                bar.set_position(0);
                bar.reset_eta();
                bar.set_message(printable(part).into_owned());
            }
            None if self.silent => {}
            None => output::note(part),
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

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

    use proto::message::IterationReport;

    use super::*;
    use crate::report::Live;
    use crate::report::margin::tests::{Screen, on};

    fn line(iteration: u64) -> Line {
        let mut report = IterationReport { iteration, ..IterationReport::default() };
        report.accounting.trained = 3200;
        Line::new(
            &report,
            &Live { wall_s: 1.0, env_steps_per_s: 9000.0, workers: 2, ..Live::default() },
        )
    }

    /// A screen, and a progress of a run of as many env-steps as anybody wants that is shown on it.
    fn shown() -> (Screen, Progress) {
        let screen = Screen::new(80);
        let layers = Layers::new(Preset::Tuned, None).set("run.env_steps=300000000");
        let config = layers.and_then(|layers| layers.resolve()).expect("valid");
        let mut progress = Progress::new(&config, 0, true);
        progress.form = Form::Bar(run_bar(progress.planned_steps, 0, on(&screen)));
        (screen, progress)
    }

    #[test]
    fn the_bar_of_a_run_is_one_row_of_80_columns_whatever_it_says() {
        let (screen, mut progress) = shown();
        let mut large = line(99_998);
        large.return_mean = -98_765.4;
        large.env_steps_per_s = 123_456.0;
        (large.errors.position, large.errors.orientation) = (9.999, 3.111);
        progress.iteration(&large, 10.0);
        let rows = screen.rows();
        assert_eq!(rows.len(), 1, "{rows:?}");
        for part in ["eta ", "99999/", "123,456/s", "return -98765.4"] {
            assert!(rows[0].contains(part), "{part} is not in {rows:?}");
        }
        assert!(rows[0].chars().count() <= 76, "room for ^C: {rows:?}");
        // What a run says mostly is there to its end.
        let mut usual = line(411);
        (usual.return_mean, usual.env_steps_per_s) = (-12.34, 5432.1);
        (usual.errors.position, usual.errors.orientation) = (0.012, 0.034);
        progress.iteration(&usual, 10.0);
        assert!(screen.rows()[0].contains("12 mm 34 mrad"), "{:?}", screen.rows());
        // Ctrl-C leaves no copy of it.
        screen.put("^C");
        progress.note("stopping");
        progress.iteration(&usual, 10.0);
        assert_eq!(screen.lines_with("412/"), 1, "{:?}", screen.rows());
    }

    #[test]
    fn parts_are_one_row_and_never_over_before_they_are() {
        let screen = Screen::new(80);
        let bar = parts_bar(50, on(&screen));
        let parts = Parts { bar: Some(bar), whole: true, silent: false };
        let long =
            "disturbance, trajectory: 50 N on hand 2 in each of six directions, and back again";
        parts.begin(long, 50);
        for done in 0..50 {
            let rows = screen.rows();
            assert_eq!(rows.len(), 1, "{rows:?}");
            assert!(
                rows[0].chars().count() <= 76 && rows[0].contains("disturbance, traj"),
                "{rows:?}"
            );
            assert!(!rows[0].contains(" 0s") && !rows[0].contains("ending"), "{done}: {rows:?}");
            assert_eq!(rows[0].contains("eta "), done > 0, "{done}: {rows:?}");
            parts.advance();
            if let Some(bar) = &parts.bar {
                bar.force_draw();
            }
        }
        assert!(screen.rows()[0].contains("ending"), "{:?}", screen.rows());
    }

    #[test]
    fn what_is_told_beside_a_bar_moves_no_cursor() {
        let (screen, mut progress) = shown();
        progress.note("a\u{1b}[2Jb");
        assert_eq!(screen.lines_with("a\\u{1b}[2Jb"), 1, "{:?}", screen.rows());
    }
}
