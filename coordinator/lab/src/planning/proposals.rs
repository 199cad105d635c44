//! What a trained policy would do.

use std::sync::Arc;

use anyhow::Context as _;
use simulator::experiment::{Control, Episode, Event, Member, Start};
use simulator::plan::{Commands, Question, hand_pose};

use crate::trained::Trained;

/// Control steps that a policy plays.
const STEPS: usize = 100;

/// The policy's commands for a question: with the arms that nobody asked for at rest, and with these keeping their hands where they are.
pub(super) fn of(policy: Trained, question: &Question) -> anyhow::Result<Vec<Commands>> {
    let Trained { world, policy, .. } = policy;
    let member = Arc::new(Member { world, policy });
    let state = Some(question.start.parts().concat());
    let start = Start { state, ..Start::default() };
    let mut episode = Episode::new(vec![member], start.clone()).context("the state to begin in")?;
    let mut proposals = Vec::new();
    for others_rest in [true, false] {
        episode.reset(start.clone()).context("the state to begin in")?;
        for (arm, goal) in question.hands.iter().enumerate() {
            let robot = episode.robot();
            let pose = goal.unwrap_or_else(|| hand_pose(robot, &question.start, arm));
            episode.apply(&Event::HandGoal { arm, pose })?;
            if goal.is_none() && others_rest {
                episode.apply(&Event::Arm { arm, control: Control::Hold })?;
            }
        }
        let mut commands = Vec::with_capacity(STEPS);
        for _ in 0..STEPS {
            episode.step()?;
            commands.push(episode.commands().to_vec());
        }
        proposals.push(commands);
    }
    Ok(proposals)
}
