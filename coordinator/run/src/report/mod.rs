//! What a run tells its owner while it runs, and leaves behind to read afterwards.
//!
//! One [`Reporter`] turns every iteration into one [`Line`], and the line into
//!
//! * a JSON object in `metrics.jsonl` ([`store::jsonl`]), the record that everything else is made from;
//! * a row of `metrics.csv` ([`csv`]), the same numbers as a table;
//! * TensorBoard scalars in `events/` ([`tensorboard`]), over env-steps;
//! * the bar or the plain lines on the terminal ([`progress`]);
//! * at the end, the picture `curve.svg` ([`curve`]).
//!
//! What an evaluation on held-out goals says is a line of `evaluations.jsonl` and the scalars
//! `evaluation/…` of TensorBoard. A run evaluates to choose its best checkpoint (`run.evaluate_every`);
//! an evaluation that is not done when the next one begins is given up and leaves no line.
//!
//! # Keys of `metrics.jsonl`
//!
//! | key | unit | meaning |
//! |---|---|---|
//! | `iteration` | | number of the iteration, from 0 |
//! | `env_steps` | | env-steps trained on so far, this iteration included |
//! | `digest` | | fingerprint of the training state after the iteration, 32 hexadecimal digits |
//! | `policy_version` | | version of the policy that collected the samples |
//! | `blocks` | | fingerprints of the blocks trained on, a shard each; `octopus rollout` and the page make them again |
//! | `hosts` | | how many of `blocks` other machines made, by their names; only where some did, and not in the table |
//! | `wall_s` | s | time since the run began, over all its sessions |
//! | `env_steps_per_s` | 1/s | env-steps trained on a second, of late |
//! | `workers`, `restarts` | | workers wanted; workers and learners replaced so far |
//! | `returns` | | undiscounted return of an episode, mean over the iteration, an agent each |
//! | `return_mean` | | mean of `returns` |
//! | `policy_loss`, `value_loss` | | clipped surrogate, negated; value loss |
//! | `entropy` | nat | of the action distribution |
//! | `kl` | nat | divergence from the policy that collected the samples |
//! | `clip_fraction` | | share of samples whose ratio was clipped |
//! | `explained_variance` | | of the returns by the values, before the update; 1 is perfect |
//! | `actor_grad_norm`, `critic_grad_norm` | | global gradient norms before clipping |
//! | `errors.position` | m | of hands after an episode's last step, with exploration noise |
//! | `errors.orientation` | rad | likewise, orientation of hands |
//! | `errors.base` | rad | likewise, attitude of the base |
//! | `errors.contact_rate` | | share of control steps that end with any bodies touching |
//! | `actor_lr`, `critic_lr` | | learning rates in force |
//! | `action_std` | | mean standard deviation of the actions |
//! | `accounting.produced` | | env-steps that workers sent |
//! | `accounting.received` | | env-steps that arrived at the learner in time, or were compared: `trained + duplicate` |
//! | `accounting.trained` | | env-steps trained on |
//! | `accounting.duplicate` | | env-steps that arrived twice, or that other machines made for comparison, and were dropped |
//! | `accounting.lost` | | env-steps that died with a worker, came when their iteration was over, or from a machine that makes other bits: `produced - received` |
//! | `timing.wait_s`, `.update_s`, `.publish_s`, `.digest_s`, `.copy_s` | s | where the learner's time went |
//! | `timing.rollout_s` | s | the workers' time for the blocks trained on, summed |
//!
//! `errors`, `accounting` and `timing` are objects in the JSON and dotted columns in the table. A
//! number that is not finite is `null` in the JSON and empty in the table.
//!
//! # Keys of `evaluations.jsonl`
//!
//! | key | unit | meaning |
//! |---|---|---|
//! | `iteration`, `env_steps` | | what the policy had been trained on: so many iterations, from 1 |
//! | `wall_s` | s | when its last episode was played, since the run began, over all its sessions |
//! | `score` | | by which the best checkpoint is chosen; 1 is as good as the paper |
//! | `episodes`, `steps` | | goals, and control steps of each |
//! | `errors.tail.position`, `.orientation`, `.base` | m, rad, rad | over the last 20 steps, mean over goals and hands |
//! | `errors.min.position`, `.orientation`, `.base` | m, rad, rad | minimum over time, the paper's measure |
//!
//! # Resuming
//!
//! A run that continues at iteration k drops the lines of k and later, so no iteration stands
//! twice in a file, and drops a last line that a crash cut short. What it drops is [`promised`]: the
//! iterations that are trained on again must end with the same digests. TensorBoard's files are never
//! rewritten: the new one begins with the mark that makes TensorBoard forget what follows it.
//!
//! Before a checkpoint is committed the lines of its iterations are made durable ([`Durability`]),
//! so that they do not end before it after a power cut; a resume takes none that they do not reach
//! ([`store::recorded`]). A thread of its own writes them (`recorder.rs`): the run goes on while a disk stands still.

