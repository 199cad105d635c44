//! What there is of a gateway, the child that carries a run to other machines.

use proto::agents::Joints;
use std::path::PathBuf;
use std::process::Child;
use std::time::{Duration, Instant};

use service::live::Role;

use super::deaths::Deaths;
use super::process_view::ProcessView;

/// Where a run is open to other machines.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GatewaySpec {
    /// The program `gateway`.
    pub program: PathBuf,
    /// Where it listens: `quic/ADDRESS:PORT` or `tcp/ADDRESS:PORT`, several with commas between them.
    pub listen: String,
    /// Certificates, for `quic`.
    pub certificates: Option<PathBuf>,
}

/// What there is of it.
#[derive(Debug)]
pub(super) enum State {
    /// A process. `hung` if it was killed for its silence.
    Running { child: Child, started: Instant, hung: bool },
    /// None; one starts after this time.
    Due(Instant),
    /// None, until it is started with the other children.
    Idle,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Gateway {
    pub(super) spec: GatewaySpec,
    /// Arms of the robot.
    pub(super) joints: Joints,
    pub(super) state: State,
    /// That of the process that runs, or ran last.
    pub(super) incarnation: u32,
    /// How many have been started.
    pub(super) started: u32,
    /// How often it has died and been replaced.
    pub(super) replaced: u32,
    /// In a row, without having been heard.
    pub(super) deaths: Deaths,
}

impl Gateway {
    /// None yet.
    pub(super) fn new(spec: GatewaySpec, joints: Joints) -> Self {
        Self {
            spec,
            joints,
            state: State::Idle,
            incarnation: 0,
            started: 0,
            replaced: 0,
            deaths: Deaths::default(),
        }
    }

    /// Its process, for the run's status.
    pub(super) fn view(&self) -> ProcessView {
        let pid = match &self.state {
            State::Running { child, .. } => Some(child.id()),
            State::Due(_) | State::Idle => None,
        };
        let replaced = self.replaced;
        ProcessView { role: Role::Gateway, worker: None, pid, replaced, leaving: false }
    }

    /// The process, if one runs.
    pub(super) fn child(&mut self) -> Option<&mut Child> {
        match &mut self.state {
            State::Running { child, .. } => Some(child),
            State::Due(_) | State::Idle => None,
        }
    }

    /// It has been killed with all others, and is reaped.
    pub(super) fn is_dead(&mut self) {
        self.state = State::Idle;
    }

    /// What is to happen by the clock happens so much later.
    pub(super) fn postpone(&mut self, late: Duration) {
        if let State::Running { started, .. } = &mut self.state {
            *started += late;
        }
    }
}
