//! Blocks of a run, made again.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use export::{Block, BlockAddress};
use proto::config::Config;
use proto::layout::{ActorLayout, Dimensions, TensorSpec};
use proto::message::policy_version_for;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use run::session::failures;
use simulator::policy::Policy;
use simulator::robot::Robot;
use simulator::rollout::{RolloutError, RolloutSpec, World, rollout};
use store::checkpoint::{Checkpoint, CheckpointStore, Name, POLICY, Selector, read_policy};

/// Reads which block is meant.
pub(crate) fn address(text: &str) -> Result<BlockAddress, String> {
    let wrong = || "wants SEED/ITERATION/SHARD, such as 1/500/1".to_owned();
    let mut parts = text.split('/');
    let mut next = || parts.next().ok_or_else(wrong);
    let (seed, iteration, shard) = (next()?, next()?, next()?);
    if parts.next().is_some() {
        return Err(wrong());
    }
    Ok(BlockAddress {
        seed: seed.parse().map_err(|_| wrong())?,
        iteration: iteration.parse().map_err(|_| wrong())?,
        shard: shard.parse().map_err(|_| wrong())?,
    })
}

/// Everything that a block of a run follows from.
pub(crate) struct BlockSource {
    pub(crate) world: Arc<World>,
    pub(crate) policy: Policy,
    /// The policy's version in the run.
    pub(crate) version: u64,
    /// Where the policy was found.
    pub(crate) found: String,
    address: BlockAddress,
}

impl BlockSource {
    /// That of a run directory's block, acted with the run's own policy or that of the checkpoint `chosen`.
    pub(crate) fn open(
        run_dir: &Path,
        address: BlockAddress,
        chosen: Option<&Checkpoint>,
    ) -> anyhow::Result<Self> {
        let run_dir = store::run_files::run_directory(run_dir)?;
        let config = store::run_files::read_config(&run_dir)?;
        let (robot, _) = store::run_files::read_robot(&run_dir)?;
        let world = World::new(&config, &robot);
        check_address(address, &config, chosen.is_none())?;
        let version = policy_version_for(address.iteration, config.run.overlap);
        let layout = ActorLayout::new(&config, &world.dimensions);
        if let Some(checkpoint) = chosen {
            check_fits(checkpoint, &layout)?;
        }
        let path = match &chosen {
            Some(checkpoint) => checkpoint.dir.join(POLICY),
            None => find_policy(address, &run_dir, &config, version)?,
        };
        let (found, parameters) = (path.display().to_string(), read_policy(&path, &layout)?);
        let policy = world
            .policy(&parameters)
            .map_err(|error| ExitError::new(ExitCode::RunDirectory, format!("{found}: {error}")))?;
        Ok(Self { world: Arc::new(world), policy, version, found, address })
    }

    /// Makes the block.
    pub(crate) fn make(&self) -> Result<Block, RolloutError> {
        let BlockAddress { seed, iteration, shard } = self.address;
        let spec = RolloutSpec { seed, iteration, shard, policy: &self.policy };
        let mut numbers = vec![0.0; self.world.block_layout().len];
        rollout(&self.world, &spec, &mut numbers, &mut |_| {})?;
        Ok(Block { world: Arc::clone(&self.world), address: self.address, numbers })
    }
}

/// Refuses a policy whose network is none that the run's agents have.
fn check_fits(checkpoint: &Checkpoint, wanted: &ActorLayout) -> anyhow::Result<()> {
    let robot = Robot::from_toml(&checkpoint.robot_toml, &checkpoint.dir)?;
    let own = Dimensions::new(&checkpoint.config, robot.joints);
    let own = ActorLayout::new(&checkpoint.config, &own);
    let own_of = |name: &str| own.tensors.iter().find(|tensor| tensor.name == name);
    let fits =
        |tensor: &&TensorSpec| own_of(&tensor.name).is_some_and(|own| own.shape == tensor.shape);
    let Some(lacks) = wanted.tensors.iter().find(|tensor| !fits(tensor)) else { return Ok(()) };
    let is =
        own_of(&lacks.name).map_or_else(|| "none".to_owned(), |own| format!("{:?}", own.shape));
    let message = format!(
        "--policy {}: does not fit the run's network: `{}` is {is}, there {:?}; name one of a run with the same \
         network, observations and number of arms",
        checkpoint.dir.display(),
        lacks.name,
        lacks.shape
    );
    Err(ExitError::new(ExitCode::BadInput, message).into())
}