pub mod csv;
pub mod curve;
pub mod divergence;
mod eta;
pub mod evaluations;
mod line;
mod live;
mod margin;
pub mod points;
pub mod progress;
pub mod promised;
mod recorder;
pub mod row;
pub mod tensorboard;

use anyhow::Context as _;
pub use eta::Eta;
pub use evaluations::Evaluated;
pub use line::{Cell, Line};
pub use live::Live;
use output::printable::printable;
use proto::config::Config;
use proto::message::IterationReport;
use proto::run_dir::RunDir;
use proto::{Digest, ExitError};
pub use recorder::Durability;
use service::history::What;
pub use service::live::Diverged;
use service::live::LiveRun;
use store::budgets::Budgets;
use store::jsonl::JsonLines;

use self::csv::CsvTable;
use self::divergence::{CURE, Change, Divergence};
use self::evaluations::Evaluations;
use self::progress::Progress;
use self::promised::Promised;
use self::recorder::{Files, Recorder};
use self::tensorboard::EventWriter;

/// Writes the metrics of a run and shows its progress.
#[derive(Debug)]
pub struct Reporter {
    run_dir: RunDir,
    config: Config,
    recorder: Recorder,
    progress: Progress,
    divergence: Divergence,
    /// What earlier sessions of the run took, as the last kept line says (s).
    wall_before_s: f64,
    promised: Promised,
    budgets: Budgets,
    /// Who hears the notes, too.
    live: Option<LiveRun>,
}

impl Reporter {
    /// Opens the metrics files of `run_dir`. A run that continues at iteration `resume_from` keeps
    /// the lines before it; what the others were is promised of those to come, unless the run had
    /// another [budget](store::budgets) then. With `quiet` nothing is shown but notes.
    pub fn create(
        run_dir: &RunDir,
        config: &Config,
        resume_from: Option<u64>,
        quiet: bool,
    ) -> anyhow::Result<Self> {
        let keep = resume_from.unwrap_or(0);
        let mut promised = Promised::read(run_dir)?;
        let mut budgets = Budgets::read(run_dir)?;
        let (lines, last) = cut(run_dir, config, keep, &mut promised, &mut budgets)?;
        let evaluations = Evaluations::open(run_dir, keep)?;
        let table = CsvTable::open(&run_dir.metrics_csv(), keep)?;
        let divergence = Divergence::recorded(run_dir)?;
        let last = last.unwrap_or_default();
        let env_steps = last["env_steps"].as_u64().unwrap_or(0);
        let mut events = EventWriter::create(&run_dir.events())
            .with_context(|| format!("{}: cannot be written", run_dir.events().display()))?;
        if resume_from.is_some() {
            events.forget_after(env_steps)?;
        }
        Ok(Self {
            run_dir: run_dir.clone(),
            config: config.clone(),
            recorder: Recorder::start(Files { lines, evaluations, table, events })?,
            progress: Progress::new(config, env_steps, quiet),
            divergence,
            wall_before_s: last["wall_s"].as_f64().unwrap_or(0.0),
            promised,
            budgets,
            live: None,
        })
    }

    /// Refuses a digest that is not the one with which the iteration ended when it was trained on
    /// before.
    pub fn check_promised(&self, iteration: u64, digest: Digest) -> Result<(), ExitError> {
        self.promised.check(iteration, digest)
    }

    /// Drops the lines of `iteration` and later, which are to be trained on again.
    pub fn rewind(&mut self, iteration: u64) -> anyhow::Result<()> {
        // All lines are in the file, and no promise is being forgotten.
        self.recorder.wait_for(|_| Ok(()))?;
        let (promised, budgets) = (&mut self.promised, &mut self.budgets);
        let (lines, last) = cut(&self.run_dir, &self.config, iteration, promised, budgets)?;
        let run_dir = self.run_dir.clone();
        self.recorder.wait_for(move |files| {
            files.lines = lines;
            files.evaluations = Evaluations::open(&run_dir, iteration)?;
            files.table = CsvTable::open(&run_dir.metrics_csv(), iteration)?;
            let env_steps = last.and_then(|last| last["env_steps"].as_u64()).unwrap_or(0);
            files.events.forget_after(env_steps)
        })?;
        self.divergence = Divergence::recorded(&self.run_dir)?;
        Ok(())
    }

