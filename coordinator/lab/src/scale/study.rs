//! Many sizes side by side, and what holds each of them back.

use output::grouped;
use serde::Serialize;
use serde_json::{Value, json};

use super::machines::{Costs, Machines};
use super::simulate::{Outcome, simulate};

/// A part that is busy for so large a share of the time holds the others back.
const BUSY: f64 = 0.85;

/// Which sizes.
#[derive(Debug, Clone, PartialEq)]
pub struct Scale {
    /// Hosts, in the order of the rows.
    pub hosts: Vec<u32>,
    /// Learners, for all numbers of hosts each.
    pub learners: Vec<u32>,
    /// All else. Hosts and learners of it are not looked at.
    pub machines: Machines,
}

/// What holds a run back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    /// Updates.
    Learner,
    /// Rollouts.
    Workers,
    /// The link to a learner.
    Link,
    /// A learner's gateway.
    Hub,
    /// The link of a host.
    HostLink,
    /// The gateway of a host.
    Host,
    /// There are more workers than blocks to make at a time.
    Shards,
    /// None is busy all the time: they wait for each other.
    Turns,
}

impl Limit {
    /// Of a run that went so.
    pub fn of(costs: &Costs, machines: &Machines, outcome: &Outcome) -> Self {
        let parts = [
            (Self::Learner, outcome.learner),
            (Self::Workers, outcome.workers),
            (Self::Link, outcome.link),
            (Self::Hub, outcome.hub),
            (Self::HostLink, outcome.host_link),
            (Self::Host, outcome.host),
        ];
        let busiest = parts.into_iter().max_by(|one, other| one.1.total_cmp(&other.1));
        let workers = machines.local_workers + machines.hosts * machines.host_workers;
        match busiest {
            Some((part, share)) if share >= BUSY => part,
            _ if workers > costs.shards * (1 + costs.overlap) => Self::Shards,
            _ => Self::Turns,
        }
    }

    /// For the table.
    fn name(self) -> &'static str {
        match self {
            Self::Learner => "learner",
            Self::Workers => "workers",
            Self::Link => "learner's link",
            Self::Hub => "learner's gateway",
            Self::HostLink => "a host's link",
            Self::Host => "a host's gateway",
            Self::Shards => "shards",
            Self::Turns => "turns",
        }
    }

    /// What makes it faster.
    fn cure(self) -> &'static str {
        match self {
            Self::Learner => "a faster learner, or more of them",
            Self::Workers => "more hosts, or more workers on each",
            Self::Link => "a faster network at the learner, or more learners",
            Self::Hub => "a faster core for the learner's gateway, or more learners",
            Self::HostLink => {
                "a faster network at the hosts, or more hosts with fewer workers each"
            }
            Self::Host => "faster cores at the hosts, or more hosts with fewer workers each",
            Self::Shards => {
                "more shards (env.n_shards), as no more blocks are made at a time; no machine"
            }
            Self::Turns => {
                "run.overlap = 1, so that rollouts and updates do not take turns; no machine"
            }
        }
    }
}

/// A size, and how it went.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Hosts.
    pub hosts: u32,
    /// Learners.
    pub learners: u32,
    /// How it went.
    pub outcome: Outcome,
    /// What holds it back.
    pub limit: Limit,
}

/// All sizes; those without a worker are left out. `go_on` is asked before each whether it is still wanted.
pub fn study<E>(
    costs: &Costs,
    scale: &Scale,
    go_on: impl Fn() -> Result<(), E>,
) -> Result<Vec<Row>, E> {
    let sizes = scale
        .learners
        .iter()
        .flat_map(|&learners| scale.hosts.iter().map(move |&hosts| (learners, hosts)));
    let mut rows = Vec::new();
    for (learners, hosts) in sizes {
        go_on()?;
        let machines = Machines { hosts, learners, ..scale.machines.clone() };
        if let Some(outcome) = simulate(costs, &machines) {
            let limit = Limit::of(costs, &machines, &outcome);
            rows.push(Row { hosts, learners, outcome, limit });
        }
    }
    Ok(rows)
}

