//! What has happened in a run of late: who made which block, who died, what its owner was told.

use std::collections::VecDeque;
use std::time::Instant;

use proto::message::WorkerId;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Blocks and updates that are kept: several minutes of a training, of which a page shows the last.
const WORK: usize = 2000;
/// What is rarer is kept longer.
const RARE: usize = 1000;

/// Something that has happened. Without a worker it is about the learner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "what", rename_all = "lowercase")]
pub enum What {
    /// A worker has made a block.
    Block {
        /// Which one.
        worker: WorkerId,
        /// Of which iteration.
        iteration: u64,
        /// Its shard.
        shard: u32,
        /// How long that took (s).
        seconds: f64,
    },
    /// The learner has trained on an iteration.
    Update {
        /// Which one.
        iteration: u64,
        /// How long that took, without waiting for blocks (s).
        seconds: f64,
    },
    /// A process is ready.
    Ready {
        /// Which worker.
        worker: Option<WorkerId>,
    },
    /// A process has died; a successor starts.
    Died {
        /// Which worker.
        worker: Option<WorkerId>,
        /// Why.
        cause: String,
    },
    /// A worker that was asked to has gone.
    Left {
        /// Which one.
        worker: Option<WorkerId>,
    },
    /// What the owner of the run was told.
    Note {
        /// In these words.
        text: String,
    },
}

/// Something that has happened, and when.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Happening {
    /// Counts what has happened in this session of the run.
    pub number: u64,
    /// When it was over, since the session began (s).
    pub at_s: f64,
    /// What.
    #[serde(flatten)]
    pub what: What,
}

/// What has happened of late; older things make room.
#[derive(Debug)]
pub(crate) struct History {
    begun: Instant,
    next: u64,
    work: VecDeque<Happening>,
    rare: VecDeque<Happening>,
}

impl Default for History {
    fn default() -> Self {
        Self { begun: Instant::now(), next: 0, work: VecDeque::new(), rare: VecDeque::new() }
    }
}

impl History {
    pub(crate) fn tell(&mut self, what: What) {
        let is_work = matches!(what, What::Block { .. } | What::Update { .. });
        let (queue, most) = if is_work { (&mut self.work, WORK) } else { (&mut self.rare, RARE) };
        if queue.len() == most {
            queue.pop_front();
        }
        let at_s = self.begun.elapsed().as_secs_f64();
        queue.push_back(Happening { number: self.next, at_s, what });
        self.next += 1;
    }

    /// What is kept from a number on, in order; the number of what happens next; the time (s).
    pub(crate) fn since(&self, from: u64) -> (Vec<Happening>, u64, f64) {
        let newer = |queue: &VecDeque<Happening>| {
            let start = queue.partition_point(|happening| happening.number < from);
            queue.range(start..).cloned().collect::<Vec<_>>()
        };
        let mut found = newer(&self.work);
        found.extend(newer(&self.rare));
        found.sort_by_key(|happening| happening.number);
        (found, self.next, self.begun.elapsed().as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_blocks_leaves_the_dead_where_they_are() {
        let mut history = History::default();
        history.tell(What::Died { worker: Some(1), cause: "killed".to_owned() });
        for iteration in 0..2 * WORK as u64 {
            history.tell(What::Block { worker: 1, iteration, shard: 0, seconds: 0.1 });
        }
        let (found, next, _) = history.since(0);
        assert_eq!((found.len(), next), (WORK + 1, 2 * WORK as u64 + 1));
        assert!(matches!(found[0].what, What::Died { worker: Some(1), .. }));
        assert!(found.is_sorted_by_key(|happening| happening.number));
        let (found, ..) = history.since(next - 1);
        assert_eq!(found.iter().map(|happening| happening.number).collect::<Vec<_>>(), [next - 1]);
        assert!(history.since(next).0.is_empty());
    }
}
