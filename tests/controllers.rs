//! Exported controllers, compiled and in ONNX Runtime, at the wheel of episodes of the simulator.

use std::fmt::Write as _;
use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Arc;

use anyhow::{Context as _, Result, ensure};
use export::{HeldOut, Origin, Source};
use proto::config::{Config, Layers, Preset, TaskName};
use proto::layout::ActorLayout;
use simulator::evaluate::{Course, EvaluationOptions, evaluate};
use simulator::experiment::{Effect, Episode, Event, Member, Player, Start};
use simulator::policy::{Policy, initial_parameters};
use simulator::robot::Robot;
use simulator::rollout::World;

use crate::{Owned, crosscheck, python};

/// A policy, with its parameters.
#[derive(Debug)]
pub struct Controlled {
    /// What it is called in messages.
    pub name: String,
    /// Its world.
    pub world: World,
    /// Its networks.
    pub policy: Policy,
    /// Their parameters.
    pub parameters: Vec<f32>,
}

impl Controlled {
    /// An untrained policy whose actions are far from zero, with settings over a preset.
    ///
    /// # Errors
    /// If a setting is none.
    pub fn untrained(
        preset: Preset,
        task: TaskName,
        settings: &[&str],
        robot: &Robot,
    ) -> Result<Self> {
        let mut layers = Layers::new(preset, Some(task));
        for setting in settings {
            layers = layers.set(setting)?;
        }
        let mut config: Config = layers.resolve()?;
        // Narrow networks: a unit whose rounding to bfloat16 goes the other way moves a command by more than in wide ones.
        config.network.head_gain = 0.1;
        let world = World::new(&config, robot);
        let mut parameters = initial_parameters(&config, &world.dimensions, 3);
        // Means, gains and biases, which begin with zeros and ones, are told from each other.
        for spec in &ActorLayout::new(&config, &world.dimensions).tensors {
            if !spec.name.ends_with("weight") {
                for (index, x) in parameters[spec.range()].iter_mut().enumerate() {
                    *x += 0.1 * (0.7 * index as f32 + spec.offset as f32).sin();
                }
            }
        }
        let policy = world.policy(&parameters)?;
        let name = format!("{} {} {}", preset.as_str(), task.as_str(), settings.join(" "));
        Ok(Self { name, world, policy, parameters })
    }

    /// The policy of a checkpoint.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn of_checkpoint(dir: &Path) -> Result<Self> {
        let trained = lab::trained::Trained::new(lab::trained::open_checkpoint(dir)?, None)?;
        let parameters = trained.checkpoint.actors(trained.world.robot.joints)?;
        let name = dir.display().to_string();
        Ok(Self { name, world: trained.world, policy: trained.policy, parameters })
    }

    /// Writes its export, as `octopus export` does.
    ///
    /// # Errors
    /// If it cannot be exported or written.
    pub fn export(&self, dir: &Path) -> Result<()> {
        let origin = Origin {
            checkpoint: self.name.clone(),
            digest: "0".repeat(32),
            policy_blake3: None,
            iterations: 0,
            env_steps: 0,
            seed: 0,
            program: "test".to_owned(),
        };
        let held_out = HeldOut {
            episodes: 0,
            steps: 0,
            seed: 0,
            episodes_with_contact: 0,
            errors: Vec::new(),
        };
        let Self { world, policy, parameters, .. } = self;
        let source = Source { world, policy, parameters, origin: &origin, held_out: &held_out };
        fs::create_dir(dir)?;
        for file in export::files(&source)? {
            fs::write(dir.join(file.name), file.content)?;
        }
        Ok(())
    }

    fn options(episodes: usize, steps: usize) -> EvaluationOptions {
        EvaluationOptions { episodes, steps, ..EvaluationOptions::default() }
    }

    /// Errors of held-out episodes as the simulator plays them itself, one an episode and hand (position, orientation) or base.
    ///
    /// # Errors
    /// If an episode diverges.
    pub fn native_errors(&self, episodes: usize, steps: usize) -> Result<Vec<Course>> {
        let options = Self::options(episodes, steps);
        let executor = lab::threads::Threads::available();
        let found =
            evaluate(Player::new(&self.world, &self.policy), &options, &[], &executor, &|| {})?;
        let courses = found.episodes.into_iter().flat_map(|episode| {
            let hands =
                episode.hands.into_iter().flat_map(|hand| [hand.position, hand.orientation]);
            hands.chain([episode.base]).collect::<Vec<_>>()
        });
        Ok(courses.collect())
    }

    /// The same episodes with `driver` at the wheel.
    ///
    /// # Errors
    /// If an episode diverges or the driver fails.
    pub fn driven_errors(
        &self,
        driver: &mut dyn Driver,
        episodes: usize,
        steps: usize,
    ) -> Result<Vec<Course>> {
        let member = Member { world: self.world.clone(), policy: self.policy.clone() };
        let member = Arc::new(member);
        let mut all = Vec::new();
        for index in 0..episodes {
            let start = Start { episode: index as u32, ..Start::default() };
            // What the policy wants is replaced in every step. It keeps its seats: of arms that it does not move no goal postures are looked ahead for.
            all.push(Episode::new(vec![member.clone()], start)?);
        }
        let mut errors = vec![Vec::new(); episodes * (2 * self.world.dimensions.n_arms + 1)];
        for step in 0..steps {
            let actions = driver.actions(&all, step, &self.world)?;
            let mut errors = errors.iter_mut();
            for (episode, actions) in all.iter_mut().zip(actions) {
                for (joint, action) in actions.into_iter().enumerate() {
                    let effect = Effect::Action { joints: joint..joint + 1, value: action };
                    episode.apply(&Event::Effect { effect, steps: Some(1) })?;
                }
                episode.step()?;
                let now = episode.errors();
                for (position, orientation) in now.position_norm.iter().zip(&now.orientation_norm) {
                    errors.next().expect("room").push(*position);
                    errors.next().expect("room").push(*orientation);
                }
                errors.next().expect("room").push(now.base_norm);
            }
        }
        Ok(errors.iter().map(|values| Course::of(values.iter().copied())).collect())
    }
}

