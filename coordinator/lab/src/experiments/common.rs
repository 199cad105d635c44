//! What all experiments are asked for with.

use std::path::PathBuf;

use super::command_line::{option, path_option};
use crate::identity::ControllerName;

/// Policies, robot and episodes of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Common {
    /// A directory that holds `trajectory` and `reorientation`.
    pub policies: Option<PathBuf>,
    /// The trajectory policy.
    pub trajectory: Option<PathBuf>,
    /// The reorientation policy.
    pub reorientation: Option<PathBuf>,
    /// A controller that is not learned, instead of policies.
    pub controller: Option<ControllerName>,
    /// Another robot than the policies' own: its name or its file.
    pub robot: Option<String>,
    /// Episodes of a setting; as many as the experiment has by itself if none are given.
    pub episodes: Option<u32>,
    /// Control steps of an episode.
    pub steps: u32,
    /// Seed of goals and noise.
    pub seed: u64,
    /// Goals instead of held-out ones: a file.
    pub goals: Option<PathBuf>,
}

/// Who is measured beside the policies.
#[derive(Debug, Clone, PartialEq)]
pub enum Beside {
    /// A controller that is not learned.
    Controller(ControllerName),
    /// Another policy: a run directory, a directory of checkpoints or a checkpoint.
    Policy(PathBuf),
}

impl Default for Common {
    fn default() -> Self {
        Self {
            policies: None,
            trajectory: None,
            reorientation: None,
            controller: None,
            robot: None,
            episodes: None,
            steps: 200,
            seed: 0,
            goals: None,
        }
    }
}

impl Common {
    /// Its options on the command line of `octopus experiment`.
    pub(super) fn options(&self) -> Vec<std::ffi::OsString> {
        let paths = [
            ("--policies", &self.policies),
            ("--trajectory", &self.trajectory),
            ("--reorientation", &self.reorientation),
            ("--goals", &self.goals),
        ];
        let mut options: Vec<_> = paths
            .into_iter()
            .filter_map(|(flag, path)| Some(path_option(flag, path.as_deref()?)))
            .collect();
        options.extend(self.controller.map(|name| option("--controller", name.as_str())));
        options.extend(self.robot.as_ref().map(|robot| option("--robot", robot)));
        options.extend(self.episodes.map(|episodes| option("--episodes", episodes)));
        options.extend([option("--steps", self.steps), option("--seed", self.seed)]);
        options
    }
}
