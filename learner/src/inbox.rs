//! The inbox: blocks as they arrive, checked, counted, and handed out in the order of shards.
//!
//! Blocks stay in shared memory; the inbox holds their samples until the iteration is trained on.
//! What is trained on does not depend on who sent a block, or when: a block that is there already
//! is dropped, after a look whether it really is the same.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use channels::ArraySample;
use proto::config::{Config, TaskName};
use proto::finite::are_finite;
use proto::layout::{BlockHeader, BlockLayout, Dimensions, EpisodeMetrics};
use proto::message::{Accounting, Errors, HostId, Membership, membership_of, policy_version_for};

use crate::LearnerError;

/// Something that holds a block.
pub trait Block {
    /// What it says about itself.
    fn header(&self) -> &BlockHeader;
    /// Its numbers.
    fn payload(&self) -> &[f32];
}

impl Block for ArraySample<BlockHeader> {
    fn header(&self) -> &BlockHeader {
        self.header()
    }

    fn payload(&self) -> &[f32] {
        self.payload()
    }
}

/// Whether a block was news.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Receipt {
    /// It will be trained on.
    Fresh,
    /// It was there already, or its iteration is over, and then it does not count as received; it is dropped.
    Duplicate,
    /// It came from a host whose blocks are not wanted; it is dropped, and does not count as received.
    Unwanted,
}

/// Blocks of the iteration to be trained on next and, with overlap, of the one after.
#[derive(Debug)]
pub struct Inbox<B> {
    dimensions: Dimensions,
    layout: BlockLayout,
    overlap: usize,
    iteration: u64,
    blocks: BTreeMap<(u64, u32), B>,
    accounting: BTreeMap<u64, Accounting>,
    /// Hosts whose blocks are not wanted.
    unwanted: BTreeSet<Membership>,
}

impl<B: Block> Inbox<B> {
    /// An empty inbox that expects the blocks of `iteration`.
    pub fn new(config: &Config, dimensions: &Dimensions, iteration: u64) -> Self {
        Self {
            dimensions: *dimensions,
            layout: BlockLayout::new(dimensions),
            overlap: config.run.overlap,
            iteration,
            blocks: BTreeMap::new(),
            accounting: BTreeMap::new(),
            unwanted: BTreeSet::new(),
        }
    }

    /// Env-steps of a block.
    fn block_steps(&self) -> u64 {
        (self.dimensions.n_envs * self.dimensions.n_steps) as u64
    }

    /// Takes a block in.
    pub fn receive(&mut self, block: B) -> Result<Receipt, LearnerError> {
        let header = *block.header();
        if membership(&header).is_some_and(|of| self.unwanted.contains(&of)) {
            return Ok(Receipt::Unwanted);
        }
        self.check_header(&header, block.payload().len())?;
        if header.iteration < self.iteration {
            // Lost, by what its worker has told the coordinator.
            return Ok(Receipt::Duplicate);
        }
        let steps = self.block_steps();
        let account = self.accounting.entry(header.iteration).or_default();
        account.received += steps;
        if let Some(present) = self.blocks.get(&(header.iteration, header.shard)) {
            account.duplicate += steps;
            let same =
                |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
            if !same(present.payload(), block.payload()) {
                return Err(LearnerError::Impure {
                    iteration: header.iteration,
                    shard: header.shard,
                    workers: [present.header().worker, header.worker],
                });
            }
            return Ok(Receipt::Duplicate);
        }
        self.check_numbers(&header, block.payload())?;
        self.blocks.insert((header.iteration, header.shard), block);
        Ok(Receipt::Fresh)
    }

    /// Drops the blocks of a host that is not wanted any more, as far as they have not been taken, and all that come later.
    /// Iterations and shards of those that were here.
    pub fn discard(&mut self, gateway: u32, host: HostId) -> Vec<(u64, u32)> {
        self.unwanted.insert((gateway, host));
        let of_host = |block: &B| membership(block.header()) == Some((gateway, host));
        let here = self.blocks.iter().filter(|(_, block)| of_host(block));
        let here: Vec<_> = here.map(|(address, _)| *address).collect();
        let steps = self.block_steps();
        for address in &here {
            self.blocks.remove(address);
            if let Some(account) = self.accounting.get_mut(&address.0) {
                account.received -= steps;
            }
        }
        here
    }

