//! A plan in words and numbers.

use output::grouped;
use serde::Serialize;
use simulator::plan::{Obstacle, Question};

use super::answer::Answer;
use crate::statistics::milli;

/// What is said of a plan.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Whether every asked hand ends near enough and nothing touches.
    pub reached: bool,
    /// Why not, if not.
    pub obstacle: Option<&'static str>,
    /// The asked hands.
    pub hands: Vec<Hand>,
    /// When all of them are near enough, and stay so (s).
    pub arrived_s: Option<f64>,
    /// How long the plan is (s).
    pub duration_s: f64,
    /// Smallest distance between two bodies at the ends of control steps (m); none where no two can touch.
    pub closest_approach_m: Option<f64>,
    /// Control steps that end in a contact.
    pub contact_steps: usize,
    /// Fastest joint after a control step (rad/s).
    pub fastest_joint_rad_s: f64,
    /// Largest torque of a drive (N m).
    pub largest_torque_n_m: f64,
    /// How far the base was from where it began, at most (m).
    pub base_travel_m: f64,
    /// How far it turned, at most (rad).
    pub base_turn_rad: f64,
    /// Candidates that were played.
    pub candidates: usize,
    /// Whether it is what the given policy does.
    pub by_policy: bool,
    /// How long was looked for it (s).
    pub planning_s: f64,
}

/// An asked hand.
#[derive(Debug, Serialize)]
pub struct Hand {
    /// Counted from 1.
    #[serde(rename = "hand")]
    pub number: usize,
    /// The pose: position in the world (m), Euler angles (rad).
    pub goal: [f64; 6],
    /// Distance that is left (m).
    pub position_m: f64,
    /// Angle that is left (rad).
    pub orientation_rad: f64,
}

impl Report {
    /// Of the answer to a question, with this control period (s).
    pub fn new(question: &Question, answer: &Answer, period: f64) -> Self {
        let Answer { plan, inspection, seconds } = answer;
        let most = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
        let hand = |miss: &simulator::plan::Miss| Hand {
            number: miss.arm + 1,
            goal: question.hands[miss.arm].expect("what is missed was asked for"),
            position_m: miss.position,
            orientation_rad: miss.orientation,
        };
        let closest = inspection.clearance.iter().copied().fold(f64::INFINITY, f64::min);
        let touching = inspection.rows.iter().filter(|row| row.contacts > 0).count();
        Self {
            reached: plan.obstacle.is_none(),
            obstacle: plan.obstacle.map(|obstacle| match obstacle {
                Obstacle::Kinematics { .. } => "kinematics",
                Obstacle::Reach { .. } => "reach",
                Obstacle::Contact => "contact",
                Obstacle::Motion => "motion",
            }),
            hands: plan.misses.iter().map(hand).collect(),
            arrived_s: plan.arrived.map(|step| (step + 1) as f64 * period),
            duration_s: plan.commands.len() as f64 * period,
            closest_approach_m: closest.is_finite().then_some(closest),
            contact_steps: touching,
            fastest_joint_rad_s: most(&inspection.rates),
            largest_torque_n_m: most(&inspection.torques),
            base_travel_m: inspection.base[0],
            base_turn_rad: inspection.base[1],
            candidates: plan.tried,
            by_policy: plan.proposal.is_some(),
            planning_s: *seconds,
        }
    }

    /// As a person reads it.
    pub fn table(&self) -> String {
        let mut rows: Vec<[String; 2]> = Vec::new();
        for hand in &self.hands {
            let left =
                format!("{} mm, {} mrad", milli(hand.position_m), milli(hand.orientation_rad));
            rows.push([format!("hand {}, from its pose", hand.number), left]);
        }
        let seconds = |s: f64| format!("{s:.1} s");
        let closest = self.closest_approach_m;
        let closest = closest.map_or_else(|| "–".to_owned(), |gap| format!("{} mm", milli(gap)));
        let arrived = self.arrived_s.map_or_else(|| "not".to_owned(), seconds);
        rows.extend([
            ["arrives after".to_owned(), arrived],
            ["duration".to_owned(), seconds(self.duration_s)],
            ["closest approach".to_owned(), closest],
            ["control steps in contact".to_owned(), grouped(self.contact_steps as u64)],
            ["fastest joint".to_owned(), format!("{:.2} rad/s", self.fastest_joint_rad_s)],
            ["largest torque".to_owned(), format!("{:.0} N m", self.largest_torque_n_m)],
            [
                "base".to_owned(),
                format!(
                    "moves by {} mm, turns by {} mrad",
                    milli(self.base_travel_m),
                    milli(self.base_turn_rad)
                ),
            ],
            [
                "found".to_owned(),
                format!(
                    "{}after {} candidates, {:.2} s",
                    if self.by_policy { "by the policy, " } else { "" },
                    grouped(self.candidates as u64),
                    self.planning_s
                ),
            ],
        ]);
        output::table(["what", "how much"], rows)
    }
}

