//! A training on many machines, simulated from what a rollout and an update take here.

use output::grouped;
use serde_json::{Value, json};

use super::context::Bench;
use super::study::Study;
use super::{learner, rollout};
use crate::scale::{Costs, study, table, to_json};

/// The table, and the same for programs.
pub(super) fn measure(bench: &Bench, wanted: &Study) -> anyhow::Result<(String, Value)> {
    bench.begin("rollout")?;
    let rollout = rollout::rates(bench, &bench.config, &bench.robot, bench.seconds)?;
    bench.begin("learner")?;
    let update = learner::update(bench, &bench.whole(&[])?, false)?;
    let [rollout, update] = [rollout.env_steps_per_s, update.env_steps_per_s];
    let costs = Costs::new(&bench.config, &bench.dimensions, rollout, update, wanted.gateways);
    let rows = study(&costs, &wanted.scale, || bench.go_on())?;
    let machines = &wanted.scale.machines;
    let [hub, host] = [costs.hub_s, costs.host_s].map(|seconds| 1e3 * seconds);
    let sentence = format!(
        "Simulated from {} env-steps/s of a worker and {} of a learner, both measured here; {} blocks an \
         iteration, of {:.1} MB, each {hub:.1} ms at the learner\u{2019}s gateway and {host:.1} ms at the \
         host\u{2019}s; {} on each host, links of {} Gbit/s, {} ms from machine to machine.",
        grouped(rollout.round() as u64),
        grouped(update.round() as u64),
        costs.shards,
        1e-6 * costs.block_bytes,
        output::counted(u64::from(machines.host_workers), "worker"),
        8e-9 * machines.bandwidth,
        1e3 * machines.delay,
    );
    let text = format!("{}\n\n{}", table(&rows), output::wrap(&sentence));
    let json = json!({
        "rows": to_json(&rows),
        "rollout_env_steps_per_s_per_core": rollout,
        "learner_env_steps_per_s": update,
        "block_bytes": costs.block_bytes,
        "policy_bytes": costs.policy_bytes,
        "shards": costs.shards,
        "hub_s_per_block": costs.hub_s,
        "host_s_per_block": costs.host_s,
        "host_workers": machines.host_workers,
        "local_workers": machines.local_workers,
        "bandwidth_bytes_per_s": machines.bandwidth,
        "delay_s": machines.delay,
    });
    Ok((text, json))
}
