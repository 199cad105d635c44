//! From arguments to a running learner.

use proto::agents::Joints;
use std::path::{Path, PathBuf};

use process::{input, originals};
use proto::ExitError;
use proto::config::Config;
use proto::layout::Dimensions;
use proto::message::{self, Progress};
use proto::run_dir::RunDir;
use tch::Device;

use super::learner_loop::serve;
use super::outbox::Outbox;
use super::ports::Ports;
use super::process::{Learner, Trainer};
use crate::LearnerError;
use crate::algorithm::Algorithm;
use crate::precision::Arithmetic;
use crate::state::TrainingState;
use crate::state::image::Image;
use crate::threads::KeptThreads;

/// Trains the policies of a SpaceOctopus run; started by `octopus`, not by hand.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "learner", version)]
pub struct Arguments {
    /// Run directory, holding config.toml and robot.toml.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
    /// Name under which the run's shared memory lives.
    #[arg(long, value_name = "NAME")]
    pub domain: String,
    /// Training state to go on from.
    #[arg(long, value_name = "FILE")]
    pub resume: Option<PathBuf>,
    /// Process that started this one: the learner does not start if that is gone already.
    #[arg(long, value_name = "PID")]
    pub parent: Option<i32>,
}

/// Learns until it is told to stop.
pub fn run(arguments: &Arguments) -> Result<(), ExitError> {
    process::child::die_with_parent(arguments.parent)?;
    let (config, dimensions) = load(&RunDir::new(&arguments.run_dir))?;
    let device = device(&config.run.device)?;
    let threads = i32::try_from(config.run.learner_threads).unwrap_or(i32::MAX);
    tch::set_num_threads(threads);
    tch::set_num_interop_threads(1);
    let arithmetic = Arithmetic::of(config.run.precision)?;
    let state = match &arguments.resume {
        None => TrainingState::initial(&config, &dimensions, arithmetic, device),
        Some(path) => {
            let data = read_state(path)?;
            let state = TrainingState::from_safetensors(&data, &config, &dimensions, device)
                .map_err(|error| LearnerError::State(format!("{}: {error}", path.display())))?;
            if state.arithmetic != arithmetic {
                return Err(LearnerError::State(format!(
                    "{}: was trained in {}, and run.precision is {}; is it a state of this run?",
                    path.display(),
                    state.arithmetic.as_str(),
                    arithmetic.as_str()
                ))
                .into());
            }
            state
        }
    };
    let mut ports = Ports::open(&arguments.domain, &config, &dimensions, state.iteration)?;
    let (image, spare) = Image::new(&state);
    ports.outbox = Outbox::new(spare);
    let mut learner = Learner {
        ports,
        image,
        dimensions,
        task: config.task.name,
        run: config.run.clone(),
        digest: state.digest(),
        trainer: Trainer {
            algorithm: Algorithm::new(&config, &dimensions, &state),
            state,
            thread: KeptThreads::new("update", 1),
        },
    };
    let result = serve(&mut learner);
    if let Err(error) = &result {
        let message = message::clip(&error.to_string());
        // The coordinator may be gone; the error is returned either way.
        let _ = learner.ports.progress.send(&Progress::Failed { message });
    }
    Ok(result?)
}

/// Reads a training state. One that cannot be read is as one that cannot be restored: the coordinator goes on
/// from the one before.
fn read_state(path: &Path) -> Result<Vec<u8>, LearnerError> {
    input::read(path, input::STATE).map_err(|error| {
        LearnerError::State(format!("{}: cannot be read: {error}", path.display()))
    })
}

/// Reads configuration and robot of a run. Of the robot the learner needs the number of joints of each arm only.
pub fn load(run_dir: &RunDir) -> Result<(Config, Dimensions), LearnerError> {
    let named = |path: PathBuf, text| -> Result<(String, String), LearnerError> {
        match text {
            Ok(text) => Ok((text, path.display().to_string())),
            Err(source) => Err(LearnerError::File { path, source }),
        }
    };
    let (config, origin) = named(run_dir.config(), originals::config(run_dir))?;
    let config = Config::from_resolved_toml(&config, &origin)?;
    let (robot, origin) = named(run_dir.robot(), originals::robot(run_dir))?;
    let robot: toml::Table = robot
        .parse()
        .map_err(|error| LearnerError::Robot(format!("{origin}: not valid TOML: {error}")))?;
    let arms = robot.get("arms").and_then(toml::Value::as_array).map_or(&[][..], Vec::as_slice);
    let of_arm = |arm: &toml::Value| arm.get("home")?.as_array().map(Vec::len);
    let joints: Vec<usize> = arms.iter().map(|arm| of_arm(arm).unwrap_or(0)).collect();
    let Some(of_robot) = Joints::of_outside(&joints) else {
        let expected = "1 to 8 [[arms]], each with the 2 to 7 angles of its joints at `home`";
        return Err(LearnerError::Robot(format!(
            "{origin}: arms of {joints:?} joints, expected {expected}"
        )));
    };
    let dimensions = Dimensions::new(&config, of_robot);
    Ok((config, dimensions))
}

/// The device called `name`, if it is there.
pub fn device(name: &str) -> Result<Device, LearnerError> {
    let Some(index) = name.strip_prefix("cuda:") else { return Ok(Device::Cpu) };
    let index: usize =
        index.parse().map_err(|_| LearnerError::Device(format!("`{name}` is no device")))?;
    if !cfg!(feature = "cuda") {
        return Err(LearnerError::Device(format!(
            "run.device is `{name}`, but this learner was built without CUDA; \
             `make setup DEVICE=cuda && make build` builds one with it, run.device=cpu does without"
        )));
    }
    let count = tch::Cuda::device_count() as usize;
    if !tch::Cuda::is_available() || index >= count {
        return Err(LearnerError::Device(format!(
            "run.device is `{name}`, but libtorch sees {}; `nvidia-smi` lists them, \
             run.device=cpu does without",
            match count {
                0 => "no CUDA device".to_owned(),
                1 => "one CUDA device, cuda:0".to_owned(),
                _ => format!("CUDA devices cuda:0 to cuda:{}", count - 1),
            }
        )));
    }
    Ok(Device::Cuda(index))
}

#[cfg(test)]
mod tests {
    use proto::ExitCode;

    use super::*;

    /// A checkpoint that was removed while a learner started from it once ended the run.
    #[test]
    fn a_state_that_cannot_be_read_is_told_from_other_bad_input() {
        let dir = tempfile::tempdir().expect("tempdir");
        for path in [dir.path().join("gone.safetensors"), dir.path().to_owned()] {
            let error = ExitError::from(read_state(&path).expect_err("nothing to read"));
            assert_eq!(error.code, ExitCode::RunDirectory, "{error}");
            assert!(error.message.starts_with("training state: "), "{error}");
            assert!(error.message.contains(&path.display().to_string()), "{error}");
        }
        let error = ExitError::from(load(&RunDir::new(dir.path())).expect_err("no run"));
        assert_eq!(error.code, ExitCode::BadInput, "the state is not to blame: {error}");
        assert!(error.message.contains("config.toml"), "{error}");
    }
}