/// Why a question has no plan, and by how much it is missed; none if it has one.
pub fn sentence(question: &Question, answer: &Answer) -> Option<String> {
    let obstacle = answer.plan.obstacle?;
    let near = |miss: &simulator::plan::Miss| {
        format!(
            "hand {} by {} mm and {} mrad",
            miss.arm + 1,
            milli(miss.position),
            milli(miss.orientation)
        )
    };
    let misses: Vec<String> = answer.plan.misses.iter().map(near).collect();
    let misses = misses.join(", ");
    let within = format!(
        "{} mm and {} mrad",
        milli(question.within.position),
        milli(question.within.orientation)
    );
    let reason = match obstacle {
        Obstacle::Kinematics { arm } => format!(
            "no joint angles bring hand {} to its pose, nor near it; the arm is too short for it, or its \
             wrist would be inside of its own first joint",
            arm + 1
        ),
        Obstacle::Reach { arm } if question.hold_base => format!(
            "hand {} does not reach its pose with the base where it is; without --hold-base a motion that moves \
             the base may bring it there",
            arm + 1
        ),
        Obstacle::Reach { arm } => format!(
            "hand {} does not reach its pose with the base where it is, and no candidate has moved the base \
             far enough; more time (--time-limit) may find one that does",
            arm + 1
        ),
        Obstacle::Contact => {
            "candidates arrive, but all of them touch something on their way; more time \
                              (--time-limit) may find a way round"
                .to_owned()
        }
        Obstacle::Motion => {
            "joint angles for it are known, but no candidate arrives: the base gives way, or bodies \
             are in the way; more time (--time-limit), other arms at rest or a wider --within may help"
                .to_owned()
        }
    };
    let nearest = match answer.plan.tried {
        0 => "At the start it misses".to_owned(),
        1 => "The one candidate misses".to_owned(),
        tried => format!("The nearest of {} candidates misses", grouped(tried as u64)),
    };
    Some(format!("no plan within {within}: {reason}. {nearest} {misses}"))
}

#[cfg(test)]
mod tests {
    use simulator::plan::{Inspection, Plan, Tolerance};
    use simulator::robot::Robot;
    use simulator::state::State;

    use super::*;

    #[test]
    fn bodies_that_cannot_touch_come_to_no_distance_of_each_other() {
        let start = State::home(&Robot::builtin("paper").expect("built in"));
        let within = Tolerance { position: 5e-3, orientation: 10e-3 };
        let question = Question {
            start,
            hands: vec![None; 4],
            hold_base: false,
            within,
            fastest: 0.8,
            seed: 0,
        };
        for (clearance, in_json, in_words) in [
            (vec![f64::INFINITY; 2], serde_json::json!(null), "–"),
            (vec![f64::INFINITY, 0.25], serde_json::json!(0.25), "250.0 mm"),
        ] {
            let plan = Plan {
                commands: Vec::new(),
                misses: Vec::new(),
                arrived: None,
                obstacle: None,
                tried: 1,
                proposal: None,
            };
            let (rows, torques, rates) = (Vec::new(), Vec::new(), Vec::new());
            let inspection = Inspection { rows, clearance, torques, rates, base: [0.0; 2] };
            let answer = Answer { plan, inspection, seconds: 0.0 };
            let report = Report::new(&question, &answer, 0.4);
            let json = serde_json::to_value(&report).expect("plain data");
            assert_eq!(json["closest_approach_m"], in_json);
            let table = report.table();
            let row = table.lines().find(|row| row.contains("closest approach")).expect("a row");
            assert!(row.contains(in_words), "{table}");
        }
    }
}
