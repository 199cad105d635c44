//! Checks all golden digests, or records them: `make golden`, `make golden RECORD=1`.

use std::io::Write as _;

use anyhow::{Result, bail};
use clap::Parser as _;
use tests::golden::{Golden, blocks, differences, evaluations, processor, trainings};

/// Makes small rollouts, evaluations and trainings again and compares their digests with the recorded
/// ones. Ends with 1 if one differs, or if nothing is recorded for this type of processor.
#[derive(Debug, clap::Parser)]
#[command(name = "golden")]
struct Arguments {
    /// Records what is found instead.
    #[arg(long)]
    record: bool,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let say = |line: &str| {
        let _ = writeln!(std::io::stderr(), "{line}");
    };
    let processor = processor();
    say(&format!("processor: {processor}"));
    let (blocks, evaluations, trainings) = (blocks()?, evaluations()?, trainings(false, &say)?);
    let found = blocks.len() + evaluations.len() + trainings.len();
    if arguments.record {
        let mut golden = Golden::read().unwrap_or_default();
        golden.blocks = blocks;
        golden.evaluations = evaluations;
        golden.trainings.insert(processor, trainings);
        golden.write()?;
        say(&format!("recorded {found} digests in {}", Golden::path().display()));
        return Ok(());
    }
    let golden = Golden::read()?;
    let known = golden.trainings.get(&processor).cloned().unwrap_or_default();
    let lines = [
        differences(&golden.blocks, &blocks),
        differences(&golden.evaluations, &evaluations),
        differences(&known, &trainings),
    ]
    .concat();
    for line in &lines {
        say(line);
    }
    if !lines.is_empty() {
        bail!("{} of {found} digests differ from the record, or are not in it", lines.len());
    }
    say(&format!("all {found} digests are the recorded ones"));
    Ok(())
}