    fn check_header(&self, header: &BlockHeader, len: usize) -> Result<(), LearnerError> {
        let foreign = |what, found: u64, expected: String| {
            Err(LearnerError::ForeignBlock { worker: header.worker, what, found, expected })
        };
        let Dimensions { n_envs, n_steps, n_shards, .. } = self.dimensions;
        if len != self.layout.len {
            return foreign("length", len as u64, self.layout.len.to_string());
        }
        if header.n_envs as usize != n_envs {
            return foreign("number of environments", header.n_envs.into(), n_envs.to_string());
        }
        if header.n_steps as usize != n_steps {
            return foreign("number of steps", header.n_steps.into(), n_steps.to_string());
        }
        if header.shard as usize >= n_shards {
            return foreign("shard", header.shard.into(), format!("less than {n_shards}"));
        }
        let newest = self.iteration + self.overlap as u64;
        if header.iteration > newest {
            return foreign("iteration", header.iteration, format!("at most {newest}"));
        }
        let version = policy_version_for(header.iteration, self.overlap);
        if header.policy_version != version {
            return foreign("policy version", header.policy_version, version.to_string());
        }
        Ok(())
    }

    /// Finds the first number that is not finite.
    fn check_numbers(&self, header: &BlockHeader, data: &[f32]) -> Result<(), LearnerError> {
        let layout = &self.layout;
        let Dimensions { n_steps: t, n_envs: n, .. } = self.dimensions;
        // Array, place, and its dimensions before the features: (agents or 1, steps, environments).
        let a = self.dimensions.n_agents;
        let arrays = [
            ("observation", &layout.observation, Some(a), Some(t + 1)),
            ("state", &layout.state, None, Some(t + 1)),
            ("action", &layout.action, Some(a), Some(t)),
            ("log-probability", &layout.log_prob, Some(a), Some(t)),
            ("reward", &layout.reward, Some(a), Some(t)),
            ("termination flag", &layout.terminated, None, Some(t)),
            ("truncation flag", &layout.truncated, None, Some(t)),
            ("metric", &layout.metrics, None, None),
        ];
        for (array, range, agents, steps) in arrays {
            let numbers = &data[range.clone()];
            if are_finite(numbers) {
                continue;
            }
            let index = numbers.iter().position(|x| !x.is_finite()).expect("one is not finite");
            let rows = agents.unwrap_or(1) * steps.unwrap_or(1) * n;
            let row = index / (numbers.len() / rows);
            let env = header.shard as usize * n + row % n;
            let place = match (agents, steps) {
                (Some(_), Some(steps)) => {
                    let (step, agent) = (row / n % steps, row / n / steps);
                    format!("environment {env}, step {step}, agent {agent}")
                }
                (None, Some(steps)) => format!("environment {env}, step {}", row / n % steps),
                (_, None) => format!("environment {env}"),
            };
            return Err(LearnerError::BadBlock {
                worker: header.worker,
                incarnation: header.incarnation,
                iteration: header.iteration,
                shard: header.shard,
                array,
                value: numbers[index],
                place,
            });
        }
        Ok(())
    }

    /// Whether all shards of the iteration are in.
    pub fn is_complete(&self) -> bool {
        let shards = self.blocks.range((self.iteration, 0)..(self.iteration + 1, 0)).count();
        shards == self.dimensions.n_shards
    }

    /// All blocks of the iteration, ordered by shard. The inbox now expects the next one's, while
    /// these are trained on; see [`Self::account`].
    ///
    /// # Panics
    /// If the iteration is not complete.
    pub fn take(&mut self) -> Vec<B> {
        assert!(self.is_complete(), "iteration {} is not complete", self.iteration);
        let later = self.blocks.split_off(&(self.iteration + 1, 0));
        let blocks = std::mem::replace(&mut self.blocks, later);
        self.iteration += 1;
        blocks.into_values().collect()
    }