/// Refuses a block that the run never makes. With a policy of one's own, any seed will do.
fn check_address(
    address: BlockAddress,
    config: &Config,
    own_policy: bool,
) -> Result<(), ExitError> {
    let BlockAddress { seed, iteration, shard } = address;
    let refuse = |what: String| {
        Err(ExitError::new(
            ExitCode::Usage,
            format!("--address {seed}/{iteration}/{shard}: {what}"),
        ))
    };
    let n_shards = config.env.n_shards as u64;
    if u64::from(shard) >= n_shards {
        return refuse(format!(
            "there is no shard {shard}: the run has {}, counted from 0",
            output::counted(n_shards, "shard")
        ));
    }
    if own_policy && seed != config.run.seed {
        let own = config.run.seed;
        return refuse(format!(
            "the run's seed is {own}, not {seed}; with --policy any seed can be rolled out"
        ));
    }
    Ok(())
}

/// The checkpoint that `--policy` names.
pub(crate) fn open_policy(path: &Path) -> anyhow::Result<Checkpoint> {
    let selector =
        Selector::from_path(path).map_err(|message| ExitError::new(ExitCode::Usage, message))?;
    Ok(selector.open()?)
}

/// Where the run has kept the policy.
fn find_policy(
    address: BlockAddress,
    run_dir: &RunDir,
    config: &Config,
    version: u64,
) -> anyhow::Result<PathBuf> {
    let beside = failures::directory(run_dir, (address.iteration, address.shard)).join(POLICY);
    if beside.is_file() {
        return Ok(beside);
    }
    let store = CheckpointStore::new(run_dir.checkpoints());
    let path = store.dir(&Name::of_iteration(version)).join(POLICY);
    if path.is_file() {
        return Ok(path);
    }
    let versions = store.entries()?.into_iter().filter_map(|entry| {
        (entry.name == Name::of_iteration(entry.iteration)).then_some(entry.iteration)
    });
    let possible = reproducible(versions, config.run.overlap, config.planned_iterations());
    let possible: Vec<String> = possible.iter().map(ToString::to_string).collect();
    let possible = match possible.as_slice() {
        [] => "no iteration can be made from the checkpoints that there are".to_owned(),
        [one] => format!("only iteration {one} can be made from the checkpoints that there are"),
        all => {
            format!(
                "from the checkpoints that there are, iterations {} can be made",
                all.join(", ")
            )
        }
    };
    Err(ExitError::new(
        ExitCode::RunDirectory,
        format!(
            "{}: the policy that iteration {} acted with, version {version}, was not kept; \
             {possible}; --policy acts with another one",
            run_dir.path().display(),
            address.iteration,
        ),
    )
    .into())
}

/// The iterations before `planned` that acted with one of these policy versions, in order.
fn reproducible(
    versions: impl IntoIterator<Item = u64>,
    overlap: usize,
    planned: u64,
) -> BTreeSet<u64> {
    let acted = |version: u64| {
        (version..=version.saturating_add(overlap as u64))
            .filter(move |&iteration| policy_version_for(iteration, overlap) == version)
    };
    versions.into_iter().flat_map(acted).filter(|&iteration| iteration < planned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_policy_was_used_for() {
        let of = |versions: &[u64], overlap| {
            reproducible(versions.iter().copied(), overlap, 20).into_iter().collect::<Vec<_>>()
        };
        assert_eq!(of(&[5, 10, 20], 0), [5, 10], "iteration 20 would be the 21st of 20");
        assert_eq!(of(&[0, 5, 10], 1), [0, 1, 6, 11]);
        assert!(of(&[], 1).is_empty());
    }

    /// It was said to be damaged, or longer than what is read.
    #[test]
    fn a_policy_of_another_network_does_not_fit() {
        let policies = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/policies");
        let policy = open_policy(&policies.join("trajectory")).expect("it is there");
        let dir = tempfile::tempdir().expect("tempdir");
        let run_dir = RunDir::new(dir.path());
        std::fs::write(run_dir.robot(), &policy.robot_toml).expect("written");
        let open = |config: &Config| {
            std::fs::write(run_dir.config(), config.to_toml()).expect("written");
            let address = BlockAddress { seed: 2, iteration: 0, shard: 0 };
            BlockSource::open(dir.path(), address, Some(&policy)).map(drop)
        };
        open(&policy.config).expect("its own network");
        let mut config = policy.config.clone();
        config.network.hidden = vec![8];
        let error = open(&config).expect_err("another network");
        assert_eq!(run::errors::exit_code(&error), ExitCode::BadInput);
        let told = error.to_string();
        assert!(told.contains("does not fit the run's network: `hidden.0.weight` is ["), "{told}");
    }
}
