//! A motion that brings hands to poses: what a motion planner is asked.
//!
//! A plan is a table of joint rate commands. It is found by trying: candidates are played in the very simulator, a lane each, and the first that
//! arrives without touching anything is taken. A candidate brings every asked arm to one of the joint angles that its inverse kinematics has for the
//! pose, solved again from there in every control step, because the base gives way. The first candidates go straight, the arms that nobody asked for
//! at rest; the later ones make a detour, wait, turn a joint the other way round, or have the other arms move, which moves the base.
//!
//! Candidates are tried in waves of the same size on every machine, and a wave is decided as a whole. So a question that is answered in time has
//! one answer on machines with the same type of processor and C library, on which inverse kinematics hangs; the time only says when to give up.

mod attempt;
mod candidates;
mod frame;
mod inspection;
mod question;
mod reaction;

pub use self::frame::{Frame, hand_pose};
pub use self::inspection::{Inspection, inspect};
use self::question::Search;
pub use self::question::{Commands, Miss, Question, Tolerance, widen};
use crate::executor::{self, Executor};
use crate::robot::Robot;
use crate::scalar::LANES;
use crate::simulate::{Precision, SimulationRow, simulate_from};
use crate::step::StepOptions;
use attempt::{Attempt, Played};
use candidates::Candidates;

/// Lane groups of a wave: as many candidates as keep two processors busy.
const WAVE: usize = 2;
/// A motion that the same commands without contacts would not have changed by more was not pushed by any (m and rad).
const UNTOUCHED: f64 = 1e-5;

/// Why no plan was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Obstacle {
    /// No joint angles put the hand of this arm at its pose, nor near it: nothing was tried.
    Kinematics {
        /// The arm.
        arm: usize,
    },
    /// This arm does not reach its pose with the base where it was at the start, and no candidate has moved the base far enough.
    Reach {
        /// The arm.
        arm: usize,
    },
    /// Candidates arrive, and every one of them touches something.
    Contact,
    /// Joint angles are known, and no candidate arrives at them: the base gives way too far, or the hands hinder each other.
    Motion,
}

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Joint rate commands (rad/s): `[control step][joint]`, arm-major.
    pub commands: Commands,
    /// Where the asked hands are after the last command.
    pub misses: Vec<Miss>,
    /// The control step after which all asked hands are near enough, and stay so.
    pub arrived: Option<usize>,
    /// Why nothing holds what was asked; the commands are those of what came nearest then.
    pub obstacle: Option<Obstacle>,
    /// Candidates that were played.
    pub tried: usize,
    /// Whether the commands are the proposal of this index.
    pub proposal: Option<usize>,
}

/// Looks for a plan until one is found or `go_on` says no, which is asked before every wave but the first. `proposals` are tried first.
///
/// # Panics
/// If the question has not as many hands as the robot, or no goal, or a state with another number of joints.
pub fn plan(
    robot: &Robot,
    options: &StepOptions,
    question: &Question,
    proposals: &[Commands],
    executor: &dyn Executor,
    go_on: &mut dyn FnMut() -> bool,
) -> Plan {
    assert_eq!(question.hands.len(), robot.n_arms, "a goal or none for every arm");
    assert!(question.hands.iter().any(Option::is_some), "a goal");
    let search = Search { robot, options, question };
    let mut best = Best::default();
    let proposed = proposals.iter().map(|commands| search.judge(commands)).enumerate();
    for (index, played) in proposed {
        best.tried += 1;
        if played.arrives() && !search.is_pushed(&played.commands) {
            return Plan { proposal: Some(index), ..search.plan(played, best.tried, None) };
        }
        best.consider(played, Some(index));
    }
    let candidates = Candidates::new(robot, question);
    if let Some(arm) = candidates.arm_without_way() {
        let obstacle = Some(Obstacle::Kinematics { arm });
        let (played, proposal) = best.played.unwrap_or_else(|| (search.judge(&[]), None));
        return Plan { proposal, ..search.plan(played, best.tried, obstacle) };
    }
    let mut first = 0;
    loop {
        let mut groups = vec![Vec::new(); WAVE];
        let each = groups.iter_mut().enumerate().collect();
        let Ok(()) = executor::for_each(executor, each, |(index, played): (usize, &mut Vec<_>)| {
            let from = first + index * LANES;
            let group: Vec<_> = (from..from + LANES).map(|index| candidates.get(index)).collect();
            *played = crate::scalar::dispatch(Attempt { search: &search, candidates: &group });
            Ok::<_, std::convert::Infallible>(())
        });
        first += WAVE * LANES;
        best.tried += WAVE * LANES;
        let mut played = groups.concat();
        // Stable, so that of two that take as long the earlier candidate is taken.
        played.sort_by_key(|played| played.arrived.unwrap_or(usize::MAX));
        for played in played {
            if played.arrives() && !search.is_pushed(&played.commands) {
                return search.plan(played, best.tried, None);
            }
            best.consider(played, None);
        }
        if !go_on() {
            break;
        }
    }
    let obstacle = match candidates.arm_out_of_reach(robot) {
        _ if best.has_arrived => Obstacle::Contact,
        Some(arm) => Obstacle::Reach { arm },
        None => Obstacle::Motion,
    };
    let (played, proposal) = best.played.expect("a wave was played");
    Plan { proposal, ..search.plan(played, best.tried, Some(obstacle)) }
}

