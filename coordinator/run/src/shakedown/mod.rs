//! What a robot does at home before anything is done with it: a description may be valid and yet be of no robot that can be
//! trained. An arm that stands inside the base touches for ever; a mass that drowns all others, or a servo faster than the
//! integrator, ends a training after a while with a number that is none, far from its cause.

mod fault;
mod keys;
mod touches;

use self::fault::Fault;
use self::keys::type_prefix;
use proto::{ExitCode, ExitError};
use simulator::dynamics::reference_dynamics;
use simulator::robot::Robot;
use simulator::simulate::{Precision, SimulationRow, simulate};
use simulator::step::{Integrator, StepOptions};
use touches::touches_at_home;

/// Control periods of the motion: joints go away, come back, and stand still.
const PERIODS: usize = 6;
/// How far each joint goes from home (rad): far enough for servos to work, too little to reach anything.
const WAY: f64 = 0.05;
/// What a hand may differ by from a finer simulation (m): a fifth of the accuracy that the paper claims.
const HAND_TOLERANCE: f64 = 5e-3;
/// Momentum that may come from nowhere, as a share of what the bodies exchange.
const MOMENTUM_TOLERANCE: f64 = 0.01;
/// Share of their way that joints must go: a servo that moves nothing at all learns nothing.
const LEAST_WAY: f64 = 0.01;
/// How many times finer the simulation is that the robot's own is compared with.
const FINER: f64 = 4.0;
/// Substeps to the time in which a servo answers up to which Runge–Kutta is stable, with some reserve (2.51 for the third order).
const STABLE: f64 = 2.0;
/// A part this many times as heavy as all others together leaves them no digit in single precision, of seven.
const DROWNS: f64 = 1e7;
/// Largest radius of gyration of a part of a robot (m).
const WIDEST: f64 = 100.0;

/// Refuses a robot that touches itself at home, or whose simulation does not do there what it should: stay finite, move the
/// joints that are commanded, keep its momentum, and agree with one in double precision and finer substeps.
///
/// `name` is that of the file, for the message. Training runs in single precision with `options`; contacts are off while the
/// robot moves, as they take other steps.
pub fn shakedown(robot: &Robot, name: &str, options: &StepOptions) -> Result<(), ExitError> {
    let fault = touches_at_home(robot).or_else(|| drowned(robot)).or_else(|| moved(robot, options));
    fault.map_or(Ok(()), |Fault { found, expected, cure }| {
        let message = format!("robot {name}: {found}, expected {expected}; {cure}");
        Err(ExitError::new(ExitCode::BadInput, message))
    })
}

/// A part beside which the others are nothing, or that is wider than any.
fn drowned(robot: &Robot) -> Option<Fault> {
    let expected = "parts whose masses and sizes are those of one robot";
    let parts = parts(robot);
    let heaviest = parts.iter().max_by(|a, b| a.mass.total_cmp(&b.mass))?;
    let others = parts.iter().filter(|part| part.key != heaviest.key);
    let others: f64 = others.map(|part| part.count * part.mass).sum();
    let Part { key, mass, .. } = heaviest;
    if *mass > DROWNS * others {
        return Some(Fault {
            found: format!("{key}.mass is {mass:e} kg, and all other parts have {others:.1} kg"),
            expected,
            cure: format!("give {key}.mass in kg"),
        });
    }
    let Part { key, moment, mass, .. } =
        parts.iter().find(|part| (part.moment / part.mass).sqrt() > WIDEST)?;
    Some(Fault {
        found: format!("{key}.inertia holds {moment:e} kg m² for {mass} kg"),
        expected,
        cure: format!("give {key}.inertia in kg m²"),
    })
}

/// A part of the description.
struct Part {
    key: String,
    /// How many there are on the robot.
    count: f64,
    mass: f64,
    /// Largest element of its inertia, if the description gives one.
    moment: f64,
}

fn parts(robot: &Robot) -> Vec<Part> {
    let d = robot.description();
    let largest = |inertia: &[f64; 6]| inertia.iter().copied().fold(0.0, f64::max);
    let types = std::iter::once((String::new(), &d.mount, &d.pedestal, &d.links));
    let others = d.arm_types.iter().map(|(name, other)| {
        (format!("arm_types.{name}."), &other.mount, &other.pedestal, &other.links)
    });
    let boxes = d.base.iter().enumerate().map(|(i, part)| Part {
        key: format!("base[{i}] ({})", part.name),
        count: 1.0,
        mass: part.mass,
        moment: 0.0,
    });
    let of_types =
        types.chain(others).enumerate().flat_map(|(arm_type, (prefix, mount, pedestal, links))| {
            let count = robot.arms.iter().filter(|arm| arm.arm_type == arm_type).count() as f64;
            let links = links.iter().enumerate().map(|(i, part)| Part {
                key: format!("{prefix}links[{i}] ({})", part.name),
                count,
                mass: part.mass,
                moment: largest(&part.inertia),
            });
            let mount =
                Part { key: format!("{prefix}mount"), count, mass: mount.mass, moment: 0.0 };
            let pedestal = Part {
                key: format!("{prefix}pedestal"),
                count,
                mass: pedestal.mass,
                moment: largest(&pedestal.inertia),
            };
            [mount, pedestal].into_iter().chain(links).collect::<Vec<Part>>()
        });
    // A type that no arm has is no part of the robot.
    boxes.chain(of_types).filter(|part| part.count > 0.0).collect()
}

