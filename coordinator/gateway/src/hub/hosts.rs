//! Which hosts there are, and which of their workers take orders: no network, clock or channel of its own.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use channels::ChannelSizes;
use proto::certificates::NAME_LEN;
use proto::message::{HostId, HostReport, INCARNATIONS_OF_A_GATEWAY, WORKERS_OF_A_HOST, WorkerId};

use crate::{SILENCE, keys};

/// Most hosts that may have joined at once. Their list is one status message, which has 4 KiB.
const MAX_HOSTS: usize = 24;
/// Most workers that they may have together, likewise.
const MAX_WORKERS: usize = 256;

/// A host that has joined.
#[derive(Debug)]
struct Host {
    name: String,
    /// Whether its processor is of another type than that of this machine.
    is_other_processor: bool,
    /// Workers that it is to have.
    wanted: u32,
    /// Workers that its channels have room for.
    room: u32,
    /// When it was heard last; none if it is known to be gone.
    heard: Option<Instant>,
    /// Workers that take orders, with their incarnations.
    workers: BTreeMap<WorkerId, u32>,
    blocks: u64,
    bytes: u64,
    missing: u64,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Hosts {
    joined: BTreeMap<HostId, Host>,
    /// The number of the next host, never given twice.
    next: HostId,
    /// The incarnation of the next worker, likewise, also by the next hub.
    incarnation: u32,
    /// Names of machines that are taken in no more.
    refused: BTreeSet<String>,
}

impl Hosts {
    /// None, of the hub that is `incarnation`.
    pub(super) fn new(incarnation: u32) -> Self {
        let incarnation = incarnation.wrapping_mul(INCARNATIONS_OF_A_GATEWAY);
        Self { joined: BTreeMap::new(), next: 1, incarnation, refused: BTreeSet::new() }
    }

    /// Takes a host in, whose workers follow when they are ready. The error is for it to read.
    pub(super) fn join(
        &mut self,
        name: &str,
        workers: u32,
        is_other_processor: bool,
        now: Instant,
    ) -> Result<HostId, String> {
        if self.refused.contains(shown(name)) {
            return Err(format!(
                "`{name}` has made a block with other bits than the run's own machine, or could not make one, and is taken back no more; if this \
                 is another machine, join with another --name"
            ));
        }
        let wanted = |hosts: &BTreeMap<HostId, Host>| hosts.values().map(|host| host.wanted).sum();
        let is_full = |hosts: &BTreeMap<HostId, Host>| {
            let others: u32 = wanted(hosts);
            hosts.len() >= MAX_HOSTS || others.saturating_add(workers) > MAX_WORKERS as u32
        };
        if is_full(&self.joined) {
            // Who is not heard has joined again, will not come back, or joins again when it does.
            self.joined.retain(|_, host| host.heard.is_some());
        }
        if self.joined.len() >= MAX_HOSTS {
            return Err(format!("this run has {MAX_HOSTS} hosts already, more it cannot have"));
        }
        if workers == 0 || is_full(&self.joined) {
            let others: u32 = wanted(&self.joined);
            let room = (MAX_WORKERS as u32).saturating_sub(others);
            return Err(format!(
                "{workers} workers wanted: this run has room for {room} more of other machines; \
                 join with fewer --workers"
            ));
        }
        let host = self.next;
        self.next += 1;
        let joined = Host {
            name: name.to_owned(),
            is_other_processor,
            wanted: workers,
            room: ChannelSizes::most_workers(workers as usize) as u32,
            heard: Some(now),
            workers: BTreeMap::new(),
            blocks: 0,
            bytes: 0,
            missing: 0,
        };
        self.joined.insert(host, joined);
        Ok(host)
    }

    /// A host shall have so many workers from now on. Whether it can.
    pub(super) fn scale(&mut self, host: HostId, workers: u32) -> bool {
        let can = (1..=self.most(host)).contains(&workers);
        match self.joined.get_mut(&host) {
            Some(known) if can => known.wanted = workers,
            _ => return false,
        }
        true
    }

    /// Workers that a host can have at most, with those of all others.
    fn most(&self, host: HostId) -> u32 {
        let others = self.joined.iter().filter(|(number, _)| **number != host);
        let others: u32 = others.map(|(_, host)| host.wanted).sum();
        let room = self.joined.get(&host).map_or(0, |host| host.room);
        room.min((MAX_WORKERS as u32).saturating_sub(others))
    }

    /// Machines of this name are hosts no more. Whether that is news.
    pub(super) fn refuse(&mut self, name: &str) -> bool {
        let name = shown(name);
        self.joined.retain(|_, host| shown(&host.name) != name);
        self.refused.insert(name.to_owned())
    }

    /// How many names are refused.
    pub(super) fn refused(&self) -> u32 {
        self.refused.len() as u32
    }

