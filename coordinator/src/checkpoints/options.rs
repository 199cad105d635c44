//! Options of `octopus checkpoints`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use store::checkpoint::{Name, Selector};

use crate::values::whole;

const GROUP_EXAMPLES: &str = "\
Examples:
  octopus checkpoints list runs/trajectory-20260101-120000
  octopus checkpoints pin runs/trajectory-20260101-120000:best
  octopus checkpoints COMMAND --help

Wherever a CHECKPOINT is wanted, write
  RUN            the newest from which training can go on
  RUN:latest     likewise
  RUN:best       the one with the lowest score
  RUN:50         the one after 50 iterations
  RUN:NAME       the one of that name
  RUN:TAG        the one with that tag
  DIR            a checkpoint's own directory
where RUN is a run directory or any directory of checkpoints, which is also what STORE stands \
for. list, show, verify, diff, pin, unpin, tag, untag, prune, export and delete take a bucket for \
RUN or STORE, too, as in s3://bucket/prefix:best.";

const LIST_EXAMPLES: &str = "\
Examples:
  octopus checkpoints list runs/trajectory-20260101-120000
  octopus checkpoints list runs/a --json | jq '.entries[].name'

The same is in STORE/catalogue.sqlite, for a run in RUN/checkpoints/catalogue.sqlite:
  select c.name, c.score from checkpoints c
    join tags t on t.name = c.name where t.tag = 'best';

Reads manifests and labels only. One whose manifest cannot be read is listed as damaged, and the \
command still exits with 0; `verify` and `show` look at all files and exit with 5 then.";

const SHOW_EXAMPLES: &str = "\
Examples:
  octopus checkpoints show runs/trajectory-20260101-120000:best
  octopus checkpoints show runs/a:50 --json | jq .manifest.provenance

Checks the files as `verify` does, and exits with 5 if anything is wrong.";

const VERIFY_EXAMPLES: &str = "\
Examples:
  octopus checkpoints verify runs/trajectory-20260101-120000
  octopus checkpoints verify runs/trajectory-20260101-120000:best

Checks length and BLAKE3 hash of every file, that configuration, robot and tensors are readable, \
that all numbers are finite, that all tensors fit the configuration, that digest and counters of \
the manifest are those of the training state, and that the actors are its. A run or STORE without \
`:` means all its checkpoints. Exits with 5 if anything is wrong.";

const DIFF_EXAMPLES: &str = "\
Examples:
  octopus checkpoints diff runs/a:best runs/b:best
  octopus checkpoints diff runs/a:50 runs/a:100 --json | \\
      jq '.tensors[] | {tensor, max_abs}'

Exits with 0 if they are the same, with 1 if they differ.";

const PIN_EXAMPLES: &str = "\
Examples:
  octopus checkpoints pin runs/trajectory-20260101-120000:best
  octopus checkpoints unpin runs/trajectory-20260101-120000:50

A pinned checkpoint is never removed, neither by a run nor by hand, until it is unpinned.";

const TAG_EXAMPLES: &str = "\
Examples:
  octopus checkpoints tag runs/trajectory-20260101-120000:50 paper-figure-3
  octopus eval runs/trajectory-20260101-120000:paper-figure-3
  octopus checkpoints untag runs/trajectory-20260101-120000 paper-figure-3

A tag is on at most one checkpoint of a store: given again, it moves. A tagged checkpoint is kept \
by `prune` and by the run. The tags `best` and `latest` move by themselves.";

const PRUNE_EXAMPLES: &str = "\
Examples:
  octopus checkpoints prune runs/a --keep-latest 2 --dry-run
  octopus checkpoints prune runs/a --keep-latest 1 --keep-every 100
  octopus checkpoints prune s3://bucket/runs/a --keep-latest 5

Always kept: the newest whole one, the best, pinned and tagged ones, milestones, and everything \
that is not named iteration-N.";

const REBUILD_EXAMPLES: &str = "\
Examples:
  octopus checkpoints rebuild runs/trajectory-20260101-120000
  octopus checkpoints rebuild shared --json