/// For people; below it, what would make the runs faster.
pub fn table(rows: &[Row]) -> String {
    let header = ["hosts", "learners", "env-steps/s", "MB/s", "learner", "workers", "held back by"];
    let percent = |share: f64| format!("{:.0} %", 100.0 * share.min(1.0));
    let cells = rows.iter().map(|row| {
        let Outcome { env_steps_per_s, bytes_per_s, learner, workers, .. } = row.outcome;
        [
            grouped(u64::from(row.hosts)),
            row.learners.to_string(),
            grouped(env_steps_per_s.round() as u64),
            grouped((1e-6 * bytes_per_s).round() as u64),
            percent(learner),
            percent(workers),
            row.limit.name().to_owned(),
        ]
    });
    let mut limits: Vec<Limit> = Vec::new();
    for row in rows {
        if !limits.contains(&row.limit) {
            limits.push(row.limit);
        }
    }
    let cures = limits
        .into_iter()
        .map(|limit| output::wrap(&format!("Held back by {}: {}.", limit.name(), limit.cure())));
    let cures: Vec<String> = cures.collect();
    format!("{}\n\n{}", output::table(header, cells), cures.join("\n"))
}

/// For programs: one object a row.
pub fn to_json(rows: &[Row]) -> Value {
    let object = |row: &Row| {
        let outcome = &row.outcome;
        json!({
            "hosts": row.hosts,
            "learners": row.learners,
            "env_steps_per_s": outcome.env_steps_per_s,
            "bytes_per_s": outcome.bytes_per_s,
            "busy": {
                "learner": outcome.learner,
                "workers": outcome.workers,
                "link": outcome.link,
                "hub": outcome.hub,
                "host_link": outcome.host_link,
                "host": outcome.host,
            },
            "held_back_by": row.limit,
        })
    };
    Value::Array(rows.iter().map(object).collect())
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn scale(hosts: &[u32]) -> (Costs, Scale) {
        let costs = Costs {
            block_env_steps: 1000.0,
            block_bytes: 4e6,
            shared_part: 0.2,
            policy_bytes: 2e6,
            shards: 64,
            overlap: 1,
            rollout_s: 0.5,
            update_s: 1.0,
            hub_s: 7e-3,
            host_s: 11e-3,
        };
        let machines = Machines {
            local_workers: 0,
            hosts: 0,
            host_workers: 4,
            learners: 1,
            bandwidth: 1.25e9,
            delay: 1e-4,
        };
        (costs, Scale { hosts: hosts.to_vec(), learners: vec![1, 8], machines })
    }

    fn all(costs: &Costs, scale: &Scale) -> Vec<Row> {
        let Ok(rows) = study(costs, scale, || Ok::<_, Infallible>(()));
        rows
    }

    #[test]
    fn what_holds_back_changes_as_a_run_grows() {
        let (costs, scale) = scale(&[0, 1, 4, 100]);
        let rows = all(&costs, &scale);
        assert_eq!(rows.len(), 6, "without hosts there is no worker");
        let limits: Vec<_> = rows.iter().map(|row| row.limit).collect();
        assert_eq!(limits[..3], [Limit::Workers, Limit::Workers, Limit::Learner], "{rows:#?}");
        let [one, four, hundred] = [0, 1, 2].map(|row| rows[row].outcome.env_steps_per_s);
        assert!(four > 3.8 * one && hundred > 1.5 * four, "{one} {four} {hundred}");
        assert!(hundred <= 64_000.0, "the learner trains on 64,000 a second");
        assert!(rows[5].outcome.env_steps_per_s > 1.5 * hundred, "eight learners");
    }

    #[test]
    fn the_table_says_what_to_buy() {
        let (costs, scale) = scale(&[1, 100]);
        let rows = all(&costs, &scale);
        let table = table(&rows);
        assert!(table.contains("Held back by workers: more hosts"), "{table}");
        assert!(table.lines().all(|line| line.chars().count() <= 80), "{table}");
        let json = to_json(&rows);
        assert_eq!(json[0]["held_back_by"], "workers");
        assert_eq!(json.as_array().map(Vec::len), Some(rows.len()));
    }
}
