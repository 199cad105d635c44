//! Measures what other machines bring to a run, beside what `octopus bench scale` foretells of them.
//!
//! `cargo build --release --bins && cargo run --release -p tests --example hosts [-- SECONDS]`, as root.
//!
//! All machines are this one: network namespaces behind a bridge, each with the same small share of a core by a control group, so
//! that several are faster than one although they share two cores. The learner has a small network and all the time that it wants.

use proto::agents::Joints;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use certificates::issue::{Wanted, issue};
use lab::scale::{Costs, Machines, simulate};
use proto::certificates::CertificateDir;
use proto::layout::Dimensions;
use proto::run_dir::RunDir;
use rustix::process::Signal;
use serde_json::{Value, json};
use store::run_files::read_config;
use tempfile::TempDir;
use tests::network::{Cable, Network};
use tests::{Owned, Run, processes_with, program};

/// Iterations that do not count, because workers and orders come to their rhythm in them.
const BEGINNING: usize = 3;
/// Iterations that count, however long they take.
const LEAST_ITERATIONS: usize = 4;

/// One measurement.
#[derive(Debug, Clone, Copy)]
struct Case {
    hosts: usize,
    overlap: u32,
    /// Of every host's cable.
    delay_ms: f64,
    /// Share of a core that a host has; all of it if none.
    share: Option<f64>,
    quic: bool,
    environments: u32,
    steps: u32,
}

/// What was measured.
#[derive(Debug, Clone)]
struct Measured {
    env_steps_per_s: f64,
    blocks_per_s: f64,
    rollout_s: f64,
    update_s: f64,
    /// Processor time of a block at the gateway of the run, and of all hosts (s).
    gateways: [f64; 2],
    costs: Costs,
}

fn main() -> Result<()> {
    let seconds = std::env::args().nth(1).map_or(Ok(20.0), |text| text.parse())?;
    let small = Case {
        hosts: 1,
        overlap: 1,
        delay_ms: 0.0,
        share: Some(0.08),
        quic: false,
        environments: 8,
        steps: 25,
    };
    let mut cases = Vec::new();
    for overlap in [1, 0] {
        cases.extend([1, 2, 4, 8].map(|hosts| Case { hosts, overlap, ..small }));
    }
    for overlap in [1, 0] {
        cases.push(Case { hosts: 4, overlap, delay_ms: 20.0, ..small });
    }
    // One machine with all the time that there is, and blocks as large as those of a real training.
    let large = Case { share: None, environments: 64, ..small };
    cases.extend([large, Case { quic: true, ..large }]);

    let mut alone: Option<Costs> = None;
    let mut rows = Vec::new();
    for case in cases {
        let measured = measure(case, seconds)?;
        // What one machine took foretells the others.
        if case.share.is_some() && case.hosts == 1 {
            alone = Some(measured.costs.clone());
        }
        let foretold = |costs: &Costs| {
            let costs = Costs { overlap: case.overlap, ..costs.clone() };
            let machines = Machines {
                local_workers: 0,
                hosts: case.hosts as u32,
                host_workers: 1,
                learners: 1,
                bandwidth: 1.25e9,
                delay: 1e-3 * case.delay_ms,
            };
            simulate(&costs, &machines).map(|outcome| outcome.env_steps_per_s)
        };
        let from_one = alone.as_ref().filter(|_| case.share.is_some()).and_then(foretold);
        let row = row(case, &measured, [from_one, foretold(&measured.costs)]);
        writeln!(std::io::stderr(), "{row}")?;
        rows.push(row);
    }
    writeln!(std::io::stdout(), "{}", serde_json::to_string_pretty(&rows)?)?;
    Ok(())
}

/// `foretold` is what the simulation makes of the times of one machine, and of those of this row.
fn row(case: Case, measured: &Measured, foretold: [Option<f64>; 2]) -> Value {
    let megabytes = 1e-6 * measured.costs.block_bytes;
    let [hub, host] = measured.gateways.map(|seconds| 1e3 * seconds);
    json!({
        "hosts": case.hosts,
        "overlap": case.overlap,
        "delay_ms": case.delay_ms,
        "share_of_a_core": case.share,
        "link": if case.quic { "quic" } else { "tcp" },
        "env_steps_per_s": measured.env_steps_per_s,
        "foretold_from_one_host": foretold[0],
        "foretold_from_these_times": foretold[1],
        "blocks_per_s": measured.blocks_per_s,
        "block_mb": megabytes,
        "rollout_s": measured.rollout_s,
        "update_s": measured.update_s,
        "hub_ms_per_block": hub,
        "host_ms_per_block": host,
        "hub_ms_per_mb": hub / megabytes,
        "host_ms_per_mb": host / megabytes,
    })
}

