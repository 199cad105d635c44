//! `octopus reproduce`: all of the paper's experiments, and a page that shows them.

mod options;
mod training;

use lab::reproduce::{
    Study, Tally, check_place, curves_beside, default_policies, reproduce, table,
};
use store::provenance::Utc;

pub use self::options::ReproduceArgs;

/// Does what is missing, draws, and says which claims hold.
pub fn run(args: &ReproduceArgs) -> anyhow::Result<()> {
    let now = Utc::now().compact();
    let out = args.out.clone().unwrap_or_else(|| format!("reproduction-{now}").into());
    training::check_place(&out, args.force)?;
    check_place(&out, args.force)?;
    let controller = args.controller.map(|name| name.0);
    let (policies, curves) = if args.train {
        let (policies, curves) = training::train(args, &out)?;
        (Some(policies), curves)
    } else if controller.is_some() {
        (None, Vec::new())
    } else {
        let policies = args.policies.clone().map_or_else(default_policies, Ok)?;
        let beside = if args.runs.is_empty() { curves_beside(&policies) } else { None };
        (Some(policies), args.runs.iter().cloned().chain(beside).collect())
    };
    let made = reproduce(&Study {
        policies,
        controller,
        curves,
        out,
        quick: args.quick,
        episodes: args.episodes,
        steps: args.steps,
        seed: args.seed,
    })?;
    if args.json {
        return output::json(&made);
    }
    let tally = Tally::of(&made.claims);
    output::line(&format!(
        "{}\n\n{} of {} claims hold{}\nreport      {}",
        table(output::columns(), &made.claims),
        tally.hold,
        tally.of,
        tally.not_judged(),
        made.report.display()
    ))
}
