//! What a run needs of the machine, checked before anything is created.
//!
//! Every check ends in a [`Check`]: what was found, and if that is not enough, the flag or command
//! that cures it. A run stops at the first one that fails; `octopus doctor` shows all that do not
//! depend on the run.

use std::io::Read as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use channels::{ChannelSizes, SHARED_MEMORY};
use proto::config::{Config, Precision};
use proto::layout::{Dimensions, replay_bytes};
pub use proto::mib;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use rustix::process::{Resource, getrlimit};
use serde::Serialize;
use simulator::robot::Robot;
use store::checkpoint::CheckpointStore;
use store::files::free_space;
use store::provenance;

use crate::{environment, precision};

mod smaller;

/// What helps where shared memory is full and no run's needs are known.
pub const MAKE_ROOM: &str = "`octopus clean` removes what killed runs left, `ls -l /dev/shm` shows what \
                             others have there, `mount -o remount,size=SIZE /dev/shm` enlarges it";

/// How a check ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Enough.
    Good,
    /// A run works, but not as well as it could.
    Warning,
    /// A run does not work.
    Failure,
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What.
    pub name: &'static str,
    /// Whether it is enough.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What to do about it.
    pub cure: Option<String>,
}

impl Check {
    /// Enough.
    pub fn good(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Good, found: found.into(), cure: None }
    }

    /// Not as good as it could be.
    pub fn warning(name: &'static str, found: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Warning, found: found.into(), cure: Some(cure.into()) }
    }

    /// Not enough.
    pub fn failure(name: &'static str, found: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Failure, found: found.into(), cure: Some(cure.into()) }
    }

    /// Found and cure in one sentence.
    pub fn sentence(&self) -> String {
        match &self.cure {
            Some(cure) => format!("{}: {}; {cure}", self.name, self.found),
            None => format!("{}: {}", self.name, self.found),
        }
    }
}

/// Refuses to start a run that this machine cannot carry; logs what could be better. What the command that asks has of
/// [`Remedy::flags`] is in `flags`.
pub fn check_run(
    config: &Config,
    dimensions: &Dimensions,
    learner: &Path,
    flags: &[&str],
) -> Result<(), ExitError> {
    let workers = config.run.workers;
    let checks: [&dyn Fn() -> Check; 8] = [
        &|| shared_memory(config, dimensions, flags),
        &|| file_size(config, dimensions),
        &|| descriptors(workers, flags),
        &|| memory_maps(workers),
        &|| processors(workers, config.run.learner_threads, flags),
        &|| arithmetic(config, &provenance::vector_extensions()),
        &|| libtorch(learner),
        &|| device(learner, &config.run.device),
    ];
    for check in checks {
        let check = check();
        match check.verdict {
            Verdict::Good => {}
            Verdict::Warning => output::note(&format!("note: {}", check.sentence())),
            Verdict::Failure => {
                return Err(ExitError::new(ExitCode::Environment, check.sentence()));
            }
        }
    }
    Ok(())
}

/// Free shared memory against what the channels of the run reserve.
pub fn shared_memory(config: &Config, dimensions: &Dimensions, flags: &[&str]) -> Check {
    const NAME: &str = "shared memory";
    let directory = Path::new(SHARED_MEMORY);
    let free = match free_space(directory) {
        Ok(free) => free,
        Err(error) => return unmounted(NAME, directory, &error),
    };
    let workers = config.run.workers;
    let budget = ChannelSizes::new(config, dimensions).shared_memory(workers);
    let needed: u64 = budget.iter().map(|(_, bytes)| bytes).sum();
    if needed <= free {
        let found = format!("{} free of {} needed", mib(free), mib(needed));
        return Check::good(NAME, found);
    }
    let parts: Vec<_> =
        budget.iter().map(|(name, bytes)| format!("{name} {}", mib(*bytes))).collect();
    let shown = directory.display();
    Check::failure(
        NAME,
        format!(
            "this run needs {} ({}) and {shown} has {} free",
            mib(needed),
            parts.join(", "),
            mib(free)
        ),
        cures(needed, &smaller::fitting(config, dimensions, free, flags), directory),
    )
}