    /// What became of the env-steps of `iteration`.
    pub fn account(&mut self, iteration: u64) -> Accounting {
        let mut account = self.accounting.remove(&iteration).unwrap_or_default();
        account.trained = self.block_steps() * self.dimensions.n_shards as u64;
        account
    }
}

/// The membership that a block came by; none if it was made on this machine.
fn membership(header: &BlockHeader) -> Option<Membership> {
    membership_of(header.worker, header.incarnation)
}

/// Means of the episodes' errors over the hands that `task` measures and episodes of all blocks.
pub fn errors(task: TaskName, dimensions: &Dimensions, shards: &[&[f32]]) -> Errors {
    let layout = BlockLayout::new(dimensions);
    let places = EpisodeMetrics::new(dimensions.n_arms);
    let episodes = || {
        shards
            .iter()
            .flat_map(|shard| shard[layout.metrics.clone()].chunks_exact(dimensions.n_metrics))
    };
    let n_arms = dimensions.n_arms;
    let of_hands = |place: &Range<usize>| {
        (0..n_arms)
            .filter(|&arm| task.measures_hand(arm, n_arms))
            .map(|arm| place.start + arm)
            .collect::<Vec<_>>()
    };
    let mean = |places: &[usize]| {
        let count = places.len() * dimensions.n_envs * shards.len();
        let values = episodes().flat_map(|row| places.iter().map(|&place| f64::from(row[place])));
        (values.sum::<f64>() / count as f64) as f32
    };
    Errors {
        position: mean(&of_hands(&places.final_position)),
        orientation: mean(&of_hands(&places.final_orientation)),
        base: mean(&[places.final_base]),
        contact_rate: mean(&[places.contact_steps]) / dimensions.n_steps as f32,
    }
}

#[cfg(test)]
mod tests {
    use proto::agents::Joints;
    use proto::config::{Layers, Preset};
    use proto::message::INCARNATIONS_OF_A_GATEWAY;

    use super::*;

    struct Copy {
        header: BlockHeader,
        data: Vec<f32>,
    }

    impl Block for Copy {
        fn header(&self) -> &BlockHeader {
            &self.header
        }

        fn payload(&self) -> &[f32] {
            &self.data
        }
    }

    fn inbox(overlap: usize) -> (Inbox<Copy>, BlockLayout, Dimensions) {
        let small =
            ["env.n_envs=4", "env.n_shards=2", "task.episode_steps=3", "algorithm.mini_batches=1"];
        let config = small
            .into_iter()
            .fold(Layers::new(Preset::Tuned, None), |layers, a| layers.set(a).expect("valid"))
            .set(&format!("run.overlap={overlap}"))
            .and_then(|layers| layers.resolve())
            .expect("valid");
        let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
        (Inbox::new(&config, &dimensions, 0), BlockLayout::new(&dimensions), dimensions)
    }

    fn block(layout: &BlockLayout, iteration: u64, shard: u32, overlap: usize) -> Copy {
        Copy {
            header: BlockHeader {
                iteration,
                policy_version: policy_version_for(iteration, overlap),
                shard,
                worker: 5,
                n_envs: 2,
                n_steps: 3,
                ..BlockHeader::default()
            },
            data: vec![shard as f32; layout.len],
        }
    }

    #[test]
    fn blocks_come_out_by_shard_and_every_step_is_accounted_for() {
        let (mut inbox, layout, _) = inbox(1);
        let mut receive = |iteration, shard| {
            inbox.receive(block(&layout, iteration, shard, 1)).expect("a good block")
        };
        assert_eq!(receive(0, 1), Receipt::Fresh);
        assert_eq!(receive(1, 0), Receipt::Fresh, "an early block of the next iteration");
        assert_eq!(receive(0, 1), Receipt::Duplicate);
        assert_eq!(receive(0, 0), Receipt::Fresh);
        assert!(inbox.is_complete());
        let shards: Vec<u32> = inbox.take().iter().map(|block| block.header.shard).collect();
        assert_eq!(shards, [0, 1]);
        let first = inbox.account(0);
        assert_eq!((first.received, first.trained, first.duplicate), (18, 12, 6));
        // One whose iteration is over counts nowhere.
        assert_eq!(inbox.receive(block(&layout, 0, 0, 1)).expect("late"), Receipt::Duplicate);
        assert_eq!(inbox.receive(block(&layout, 1, 1, 1)).expect("fresh"), Receipt::Fresh);
        inbox.take();
        let second = inbox.account(1);
        assert_eq!((second.received, second.trained, second.duplicate), (12, 12, 0));
    }

