//! A run on many machines, event by event.
//!
//! Orders go out as the scheduler's do: an iteration is open when the policy that it is played with exists, every worker
//! has two orders at most, and those go round. A worker plays one block after the other, as soon as its machine has the
//! policy. Its gateway takes time to send a block, then both links carry it, then the learner's gateway takes time, and the
//! learner has it. A policy is announced, asked for by each host, and carried by the learner's link to one host after
//! the other.
//!
//! Several learners are machines of their own. Each has an equal share of the agents, and needs of every block what
//! concerns them and what all critics see. All are alike, so one is simulated.

use std::collections::{BTreeSet, VecDeque};

use channels::ORDERS_PER_WORKER;
use proto::message::policy_version_for;

use super::event::{Agenda, Event, Shard};
use super::machines::{Costs, Machines};
use super::server::Server;

/// Iterations that count, and before them those that do not, because the run begins.
const ITERATIONS: u64 = 40;
const BEGINNING: u64 = 10;
/// A block takes up to so much more or less time than the mean: episodes differ in how much touches.
const SPREAD: f64 = 0.1;

/// How a run went. Shares are of the time of the iterations that count; they may be a little above 1, where the
/// last task reaches beyond the end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Env-steps a second that are trained on.
    pub env_steps_per_s: f64,
    /// For which the learner updates.
    pub learner: f64,
    /// For which the workers play, on average.
    pub workers: f64,
    /// For which the link to a learner carries.
    pub link: f64,
    /// For which a learner's gateway is busy.
    pub hub: f64,
    /// For which the busiest link of a host carries.
    pub host_link: f64,
    /// For which the busiest gateway of a host is busy.
    pub host: f64,
    /// What comes to one learner (bytes/s).
    pub bytes_per_s: f64,
}

/// Simulates a run; None if there is no worker.
pub fn simulate(costs: &Costs, machines: &Machines) -> Option<Outcome> {
    let mut run = Run::new(costs, machines);
    if run.workers.is_empty() {
        return None;
    }
    run.assign(0.0);
    let mut beginning = None;
    while let Some((now, event)) = run.agenda.next() {
        run.take(now, event);
        if event != Event::Trained {
            continue;
        }
        if run.trained == BEGINNING {
            beginning = Some((now, run.busy()));
        }
        if run.trained == BEGINNING + ITERATIONS {
            let (since, before) = beginning?;
            return Some(run.outcome(now - since, before));
        }
    }
    None
}

struct Worker {
    /// None if it is the learner's machine.
    host: Option<usize>,
    /// Orders that have not come back, here, there or on the way.
    credit: usize,
    /// Orders that wait for it.
    queue: VecDeque<Shard>,
    playing: bool,
    busy: f64,
}

#[derive(Clone, Default)]
struct Host {
    /// The newest that it has.
    policy: u64,
    gateway: Server,
    link: Server,
}

struct Run<'a> {
    costs: &'a Costs,
    machines: &'a Machines,
    agenda: Agenda,
    workers: Vec<Worker>,
    hosts: Vec<Host>,
    /// Shards that nobody has been ordered to make.
    open: BTreeSet<Shard>,
    next_iteration: u64,
    /// Blocks that the learner has, of iterations not trained on.
    received: BTreeSet<Shard>,
    trained: u64,
    updating: bool,
    learner: Server,
    hub: Server,
    into: Server,
    out_of: Server,
}

impl<'a> Run<'a> {
    fn new(costs: &'a Costs, machines: &'a Machines) -> Self {
        let local = (0..machines.local_workers).map(|_| None);
        let of_host = |host| (0..machines.host_workers).map(move |_| Some(host as usize));
        let workers = local.chain((0..machines.hosts).flat_map(of_host)).map(|host| Worker {
            host,
            credit: 0,
            queue: VecDeque::new(),
            playing: false,
            busy: 0.0,
        });
        Self {
            costs,
            machines,
            agenda: Agenda::default(),
            workers: workers.collect(),
            hosts: vec![Host::default(); machines.hosts as usize],
            open: BTreeSet::new(),
            next_iteration: 0,
            received: BTreeSet::new(),
            trained: 0,
            updating: false,
            learner: Server::default(),
            hub: Server::default(),
            into: Server::default(),
            out_of: Server::default(),
        }
    }

    fn take(&mut self, now: f64, event: Event) {
        match event {
            Event::Ordered { worker, shard } => {
                self.workers[worker].queue.push_back(shard);
                self.play(now, worker);
            }
            Event::Made { worker, shard } => {
                self.workers[worker].playing = false;
                self.send(now, worker, shard);
                self.play(now, worker);
            }
            Event::Arrives { worker, shard } => self.receive(now, worker, shard),
            Event::Received { worker, shard } => {
                self.workers[worker].credit -= 1;
                self.received.insert(shard);
                self.update(now);
                self.assign(now);
            }
            Event::Trained => {
                self.updating = false;
                let done = self.trained;
                self.received.retain(|shard| shard.0 > done);
                self.trained += 1;
                self.announce(now);
                self.update(now);
                self.assign(now);
                self.play_all(now, None);
            }
            Event::Policy { host, version } => {
                let policy = &mut self.hosts[host].policy;
                *policy = (*policy).max(version);
                self.play_all(now, Some(host));
            }
        }
    }