/// Something that decides on actions.
pub trait Driver {
    /// Actions of every episode, before scaling (rad/s).
    ///
    /// # Errors
    /// If it does not answer, or refuses.
    fn actions(
        &mut self,
        episodes: &[Episode],
        step: usize,
        world: &World,
    ) -> Result<Vec<Vec<f64>>>;
}

/// A program that is asked by lines and answers by lines.
struct Asked {
    // Dropped before the program, which ends when nobody asks.
    to: Option<ChildStdin>,
    from: BufReader<ChildStdout>,
    _program: Owned,
}

impl Asked {
    fn spawn(command: &mut Command) -> Result<Self> {
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn()?;
        let from = BufReader::new(child.stdout.take().context("a pipe")?);
        let to = child.stdin.take();
        Ok(Self { to, from, _program: Owned::from(child) })
    }

    fn ask(&mut self, question: &str, answers: usize) -> Result<Vec<Vec<f64>>> {
        let to = self.to.as_mut().context("a pipe")?;
        to.write_all(question.as_bytes())?;
        to.flush()?;
        let mut all = Vec::new();
        for _ in 0..answers {
            let mut line = String::new();
            self.from.read_line(&mut line)?;
            let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
            all.push(numbers.with_context(|| format!("{line:?}"))?);
        }
        Ok(all)
    }
}

/// The numbers of a state, and of the goals, as inputs have them.
fn state_and_goals(episode: &Episode, world: &World) -> [Vec<f32>; 2] {
    let (goals, task) = (episode.goals(), world.config.task.name);
    let mut numbers = Vec::new();
    if task.reaches() {
        numbers.extend(goals.hands.as_flattened());
    }
    numbers.extend(goals.hand_velocities().unwrap_or_default().as_flattened());
    if task.turns() {
        numbers.extend(goals.base);
    }
    [episode.state().parts().concat(), numbers]
}

fn write_numbers(line: &mut String, numbers: impl IntoIterator<Item = f32>) {
    for number in numbers {
        let _ = write!(line, "{number:e} ");
    }
}

/// The C code, compiled.
pub struct CDriver(Asked);

impl std::fmt::Debug for CDriver {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("CDriver")
    }
}

/// Compiles a program of C with `controller.c` of `dir`, with every warning an error.
///
/// # Errors
/// If the compiler refuses.
pub fn compile(dir: &Path, program: &Path, flags: &[&str]) -> Result<PathBuf> {
    let cc = |words: &[&Path]| -> Result<()> {
        let output = Command::new("cc")
            .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"])
            .args(flags)
            .arg("-I")
            .arg(dir)
            .args(words)
            .arg("-lm")
            .output()
            .context("cc can be started")?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "cc {flags:?} of {}: {said}", dir.display());
        Ok(())
    };
    let [source, o, c] = [&*dir.join("controller.c"), "-o".as_ref(), "-c".as_ref()];
    // Longer than most programs with it take: compiled once with the same flags.
    let object = dir.join(format!("controller{}.o", flags.concat()));
    if !object.exists() {
        cc(&[c, source, o, &object])?;
    }
    let out = dir.join(program.file_stem().context("a name")?);
    cc(&[program, &object, o, &out])?;
    Ok(out)
}

