//! What the `learner` program finds: libtorch, and devices that it can compute on.

use std::io::Read as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use super::check::Check;
use crate::environment;

/// How long is waited for the learner's answer.
#[derive(Debug, Clone, Copy)]
struct Patience {
    /// So long nothing is said.
    silent: Duration,
    /// Then it is given up.
    whole: Duration,
}

/// An answer takes a second once libtorch is in memory. Before, its libraries, some GB with CUDA, are read from the disk, page by page:
/// at 10 MB/s that takes minutes.
const PATIENCE: Patience =
    Patience { silent: Duration::from_secs(5), whole: Duration::from_mins(5) };

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
        Err(found) => {
            let (found, cure) = with_cure(&found, CURE);
            Check::failure(NAME, found, cure)
        }
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
    let (found, cure) = with_cure(reason.trim(), "run.device=cpu does without");
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
    let (why, cure) = with_cure(&reason, "`make setup DEVICE=cuda && make build`");
    Check::warning(NAME, format!("{shown}; the learner uses the processor: {why}"), cure)
}

/// A reason, and what helps: all errors say so after a semicolon, if that is known.
fn with_cure<'a>(reason: &'a str, otherwise: &'a str) -> (&'a str, &'a str) {
    reason.rsplit_once("; ").unwrap_or((reason, otherwise))
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

/// What the learner prints if it is started with `args`, or why it prints nothing, and after a semicolon what helps if that is known.
fn answer(learner: &Path, args: &[&str]) -> Result<String, String> {
    answer_within(PATIENCE, learner, args, &mut output::note)
}

/// The same with another patience; `wait` is told once what is waited for, if that takes long.
fn answer_within(
    Patience { silent, whole }: Patience,
    learner: &Path,
    args: &[&str],
    wait: &mut dyn FnMut(&str),
) -> Result<String, String> {
    let mut command = Command::new(learner);
    environment::clean(&mut command);
    let mut child = command
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|error| format!("{} does not start: {error}", learner.display()))?;
    let begun = Instant::now();
    let mut told = false;
    let status = loop {
        match child.try_wait() {
            Ok(Some(status)) => break status,
            Ok(None) if begun.elapsed() < whole => {
                if !told && begun.elapsed() >= silent {
                    told = true;
                    wait(&format!(
                        "note: waiting for {} {}: libtorch is read from the disk the first time",
                        learner.display(),
                        args.join(" ")
                    ));
                }
                std::thread::sleep(Duration::from_millis(2));
            }
            _ => {
                // It is killed so that it does not outlive this check.
                let _ = child.kill();
                let _ = child.wait();
                return Err(format!(
                    "{} {} does not answer within {} s; libtorch is read from the disk the first time and is in \
                     memory then: try again now, or later if this machine is busy",
                    learner.display(),
                    args.join(" "),
                    whole.as_secs()
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

#[cfg(test)]
mod tests {
    use super::super::check::Verdict;
    use super::*;

    #[test]
    fn a_learner_that_is_missing_or_fails_is_reported_with_its_words() {
        let missing = libtorch(Path::new("/nonexistent/learner"));
        assert_eq!(missing.verdict, Verdict::Failure);
        assert!(missing.sentence().contains("make setup"), "{}", missing.sentence());
        let failing = libtorch(Path::new("/bin/false"));
        assert_eq!(failing.verdict, Verdict::Failure);
    }

    #[test]
    fn what_is_waited_for_is_said_once_and_what_helps_in_the_end() {
        let mut told = Vec::new();
        let mut ask = |silent, whole, seconds| {
            let patience = Patience {
                silent: Duration::from_millis(silent),
                whole: Duration::from_millis(whole),
            };
            answer_within(patience, Path::new("/bin/sleep"), &[seconds], &mut |what| {
                told.push(what.to_owned());
            })
        };
        assert_eq!(ask(60_000, 60_000, "0"), Ok(String::new()));
        let found = ask(0, 500, "60").expect_err("it sleeps");
        let (found, cure) = with_cure(&found, "");
        assert!(found.contains("/bin/sleep 60 does not answer within"), "{found}");
        assert!(cure.contains("libtorch") && cure.contains("try again now"), "{cure}");
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].contains("waiting for /bin/sleep 60: libtorch"), "{told:?}");
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
}
