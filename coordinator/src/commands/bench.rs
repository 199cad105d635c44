//! `octopus bench`: how fast this machine simulates, learns and transports.

use lab::bench::{Study, Subject, measure};
use proto::{ExitCode, ExitError};

use crate::cli::bench::BenchArgs;

/// Measures and prints.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let growth = args.subject.0 == Subject::Growth;
    for (given, flag, cure) in [
        (growth && args.peer, "--peer", "leave it out"),
        (!growth && args.pictures.is_some(), "--pictures", "it is for `octopus bench growth`"),
    ] {
        if given {
            let message = format!("{flag} has no meaning here; {cure}");
            return Err(ExitError::new(ExitCode::Usage, message).into());
        }
    }
    let measured = measure(&Study {
        subject: args.subject.0,
        preset: args.preset.into(),
        sets: args.sets.clone(),
        workers: args.workers,
        seconds: args.seconds,
        peers: args.peer.then(|| args.python.clone()),
        pictures: args.pictures.clone(),
        force: args.force,
    })?;
    if args.json { output::json(&measured.json) } else { output::line(&measured.table) }
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;
    use lab::bench::TRAINED;
    use proto::config::Preset;

    use crate::cli::{Cli, Command};

    #[test]
    fn the_preset_that_a_table_names_is_the_one_that_is_trained_by_default() {
        let cli = Cli::try_parse_from(["octopus", "train"]).expect("valid");
        let Command::Train(args) = cli.command else { panic!("not train") };
        assert_eq!(Preset::from(args.preset), TRAINED);
    }
}
