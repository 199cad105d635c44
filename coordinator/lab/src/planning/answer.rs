//! An answer within a time.

use std::time::{Duration, Instant};

use simulator::plan::{Inspection, Plan, Question, inspect, plan};
use simulator::robot::Robot;
use simulator::step::StepOptions;

use super::proposals;
use crate::threads::Threads;
use crate::trained::Trained;

/// A plan, what it does to the robot, and what it took.
#[derive(Debug)]
pub struct Answer {
    /// The plan.
    pub plan: Plan,
    /// Its motion.
    pub inspection: Inspection,
    /// How long was looked for it (s).
    pub seconds: f64,
}

/// Answers a question within about `limit`, on as many threads as there are. The policy's motions are tried first, if one is given.
///
/// # Errors
/// If the policy gives no number or the simulation of it diverges.
pub fn answer(
    robot: &Robot,
    options: &StepOptions,
    question: &Question,
    policy: Option<Trained>,
    limit: Duration,
) -> anyhow::Result<Answer> {
    let begin = Instant::now();
    let proposals = match policy {
        Some(policy) => proposals::of(policy, question)?,
        None => Vec::new(),
    };
    let mut last = begin;
    // Another wave takes about as long as the one before.
    let mut go_on = || {
        let now = Instant::now();
        let wave = now - last;
        last = now;
        begin.elapsed() + wave < limit
    };
    let plan = plan(robot, options, question, &proposals, &Threads::available(), &mut go_on);
    let seconds = begin.elapsed().as_secs_f64();
    let inspection = inspect(robot, options, &question.start, &plan.commands);
    Ok(Answer { plan, inspection, seconds })
}