fn measure(case: Case, seconds: f64) -> Result<Measured> {
    let mut network =
        Network::new(case.hosts + 1).context("network namespaces need root and ip")?;
    if case.delay_ms > 0.0 {
        for host in 1..=case.hosts {
            network.cable(host, Cable { delay_ms: case.delay_ms, ..Cable::default() });
        }
    }
    let certificates = case.quic.then(certificates).transpose()?;
    let secured = certificates.as_ref().map_or("--insecure".to_owned(), |dir| {
        format!("--certificates={}", dir.path().join("certificates").display())
    });
    let carrier = if case.quic { "quic" } else { "tcp" };
    let endpoint = format!("{carrier}/{}:7447", Network::address(0));

    let mut run = Run::new();
    let launcher = network.on(0);
    run.start_behind(&launcher.each_ref().map(String::as_str));
    let shards = 16;
    run.start_training(&[
        "--workers=0",
        "--iterations=1000000",
        "--set=network.hidden=[16]",
        "--set=run.audit=0.0",
        "--set=run.checkpoint_every=1000000",
        &format!("--set=env.n_envs={}", case.environments * shards),
        &format!("--set=env.n_shards={shards}"),
        &format!("--set=task.episode_steps={}", case.steps),
        &format!("--overlap={}", case.overlap),
        &format!("--listen-workers={endpoint}"),
        &secured,
    ]);
    let mut hosts = Vec::new();
    for host in 1..=case.hosts {
        hosts.push(Host::join(&network, host, case.share, &endpoint, &secured)?);
    }
    let path = run.path();
    for host in 1..=case.hosts {
        wait_for(&mut run, |run| {
            run.log().contains(&format!("(machine-{host}) has made its first block"))
        })?;
    }
    let begun = run.metrics().len() + BEGINNING;
    wait_for(&mut run, |run| run.metrics().len() > begun)?;
    let (before, from) = (gateways(&run, &hosts)?, run.metrics().len());
    let since = Instant::now();
    wait_for(&mut run, |run| {
        since.elapsed().as_secs_f64() > seconds && run.metrics().len() >= from + LEAST_ITERATIONS
    })?;
    let (after, metrics) = (gateways(&run, &hosts)?, run.metrics());
    let config = read_config(&RunDir::new(&path))?;
    run.signal(Signal::INT);
    run.succeed();

    // From the end of an iteration to the end of another.
    let lines = &metrics[from - 1..];
    let (first, last) = (&lines[0], &lines[lines.len() - 1]);
    let number = |line: &Value, key: &str| line[key].as_f64().context("a number in the metrics");
    let over = |key: &str| Ok::<_, anyhow::Error>(number(last, key)? - number(first, key)?);
    let (env_steps, wall) = (over("env_steps")?, over("wall_s")?);
    let timing = |key: &str| {
        let values = lines[1..].iter().filter_map(|line| line["timing"][key].as_f64());
        values.sum::<f64>() / (lines.len() - 1) as f64
    };
    let dimensions = Dimensions::new(&config, Joints::of_sixes(4));
    let per_block = (dimensions.n_envs * dimensions.n_steps) as f64;
    let blocks = env_steps / per_block;
    let taken = [after[0] - before[0], after[1] - before[1]].map(|time| time / blocks);
    let (rollout_s, update_s) = (timing("rollout_s") / f64::from(shards), timing("update_s"));
    let mut costs = Costs::new(&config, &dimensions, per_block / rollout_s, 1.0, [0.0; 2]);
    costs.update_s = update_s;
    [costs.hub_s, costs.host_s] = [taken[0], taken[1] / case.share.unwrap_or(1.0)];
    Ok(Measured {
        env_steps_per_s: env_steps / wall,
        blocks_per_s: blocks / wall,
        rollout_s,
        update_s,
        gateways: taken,
        costs,
    })
}