impl CDriver {
    /// Compiles and starts it.
    ///
    /// # Errors
    /// If that fails.
    pub fn new(dir: &Path) -> Result<Self> {
        let program = compile(dir, &crosscheck("controller_loop.c"), &["-O2"])?;
        Ok(Self(Asked::spawn(&mut Command::new(program))?))
    }
}

impl Driver for CDriver {
    fn actions(
        &mut self,
        episodes: &[Episode],
        step: usize,
        world: &World,
    ) -> Result<Vec<Vec<f64>>> {
        let mut question = String::new();
        for (index, episode) in episodes.iter().enumerate() {
            let _ = write!(question, "{index} {} ", i32::from(step == 0));
            write_numbers(&mut question, state_and_goals(episode, world).into_iter().flatten());
            question.push('\n');
        }
        let answers = self.0.ask(&question, episodes.len())?;
        let joints = world.robot.n_joints();
        answers.iter().zip(episodes).try_for_each(|(answer, episode)| {
            ensure!(answer.len() == 1 + 2 * joints, "{answer:?}");
            ensure!(answer[0] == 0.0, "status {} in step {step}", answer[0]);
            let scale = world.task.action_scale as f32;
            for (action, command) in answer[1..].iter().zip(&answer[1 + joints..]) {
                ensure!(f64::from(*action as f32 * scale) == *command, "{action} {command}");
            }
            ensure!(episode.steps() == step, "one step after the other");
            Ok(())
        })?;
        Ok(answers.into_iter().map(|answer| answer[1..=joints].to_vec()).collect())
    }
}

/// ONNX Runtime.
pub struct OnnxDriver(Asked);

impl std::fmt::Debug for OnnxDriver {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("OnnxDriver")
    }
}

impl OnnxDriver {
    /// Starts it for so many robots at once.
    ///
    /// # Errors
    /// If that fails.
    pub fn new(dir: &Path, robots: usize) -> Result<Self> {
        let mut command = Command::new(python());
        command.arg(crosscheck("controllers.py")).args(["loop", &robots.to_string()]).arg(dir);
        Ok(Self(Asked::spawn(&mut command)?))
    }
}

impl Driver for OnnxDriver {
    fn actions(
        &mut self,
        episodes: &[Episode],
        _step: usize,
        world: &World,
    ) -> Result<Vec<Vec<f64>>> {
        let mut question = String::new();
        for episode in episodes {
            let [state, goals] = state_and_goals(episode, world);
            let last = episode.commands().iter().copied();
            let room = 2 + world.robot.joints.longest_arm();
            let postures = episode.errors().postures().unwrap_or_default();
            let postures = postures
                .iter()
                .flat_map(|of_arm| of_arm.iter().copied().chain(std::iter::repeat(0.0)).take(room));
            let numbers = state.into_iter().chain(last).chain(goals).chain(postures);
            write_numbers(&mut question, numbers);
            question.push('\n');
        }
        let commands = self.0.ask(&question, episodes.len())?;
        let scale = world.task.action_scale;
        Ok(commands
            .into_iter()
            .map(|row| row.into_iter().map(|command| command / scale).collect())
            .collect())
    }
}

/// The C code at the wheel, and ONNX Runtime asked beside it in every step.
#[derive(Debug)]
pub struct Compared {
    c: CDriver,
    onnx: OnnxDriver,
    /// Largest difference of a command so far (rad/s).
    pub apart: f64,
}

impl Compared {
    /// Starts both for so many robots.
    ///
    /// # Errors
    /// If that fails.
    pub fn new(dir: &Path, robots: usize) -> Result<Self> {
        Ok(Self { c: CDriver::new(dir)?, onnx: OnnxDriver::new(dir, robots)?, apart: 0.0 })
    }
}

impl Driver for Compared {
    fn actions(
        &mut self,
        episodes: &[Episode],
        step: usize,
        world: &World,
    ) -> Result<Vec<Vec<f64>>> {
        let by_c = self.c.actions(episodes, step, world)?;
        let by_onnx = self.onnx.actions(episodes, step, world)?;
        for (c, onnx) in by_c.iter().flatten().zip(by_onnx.iter().flatten()) {
            ensure!(onnx.is_finite(), "ONNX Runtime commands {onnx} in step {step}");
            self.apart = self.apart.max(world.task.action_scale * (c - onnx).abs());
        }
        Ok(by_c)
    }
}
