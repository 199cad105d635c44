//! Plays candidates, a lane each.

use nalgebra::Isometry3;

use super::candidates::{Candidate, Course};
use super::question::{Commands, Search};
use super::reaction::hold_base;
use crate::collision::count_contacts;
use crate::inverse_kinematics::{Angles, approach, base_pose, padded};
use crate::model::Model;
use crate::scalar::{LaneFn, Real};
use crate::state::State;
use crate::step::step;
use crate::workspace::Workspace;

/// Control steps of an attempt.
const STEPS: usize = 60;
/// Share of a joint's way that a control step may take.
const GAIN: f64 = 0.7;
/// Part of what is near enough that an attempt comes to before it ends,
const SETTLED: f64 = 0.5;
/// for so many control steps.
const SETTLING: usize = 3;
/// How near to its angles a joint on a detour comes (rad),
const PASSED: f64 = 0.25;
/// or after how many control steps it goes on.
const LONGEST_DETOUR: usize = 20;
/// Iterations of the inverse kinematics in a control step.
const ITERATIONS: usize = 4;

/// How a candidate went.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Played {
    /// What was commanded, up to where everything has settled.
    pub(super) commands: Commands,
    /// The worst miss at the end, in parts of what is near enough.
    pub(super) miss: f64,
    /// Control steps that end in a contact.
    pub(super) touched: usize,
    /// The control step after which all hands are near enough until the end.
    pub(super) arrived: Option<usize>,
}

impl Played {
    /// Whether it is near enough in the end, and no control step ended in a contact.
    pub(super) fn arrives(&self) -> bool {
        self.arrived.is_some() && self.touched == 0
    }
}

/// Candidates to be played.
pub(super) struct Attempt<'a> {
    pub(super) search: &'a Search<'a>,
    pub(super) candidates: &'a [Candidate],
}

impl LaneFn for Attempt<'_> {
    type Output = Vec<Played>;

    #[inline(always)]
    fn call<S: Real>(self) -> Vec<Played> {
        let Self { search, candidates } = self;
        candidates.chunks(S::LANES).flat_map(|group| play::<S>(search, group)).collect()
    }
}

/// A candidate on its way.
struct Lane {
    courses: Candidate,
    on_detour: Vec<bool>,
    played: Played,
    near: Option<usize>,
    settled: usize,
    ended: bool,
}

/// Plays one lane group.
#[inline(always)]
fn play<S: Real>(search: &Search<'_>, candidates: &[Candidate]) -> Vec<Played> {
    let Search { robot, options, question } = *search;
    let model = Model::<S>::new(robot);
    let mut workspace = Workspace::new(&model);
    let mut state = State::<S>::home(robot);
    for lane in 0..S::LANES {
        state.set_lane(lane, &question.start);
    }
    let mut command = vec![S::zero(); robot.n_joints()];
    let mut lanes: Vec<Lane> = candidates.iter().map(Lane::new).collect();
    let driver = Driver::new(search);
    for number in 0..STEPS {
        for (lane, of) in lanes.iter_mut().enumerate().filter(|(_, of)| !of.ended) {
            let rates = driver.rates(&state.lane(lane), of, number);
            let rates: Vec<f32> = rates.into_iter().map(|rate| rate as f32).collect();
            for (slot, &rate) in command.iter_mut().zip(&rates) {
                slot.set_lane(lane, f64::from(rate));
            }
            of.played.commands.push(rates);
        }
        step(&model, &mut workspace, &mut state, &command, options);
        let contacts = count_contacts(&model, &mut workspace, &state);
        for (lane, of) in lanes.iter_mut().enumerate().filter(|(_, of)| !of.ended) {
            let miss = question.worst_miss(robot, &state.lane(lane));
            of.step_ended(number, miss, contacts.lane(lane) > 0.0);
        }
        if lanes.iter().all(|of| of.ended) {
            break;
        }
    }
    lanes.into_iter().map(|of| Played { arrived: of.near, ..of.played }).collect()
}

