//! Blocks that cannot be made: counted, written down, and the end of the run at the third time.
//!
//! A rollout is a pure function, so what fails by itself fails again, wherever it is made. It is made
//! again all the same, twice, in case a machine and not the program was at fault; what another machine cannot make counts only
//! if this one cannot either. What a person needs
//! to look into it lands in the run directory:
//!
//! ```text
//! failures/iteration-00000017-shard-3/
//!   failure.json          address, message, and the environment before the step that failed
//!   policy.safetensors    the actors that the block was made with, for `octopus rollout`
//! ```

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use channels::ChannelError;
use channels::{ArrayReceiver, ArraySample};
use proto::config::Config;
use proto::layout::{ActorLayout, Dimensions, PolicyHeader};
use proto::message::{Fault, policy_version_for};
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::json;
use store::checkpoint::POLICY;
use store::files;

use crate::scheduler::ShardAddress;

/// How often a block may fail before the run is stopped.
const MAX_ATTEMPTS: u32 = 3;
/// Policies that are kept: that of the iteration being trained on and that of the next.
const KEPT_POLICIES: usize = 2;
/// Name of the report.
pub const FAILURE: &str = "failure.json";

/// Directory of a failed block.
pub fn directory(run_dir: &RunDir, (iteration, shard): ShardAddress) -> PathBuf {
    run_dir.failures().join(format!("iteration-{iteration:08}-shard-{shard}"))
}

/// The failures of a session, and the newest policies.
#[derive(Debug)]
pub(super) struct Failures {
    run_dir: RunDir,
    config: Config,
    layout: ActorLayout,
    attempts: BTreeMap<ShardAddress, u32>,
    policies: VecDeque<ArraySample<PolicyHeader>>,
    /// A copy that outlives its sample, of the version that was asked for last.
    copied: Option<(u64, Arc<[f32]>)>,
    receiver: ArrayReceiver<PolicyHeader>,
}

impl Failures {
    pub(super) fn new(
        run_dir: &RunDir,
        config: &Config,
        dimensions: &Dimensions,
        receiver: ArrayReceiver<PolicyHeader>,
    ) -> Self {
        Self {
            run_dir: run_dir.clone(),
            config: config.clone(),
            layout: ActorLayout::new(config, dimensions),
            attempts: BTreeMap::new(),
            policies: VecDeque::new(),
            copied: None,
            receiver,
        }
    }

    /// Takes in new policies: views of shared memory, nothing is copied.
    pub(super) fn take_policies(&mut self) -> Result<(), ChannelError> {
        while let Some(policy) = self.receiver.try_receive()? {
            self.policies.push_back(policy);
            while self.policies.len() > KEPT_POLICIES {
                self.policies.pop_front();
            }
        }
        Ok(())
    }

    /// Parameters of a policy, if it is one of the newest. One that is asked for again is not copied again.
    pub(super) fn policy(&mut self, version: u64) -> Option<Arc<[f32]>> {
        if let Some((copied, policy)) = &self.copied
            && *copied == version
        {
            return Some(Arc::clone(policy));
        }
        let policy = self.policies.iter().find(|policy| policy.header().version == version)?;
        let policy: Arc<[f32]> = policy.payload().into();
        self.copied = Some((version, Arc::clone(&policy)));
        Some(policy)
    }

    /// Lets go of the policies of a learner that is no more.
    pub(super) fn forget_policies(&mut self) {
        self.policies.clear();
        self.copied = None;
    }

    /// A block has been made, so nothing is wrong with it.
    pub(super) fn made(&mut self, address: ShardAddress) {
        self.attempts.remove(&address);
    }

    /// A block could not be made. Written down; the error ends the run.
    pub(super) fn failed(
        &mut self,
        address: ShardAddress,
        message: &str,
        fault: Option<&Fault>,
    ) -> Result<(), ExitError> {
        let attempts = self.attempts.entry(address).or_default();
        *attempts += 1;
        let attempts = *attempts;
        let (iteration, shard) = address;
        let dir = directory(&self.run_dir, address);
        if let Err(error) = self.write(&dir, address, attempts, message, fault) {
            tracing::warn!(%error, "a failed block could not be written down");
        }
        if attempts < MAX_ATTEMPTS {
            return Ok(());
        }
        let seed = self.config.run.seed;
        Err(ExitError::new(
            ExitCode::Child,
            format!(
                "the block of seed {seed}, iteration {iteration}, shard {shard} failed {attempts} \
                 times: {message}\nwhat is known about it: {}\nmake it alone: octopus rollout {} \
                 --address {seed}/{iteration}/{shard}",
                dir.display(),
                output::quoted(self.run_dir.path()),
            ),
        ))
    }

    fn write(
        &self,
        dir: &Path,
        (iteration, shard): ShardAddress,
        attempts: u32,
        message: &str,
        fault: Option<&Fault>,
    ) -> anyhow::Result<()> {
        std::fs::create_dir_all(dir)?;
        let version = policy_version_for(iteration, self.config.run.overlap);
        let policy = self.policies.iter().find(|policy| policy.header().version == version);
        if let Some(policy) = policy {
            let views = self.layout.tensors.iter().map(|tensor| {
                let bytes = bytemuck::cast_slice(&policy.payload()[tensor.range()]);
                let view = TensorView::new(Dtype::F32, tensor.shape.clone(), bytes);
                (tensor.name.clone(), view.expect("a layout's ranges fit its shapes"))
            });
            files::replace(&dir.join(POLICY), &safetensors::serialize(views, None)?)?;
        }
        let report = json!({
            "seed": self.config.run.seed,
            "iteration": iteration,
            "shard": shard,
            "policy_version": version,
            "attempts": attempts,
            "message": message,
            "environment_index": fault.and_then(|fault| fault.env),
            "step": fault.and_then(|fault| fault.step),
            "environment": fault.map(|fault| &fault.environment),
        });
        files::replace(&dir.join(FAILURE), &serde_json::to_vec_pretty(&report)?)?;
        Ok(())
    }
}