/// What came nearest so far.
#[derive(Default)]
struct Best {
    played: Option<(Played, Option<usize>)>,
    has_arrived: bool,
    tried: usize,
}

impl Best {
    /// Those that touch nothing come first, then those that miss by less.
    fn consider(&mut self, played: Played, proposal: Option<usize>) {
        self.has_arrived |= played.arrived.is_some();
        let rank = |played: &Played| (played.touched > 0, played.miss);
        let better = self.played.as_ref().is_none_or(|(best, _)| rank(&played) < rank(best));
        if better {
            self.played = Some((played, proposal));
        }
    }
}

/// What decides between candidates.
impl Search<'_> {
    fn simulate(&self, commands: &[Vec<f32>], options: &StepOptions) -> Vec<SimulationRow> {
        let start = &self.question.start;
        simulate_from(self.robot, start, &widen(commands), Precision::F32, options)
    }

    /// What given commands lead to.
    fn judge(&self, commands: &[Vec<f32>]) -> Played {
        let rows = self.simulate(commands, self.options);
        let touched = rows.iter().filter(|row| row.contacts > 0).count();
        let worst_miss = |state| self.question.worst_miss(self.robot, state);
        let misses: Vec<f64> = rows.iter().map(|row| worst_miss(&row.state)).collect();
        let last = misses.last().copied();
        let miss = last.unwrap_or_else(|| worst_miss(&self.question.start));
        let outside = misses.iter().rposition(|&miss| miss > 1.0);
        let arrived = (miss <= 1.0).then(|| outside.map_or(0, |last| last + 1));
        Played { commands: commands.to_vec(), miss, touched, arrived }
    }

    /// Whether contacts changed the motion, also between the ends of control steps.
    fn is_pushed(&self, commands: &[Vec<f32>]) -> bool {
        if !self.options.contacts {
            return false;
        }
        let free = StepOptions { contacts: false, ..*self.options };
        let [pushed, free] = [self.options, &free].map(|options| self.simulate(commands, options));
        pushed.iter().zip(&free).any(|(a, b)| {
            let pairs = a.state.q.iter().zip(&b.state.q);
            let places = a.state.base_position.iter().zip(&b.state.base_position);
            pairs.chain(places).any(|(x, y)| (x - y).is_nan() || (x - y).abs() > UNTOUCHED)
        })
    }

    fn plan(&self, played: Played, tried: usize, obstacle: Option<Obstacle>) -> Plan {
        let Played { commands, arrived, .. } = played;
        let rows = self.simulate(&commands, self.options);
        let end = rows.last().map_or(&self.question.start, |row| &row.state);
        let misses = self.question.misses(self.robot, end);
        Plan { commands, misses, arrived, obstacle, tried, proposal: None }
    }
}

#[cfg(test)]
mod tests;
