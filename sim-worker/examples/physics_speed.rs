//! Measures the dynamics alone: control steps per second and core, sixteen environments to a group.
//!
//! `cargo run --release -p sim-worker --example physics_speed [SECONDS] [ROBOT]`

#![expect(
    clippy::inline_always,
    reason = "only code inlined into a lane function is compiled for the processor's vectors"
)]

use std::time::Instant;

use sim_worker::collision::count_contacts;
use sim_worker::dynamics::{StepOptions, Workspace, step};
use sim_worker::robot::{Model, Robot};
use sim_worker::scalar::{Backend, LaneFn, Real, dispatch_on};
use sim_worker::state::State;

/// Groups of lanes in flight, so that states come from the cache a rollout would use.
const GROUPS: usize = 8;

/// Control steps of an episode.
const EPISODE: usize = 50;

struct Run<'a> {
    robot: &'a Robot,
    contacts: bool,
    seconds: f64,
}

/// Time this thread has spent on a processor (s): a busy machine does not change the result. Wall time where the system does not tell.
fn processor_seconds(start: Instant) -> f64 {
    std::fs::read_to_string("/proc/thread-self/schedstat")
        .ok()
        .and_then(|text| text.split(' ').next()?.parse::<f64>().ok())
        .map_or_else(|| start.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

/// Uniform numbers in ±1 from a counter.
fn noise(counter: &mut u64) -> f64 {
    *counter = counter.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    (*counter >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

impl LaneFn for Run<'_> {
    type Output = (f64, f64);

    /// Control steps per second, and mean number of touching pairs.
    #[inline(always)]
    fn call<S: Real>(self) -> (f64, f64) {
        let options = StepOptions { contacts: self.contacts, ..StepOptions::default() };
        let model = Model::<S>::new(self.robot);
        let mut ws = Workspace::new(&model);
        let n = self.robot.n_joints();
        let mut counter = 1;
        let mut commands = vec![S::zero(); n * EPISODE * GROUPS];
        for c in &mut commands {
            for lane in 0..S::LANES {
                c.set_lane(lane, 0.8 * noise(&mut counter));
            }
        }
        let (mut steps, mut contacts) = (0, S::zero());
        let start = Instant::now();
        let from = processor_seconds(start);
        let seconds = loop {
            for group in 0..GROUPS {
                let mut state = State::<S>::home(self.robot);
                for t in 0..EPISODE {
                    let at = (group * EPISODE + t) * n;
                    step(&model, &mut ws, &mut state, &commands[at..at + n], &options);
                    if self.contacts {
                        contacts += count_contacts(&model, &mut ws, &state);
                    }
                }
                assert!(state.is_finite(), "the simulation diverged");
                steps += EPISODE;
            }
            let seconds = processor_seconds(start) - from;
            if seconds > self.seconds {
                break seconds;
            }
        };
        let touching = (0..S::LANES).map(|i| contacts.lane(i)).sum::<f64>();
        let lanes = (steps * S::LANES) as f64;
        (lanes / seconds, touching / lanes)
    }
}

fn main() {
    let mut args = std::env::args().skip(1);
    let seconds = args.next().map_or(2.0, |s| s.parse().expect("SECONDS is a number"));
    let robot = Robot::load(&args.next().unwrap_or_else(|| "paper".into())).expect("a robot");
    for backend in [Backend::Avx512, Backend::Avx2] {
        if !backend.is_available() {
            continue;
        }
        for contacts in [false, true] {
            let (rate, touching) = dispatch_on(backend, Run { robot: &robot, contacts, seconds });
            eprintln!(
                "{backend:?}, contacts {contacts}: {rate:.0} env-steps/s per core, {touching:.3} pairs touching"
            );
        }
    }
}