    /// Opens iterations whose policy exists, and gives their shards out.
    fn assign(&mut self, now: f64) {
        let overlap = self.costs.overlap as usize;
        while self.open.is_empty()
            && policy_version_for(self.next_iteration, overlap) <= self.trained
            && self.next_iteration <= self.trained + overlap as u64
        {
            let iteration = self.next_iteration;
            self.open.extend((0..self.costs.shards).map(|shard| (iteration, shard)));
            self.next_iteration += 1;
        }
        for depth in 0..ORDERS_PER_WORKER {
            for index in 0..self.workers.len() {
                let worker = &mut self.workers[index];
                if worker.credit > depth {
                    continue;
                }
                let Some(shard) = self.open.pop_first() else { return };
                worker.credit += 1;
                let delay = if worker.host.is_some() { self.machines.delay } else { 0.0 };
                self.agenda.put(now + delay, Event::Ordered { worker: index, shard });
            }
        }
    }

    fn play_all(&mut self, now: f64, host: Option<usize>) {
        let [local, each] = [self.machines.local_workers, self.machines.host_workers];
        let [local, each] = [local, each].map(|workers| workers as usize);
        // In the order in which they were made.
        let of_machine =
            host.map_or(0..local, |host| local + host * each..local + (host + 1) * each);
        for index in of_machine {
            self.play(now, index);
        }
    }

    /// A worker begins its next block, if it can.
    fn play(&mut self, now: f64, index: usize) {
        let worker = &mut self.workers[index];
        let policy = worker.host.map_or(self.trained, |host| self.hosts[host].policy);
        let overlap = self.costs.overlap as usize;
        let Some(&shard) = worker.queue.front().filter(|_| !worker.playing) else { return };
        if policy_version_for(shard.0, overlap) > policy {
            return;
        }
        worker.queue.pop_front();
        worker.playing = true;
        let duration = self.costs.rollout_s * (1.0 + SPREAD * uneven(shard));
        worker.busy += duration;
        self.agenda.put(now + duration, Event::Made { worker: index, shard });
    }

    /// A block leaves its machine.
    fn send(&mut self, now: f64, worker: usize, shard: Shard) {
        let Some(host) = self.workers[worker].host else {
            return self.agenda.put(now, Event::Received { worker, shard });
        };
        let host = &mut self.hosts[host];
        let [_, ready] = host.gateway.serve(now, self.costs.host_s);
        let shared = self.costs.shared_part;
        let bytes = self.costs.block_bytes * (1.0 + shared * f64::from(self.machines.learners - 1));
        let [begins, _] = host.link.serve(ready, bytes / self.machines.bandwidth);
        self.agenda.put(begins + self.machines.delay, Event::Arrives { worker, shard });
    }

    /// A block comes in while it is still being sent.
    fn receive(&mut self, now: f64, worker: usize, shard: Shard) {
        let part = self.part_of_a_learner();
        let carried = part * self.costs.block_bytes / self.machines.bandwidth;
        let [_, came] = self.into.serve(now, carried);
        let [_, taken] = self.hub.serve(came, part * self.costs.hub_s);
        self.agenda.put(taken, Event::Received { worker, shard });
    }

    /// Of a block.
    fn part_of_a_learner(&self) -> f64 {
        let shared = self.costs.shared_part;
        shared + (1.0 - shared) / f64::from(self.machines.learners)
    }

    /// Trains on the next iteration, if all of it is there.
    fn update(&mut self, now: f64) {
        let iteration = self.trained;
        let there = self.received.range((iteration, 0)..(iteration + 1, 0)).count();
        if self.updating || there < self.costs.shards as usize {
            return;
        }
        self.updating = true;
        let duration = self.costs.update_s / f64::from(self.machines.learners);
        let [_, ends] = self.learner.serve(now, duration);
        self.agenda.put(ends, Event::Trained);
    }

    /// Hosts hear of a new policy, and ask each learner for its part.
    fn announce(&mut self, now: f64) {
        let version = self.trained;
        let carried = self.costs.policy_bytes / f64::from(self.machines.learners);
        for index in 0..self.hosts.len() {
            // The announcement and the question, before the answer begins.
            let asked = now + 2.0 * self.machines.delay;
            let [_, sent] = self.out_of.serve(asked, carried / self.machines.bandwidth);
            let event = Event::Policy { host: index, version };
            self.agenda.put(sent + self.machines.delay, event);
        }
    }

    fn busy(&self) -> [f64; 6] {
        let most = |of: fn(&Host) -> f64| self.hosts.iter().map(of).fold(0.0, f64::max);
        let played: f64 = self.workers.iter().map(|worker| worker.busy).sum();
        [
            self.learner.busy(),
            played / self.workers.len() as f64,
            self.into.busy(),
            self.hub.busy(),
            most(|host| host.link.busy()),
            most(|host| host.gateway.busy()),
        ]
    }

