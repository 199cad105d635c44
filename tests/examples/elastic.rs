//! Measures how long a run takes to start, to get another worker, and to go on after a stop.
//!
//! `cargo run --release -p tests --example elastic [-- REPETITIONS]`

use std::io::Write as _;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use rustix::process::Signal;
use serde_json::json;
use tests::chaos::measure::Times;
use tests::chaos::observe::{FirstBlock, iterations, workers};
use tests::{Run, octopus, stderr};

/// A run that never uses up its budget.
const FLAGS: [&str; 4] = ["--workers=1", "--overlap=1", "--iterations=1000000", "--quiet"];

fn main() -> Result<()> {
    let repetitions = std::env::args().nth(1).map_or(Ok(20), |text| text.parse())?;
    let (mut starts, mut scalings, mut resumes) =
        (Times::default(), Times::default(), Times::default());
    let mut run = Run::with_logged_blocks();
    let begun = Instant::now();
    run.start_training(&FLAGS);
    starts.push(wait_for(&mut run, begun, |run| iterations(run) > 0)?);
    let path = run.path();
    let path = path.to_str().context("the path is not UTF-8")?;
    for _ in 0..repetitions {
        let first_block = FirstBlock::of_new(&run, 1);
        let begun = Instant::now();
        scale(path, "2")?;
        scalings.push(wait_for(&mut run, begun, |_| first_block.is_sent())?);
        scale(path, "1")?;
        wait_for(&mut run, begun, |run| workers(run).len() == 1)?;

        run.signal(Signal::INT);
        run.succeed();
        let before = iterations(&run);
        let begun = Instant::now();
        run.resume(&["--quiet"]);
        resumes.push(wait_for(&mut run, begun, |run| iterations(run) > before)?);
    }
    run.signal(Signal::INT);
    run.succeed();
    let summary = json!({
        "train_to_first_iteration": starts.to_json(),
        "scale_to_first_block": scalings.to_json(),
        "resume_to_first_iteration": resumes.to_json(),
    });
    writeln!(std::io::stdout(), "{}", serde_json::to_string_pretty(&summary)?)?;
    Ok(())
}

fn scale(path: &str, workers: &str) -> Result<()> {
    let output = octopus(&["scale", path, workers]);
    ensure!(output.status.success(), "{}", stderr(&output));
    Ok(())
}

/// Waits until something of a run has happened. Returns the time since `begun`.
fn wait_for(
    run: &mut Run,
    begun: Instant,
    mut happened: impl FnMut(&Run) -> bool,
) -> Result<Duration> {
    while !happened(run) {
        let ended = run.ended();
        ensure!(ended.is_none(), "the run ended with {ended:?}; its log:\n{}", run.log());
        ensure!(begun.elapsed() < Duration::from_mins(1), "hung; its log:\n{}", run.log());
        std::thread::sleep(Duration::from_millis(1));
    }
    Ok(begun.elapsed())
}
