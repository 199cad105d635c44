//! Writes the files of a run's metrics on a thread of its own, in the order in which their lines come:
//! the run's loop never waits for a disk.
//!
//! Who commits a checkpoint waits until the lines of its iterations are durable ([`Durability`]). After a
//! failure nothing more is written, so that no line is left out, and whoever hands over the next one is
//! told.

use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

use anyhow::{Context as _, anyhow};
use store::jsonl::JsonLines;

use super::csv::CsvTable;
use super::evaluations::{Evaluated, Evaluations};
use super::line::Line;
use super::promised::Promised;
use super::tensorboard::EventWriter;

/// Lines that may wait; a disk that is slower for longer holds the run up.
const QUEUE: usize = 1024;

/// The open files.
#[derive(Debug)]
pub(super) struct Files {
    pub(super) lines: JsonLines,
    pub(super) evaluations: Evaluations,
    pub(super) table: CsvTable,
    pub(super) events: EventWriter,
}

impl Files {
    fn append(&mut self, line: &Line) -> anyhow::Result<()> {
        self.lines.append(line)?;
        self.table.append(line)?;
        self.events.append(line)
    }

    fn append_evaluation(&mut self, evaluated: &Evaluated, wall_s: f64) -> anyhow::Result<()> {
        if self.evaluations.append(evaluated, wall_s)? {
            self.events.append_evaluation(evaluated)?;
        }
        Ok(())
    }

    /// Makes durable what a checkpoint relies on.
    pub(super) fn sync(&mut self) -> anyhow::Result<()> {
        self.lines.sync()?;
        self.table.sync()?;
        self.evaluations.sync()
    }
}

type Work = Box<dyn FnOnce(&mut Files) -> anyhow::Result<()> + Send>;

enum RecordRequest {
    Line(Box<Line>),
    Evaluation(Box<Evaluated>, f64),
    /// The last promise is kept; its file may go, once the digests are safe in the lines again.
    Kept(Promised),
    /// Anything else, and whoever waits for it.
    Do(Work, Sender<anyhow::Result<()>>),
    End,
}

/// The loop's side. Dropping it waits until everything is written.
#[derive(Debug)]
pub(super) struct Recorder {
    jobs: SyncSender<RecordRequest>,
    failure: Arc<OnceLock<String>>,
    thread: Option<JoinHandle<()>>,
}

impl Recorder {
    /// Starts the thread.
    pub(super) fn start(files: Files) -> anyhow::Result<Self> {
        let (jobs, orders) = sync_channel(QUEUE);
        let failure = Arc::new(OnceLock::new());
        let failed = Arc::clone(&failure);
        let thread = std::thread::Builder::new()
            .name("metrics".to_owned())
            .spawn(move || work(files, &orders, &failed))
            .context("no thread can be started")?;
        Ok(Self { jobs, failure, thread: Some(thread) })
    }

    /// Records an iteration.
    pub(super) fn line(&self, line: Line) -> anyhow::Result<()> {
        self.hand_over(RecordRequest::Line(Box::new(line)))
    }

    /// Records an evaluation.
    pub(super) fn evaluation(&self, evaluated: Evaluated, wall_s: f64) -> anyhow::Result<()> {
        self.hand_over(RecordRequest::Evaluation(Box::new(evaluated), wall_s))
    }

    /// Removes the file of promises that are all kept.
    pub(super) fn kept(&self, promised: Promised) -> anyhow::Result<()> {
        self.hand_over(RecordRequest::Kept(promised))
    }

    /// Does something with the files after all that was handed over before, and waits for it.
    pub(super) fn wait_for(
        &self,
        work: impl FnOnce(&mut Files) -> anyhow::Result<()> + Send + 'static,
    ) -> anyhow::Result<()> {
        wait_for(&self.jobs, Box::new(work))
    }

    /// What waits until all that was handed over before is durable.
    pub(super) fn durability(&self) -> Durability {
        Durability(self.jobs.clone())
    }

    fn hand_over(&self, job: RecordRequest) -> anyhow::Result<()> {
        if let Some(failure) = self.failure.get() {
            return Err(anyhow!("{failure}"));
        }
        self.jobs.send(job).map_err(|_| gone())
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // A thread that has panicked shows when it is joined.
        let _ = self.jobs.send(RecordRequest::End);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that writes the metrics had panicked");
        }
    }
}

/// Waits, on any thread, until all lines that were handed over before are durable.
#[derive(Debug, Clone)]
pub struct Durability(SyncSender<RecordRequest>);

impl Durability {
    /// See the type.
    pub fn wait(&self) -> anyhow::Result<()> {
        wait_for(&self.0, Box::new(Files::sync))
    }
}

#[cfg(test)]
impl Durability {
    /// Has the thread do nothing more until what is returned is dropped, as on a disk that stands still.
    pub(super) fn stand_still(&self) -> Sender<()> {
        let (end, wait) = channel();
        let (done, _) = channel();
        let work: Work = Box::new(move |_| {
            // That nothing is ever sent is how it ends.
            let _ = wait.recv();
            Ok(())
        });
        self.0.send(RecordRequest::Do(work, done)).expect("the thread lives");
        end
    }
}

fn wait_for(jobs: &SyncSender<RecordRequest>, work: Work) -> anyhow::Result<()> {
    let (done, wait) = channel();
    jobs.send(RecordRequest::Do(work, done)).map_err(|_| gone())?;
    wait.recv().map_err(|_| gone())?
}

fn gone() -> anyhow::Error {
    anyhow!("the thread that writes the metrics has ended")
}

fn work(mut files: Files, jobs: &Receiver<RecordRequest>, failure: &OnceLock<String>) {
    for job in jobs {
        let failed = || failure.get().map_or(Ok(()), |failure| Err(anyhow!("{failure}")));
        let result = match job {
            RecordRequest::End => return,
            RecordRequest::Do(work, done) => {
                let result = failed().and_then(|()| work(&mut files));
                if let Err(error) = &result {
                    // Before anybody knows of it, so that nothing is handed over any more then.
                    let _ = failure.set(format!("{error:#}"));
                }
                // Who asked may have gone.
                let _ = done.send(result);
                continue;
            }
            _ if failure.get().is_some() => continue,
            RecordRequest::Line(line) => files.append(&line),
            RecordRequest::Evaluation(evaluated, wall_s) => {
                files.append_evaluation(&evaluated, wall_s)
            }
            RecordRequest::Kept(mut promised) => files.lines.sync().and_then(|()| promised.clear()),
        };
        if let Err(error) = result {
            let _ = failure.set(format!("{error:#}"));
        }
    }
}

impl std::fmt::Debug for RecordRequest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Line(_) => "Line",
            Self::Evaluation(..) => "Evaluation",
            Self::Kept(_) => "Kept",
            Self::Do(..) => "Do",
            Self::End => "End",
        })
    }
}
