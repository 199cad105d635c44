//! The long form of the chaos tests: `make chaos`.

use std::io::Write as _;
use std::time::Instant;

use anyhow::{Context as _, bail};
use clap::Parser as _;
use run::signals::StopRequests;
use serde_json::json;
use tests::chaos::plan::Plan;
use tests::chaos::standstills::Dose;
use tests::chaos::{Chaos, calm, damage, environment, http, others, restarts, standstills};

/// Kills, hangs, stops and scales runs at random, damages their files, starts them from foreign
/// environments, and attacks them from outside, and checks that it changes no bit and leaves nothing. Progress goes to standard error, a summary as JSON to standard output.
#[derive(Debug, clap::Parser)]
#[command(name = "chaos")]
struct Arguments {
    /// Kills of workers, learners and coordinators, half of them with overlap 0, half with 1.
    #[arg(long, default_value_t = 200)]
    kills: usize,
    /// Kills of workers of one live run, after that.
    #[arg(long, default_value_t = 1000)]
    worker_restarts: usize,
    /// Kills of the learner of the same run, after that.
    #[arg(long, default_value_t = 50)]
    learner_restarts: usize,
    /// Files of a run directory that are damaged, after that, each in a fresh copy.
    #[arg(long, default_value_t = 100)]
    damages: usize,
    /// Short runs from foreign environments, after that.
    #[arg(long, default_value_t = 100)]
    environments: usize,
    /// Requests to a live run, many of them hostile, after that.
    #[arg(long, default_value_t = 5000)]
    requests: usize,
    /// Attempts of another user at a live run, after that; needs root.
    #[arg(long, default_value_t = 500)]
    intrusions: usize,
    /// Standstills of a live run's disk or coordinator, each of one to two minutes, after that; needs root and
    /// loop devices.
    #[arg(long, default_value_t = 7)]
    standstills: usize,
    /// What the plans are drawn from.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let stop = StopRequests::new();
    stop.listen().context("signals cannot be caught")?;
    let begun = Instant::now();
    let mut narrate = |line: &str| {
        let _ = writeln!(std::io::stderr(), "{:7.1} s  {line}", begun.elapsed().as_secs_f64());
    };

    let mut runs = Vec::new();
    for overlap in [0, 1] {
        let kills = usize::midpoint(arguments.kills, overlap);
        if kills == 0 {
            continue;
        }
        // Two plans of one seed: the overlap is part of what is drawn from.
        let plan = Plan::new(arguments.seed * 2 + overlap as u64, kills);
        narrate(&format!("overlap {overlap}, {plan}"));
        narrate("the calm run");
        let expected = calm(overlap, plan.iterations, &stop)?;
        let report = Chaos::run(&plan, overlap, &expected, &stop, &mut narrate)
            .with_context(|| format!("overlap {overlap}, plan of seed {}", plan.seed))?;
        narrate(&format!("overlap {overlap}: {} iterations, the same bits", report.iterations));
        runs.push(
            json!({ "overlap": overlap, "plan_seed": plan.seed, "result": report.to_json() }),
        );
    }
    let restarts = match (arguments.worker_restarts, arguments.learner_restarts) {
        (0, 0) => None,
        (workers, learners) => {
            Some(restarts::run(workers, learners, &stop, &mut narrate)?.to_json())
        }
    };
    let damages = match arguments.damages {
        0 => None,
        times => Some(damage::run(times, arguments.seed, &stop, &mut narrate)?.to_json()),
    };
    let seed = arguments.seed;
    let environments = match arguments.environments {
        0 => None,
        times => Some(environment::run(times, seed, &stop, &mut narrate)?.to_json()),
    };
    let requests = match arguments.requests {
        0 => None,
        times => Some(http::run(times, seed, &stop, &mut narrate)?.to_json()),
    };
    let intrusions = match arguments.intrusions {
        0 => None,
        times => Some(others::run(times, seed, &stop, &mut narrate)?.to_json()),
    };
    let standstills = match arguments.standstills {
        0 => None,
        times => Some(standstills::run(times, Dose::Long, &stop, &mut narrate)?),
    };
    let summary = json!({
        "seed": arguments.seed,
        "runs": runs,
        "restarts": restarts,
        "damages": damages,
        "environments": environments,
        "requests": requests,
        "intrusions": intrusions,
        "standstills": standstills.as_ref().map(standstills::Report::to_json),
        "seconds": begun.elapsed().as_secs_f64(),
    });
    writeln!(std::io::stdout(), "{}", serde_json::to_string_pretty(&summary)?)?;
    // What was asked for and could not be tried has not passed.
    if let Some(reason) = standstills.and_then(|report| report.not_tried) {
        bail!("standstills were not tried ({reason}); --standstills 0 leaves them out");
    }
    Ok(())
}