/// What helps where shared memory is too small; only what would be enough.
fn cures(needed: u64, less: &[String], directory: &Path) -> String {
    let shown = directory.display();
    let mut cures = Vec::new();
    if round_up(needed) << 20 <= provenance::memory() {
        let size = round_up(needed);
        cures.push(format!(
            "enlarge it: `mount -o remount,size={size}M {shown}` (in a container start it with \
             --shm-size={size}m)"
        ));
    }
    if !less.is_empty() {
        cures.push(format!("need less: {}", less.join(" or ")));
    }
    if cures.is_empty() {
        cures.push(
            "need less: smaller networks and episodes, or a machine with more memory".to_owned(),
        );
    }
    cures.push("`octopus clean` removes what killed runs left".to_owned());
    cures.join("; ")
}

fn unmounted(name: &'static str, directory: &Path, error: &std::io::Error) -> Check {
    let shown = directory.display();
    Check::failure(
        name,
        format!("{shown} cannot be measured: {error}"),
        format!("mount it: `mount -t tmpfs -o size=1024M tmpfs {shown}`"),
    )
}

/// Whether there is shared memory for `to` workers where `from` are now.
pub fn scale(sizes: &ChannelSizes, from: usize, to: usize) -> Result<(), String> {
    let total = |workers| sizes.shared_memory(workers).iter().map(|(_, bytes)| bytes).sum::<u64>();
    let more = total(to).saturating_sub(total(from));
    let free =
        free_space(Path::new(SHARED_MEMORY)).map_err(|error| format!("shared memory: {error}"))?;
    if more <= free {
        return Ok(());
    }
    Err(format!(
        "{to} workers need {} more of shared memory, {} are free; ask for fewer workers",
        mib(more),
        mib(free)
    ))
}

/// Whether there is not even room for what a process needs to come up.
pub fn shared_memory_is_full() -> bool {
    free_space(Path::new(SHARED_MEMORY)).is_ok_and(|free| free < 1 << 20)
}

/// Refuses what the machine cannot carry; `remedy` is what helps.
pub fn check_machine(
    config: &Config,
    robot: &Robot,
    run_dir: &RunDir,
    learner: &Path,
    remedy: &Remedy,
) -> Result<(), ExitError> {
    let dimensions = Dimensions::new(config, robot.n_arms);
    check_run(config, &dimensions, learner, remedy.flags)?;
    let there = CheckpointStore::new(run_dir.checkpoints()).list().map_or(0, |there| there.len());
    let disk = disk(run_dir.path(), config, &dimensions, there, remedy);
    if disk.verdict == Verdict::Failure {
        return Err(ExitError::new(ExitCode::RunDirectory, disk.sentence()));
    }
    Ok(())
}

/// How large a file may become, against the largest segment of shared memory and the largest file of a
/// checkpoint.
pub fn file_size(config: &Config, dimensions: &Dimensions) -> Check {
    const NAME: &str = "file size";
    let Some(limit) = getrlimit(Resource::Fsize).current else {
        return Check::good(NAME, "no limit");
    };
    let segments = ChannelSizes::new(config, dimensions).shared_memory(1);
    let segment = segments.iter().map(|(_, bytes)| *bytes).max().unwrap_or(0);
    let needed = segment.max(checkpoint_size(config, dimensions));
    if limit < needed {
        let found =
            format!("a file may have {} and this run makes one of {}", mib(limit), mib(needed));
        return Check::failure(NAME, found, "`ulimit -f unlimited`");
    }
    Check::good(NAME, format!("{} allowed, {} needed", mib(limit), mib(needed)))
}

/// Size of a checkpoint, about (bytes): actors and critics of the same size, parameters and two moments
/// of each, the actors apart, and a replay.
fn checkpoint_size(config: &Config, dimensions: &Dimensions) -> u64 {
    let policy = ChannelSizes::new(config, dimensions).policy_len as u64;
    4 * policy * 7 + replay_bytes(config, dimensions)
}