Makes STORE/catalogue.sqlite, for a run RUN/checkpoints/catalogue.sqlite, from the manifests and \
labels and puts the tag `best` where the scores say. Commands do so by themselves; this is for \
files that were copied or deleted by hand.";

const DELETE_EXAMPLES: &str = "\
Examples:
  octopus checkpoints delete runs/trajectory-20260101-120000:50
  octopus checkpoints delete shared/mixed

A pinned checkpoint is not removed; `unpin` lets it go. Nor is the newest whole one of a run, \
from which the run goes on after a failure and `octopus resume` after its end; --force removes \
it, but never while the run is going on. `prune` removes several at once.";

const EXPORT_EXAMPLES: &str = "\
Examples:
  octopus checkpoints export runs/trajectory-20260101-120000:best --out best.tar
  octopus checkpoints export runs/a:best --out - | \\
      ssh host octopus checkpoints import - --store runs/a

The archive is an uncompressed tar; the same checkpoint always gives the same bytes.";

const COMMIT_EXAMPLES: &str = "\
Examples:
  octopus checkpoints commit runs/trajectory-20260101-120000
  octopus checkpoints commit runs/a && octopus eval runs/a

Asks the run that is going on there, which commits after the iteration that it is training on. A \
run commits by itself, too: see run.checkpoint_every and run.checkpoint_every_s.";

const IMPORT_EXAMPLES: &str = "\
Examples:
  octopus checkpoints import best.tar --store shared
  octopus checkpoints import best.tar --store runs/a --name from-alice

The archive is checked as `verify` does before anything appears in the store. A name iteration-N \
is for checkpoints of the store's own run only; `octopus resume` goes on from it only if the run \
has recorded its digest. Pins, tags and scores do not travel.";

const COMPOSE_USAGE: &str = "\
octopus checkpoints compose [OPTIONS] --arm <ARMS=CHECKPOINT>...
                                   --out <STORE/NAME>";

const COMPOSE_EXAMPLES: &str = "\
Examples:
  octopus checkpoints compose --arm 1=runs/a:best --arm 2=runs/b:best \\
      --arm 3,4=runs/b --out shared/mixed
  octopus eval shared/mixed

Arms count from 1; arm i moves with agents 2(i-1) and 2(i-1)+1, which keep their places. All \
parts must have learned the same task on the same robot with the same observations and networks. \
The result holds actors only: it can be evaluated, exported and composed again, but not trained \
on.";

/// Options of `octopus checkpoints`.
#[derive(Debug, Clone, Args)]
#[command(after_help = GROUP_EXAMPLES, subcommand_required = true)]
pub struct CheckpointsArgs {
    /// What to do.
    #[command(subcommand)]
    pub command: CheckpointsCommand,
}

/// The commands of `octopus checkpoints`.
#[derive(Debug, Clone, Subcommand)]
pub enum CheckpointsCommand {
    /// List the checkpoints of a run or store.
    List(ListArgs),
    /// Show everything about one checkpoint.
    Show(ShowArgs),
    /// Check checkpoints thoroughly.
    Verify(VerifyArgs),
    /// Show what differs between two checkpoints.
    Diff(DiffArgs),
    /// Protect a checkpoint from removal.
    Pin(PinArgs),
    /// Undo `pin`.
    Unpin(PinArgs),
    /// Give a checkpoint a second name.
    Tag(TagArgs),
    /// Remove a tag.
    Untag(UntagArgs),
    /// Remove old checkpoints of a run.
    Prune(PruneArgs),
    /// Rebuild the catalogue from the checkpoints.
    Rebuild(RebuildArgs),
    /// Have a live run commit a checkpoint now.
    Commit(CommitArgs),
    /// Unpack an archive into a store.
    Import(ImportArgs),
    /// Pack a checkpoint into an archive.
    Export(ExportArgs),
    /// Build one policy set from the arms of several checkpoints.
    Compose(ComposeArgs),
    /// Remove one checkpoint.
    Delete(DeleteArgs),
}

