//! Other programs on the same work: MuJoCo for the physics, PyTorch for learning and acting.

use std::cell::OnceCell;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context as _;
use proto::config::Activation;
use proto::{ExitCode, ExitError};
use run::environment;
use serde_json::{Value, json};
use simulator::robot::MjcfOptions;
use simulator::robot::mjcf::mjcf;

use super::child;
use super::context::Bench;

const MUJOCO: &str = include_str!("../../../../tests/peers/mujoco_physics.py");
const BATCH: &str = include_str!("../../../../tests/peers/python_batch.py");
const TORCH: &str = include_str!("../../../../tests/peers/torch_learner.py");

/// The Python that has them, and what they reached.
#[derive(Debug)]
pub(super) struct Peers {
    python: PathBuf,
    mujoco: OnceCell<f64>,
    torch: OnceCell<Torch>,
}

/// What PyTorch reaches (env-steps per second of wall time).
#[derive(Debug, Clone, Copy)]
pub(super) struct Torch {
    /// Updates.
    pub(super) learner: f64,
    /// All actions and values.
    pub(super) inference: f64,
}

impl Peers {
    /// Refuses a Python that is not there.
    pub(super) fn find(python: &Path) -> Result<Self, ExitError> {
        if !python.is_file() {
            return Err(child::environment(format!(
                "{}: no Python there; `make venv-benches` installs the peers, --python names another",
                python.display()
            )));
        }
        // A relative program is looked for from here, whatever the child's directory is.
        let python = std::path::absolute(python).unwrap_or_else(|_| python.to_owned());
        Ok(Self { python, mujoco: OnceCell::new(), torch: OnceCell::new() })
    }

    /// Measures MuJoCo: env-steps per second of processor time.
    pub(super) fn mujoco(&self, bench: &Bench, seconds: f64) -> anyhow::Result<f64> {
        let model = bench.scratch.path().join("robot.xml");
        write(&model, &mjcf(&bench.robot, MjcfOptions { contacts: true }))?;
        let home: Vec<String> = bench.robot.home_q().iter().map(f64::to_string).collect();
        let mut command = self.script(bench, "mujoco_physics.py", MUJOCO)?;
        command.arg(&model).arg(format!("--home={}", home.join(",")));
        command.args(["--seconds", &seconds.to_string()]);
        let said = ask(bench, command, None)?;
        said["env_steps_per_s"].as_f64().context("MuJoCo's figures have no rate")
    }

    /// Keeps a rate for what else is compared with it.
    pub(super) fn remember_mujoco(&self, rate: f64) -> f64 {
        *self.mujoco.get_or_init(|| rate)
    }

    /// MuJoCo's rate, measured once.
    pub(super) fn known_mujoco(&self, bench: &Bench) -> anyhow::Result<f64> {
        match self.mujoco.get() {
            Some(rate) => Ok(*rate),
            None => Ok(self.remember_mujoco(self.mujoco(bench, bench.seconds)?)),
        }
    }

    /// PyTorch's rates, measured once.
    pub(super) fn torch(&self, bench: &Bench) -> anyhow::Result<Torch> {
        if let Some(rates) = self.torch.get() {
            return Ok(*rates);
        }
        bench.begin("PyTorch")?;
        let (config, sizes) = (&bench.config, &bench.dimensions);
        let workload = json!({
            "n_agents": sizes.n_agents,
            "observation": sizes.observation,
            "state": sizes.critic_input(),
            "actions": sizes.n_actions,
            "hidden": config.network.hidden,
            "layer_norm": config.network.layer_norm,
            "activation": match config.network.activation {
                Activation::Relu => "relu",
                Activation::Elu => "elu",
                Activation::Tanh => "tanh",
            },
            "epochs": config.algorithm.epochs,
            "mini_batches": config.algorithm.mini_batches,
            "n_steps": sizes.n_steps,
            "n_envs": sizes.n_envs * sizes.n_shards,
            "threads": config.run.learner_threads,
            "seconds": bench.seconds,
        });
        let input = bench.scratch.path().join("workload.json");
        write(&input, &workload.to_string())?;
        let command = self.script(bench, "torch_learner.py", TORCH)?;
        let file = File::open(&input).with_context(|| input.display().to_string())?;
        let said = ask(bench, command, Some(file))?;
        let rate = |key: &str| {
            said[key].as_f64().with_context(|| format!("PyTorch's figures have no {key}"))
        };
        let rates = Torch {
            learner: rate("env_steps_per_s")?,
            inference: rate("inference_env_steps_per_s")?,
        };
        Ok(*self.torch.get_or_init(|| rates))
    }

    /// Measures batches of so many environments in Python, and MuJoCo's rollouts: rates by number of environments.
    pub(super) fn batches(&self, bench: &Bench, envs: &[usize]) -> anyhow::Result<Value> {
        let path = |name: &str| bench.scratch.path().join(name);
        let texts = [
            ("config.toml", bench.config.to_toml()),
            ("robot.toml", bench.robot.to_toml()),
            ("robot.xml", mjcf(&bench.robot, MjcfOptions { contacts: true })),
        ];
        let mut command = self.script(bench, "python_batch.py", BATCH)?;
        for (name, text) in texts {
            write(&path(name), &text)?;
            command.arg(path(name));
        }
        let envs: Vec<String> = envs.iter().map(usize::to_string).collect();
        command.arg(format!("--envs={}", envs.join(",")));
        command.args(["--seconds", &bench.seconds.to_string()]);
        ask(bench, command, None)
    }

    fn script(&self, bench: &Bench, name: &str, text: &str) -> anyhow::Result<Command> {
        let path = bench.scratch.path().join(name);
        write(&path, text)?;
        let mut command = Command::new(&self.python);
        environment::clean(&mut command);
        command.arg(path);
        Ok(command)
    }
}

/// Runs a script to its end and reads its figures.
fn ask(bench: &Bench, command: Command, stdin: Option<File>) -> anyhow::Result<Value> {
    let text = child::output_of(bench, command, stdin, |_| {}).map_err(|error| {
        // Exit code 3 of a script is a package that is missing.
        match error.downcast::<ExitError>() {
            Ok(error) if error.code == ExitCode::BadInput => {
                child::environment(error.message).into()
            }
            Ok(error) => error.into(),
            Err(error) => error,
        }
    })?;
    serde_json::from_str(&text).context("the peer's figures are no JSON")
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))
}