/// Open files that a process of the run may have, against what the transport opens.
pub fn descriptors(workers: usize, flags: &[&str]) -> Check {
    const NAME: &str = "file descriptors";
    // With two workers a learner has 80 open, a worker 69, a coordinator 65 (/proc/PID/fd); each
    // further worker adds a few connections to all of them, and this leaves room for that.
    let needed = 128 + 32 * (workers as u64 + 2);
    let limits = getrlimit(Resource::Nofile);
    match limits.current {
        Some(limit) if limit < needed => Check::failure(
            NAME,
            format!("a process may open {limit} files and {workers} workers need {needed}"),
            smaller::open_files(needed, limit, limits.maximum, flags),
        ),
        Some(limit) => Check::good(NAME, format!("{limit} allowed, {needed} needed")),
        None => Check::good(NAME, "no limit"),
    }
}

/// Memory maps that a process may have.
pub fn memory_maps(workers: usize) -> Check {
    const NAME: &str = "memory maps";
    let needed = 4096 + 256 * workers as u64;
    let text = std::fs::read_to_string("/proc/sys/vm/max_map_count").unwrap_or_default();
    match text.trim().parse::<u64>() {
        Ok(limit) if limit < needed => Check::failure(
            NAME,
            format!("a process may have {limit} and {needed} are needed"),
            format!("`sysctl -w vm.max_map_count={}`", needed.max(65_530)),
        ),
        Ok(limit) => Check::good(NAME, format!("{limit} allowed, {needed} needed")),
        Err(_) => Check::good(NAME, "no limit known"),
    }
}

/// Processors against the threads of a run.
pub fn processors(workers: usize, learner_threads: usize, flags: &[&str]) -> Check {
    const NAME: &str = "processors";
    let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let extensions = provenance::vector_extensions();
    let name = provenance::processor_name();
    let found = format!("{processors} of {name} ({})", extensions.join(", "));
    let mut crowd = Vec::new();
    let mut faster = Vec::new();
    if workers > processors {
        crowd.push(format!("{workers} workers"));
        if flags.contains(&smaller::WORKERS) {
            faster.push(format!("{} {processors}", smaller::WORKERS));
        }
    }
    if learner_threads > processors {
        crowd.push(format!("{learner_threads} learner threads"));
        faster.push(format!("a new run with --set run.learner_threads={processors}"));
    }
    if !crowd.is_empty() {
        let found = format!("{found}, shared by {}", crowd.join(" and by "));
        let cure = match faster.as_slice() {
            [] => "a machine with more processors is faster".to_owned(),
            some => format!("{} is faster", some.join(", ")),
        };
        return Check::warning(NAME, found, cure);
    }
    if cfg!(target_arch = "x86_64")
        && !(extensions.contains(&"avx2") && extensions.contains(&"fma"))
    {
        return Check::warning(
            NAME,
            format!("{found}; without AVX2 and FMA rollouts are several times slower"),
            "use a processor of 2013 or later",
        );
    }
    Check::good(NAME, found)
}

/// Whether a processor with these `instructions` has one for the products that are asked for. It computes them
/// without, all the same.
pub fn arithmetic(config: &Config, instructions: &[&str]) -> Check {
    const NAME: &str = "precision";
    let best = precision::decide(&config.run.device, instructions);
    let wanted = match config.run.precision {
        Precision::Auto => best,
        wanted => wanted,
    };
    if wanted == Precision::Bf16 && best == Precision::F32 {
        return Check::warning(
            NAME,
            "bf16, which this processor has no instructions for; libtorch computes it slowly by others, which may \
             round sums otherwise than where a run began",
            "a new run with --set run.precision=f32 is faster here",
        );
    }
    let name = precision::name(wanted);
    Check::good(
        NAME,
        match config.run.precision {
            Precision::Auto => format!("the learner multiplies in {name} unless told otherwise"),
            _ => name.to_owned(),
        },
    )
}