/// Processor time so far of the gateway of the run, and of those of all hosts (s).
fn gateways(run: &Run, hosts: &[Host]) -> Result<[f64; 2]> {
    let of_hosts: f64 = hosts.iter().map(Host::gateway_time).sum::<Result<f64>>()?;
    let hub = run.children("gateway").into_iter().map(processor_time).sum::<Result<f64>>()?;
    Ok([hub, of_hosts])
}

/// Certificates for the run and one machine.
fn certificates() -> Result<TempDir> {
    let dir = tempfile::tempdir()?;
    let (hosts, learner) = (vec!["machine-1".to_owned()], vec![Network::address(0)]);
    let wanted = Wanted { hosts, learner, days: 2 };
    let made = CertificateDir::new(dir.path().join("certificates"));
    issue(&made, &wanted, std::time::SystemTime::now())?;
    Ok(dir)
}

/// A machine that helps, with a directory of its own.
struct Host {
    process: Owned,
    dir: TempDir,
    _share: Option<Share>,
}

impl Host {
    fn join(
        network: &Network,
        host: usize,
        share: Option<f64>,
        endpoint: &str,
        secured: &str,
    ) -> Result<Self> {
        let dir = tempfile::tempdir()?;
        let share = share.map(|share| Share::new(host, share)).transpose()?;
        let tasks = share.as_ref().map_or(PathBuf::from("/dev/null"), Share::tasks);
        let mut command = Command::new("sh");
        command.args(["-c", "echo $$ > \"$0\" && exec \"$@\""]).arg(tasks);
        command.args(network.on(host)).arg(program("octopus"));
        let name = format!("--name=machine-{host}");
        command.args(["join", endpoint, "--workers=1", secured, &name]);
        command.env("TMPDIR", dir.path());
        let log = fs::File::create(dir.path().join("log"))?;
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
        Ok(Self { process: Owned::spawn(&mut command), dir, _share: share })
    }

    /// Processor time of its gateway so far (s).
    fn gateway_time(&self) -> Result<f64> {
        let own = processes_with(self.dir.path().to_str().context("UTF-8")?);
        let gateways = own.into_iter().filter(|(_, program)| program == "gateway");
        gateways.map(|(pid, _)| processor_time(pid)).sum()
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        // It ends by itself when the run does; a group goes away only without processes.
        let patience = Instant::now() + Duration::from_secs(20);
        while self.process.ended().is_none() && Instant::now() < patience {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// A control group (version 1) that has a share of a core.
struct Share(PathBuf);

impl Share {
    fn new(host: usize, share: f64) -> Result<Self> {
        // As short as the kernel takes it, so that a machine is slow and does not stand still.
        const PERIOD_US: f64 = 12_500.0;
        let name = format!("octopus-{}-{host}", std::process::id());
        let group = Self(Path::new("/sys/fs/cgroup/cpu").join(name));
        fs::create_dir(&group.0).with_context(|| format!("cannot make {}", group.0.display()))?;
        fs::write(group.0.join("cpu.cfs_period_us"), PERIOD_US.to_string())?;
        fs::write(group.0.join("cpu.cfs_quota_us"), (share * PERIOD_US).round().to_string())?;
        Ok(group)
    }

    fn tasks(&self) -> PathBuf {
        self.0.join("tasks")
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let patience = Instant::now() + Duration::from_secs(5);
        while fs::remove_dir(&self.0).is_err() && Instant::now() < patience {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// User and system time of a process (s).
fn processor_time(pid: u32) -> Result<f64> {
    let text = fs::read_to_string(format!("/proc/{pid}/stat"))?;
    // After the name in parentheses: state, then eleven numbers, then both times in ticks of 10 ms.
    let (_, rest) = text.rsplit_once(')').context("a process has a name")?;
    let ticks = rest.split_whitespace().skip(11).take(2);
    Ok(ticks.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0)
}

fn wait_for(run: &mut Run, mut happened: impl FnMut(&Run) -> bool) -> Result<()> {
    let patience = Instant::now() + Duration::from_mins(3);
    while !happened(run) {
        let ended = run.ended();
        ensure!(ended.is_none(), "the run ended with {ended:?}; its log:\n{}", run.log());
        ensure!(Instant::now() < patience, "hung; its log:\n{}", run.log());
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(())
}
