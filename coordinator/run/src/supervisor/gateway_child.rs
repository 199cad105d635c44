//! The gateway of a run: started, watched, reaped, replaced.

use std::process::Command;
use std::time::Instant;

use proto::agents::Joints;
use proto::{ExitCode, ExitError};

use super::Supervisor;
use super::cause::{Cause, log_tail};
use super::deaths::{Death, Deaths, MAX_CRASHES, MAX_KILLS};
use super::gateway::{Gateway, GatewaySpec, State};
use crate::environment;

impl Supervisor {
    /// Opens the run to other machines: from now on there is a gateway whenever there is a learner, and it waits for
    /// hosts where `spec` says. `joints` are the robot's.
    pub fn open_to_hosts(&mut self, spec: GatewaySpec, joints: Joints) {
        self.gateway = Some(Gateway::new(spec, joints));
    }

    /// Starts the gateway, if the run has one; see [`Supervisor::start_learner`] for the thread to call it from.
    pub fn start_gateway(&mut self) -> Result<(), ExitError> {
        let Some(gateway) = &mut self.gateway else { return Ok(()) };
        // It tells hosts the build that they must have.
        self.started.check(&self.programs.sim_worker)?;
        let incarnation = gateway.started;
        gateway.started += 1;
        let mut command = Command::new(&gateway.spec.program);
        environment::clean(&mut command);
        command.args(["hub", "--listen", &gateway.spec.listen]);
        if let Some(dir) = &gateway.spec.certificates {
            command.arg("--certificates").arg(dir);
        }
        let joints: Vec<String> = gateway.joints.by_arm().map(|n| n.to_string()).collect();
        command.args(["--joints", &joints.join(",")]);
        command.arg(format!("--processor={}", store::provenance::processor_type()));
        command.args(["--incarnation", &incarnation.to_string()]);
        command.arg("--sim-worker").arg(&self.programs.sim_worker);
        let child = self.spawn(command, "gateway.log")?;
        if let Some(gateway) = &mut self.gateway {
            gateway.incarnation = incarnation;
            gateway.state = State::Running { child, started: Instant::now(), hung: false };
        }
        Ok(())
    }

    /// Whether `incarnation` is the gateway that runs now.
    pub fn is_gateway(&self, incarnation: u32) -> bool {
        self.gateway.as_ref().is_some_and(|gateway| {
            gateway.incarnation == incarnation && matches!(gateway.state, State::Running { .. })
        })
    }

    /// When the gateway that runs now was started.
    pub fn gateway_since(&self) -> Option<Instant> {
        match self.gateway.as_ref()?.state {
            State::Running { started, .. } => Some(started),
            State::Due(_) | State::Idle => None,
        }
    }

    /// The gateway has been heard: what killed its predecessors is over.
    pub fn gateway_lives(&mut self) {
        if let Some(gateway) = &mut self.gateway {
            gateway.deaths = Deaths::default();
        }
    }

    /// Kills a gateway that does not answer; [`Supervisor::reap`] will find it. Whether it had to be.
    pub fn kill_gateway(&mut self) -> bool {
        if let Some(Gateway { state: State::Running { child, hung, .. }, .. }) = &mut self.gateway
            && !*hung
        {
            *hung = true;
            let _ = child.kill();
            return true;
        }
        false
    }

    /// Refuses to go on with a gateway that dies again and again, or that this machine does not carry.
    pub fn check_gateway_deaths(&self, cause: Cause) -> Result<(), ExitError> {
        let Some(gateway) = &self.gateway else { return Ok(()) };
        let is_hopeless = cause.exit_code() != ExitCode::Child;
        if !is_hopeless && !gateway.deaths.are_too_many(MAX_CRASHES, MAX_KILLS) {
            return Ok(());
        }
        let log = self.run_dir.logs().join("gateway.log");
        let lines = log_tail(&log, 5);
        let message = format!("the gateway died ({cause}); the end of {}:\n{lines}", log.display());
        Err(ExitError::new(cause.exit_code(), message))
    }

    /// The gateway's death, if it has died.
    pub(super) fn reap_gateway(&mut self, now: Instant) -> Option<Death> {
        let gateway = self.gateway.as_mut()?;
        let State::Running { child, started, hung } = &mut gateway.state else { return None };
        let status = child.try_wait().ok()??;
        let cause = Cause::of(status, *hung);
        gateway.deaths = gateway.deaths.and(cause, started.elapsed());
        let delay = gateway.deaths.back_off();
        gateway.state = State::Due(now + delay);
        Some(Death::Gateway(cause))
    }

    /// Starts the successor of a gateway that has died.
    pub(super) fn start_gateway_if_due(&mut self, now: Instant) -> Result<(), ExitError> {
        match &mut self.gateway {
            Some(gateway) if matches!(gateway.state, State::Due(after) if after <= now) => {
                gateway.replaced += 1;
                self.start_gateway()
            }
            _ => Ok(()),
        }
    }
}