/// Memory of the machine.
pub fn memory() -> Check {
    const NAME: &str = "memory";
    let memory = provenance::memory();
    if memory < 2 << 30 {
        return Check::warning(
            NAME,
            mib(memory),
            "the default run needs about 2 GiB: `octopus train` with fewer --workers and --envs",
        );
    }
    Check::good(NAME, mib(memory))
}

/// Whether the learner starts: it links libtorch, so the loader finds out what is missing.
pub fn libtorch(learner: &Path) -> Check {
    const NAME: &str = "libtorch";
    const CURE: &str = "`make setup && make build` fetches libtorch and builds against it; with a \
                        libtorch of your own, set LIBTORCH to it while building";
    match answer(learner, &["--version"]) {
        Ok(version) => {
            let version = version.lines().collect::<Vec<_>>().join(", ");
            Check::good(NAME, format!("{version} ({})", learner.display()))
        }
        Err(found) => Check::failure(NAME, found, CURE),
    }
}

/// Whether the learner can compute on the device called `name`.
pub fn device(learner: &Path, name: &str) -> Check {
    const NAME: &str = "device";
    // Every learner can.
    if name == "cpu" {
        return Check::good(NAME, name);
    }
    let reason = match answer(learner, &["probe", name]) {
        Ok(nothing) if nothing.trim().is_empty() => return Check::good(NAME, name),
        Ok(reason) | Err(reason) => reason,
    };
    // The learner says what helps after a semicolon, as all errors do.
    let (found, cure) =
        reason.trim().rsplit_once("; ").unwrap_or((reason.trim(), "run.device=cpu does without"));
    Check::failure(NAME, found, cure)
}

/// Whether there are GPUs, and whether the learner can compute on them; `driver` is where NVIDIA's kernel module tells of
/// its devices.
pub fn gpu(learner: Option<&Path>, driver: &Path) -> Check {
    const NAME: &str = "GPU";
    let models = gpus(driver);
    let shown = match models.as_slice() {
        [] => "no CUDA device".to_owned(),
        all => all.join(", "),
    };
    let reason = match learner.map(|learner| answer(learner, &["probe", "cuda:0"])) {
        None => "there is no learner to ask".to_owned(),
        Some(Ok(nothing)) if nothing.trim().is_empty() => {
            // Where the driver's files are hidden, libtorch's word counts.
            let shown = if models.is_empty() { "a CUDA device" } else { &shown };
            let found =
                format!("{shown}; the learner uses it with --device cuda:0, else the processor");
            return Check::good(NAME, found);
        }
        Some(Ok(reason) | Err(reason)) => reason.trim().to_owned(),
    };
    if models.is_empty() {
        return Check::good(NAME, format!("{shown}; the learner uses the processor"));
    }
    let (why, cure) =
        reason.rsplit_once("; ").unwrap_or((&reason, "`make setup DEVICE=cuda && make build`"));
    Check::warning(NAME, format!("{shown}; the learner uses the processor: {why}"), cure)
}

/// Models of the GPUs that NVIDIA's kernel module knows.
fn gpus(driver: &Path) -> Vec<String> {
    let mut models: Vec<String> = std::fs::read_dir(driver.join("gpus"))
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| std::fs::read_to_string(entry.path().join("information")).ok())
        .map(|text| {
            let model = text.lines().find_map(|line| line.strip_prefix("Model:"));
            model.map_or("a GPU", str::trim).to_owned()
        })
        .collect();
    models.sort();
    models
}