    /// A host says which of its workers are there. Whether that changes anything.
    pub(super) fn heard(&mut self, host: HostId, workers: &[u32], now: Instant) -> bool {
        let others = self.joined.iter().filter(|(number, _)| **number != host);
        let others: usize = others.map(|(_, host)| host.workers.len()).sum();
        let Some(known) = self.joined.get_mut(&host) else { return false };
        known.heard = Some(now);
        let said = workers.iter().filter(|&&worker| worker < known.room);
        // Hosts say what they like, and all of it is to fit into a message.
        let said = said.take(MAX_WORKERS.saturating_sub(others));
        let there: Vec<_> = said.map(|worker| host * WORKERS_OF_A_HOST + worker).collect();
        let before = known.workers.len();
        known.workers.retain(|worker, _| there.contains(worker));
        let mut changed = known.workers.len() != before;
        for worker in there {
            known.workers.entry(worker).or_insert_with(|| {
                changed = true;
                self.incarnation += 1;
                self.incarnation
            });
        }
        changed
    }

    /// A host is gone, until it is heard again. Whether anything changes.
    pub(super) fn gone(&mut self, host: HostId) -> bool {
        let Some(known) = self.joined.get_mut(&host) else { return false };
        known.heard = None;
        !std::mem::take(&mut known.workers).is_empty()
    }

    /// Hosts that have not been heard for too long; they are gone.
    pub(super) fn expire(&mut self, now: Instant) -> Vec<HostId> {
        let silent = self.joined.iter().filter(|(_, host)| {
            host.heard.is_some_and(|heard| now.saturating_duration_since(heard) > SILENCE)
        });
        let silent: Vec<_> = silent.map(|(&host, _)| host).collect();
        for &host in &silent {
            self.gone(host);
        }
        silent
    }

    /// A worker has not done what it was ordered: it is none until its host is heard again.
    pub(super) fn dismiss(&mut self, worker: WorkerId) {
        if let Some(host) = self.joined.get_mut(&(worker / WORKERS_OF_A_HOST)) {
            host.workers.remove(&worker);
        }
    }

    /// The host of a worker that takes orders in this incarnation, and its number there.
    pub(super) fn find(&self, worker: WorkerId, incarnation: u32) -> Option<(HostId, u32)> {
        let host = worker / WORKERS_OF_A_HOST;
        let known = self.joined.get(&host)?.workers.get(&worker)?;
        (*known == incarnation).then_some((host, worker % WORKERS_OF_A_HOST))
    }

    /// The name of a host.
    pub(super) fn name(&self, host: HostId) -> Option<&str> {
        self.joined.get(&host).map(|host| host.name.as_str())
    }

    /// Whether a host has this name, as keys have it.
    pub(super) fn is_called(&self, host: HostId, chunk: &str) -> bool {
        self.name(host).is_some_and(|name| keys::chunk(name) == chunk)
    }

    /// A block of `bytes` has come whole from a worker.
    pub(super) fn delivered(&mut self, worker: WorkerId, bytes: usize) {
        if let Some(host) = self.joined.get_mut(&(worker / WORKERS_OF_A_HOST)) {
            host.blocks += 1;
            host.bytes += bytes as u64;
        }
    }

    /// So many pieces have not come.
    pub(super) fn missed(&mut self, worker: WorkerId, pieces: u64) {
        if let Some(host) = self.joined.get_mut(&(worker / WORKERS_OF_A_HOST)) {
            host.missing += pieces;
        }
    }

    /// All hosts that may be heard again, and how many workers each is to have.
    pub(super) fn wanted(&self) -> Vec<(HostId, u32)> {
        self.joined.iter().map(|(&number, host)| (number, host.wanted)).collect()
    }