    #[test]
    fn blocks_of_a_host_that_is_not_wanted_are_dropped_and_can_be_made_by_others() {
        let (mut inbox, layout, _) = inbox(1);
        let from = |worker, incarnation, iteration, shard| {
            let mut block = block(&layout, iteration, shard, 1);
            (block.header.worker, block.header.incarnation) = (worker, incarnation);
            // What it makes differs, and may not even be compared.
            block.data[3] = worker as f32;
            block
        };
        let second = INCARNATIONS_OF_A_GATEWAY + 7;
        inbox.receive(from(2001, 7, 0, 0)).expect("a block");
        inbox.receive(from(3000, 8, 0, 1)).expect("of another host");
        inbox.receive(from(2000, 7, 1, 1)).expect("early");
        assert_eq!(inbox.discard(0, 2), [(0, 0), (1, 1)]);
        assert_eq!(inbox.receive(from(2001, 7, 0, 1)).expect("late"), Receipt::Unwanted);
        assert_eq!(inbox.receive(from(5, 0, 0, 0)).expect("made again"), Receipt::Fresh);
        assert!(inbox.is_complete());
        inbox.take();
        let account = inbox.account(0);
        assert_eq!((account.received, account.trained, account.duplicate), (12, 12, 0));
        // The next gateway's host of that number is another one.
        assert_eq!(inbox.receive(from(2001, second, 1, 1)).expect("good"), Receipt::Fresh);
    }

    #[test]
    fn a_number_that_is_not_finite_is_found_where_it_was_born() {
        let (mut inbox, layout, dimensions) = inbox(0);
        let mut bad = block(&layout, 0, 1, 0);
        // Agent 2, step 1, environment 1 of the shard, second action.
        let index = ((2 * 3 + 1) * 2 + 1) * 3 + 1;
        bad.data[layout.action.start + index] = f32::NAN;
        let error = inbox.receive(bad).expect_err("not a number").to_string();
        assert!(error.contains("worker 5") && error.contains("shard 1"), "{error}");
        assert!(error.contains("environment 3, step 1, agent 2"), "{error}");
        let mut bad = block(&layout, 0, 0, 0);
        bad.data[layout.metrics.start + dimensions.n_metrics] = f32::INFINITY;
        let error = inbox.receive(bad).expect_err("infinite").to_string();
        assert!(error.contains("metric is inf at environment 1;"), "{error}");
    }

    #[test]
    fn a_block_of_another_run_iteration_or_policy_is_refused() {
        let (mut inbox, layout, _) = inbox(0);
        let mut refuse = |change: fn(&mut Copy), word: &str| {
            let mut foreign = block(&layout, 0, 0, 0);
            change(&mut foreign);
            let error = inbox.receive(foreign).expect_err("foreign").to_string();
            assert!(error.contains(word), "{error}");
        };
        refuse(|b| b.header.n_envs = 3, "number of environments is 3, expected 2");
        refuse(|b| b.header.shard = 2, "shard is 2, expected less than 2");
        refuse(|b| b.header.iteration = 1, "iteration is 1, expected at most 0");
        refuse(|b| b.header.policy_version = 1, "policy version is 1, expected 0");
        refuse(|b| b.data.truncate(5), "length is 5");
    }

    #[test]
    fn a_duplicate_that_differs_is_an_error() {
        let (mut inbox, layout, _) = inbox(0);
        inbox.receive(block(&layout, 0, 0, 0)).expect("a good block");
        let mut other = block(&layout, 0, 0, 0);
        other.data[7] = 0.5;
        let error = inbox.receive(other).expect_err("impure").to_string();
        assert!(error.contains("differ"), "{error}");
    }
}