/// What the learner prints if it is started with `args`, or why it prints nothing.
fn answer(learner: &Path, args: &[&str]) -> Result<String, String> {
    const PATIENCE: Duration = Duration::from_mins(1);
    let mut command = Command::new(learner);
    environment::clean(&mut command);
    let mut child = command
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|error| format!("{} does not start: {error}", learner.display()))?;
    let deadline = Instant::now() + PATIENCE;
    let status = loop {
        match child.try_wait() {
            Ok(Some(status)) => break status,
            Ok(None) if Instant::now() < deadline => {
                std::thread::sleep(Duration::from_millis(2));
            }
            _ => {
                // It is killed so that it does not outlive this check.
                let _ = child.kill();
                let _ = child.wait();
                return Err(format!(
                    "{} {} does not answer within {} s",
                    learner.display(),
                    args.join(" "),
                    PATIENCE.as_secs()
                ));
            }
        }
    };
    let (mut output, mut complaint) = (String::new(), String::new());
    if let Some(mut stdout) = child.stdout.take() {
        let _ = stdout.read_to_string(&mut output);
    }
    if let Some(mut stderr) = child.stderr.take() {
        let _ = stderr.read_to_string(&mut complaint);
    }
    if status.success() {
        return Ok(output);
    }
    let last = complaint.lines().last().unwrap_or("no message");
    Err(format!("{} {} fails: {last}", learner.display(), args.join(" ")))
}

/// What helps where a machine is not enough, in the words of the command that asks: not all have the same
/// flags.
#[derive(Debug, Clone, Copy)]
pub struct Remedy {
    /// How to use another directory.
    pub elsewhere: &'static str,
    /// How to need less of a disk.
    pub less: Option<&'static str>,
    /// Which of `--workers` and `--envs` it has, with which a run needs less of everything else.
    pub flags: &'static [&'static str],
}

/// Room for a run's directory: checkpoints, metrics and logs. `there` checkpoints lie in it already.
pub fn disk(
    directory: &Path,
    config: &Config,
    dimensions: &Dimensions,
    there: usize,
    remedy: &Remedy,
) -> Check {
    const NAME: &str = "disk";
    let existing = directory.ancestors().find(|path| path.exists()).unwrap_or(Path::new("."));
    let existing = if existing.as_os_str().is_empty() { Path::new(".") } else { existing };
    if let Err(error) = rustix::fs::access(existing, rustix::fs::Access::WRITE_OK) {
        let found = format!("{} cannot be written to: {error}", existing.display());
        return Check::failure(NAME, found, remedy.elsewhere);
    }
    // One checkpoint more than is kept while the newest is written.
    let checkpoint = checkpoint_size(config, dimensions);
    let kept = config.run.checkpoints_kept;
    let with = |kept: usize| checkpoint * ((kept - there.min(kept)) as u64 + 1) + (16 << 20);
    let needed = with(kept);
    match free_space(existing) {
        Err(error) => Check::failure(
            NAME,
            format!("{} cannot be measured: {error}", existing.display()),
            remedy.elsewhere,
        ),
        Ok(free) if free < needed => Check::failure(
            NAME,
            format!(
                "{} has {} free and the run needs about {}",
                existing.display(),
                mib(free),
                mib(needed)
            ),
            match remedy.less.filter(|_| with(1) <= free) {
                Some(less) => format!("make room, {}, or {less}", remedy.elsewhere),
                None => format!("make room, or {}", remedy.elsewhere),
            },
        ),
        Ok(free) => Check::good(NAME, format!("{} free of {} needed", mib(free), mib(needed))),
    }
}