    /// Records an iteration; returns its line. It is written on another thread; what fails there is the
    /// error of the next call.
    pub fn iteration(
        &mut self,
        report: &IterationReport,
        live: &Live,
    ) -> anyhow::Result<serde_json::Value> {
        let session_s = live.wall_s;
        let live = Live { wall_s: session_s + self.wall_before_s, ..live.clone() };
        let line = Line::new(report, &live);
        self.progress.iteration(&line, session_s);
        self.watch(&line);
        let value = serde_json::to_value(&line).context("a line of metrics has no JSON form")?;
        let next = line.iteration + 1;
        self.recorder.line(line)?;
        if self.promised.is_passed(next) {
            self.recorder.kept(self.promised.take())?;
        }
        Ok(value)
    }

    /// Says so if the training diverges or has recovered.
    fn watch(&mut self, line: &Line) {
        match self.divergence.add(line.into()) {
            Some(Change::Diverged) => {
                if let Some(diverged) = self.divergence.found() {
                    let text = format!("warning: {diverged}; {CURE}");
                    self.progress.note(&text);
                }
            }
            Some(Change::Recovered) => {
                let text = format!("the training has recovered by iteration {}", line.iteration);
                self.progress.note(&text);
            }
            None => {}
        }
    }

    /// Where the training has diverged, unless it has recovered.
    pub fn diverged(&self) -> Option<&Diverged> {
        self.divergence.found()
    }

    /// Records an evaluation that was done `wall_s` after this session began.
    pub fn evaluation(&mut self, evaluated: &Evaluated, wall_s: f64) -> anyhow::Result<()> {
        self.recorder.evaluation(evaluated.clone(), wall_s + self.wall_before_s)
    }

    /// Says something that the owner should know: above the bar, or on a line of its own.
    pub fn note(&mut self, line: &str) {
        if let Some(live) = &self.live {
            live.tell(What::Note { text: line.to_owned() });
        }
        self.progress.note(&printable(line));
    }

    /// Notes are told to whoever watches the run, too.
    #[must_use]
    pub fn watched(self, live: LiveRun) -> Self {
        Self { live: Some(live), ..self }
    }

    /// What waits until the lines of all iterations so far are durable. Whoever commits a checkpoint of
    /// them does so first.
    pub fn durability(&self) -> Durability {
        self.recorder.durability()
    }

    /// Makes everything durable and draws the learning curve.
    pub fn finish(&mut self) -> anyhow::Result<()> {
        self.progress.finish();
        self.recorder.wait_for(|files| {
            files.sync()?;
            files.events.sync()
        })?;
        let points = points::read_points(&self.run_dir.metrics_jsonl())?;
        if points.len() > 1 {
            curve::draw(&self.run_dir.curve(), &points, self.config.task.name)?;
        }
        Ok(())
    }
}

/// Cuts the lines of iteration `keep` and later off the metrics; what they say is promised of these
/// iterations, if they are to be trained on again as they were.
fn cut(
    run_dir: &RunDir,
    config: &Config,
    keep: u64,
    promised: &mut Promised,
    budgets: &mut Budgets,
) -> anyhow::Result<(JsonLines, Option<serde_json::Value>)> {
    let repeat = budgets.repeat(config, keep);
    if repeat {
        // Before the cut: a kill in between loses nothing.
        promised.add(digests_from(run_dir, keep)?)?;
    }
    let opened = JsonLines::open(&run_dir.metrics_jsonl(), keep)?;
    if !repeat {
        promised.clear()?;
    }
    // Only now: until then the next session finds another budget than this one's, and does it again.
    match budgets.last() {
        Some(last) if repeat => budgets.begin(last.from, config.run.env_steps)?,
        Some(_) => budgets.begin(keep, config.run.env_steps)?,
        None => budgets.begin(0, config.run.env_steps)?,
    }
    Ok(opened)
}

/// Drops all lines of a run that starts anew, and what they promise: what they were made with is not known.
pub fn forget(run_dir: &RunDir) -> anyhow::Result<()> {
    JsonLines::open(&run_dir.metrics_jsonl(), 0)?;
    Promised::read(run_dir)?.clear()
}

/// Iterations from `keep` on that the metrics hold, and their digests.
fn digests_from(run_dir: &RunDir, keep: u64) -> anyhow::Result<Vec<(u64, Digest)>> {
    let lines = store::jsonl::read(&run_dir.metrics_jsonl())?;
    let digest = |line: &serde_json::Value| {
        Some((line["iteration"].as_u64()?, line["digest"].as_str()?.parse().ok()?))
    };
    let digests = lines.iter().filter_map(|(_, line)| digest(line));
    Ok(digests.filter(|(iteration, _)| *iteration >= keep).collect())
}

#[cfg(test)]
mod tests;
