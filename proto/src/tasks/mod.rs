//! Tasks, a file each: what arms are for, where goals lie and how they move, what counts as success.
//!
//! A task is a value of one trait, [`TaskDefinition`], and a line in [`TaskName`]. All else follows from what it says of its
//! arms' [aims](Aim) and goals: the errors, what agents and critics see of them, who is paid for which, the figures of an evaluation,
//! the page. So a task that is added here is trained, evaluated and filmed; what else can be done with it, `deploy/guide/src/tasks.md` says.
//!
//! | task | file |
//! |---|---|
//! | `trajectory` | every hand to a pose |
//! | `reorientation` | all arms turn the base |
//! | `capture` | hands follow grasp points of a body that tumbles, and hold them |
//! | `mixed` | half of the arms reach while the other half turns the base |
//!
//! **Why here.** Sizes of messages follow from what a task's agents see, so everyone who exchanges messages must know the tasks.
//! Drawing goals is arithmetic on a few numbers; what moves and measures them in lanes is the simulator's.

mod capture;
mod goals;
mod mixed;
mod reorientation;
mod target;
mod trajectory;

use serde::{Deserialize, Serialize};

pub use self::goals::{
    ArmGoals, EpisodeGoals, FreeBody, GoalAddress, GoalBox, GoalRanges, Home, HomeArm,
};
pub use self::target::Target;

/// What an arm works for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Aim {
    /// Its hand shall be at a pose.
    Hand,
    /// The base shall have an attitude.
    Base,
}

/// What it is to hold all goals: errors below these, for so many control steps one after the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hold {
    /// Of a hand's position (m).
    pub position: f64,
    /// Of a hand's orientation, norm of the Euler-angle difference (rad).
    pub orientation: f64,
    /// Of the base's attitude, likewise (rad).
    pub base: f64,
    /// Control steps.
    pub steps: usize,
}

/// A task.
pub trait TaskDefinition: Sync {
    /// What it is, in some words, for helps and tables.
    fn about(&self) -> &'static str;

    /// The fewest arms with which it makes sense.
    fn fewest_arms(&self) -> usize {
        1
    }

    /// What arm `arm` of a robot with `n_arms` works for.
    fn aim(&self, arm: usize, n_arms: usize) -> Aim;

    /// Goals of the episode at `address`; a pure function of the address. A hand has one exactly where [`TaskDefinition::aim`] says [`Aim::Hand`], the base where an arm works for it.
    fn goals(&self, ranges: &GoalRanges, address: GoalAddress) -> EpisodeGoals;

    /// Whether goals move: then [`EpisodeGoals::body`] carries them, and agents see how fast.
    fn moves(&self) -> bool {
        false
    }

    /// How goals have to be held for an episode to count as a success; `None` where errors alone are measured.
    fn hold(&self, _target: &Target) -> Option<Hold> {
        None
    }
}

/// Names the tasks, in the order of the help.
macro_rules! tasks {
    ($($name:ident = $module:ident),+ $(,)?) => {
        /// The tasks, by name.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum TaskName {
            $(#[doc = concat!("See the file `", stringify!($module), ".rs`.")] $name,)+
        }

        impl TaskName {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$name),+];

            /// The name as it is written in configurations and on the command line.
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$name => stringify!($module),)+
                }
            }

            /// What it is.
            pub fn definition(self) -> &'static dyn TaskDefinition {
                match self {
                    $(Self::$name => &$module::$name,)+
                }
            }
        }
    };
}

tasks! {
    Trajectory = trajectory,
    Reorientation = reorientation,
    Capture = capture,
    Mixed = mixed,
}

/// Arms of the largest robot.
const MANY: usize = 8;

impl TaskName {
    /// The task of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|task| task.as_str() == name)
    }

    /// The names as a message lists them: `a`, `b` or `c`.
    pub fn listed() -> String {
        let names: Vec<String> = Self::ALL.iter().map(|t| format!("`{}`", t.as_str())).collect();
        let (last, first) = names.split_last().expect("some tasks");
        format!("{} or {last}", first.join(", "))
    }

    /// What arm `arm` of a robot with `n_arms` works for.
    pub fn aim(self, arm: usize, n_arms: usize) -> Aim {
        self.definition().aim(arm, n_arms)
    }

    /// Whether hands have goals.
    pub fn reaches(self) -> bool {
        (0..MANY).any(|arm| self.aim(arm, MANY) == Aim::Hand)
    }

    /// Whether the base has a goal.
    pub fn turns(self) -> bool {
        (0..MANY).any(|arm| self.aim(arm, MANY) == Aim::Base)
    }

    /// Whether all hands have goals, and the base has none.
    pub fn only_reaches(self) -> bool {
        !self.turns()
    }

    /// Whether the hand of arm `arm` counts in mean errors: where it has a goal, or where none has one, as a distance from home.
    pub fn measures_hand(self, arm: usize, n_arms: usize) -> bool {
        !self.reaches() || self.aim(arm, n_arms) == Aim::Hand
    }

    /// Refuses a robot with fewer arms than the task makes sense with.
    ///
    /// # Errors
    /// In words, without what to do about it.
    pub fn check_arms(self, robot: &str, there: usize) -> Result<(), String> {
        let fewest = self.definition().fewest_arms();
        if there >= fewest {
            return Ok(());
        }
        let arms = if there == 1 { "arm" } else { "arms" };
        let task = self.as_str();
        Err(format!("robot {robot} has {there} {arms}, and task `{task}` needs {fewest}"))
    }

    /// Whether goals move.
    pub fn moves(self) -> bool {
        self.definition().moves()
    }
}

#[cfg(test)]
mod tests;