/// A size in MiB with some reserve, in whole 64 MiB.
fn round_up(bytes: u64) -> u64 {
    (bytes + bytes / 8).div_ceil(64 << 20) * 64
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset, TaskName};

    use super::*;

    fn config(set: &str) -> Config {
        let layers = Layers::new(Preset::Tuned, Some(TaskName::Trajectory)).set(set);
        layers.and_then(|layers| layers.resolve()).expect("valid")
    }

    #[test]
    fn a_run_that_needs_too_much_names_the_cures() {
        let config = config("env.n_envs=65536");
        let config =
            Config { run: proto::config::Run { workers: 256, ..config.run.clone() }, ..config };
        let flags = ["--workers", "--envs"];
        let check = shared_memory(&config, &Dimensions::new(&config, 4), &flags);
        assert_eq!(check.verdict, Verdict::Failure);
        let cure = check.cure.expect("a failure has a cure");
        assert!(cure.contains("need less: --") && cure.ends_with("killed runs left"), "{cure}");
        let enlarged = cures(1 << 20, &[], Path::new("/dev/shm"));
        assert!(
            enlarged.starts_with("enlarge it: `mount -o remount,size=64M /dev/shm`"),
            "{enlarged}"
        );
        let nothing = cures(u64::MAX >> 1, &[], Path::new("/dev/shm"));
        assert!(nothing.starts_with("need less: smaller networks"), "{nothing}");
    }

    #[test]
    fn what_lies_on_the_disk_already_is_not_asked_for_again() {
        let config = config("run.checkpoints_kept=3");
        let dimensions = Dimensions::new(&config, 4);
        let remedy = Remedy { elsewhere: "elsewhere", less: None, flags: &[] };
        let dir = tempfile::tempdir().expect("tempdir");
        let wanted = |there| {
            let found = disk(dir.path(), &config, &dimensions, there, &remedy).found;
            found.rsplit(" free ").next().map(str::to_owned)
        };
        assert_ne!(wanted(0), wanted(3));
        // More than are kept: milestones, or what the user pinned.
        assert_eq!(wanted(3), wanted(9));
        // No file is written there, whoever asks, and it has no free space.
        let check = disk(Path::new("/proc/1"), &config, &dimensions, 0, &remedy);
        assert!(check.cure.as_ref().is_some_and(|cure| cure.contains("elsewhere")), "{check:?}");
    }

    #[test]
    fn a_learner_that_is_missing_or_fails_is_reported_with_its_words() {
        let missing = libtorch(Path::new("/nonexistent/learner"));
        assert_eq!(missing.verdict, Verdict::Failure);
        assert!(missing.sentence().contains("make setup"), "{}", missing.sentence());
        let failing = libtorch(Path::new("/bin/false"));
        assert_eq!(failing.verdict, Verdict::Failure);
    }

    #[test]
    fn a_precision_without_instructions_is_said_to_be_slow() {
        let verdict =
            |set: &str, instructions: &[&str]| arithmetic(&config(set), instructions).verdict;
        assert_eq!(verdict("run.precision=bf16", &["avx2"]), Verdict::Warning);
        for (set, instructions) in [
            ("run.precision=bf16", &["avx512_bf16"][..]),
            ("run.precision=f32", &["avx2"]),
            ("run.precision=auto", &["avx2"]),
        ] {
            assert_eq!(verdict(set, instructions), Verdict::Good, "{set}");
        }
    }

    #[test]
    fn gpus_are_named_with_what_the_learner_makes_of_them() {
        let dir = tempfile::tempdir().expect("a directory");
        let (usable, complains) = (Path::new("/bin/true"), Path::new("/bin/echo"));
        let none = gpu(Some(complains), dir.path());
        assert_eq!(none.verdict, Verdict::Good);
        assert_eq!(none.found, "no CUDA device; the learner uses the processor");
        let place = dir.path().join("gpus/0000:01:00.0");
        std::fs::create_dir_all(&place).expect("writable");
        let text = "Model: \t\t NVIDIA H100\nIRQ:   5\n";
        std::fs::write(place.join("information"), text).expect("writable");
        let good = gpu(Some(usable), dir.path());
        assert_eq!(good.verdict, Verdict::Good);
        assert!(good.found.starts_with("NVIDIA H100; ") && good.found.contains("--device cuda:0"));
        for learner in [Some(complains), None] {
            let check = gpu(learner, dir.path());
            assert_eq!(check.verdict, Verdict::Warning, "{check:?}");
            assert!(check.found.starts_with("NVIDIA H100; the learner uses the processor: "));
            assert!(check.cure.is_some_and(|cure| cure.contains("DEVICE=cuda")));
        }
    }

    #[test]
    fn sizes_for_people() {
        assert_eq!(mib(600 << 20), "600 MiB");
        assert_eq!(mib(64 << 30), "64.0 GiB");
        assert_eq!(round_up(1 << 20), 64);
    }
}