/// Moves every joint a little and judges what comes of it.
fn moved(robot: &Robot, options: &StepOptions) -> Option<Fault> {
    let options = StepOptions { contacts: false, ..*options };
    let substep = options.substep / FINER;
    let finer = StepOptions { substep, integrator: Integrator::Rk4, ..options };
    let commands = commands(robot, options.control_period);
    let rows = simulate(robot, &commands, Precision::F32, &options);
    let reference = simulate(robot, &commands, Precision::F64, &finer);
    let (found, expected) = strays(robot, &rows, &reference)
        .or_else(|| gains_momentum(robot, &rows))
        .or_else(|| stands(robot, &rows[PERIODS / 3 - 1]))?;
    Some(Fault { found, expected, cure: suspect(robot, &options) })
}

/// Joints go away, every other one backwards, come back, and stand still.
fn commands(robot: &Robot, period: f64) -> Vec<Vec<f64>> {
    let moving = PERIODS / 3;
    let rate = WAY / (moving as f64 * period);
    let row = |step: usize| {
        let phase = match step / moving {
            0 => 1.0,
            1 => -1.0,
            _ => 0.0,
        };
        let command = |(joint, limit): (usize, f64)| {
            let sign = if joint.is_multiple_of(2) { phase } else { -phase };
            sign * rate.min(limit)
        };
        robot.max_rates().into_iter().enumerate().map(command).collect::<Vec<f64>>()
    };
    (0..PERIODS).map(row).collect()
}

/// When a row is.
fn after(row: &SimulationRow) -> String {
    format!("after {:.1} s of small motions from home", row.t)
}

/// Whether it leaves the way of a finer simulation.
fn strays(
    robot: &Robot,
    rows: &[SimulationRow],
    reference: &[SimulationRow],
) -> Option<(String, &'static str)> {
    for (row, finer) in rows.iter().zip(reference) {
        let after = after(row);
        if !row.state.is_finite() || !finer.state.is_finite() {
            return Some((format!("{after} a number is not finite"), "a motion that goes on"));
        }
        for (arm, (hand, finer)) in row.hands.iter().zip(&finer.hands).enumerate() {
            let off: f64 = hand.iter().zip(finer).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            if off > HAND_TOLERANCE {
                let arm = &robot.arms[arm].name;
                let found = format!(
                    "{after} the hand of arm `{arm}` is {:.1} mm from where finer substeps bring it",
                    1e3 * off
                );
                return Some((found, "less than 5 mm"));
            }
        }
    }
    None
}

/// Whether it is moved by nothing.
fn gains_momentum(robot: &Robot, rows: &[SimulationRow]) -> Option<(String, &'static str)> {
    let momenta: Vec<_> =
        rows.iter().map(|row| reference_dynamics::momentum(robot, &row.state)).collect();
    let linear = momenta.iter().map(|m| m.linear_scale).fold(0.0, f64::max);
    let angular = momenta.iter().map(|m| m.angular_scale).fold(0.0, f64::max);
    for (row, momentum) in rows.iter().zip(&momenta) {
        let (p, l) = (momentum.linear.norm(), momentum.angular.norm());
        if p > MOMENTUM_TOLERANCE * linear || l > MOMENTUM_TOLERANCE * angular {
            let after = after(row);
            let found = format!("{after} it has a momentum of {p:.1e} N s and {l:.1e} N m s");
            return Some((found, "none, as nothing acts from outside"));
        }
    }
    None
}

/// Whether a joint stays behind its command, given the row at the end of the way.
fn stands(robot: &Robot, far: &SimulationRow) -> Option<(String, &'static str)> {
    for (joint, (q, home)) in far.state.q.iter().zip(robot.home_q()).enumerate() {
        let way = (q - home).abs();
        let commanded = WAY.min(robot.max_rates()[joint] * far.t);
        if way < LEAST_WAY * commanded {
            let arm = &robot.arms[robot.joints.arm_of(joint)].name;
            let found = format!(
                "joint {} of arm `{arm}` has moved by {way:.0e} rad of {commanded:.0e} in {:.1} s",
                robot.joints.within_arm(joint) + 1,
                far.t
            );
            return Some((found, "a servo that moves its joint"));
        }
    }
    None
}

/// The likeliest cause that a robot cannot be simulated, as advice.
fn suspect(robot: &Robot, options: &StepOptions) -> String {
    // A joint shows no less than its drive and its own link; what these carry comes on top.
    let rates = (0..robot.n_joints()).map(|joint| {
        let link = robot.link(joint);
        let [x, y, _]: [f64; 3] = link.body.com.into();
        let own = link.body.inertia[(2, 2)] + link.body.mass * (x * x + y * y);
        (joint, link.gain / (link.armature + own))
    });
    let fastest = rates.max_by(|a, b| a.1.total_cmp(&b.1));
    if let Some((joint, rate)) = fastest
        && rate * options.substep > STABLE
    {
        let (link, index) = (robot.link(joint), robot.joints.within_arm(joint));
        let prefix = type_prefix(robot, robot.joints.arm_of(joint));
        return format!(
            "{prefix}links[{index}] ({}).servo.gain is {} N m s/rad where so little turns that the servo answers \
             within {:.0e} s, and substeps take {} s: more armature, less gain or a smaller substep \
             (`--set env.substep=…`)",
            link.name,
            link.gain,
            1.0 / rate,
            options.substep
        );
    }
    "look for a mass, an inertia, an armature, a gain or a torque that is far from what its part has, or \
     take a smaller substep (`--set env.substep=…`)"
        .to_owned()
}

#[cfg(test)]
mod tests;