/// Options of `octopus checkpoints list`.
#[derive(Debug, Clone, Args)]
#[command(after_help = LIST_EXAMPLES)]
pub struct ListArgs {
    /// A run directory or a directory of checkpoints.
    #[arg(value_name = "STORE")]
    pub store: PathBuf,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints show`.
#[derive(Debug, Clone, Args)]
#[command(after_help = SHOW_EXAMPLES)]
pub struct ShowArgs {
    /// The checkpoint.
    #[arg(value_name = "CHECKPOINT")]
    pub checkpoint: Selector,
    /// List its tensors, too.
    #[arg(long)]
    pub tensors: bool,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints verify`.
#[derive(Debug, Clone, Args)]
#[command(after_help = VERIFY_EXAMPLES)]
pub struct VerifyArgs {
    /// Checkpoints, or stores, of which all are checked.
    #[arg(value_name = "STORE|CHECKPOINT", required = true)]
    pub checkpoints: Vec<Selector>,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints diff`.
#[derive(Debug, Clone, Args)]
#[command(after_help = DIFF_EXAMPLES)]
pub struct DiffArgs {
    /// The first checkpoint.
    #[arg(value_name = "A")]
    pub a: Selector,
    /// The second.
    #[arg(value_name = "B")]
    pub b: Selector,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints pin` and `unpin`.
#[derive(Debug, Clone, Args)]
#[command(after_help = PIN_EXAMPLES)]
pub struct PinArgs {
    /// The checkpoint.
    #[arg(value_name = "CHECKPOINT")]
    pub checkpoint: Selector,
    /// Print what it is now as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints tag`.
#[derive(Debug, Clone, Args)]
#[command(after_help = TAG_EXAMPLES)]
pub struct TagArgs {
    /// The checkpoint.
    #[arg(value_name = "CHECKPOINT")]
    pub checkpoint: Selector,
    /// The tag: letters, digits, dots, underscores, dashes.
    #[arg(value_name = "TAG")]
    pub tag: Name,
    /// Print what it is now as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints untag`.
#[derive(Debug, Clone, Args)]
#[command(after_help = TAG_EXAMPLES)]
pub struct UntagArgs {
    /// A run directory or a directory of checkpoints.
    #[arg(value_name = "STORE")]
    pub store: PathBuf,
    /// The tag.
    #[arg(value_name = "TAG")]
    pub tag: Name,
    /// Print what the checkpoint is now as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints prune`.
#[derive(Debug, Clone, Args)]
#[command(after_help = PRUNE_EXAMPLES)]
pub struct PruneArgs {
    /// A run directory, a directory of checkpoints, or a bucket.
    #[arg(value_name = "STORE")]
    pub store: PathBuf,
    /// How many of the newest stay.
    #[arg(long, value_name = "N", default_value_t = 3, allow_hyphen_values = true, value_parser = whole::<u32>(1, 1_000_000_000))]
    pub keep_latest: u32,
    /// Those whose iteration is a multiple of this stay too.
    #[arg(long, value_name = "K", allow_hyphen_values = true, value_parser = whole::<u64>(1, u64::MAX))]
    pub keep_every: Option<u64>,
    /// Only say what would be removed.
    #[arg(long)]
    pub dry_run: bool,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints rebuild`.
#[derive(Debug, Clone, Args)]
#[command(after_help = REBUILD_EXAMPLES)]
pub struct RebuildArgs {
    /// A run directory or a directory of checkpoints.
    #[arg(value_name = "STORE")]
    pub store: PathBuf,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints commit`.
#[derive(Debug, Clone, Args)]
#[command(after_help = COMMIT_EXAMPLES)]
pub struct CommitArgs {
    /// The run directory.
    #[arg(value_name = "RUN")]
    pub run_dir: PathBuf,
    /// A file with the token to show [default: http.token of the run directory].
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints import`.
#[derive(Debug, Clone, Args)]
#[command(after_help = IMPORT_EXAMPLES)]
pub struct ImportArgs {
    /// The archive; `-` reads standard input.
    #[arg(value_name = "FILE.tar")]
    pub archive: PathBuf,
    /// A run directory or a directory of checkpoints; made if it does not exist.
    #[arg(long, value_name = "STORE")]
    pub store: PathBuf,
    /// Make a directory that holds other things a store.
    #[arg(long)]
    pub force: bool,
    /// The name in the store [default: the one in the archive].
    #[arg(long, value_name = "NAME", allow_hyphen_values = true)]
    pub name: Option<Name>,
    /// Print what was imported as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints export`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXPORT_EXAMPLES)]
pub struct ExportArgs {
    /// The checkpoint.
    #[arg(value_name = "CHECKPOINT")]
    pub checkpoint: Selector,
    /// The archive; `-` writes standard output.
    #[arg(long, value_name = "FILE.tar")]
    pub out: PathBuf,
    /// Write over a file that is there already, and into a run's directory; what is read stays.
    #[arg(long)]
    pub force: bool,
    /// Print what was exported as JSON, unless the archive goes to standard output.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints compose`.
#[derive(Debug, Clone, Args)]
#[command(override_usage = COMPOSE_USAGE, after_help = COMPOSE_EXAMPLES)]
pub struct ComposeArgs {
    /// Arms, counted from 1, and the checkpoint that they come from; given until every arm is.
    #[arg(
        long = "arm",
        value_name = "ARMS=CHECKPOINT",
        allow_hyphen_values = true,
        required = true
    )]
    pub arms: Vec<ArmsFrom>,
    /// Store and name of the new checkpoint.
    #[arg(long, value_name = "STORE/NAME")]
    pub out: PathBuf,
    /// Make a directory that holds other things a store.
    #[arg(long)]
    pub force: bool,
    /// Print what was made as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Options of `octopus checkpoints delete`.
#[derive(Debug, Clone, Args)]
#[command(after_help = DELETE_EXAMPLES)]
pub struct DeleteArgs {
    /// The checkpoint, as RUN:WHICH or a checkpoint's directory.
    #[arg(value_name = "CHECKPOINT")]
    pub checkpoint: Selector,
    /// Remove even the newest whole one of a run, unless the run is going on.
    #[arg(long)]
    pub force: bool,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Arms and where they come from: `3,4=runs/b:best`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArmsFrom {
    /// The arms, counted from 0.
    pub arms: Vec<usize>,
    /// The checkpoint.
    pub checkpoint: Selector,
}

/// The first arm that is there a second time.
pub fn given_twice(arms: &[usize]) -> Option<usize> {
    let again = |(place, arm): &(usize, &usize)| arms[..*place].contains(arm);
    arms.iter().enumerate().find(again).map(|(_, arm)| *arm)
}

impl std::str::FromStr for ArmsFrom {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "wants ARMS=CHECKPOINT, such as 1=runs/a:best or 3,4=runs/b".to_owned();
        let (arms, checkpoint) = text.split_once('=').ok_or_else(wrong)?;
        let arms: Option<Vec<usize>> = arms
            .split(',')
            .map(|arm| arm.parse::<usize>().ok().and_then(|arm| arm.checked_sub(1)))
            .collect();
        let arms = arms.ok_or_else(wrong)?;
        if let Some(arm) = given_twice(&arms) {
            return Err(format!("arm {} is given twice; wants every arm once", arm + 1));
        }
        Ok(Self { arms, checkpoint: checkpoint.parse()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arms_count_from_one() {
        let parsed = "3,4=runs/b:best".parse::<ArmsFrom>().expect("valid");
        assert_eq!(parsed.arms, [2, 3]);
        assert_eq!(parsed.checkpoint.to_string(), "runs/b:best");
        let twice = "1,1=runs/a".parse::<ArmsFrom>().expect_err("no arm comes from two places");
        assert!(twice.contains("arm 1 is given twice"), "{twice}");
        for wrong in ["", "1", "0=runs/a", "1,=runs/a", "a=runs/a", "1=", "-1=runs/a"] {
            assert!(wrong.parse::<ArmsFrom>().is_err(), "{wrong}");
        }
    }
}