    fn outcome(&self, time: f64, before: [f64; 6]) -> Outcome {
        let mut shares = self.busy();
        for (share, before) in shares.iter_mut().zip(before) {
            *share = (*share - before) / time;
        }
        let [learner, workers, link, hub, host_link, host] = shares;
        let blocks = ITERATIONS as f64 * f64::from(self.costs.shards);
        Outcome {
            env_steps_per_s: blocks * self.costs.block_env_steps / time,
            learner,
            workers,
            link,
            hub,
            host_link,
            host,
            bytes_per_s: link * self.machines.bandwidth,
        }
    }
}

/// How much longer or shorter than the mean a block takes, evenly in −1 to 1, and the same in every simulation.
fn uneven((iteration, shard): Shard) -> f64 {
    // Multiples of the golden ratio are spread evenly, however many there are.
    let multiple =
        (iteration as f64 * 1.324_717_957_244_746 + f64::from(shard)) * 0.618_033_988_749_895;
    2.0 * (multiple - multiple.floor()) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A block a second and worker, an update of half a second, a network that costs nothing.
    fn costs() -> Costs {
        Costs {
            block_env_steps: 100.0,
            block_bytes: 1e6,
            shared_part: 0.25,
            policy_bytes: 1e6,
            shards: 8,
            overlap: 0,
            rollout_s: 1.0,
            update_s: 0.5,
            hub_s: 0.0,
            host_s: 0.0,
        }
    }

    fn machines(hosts: u32) -> Machines {
        Machines {
            local_workers: 0,
            hosts,
            host_workers: 1,
            learners: 1,
            bandwidth: 1e12,
            delay: 0.0,
        }
    }

    fn rate(costs: &Costs, machines: &Machines) -> f64 {
        simulate(costs, machines).expect("there are workers").env_steps_per_s
    }

    fn about(value: f64, expected: f64) {
        assert!((value / expected - 1.0).abs() < 0.03, "{value}, not {expected}");
    }

    #[test]
    fn one_worker_and_a_learner_take_turns() {
        // Eight blocks of a second, and half a second.
        about(rate(&costs(), &machines(1)), 800.0 / 8.5);
        let local = Machines { local_workers: 1, ..machines(0) };
        about(rate(&costs(), &local), 800.0 / 8.5);
        assert_eq!(simulate(&costs(), &machines(0)), None);
    }

    #[test]
    fn with_overlap_the_slower_one_counts() {
        let costs = Costs { overlap: 1, ..costs() };
        about(rate(&costs, &machines(1)), 100.0);
        // Sixteen workers make two iterations in a second, the learner trains on two.
        let many = simulate(&costs, &machines(32)).expect("workers");
        assert!(many.env_steps_per_s <= 1600.0 && many.learner > 0.4, "{many:?}");
        let slow = Costs { update_s: 10.0, ..costs };
        let held = simulate(&slow, &machines(8)).expect("workers");
        about(held.env_steps_per_s, 80.0);
        about(held.learner, 1.0);
    }

    #[test]
    fn workers_beyond_the_shards_have_nothing_to_do() {
        let eight = rate(&costs(), &machines(8));
        about(rate(&costs(), &machines(100)), eight);
    }

    #[test]
    fn a_link_carries_no_more_than_it_can() {
        // Ten blocks a second; more could be made.
        let machines = Machines { bandwidth: 1e7, ..machines(8) };
        let costs = Costs { rollout_s: 0.1, update_s: 1e-3, overlap: 1, ..costs() };
        let held = simulate(&costs, &machines).expect("workers");
        assert!(held.env_steps_per_s <= 1000.0, "{held:?}");
        assert!(held.link > 0.85, "{held:?}");
        about(held.bytes_per_s, held.env_steps_per_s * 1e4);
        // Two learners share what is theirs alone.
        let two = simulate(&costs, &Machines { learners: 2, ..machines }).expect("workers");
        about(two.bytes_per_s, two.env_steps_per_s * 1e4 * (0.25 + 0.75 / 2.0));
    }

    #[test]
    fn a_delay_is_paid_once_an_iteration_without_overlap_and_hidden_with_it() {
        let costs = Costs { shards: 2, ..costs() };
        let far = Machines { delay: 0.1, host_workers: 2, ..machines(1) };
        // A second for the slower of two blocks (up to a tenth more), half a second, three delays for the policy and
        // one for the block.
        let apart = rate(&costs, &far);
        assert!((200.0 / 2.05..200.0 / 1.85).contains(&apart), "{apart}");
        let near = rate(&costs, &Machines { delay: 0.0, ..far.clone() });
        assert!(apart < 0.9 * near, "{apart} {near}");
        let hidden = rate(&Costs { overlap: 1, ..costs }, &far);
        assert!(hidden > apart * 1.2, "{hidden} {apart}");
    }

    #[test]
    fn a_gateway_that_is_slow_is_what_is_waited_for() {
        let costs = Costs { hub_s: 0.5, overlap: 1, ..costs() };
        let held = simulate(&costs, &machines(8)).expect("workers");
        about(held.env_steps_per_s, 200.0);
        assert!(held.hub > 0.95, "{held:?}");
    }
}