    /// The hosts that have workers.
    pub(super) fn report(&self) -> Vec<HostReport> {
        let there = self.joined.iter().filter(|(_, host)| !host.workers.is_empty());
        let report = there.map(|(&number, host)| HostReport {
            host: number,
            name: shown(&host.name).to_owned(),
            is_other_processor: host.is_other_processor,
            wanted: host.wanted,
            most: self.most(number),
            workers: host.workers.iter().map(|(&worker, &inc)| (worker, inc)).collect(),
            blocks: host.blocks,
            bytes: host.bytes,
            missing: host.missing,
        });
        report.collect()
    }
}

/// As much of a name as the run is told.
fn shown(name: &str) -> &str {
    &name[..name.floor_char_boundary(NAME_LEN)]
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use proto::message::{self, Status};

    use super::*;

    #[test]
    fn workers_of_a_host_come_and_go_and_no_incarnation_comes_back() {
        let now = Instant::now();
        let mut hosts = Hosts::new(0);
        let host = hosts.join("lab", 2, false, now).expect("room");
        assert!(hosts.report().is_empty(), "its workers are not ready");
        assert!(hosts.heard(host, &[0, 1, 16], now), "16 is none of its");
        assert!(!hosts.heard(host, &[0, 1], now));
        let first = hosts.report().remove(0).workers;
        assert_eq!(first.iter().map(|(worker, _)| *worker).collect::<Vec<_>>(), [1000, 1001]);
        assert_eq!(hosts.find(1001, first[1].1), Some((host, 1)));
        assert!(hosts.is_called(host, "lab") && !hosts.is_called(host, "other"));
        // Cut off, and heard again.
        assert!(hosts.expire(now + SILENCE).is_empty());
        assert_eq!(hosts.expire(now + SILENCE + Duration::from_millis(1)), [host]);
        assert_eq!((hosts.find(1001, first[1].1), hosts.report()), (None, vec![]));
        assert!(hosts.heard(host, &[0, 1], now));
        let second = hosts.report().remove(0).workers;
        assert!(first.iter().all(|worker| !second.contains(worker)));
        // One whose order did not come back.
        hosts.dismiss(1000);
        assert_eq!(hosts.report()[0].workers, second[1..]);
        assert!(hosts.gone(host) && !hosts.gone(host));
        // Those of the next hub are others still.
        let mut next = Hosts::new(1);
        let host = next.join("lab", 2, false, now).expect("room");
        next.heard(host, &[0], now);
        assert!(next.report()[0].workers[0].1 > second[1].1);
    }

    #[test]
    fn the_longest_list_fits_into_a_message() {
        let now = Instant::now();
        // The largest numbers that are likely.
        let mut hosts = Hosts::new(100);
        for _ in 0..MAX_HOSTS {
            let workers = (MAX_WORKERS / MAX_HOSTS) as u32;
            let host = hosts.join(&"ü".repeat(50), workers, true, now).expect("room");
            hosts.heard(host, &(0..workers).collect::<Vec<_>>(), now);
            hosts.delivered(host * WORKERS_OF_A_HOST, usize::MAX / 2);
            hosts.missed(host * WORKERS_OF_A_HOST, u64::MAX / 2);
        }
        assert!(hosts.join("one more", 1, false, now).is_err());
        // More than they joined with, as far as there is room on their machines.
        for host in 1..=MAX_HOSTS as u32 {
            hosts.heard(host, &(0..16).collect::<Vec<_>>(), now);
        }
        let hosts = hosts.report();
        assert_eq!(hosts.iter().map(|host| host.workers.len()).sum::<usize>(), MAX_WORKERS);
        let status =
            Status::Hosts { incarnation: u32::MAX, orders: u128::MAX, refused: u32::MAX, hosts };
        let len = message::encode(&status).len();
        assert!(len <= 4 << 10, "{len}");
    }

    #[test]
    fn a_host_with_too_many_workers_is_told_how_many_there_is_room_for() {
        let now = Instant::now();
        let mut hosts = Hosts::new(0);
        hosts.join("one", 250, false, now).expect("room");
        let told = hosts.join("two", 7, false, now).expect_err("too many");
        assert!(told.contains("room for 6 more"), "{told}");
    }

    #[test]
    fn who_makes_other_bits_is_gone_and_does_not_come_back() {
        let now = Instant::now();
        let mut hosts = Hosts::new(0);
        let name = "a-name-that-is-longer-than-what-is-kept-of-it";
        let host = hosts.join(name, 1, false, now).expect("room");
        let other = hosts.join("other", 1, true, now).expect("room");
        hosts.heard(host, &[0], now);
        hosts.heard(other, &[0], now);
        let known = hosts.report()[0].name.clone();
        assert!(hosts.refuse(&known) && !hosts.refuse(&known));
        assert_eq!((hosts.refused(), hosts.wanted()), (1, vec![(other, 1)]));
        assert!(hosts.report()[0].is_other_processor);
        let told = hosts.join(name, 1, false, now).expect_err("refused");
        assert!(told.contains("other bits") && told.contains("another --name"), "{told}");
    }

    #[test]
    fn a_host_can_have_as_many_workers_as_there_is_room_for_on_both_machines() {
        let now = Instant::now();
        let mut hosts = Hosts::new(0);
        let [small, large] = [2, 120].map(|n| hosts.join("lab", n, false, now).expect("room"));
        assert!(!hosts.scale(small, 0) && !hosts.scale(small, 17) && !hosts.scale(9, 1));
        assert!(hosts.scale(small, 16) && hosts.heard(small, &[0, 15], now));
        assert_eq!((hosts.report()[0].wanted, hosts.report()[0].most), (16, 16));
        // Its channels have room for 240, and all machines together for 256.
        assert!(hosts.scale(large, 240) && !hosts.scale(large, 241));
        assert_eq!(hosts.wanted(), [(small, 16), (large, 240)]);
        assert_eq!(hosts.report()[0].most, 16);
    }
}