impl Lane {
    fn new(courses: &Candidate) -> Self {
        let has_detour = |course: &Course| matches!(course, Course::Goal { via: Some(_), .. });
        let played =
            Played { commands: Vec::new(), miss: f64::INFINITY, touched: 0, arrived: None };
        Self {
            on_detour: courses.iter().map(has_detour).collect(),
            courses: courses.clone(),
            played,
            near: None,
            settled: 0,
            ended: false,
        }
    }

    fn step_ended(&mut self, number: usize, miss: f64, touches: bool) {
        self.played.miss = miss;
        self.played.touched += usize::from(touches);
        self.near = if miss <= 1.0 { self.near.or(Some(number)) } else { None };
        self.settled = if miss <= SETTLED { self.settled + 1 } else { 0 };
        // A hand that is nowhere: it has diverged.
        self.ended = self.settled == SETTLING || miss.is_infinite();
    }
}

/// Where the joints shall go.
struct Driver<'a> {
    search: &'a Search<'a>,
    /// By arm.
    targets: Vec<Option<Isometry3<f64>>>,
    /// Fastest rates of the joints (rad/s), arm-major.
    limits: Vec<f64>,
    base: Isometry3<f64>,
    /// Joints of the arms that nobody asked for.
    free: Vec<bool>,
}

impl<'a> Driver<'a> {
    fn new(search: &'a Search<'a>) -> Self {
        let mut targets = vec![None; search.robot.n_arms];
        for (arm, target) in search.question.targets() {
            targets[arm] = Some(target);
        }
        let joints = search.robot.joints;
        let free = (0..joints.n_joints()).map(|j| targets[joints.arm_of(j)].is_none()).collect();
        let base = base_pose(&search.question.start);
        let limits = search.robot.max_rates().into_iter();
        let limits = limits.map(|rate| rate.min(search.question.fastest)).collect();
        Self { search, targets, limits, base, free }
    }

    /// Joint rates (rad/s), arm-major, of a candidate in the state `now`.
    fn rates(&self, now: &State<f64>, of: &mut Lane, number: usize) -> Vec<f64> {
        let Search { robot, options, question } = *self.search;
        let base = base_pose(now);
        let mut rates = vec![0.0; now.q.len()];
        let Lane { courses, on_detour, .. } = of;
        for (arm, course) in courses.iter_mut().enumerate() {
            let joints = robot.joints.of_arm(arm);
            let q = padded(&now.q[joints.clone()]);
            let wanted = match course {
                Course::Still => continue,
                Course::Posture(angles) => *angles,
                Course::Goal { wait, .. } if number < *wait => continue,
                Course::Goal { wait, via, way } => {
                    if let Some(via) = via.filter(|_| on_detour[arm]) {
                        let left = q.iter().zip(&via).map(|(a, b)| (a - b).abs());
                        on_detour[arm] =
                            left.fold(0.0, f64::max) > PASSED && number < *wait + LONGEST_DETOUR;
                        via
                    } else {
                        let target = self.targets[arm].expect("an asked arm");
                        let target = base.inverse() * target;
                        (*way, _) = approach(robot, arm, &target, *way, ITERATIONS);
                        *way
                    }
                }
            };
            let limits = &self.limits[joints.clone()];
            let towards = towards(&q, &wanted, limits, options.control_period);
            rates[joints.clone()].copy_from_slice(&towards[..joints.len()]);
        }
        if question.hold_base {
            hold_base(robot, now, &self.base, &self.free, &mut rates);
            shorten(&mut rates, &self.limits);
        }
        rates
    }
}

/// Joint rates (rad/s) from `q` towards `wanted`, all joints in proportion.
fn towards(q: &Angles, wanted: &Angles, limits: &[f64], period: f64) -> Angles {
    let mut rates: Angles = std::array::from_fn(|j| GAIN / period * (wanted[j] - q[j]));
    shorten(&mut rates, limits);
    rates
}

/// Slows all joints down in proportion until none is beyond its limit.
fn shorten(rates: &mut [f64], limits: &[f64]) {
    let parts = rates.iter().zip(limits).map(|(rate, limit)| rate.abs() / limit);
    let excess = parts.fold(1.0, f64::max);
    for rate in rates {
        *rate /= excess;
    }
}
