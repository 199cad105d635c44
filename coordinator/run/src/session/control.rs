//! What others ask of a live run, and what they see of it.

use proto::ExitError;
use proto::message::{HostId, Order};
use service::live::{Best, Command, LiveStatus, Role};

use super::Session;
use super::monitor::Monitor;
use crate::preflight;
use crate::report::Reporter;
use crate::scheduler::Scheduler;
use crate::supervisor::Supervisor;

impl Session<'_> {
    /// Does what others ask for.
    pub(super) fn do_what_is_asked(
        &mut self,
        supervisor: &mut Supervisor,
        reporter: &mut Reporter,
    ) -> Result<(), ExitError> {
        while let Some(command) = self.spec.live.next_command() {
            match command {
                Command::Scale { workers, reply } => {
                    let before = self.workers;
                    let answer = match self.may_scale(workers, supervisor) {
                        Ok(()) => {
                            self.workers = workers;
                            for (worker, incarnation) in supervisor.scale(workers)? {
                                self.heard.remove(&worker);
                                if let Some(scheduler) = &mut self.scheduler {
                                    scheduler.retire(worker);
                                }
                                self.orders.send(Order::Leave { worker, incarnation })?;
                            }
                            if workers != before {
                                let s = if workers == 1 { "" } else { "s" };
                                reporter.note(&format!(
                                    "{workers} worker{s} from now on, before {before}"
                                ));
                            }
                            Ok(before)
                        }
                        Err(reason) => Err(reason),
                    };
                    // Who asked may have gone.
                    let _ = reply.send(answer);
                }
                Command::ScaleHost { host, workers, reply } => {
                    let answer = self.scale_host(host, workers);
                    if let Ok(before) = &answer
                        && *before != workers
                    {
                        let report = self.hosts.reports.iter().find(|report| report.host == host);
                        reporter.note(&format!(
                            "host {host} ({}) is to have {} from now on, before {before}",
                            report.map_or("unknown", |report| &report.name),
                            output::counted(workers as u64, "worker")
                        ));
                    }
                    let _ = reply.send(answer);
                    self.scale_hosts(reporter)?;
                }
                Command::Checkpoint { reply } => self.snapshots.ask_for(self.reported, reply),
            }
        }
        Ok(())
    }

    fn may_scale(&self, workers: usize, supervisor: &mut Supervisor) -> Result<(), String> {
        let most = self.channels.sizes().max_workers;
        let least = self.min_workers();
        if !(least..=most).contains(&workers) {
            return Err(format!(
                "{workers} workers: this run can have {least} to {most}; a run that is started or \
                 resumed with more can have twice as many as that"
            ));
        }
        preflight::scale(self.channels.sizes(), self.workers, workers)?;
        if workers > self.workers {
            // Who asks is told, and the run goes on with what it has.
            supervisor
                .may_add_workers()
                .map_err(|error| format!("{workers} workers: {}", error.message))?;
        }
        Ok(())
    }

    /// Notes how many workers a host is to have; returns how many it was to have before.
    fn scale_host(&mut self, host: HostId, workers: usize) -> Result<usize, String> {
        let report = self.hosts.reports.iter().find(|report| report.host == host);
        let report = report.ok_or_else(|| format!("host {host} is not there any more"))?;
        let (before, most) = (report.wanted as usize, report.most as usize);
        if !(1..=most).contains(&workers) {
            return Err(format!(
                "{workers} workers: host {host} ({}) can have 1 to {most}; one that joins with more --workers can have \
                 twice as many as that, and Ctrl-C at its `octopus join` takes it away",
                report.name
            ));
        }
        self.hosts.wanted.insert(host, workers as u32);
        Ok(before)
    }

    /// Fewest workers that this machine can have: who is open to others can leave all work to them.
    fn min_workers(&self) -> usize {
        usize::from(self.spec.gateway.is_none())
    }

    /// What the run looks like from outside.
    pub(super) fn look(&self, supervisor: &Supervisor) -> LiveStatus {
        let config = &self.spec.config;
        let scheduler = self.scheduler.as_ref();
        let state = match (scheduler, self.finishing, self.stopped_by) {
            (None, _, _) if self.learner_restarts > 0 => "recovering",
            (None, _, _) => "starting",
            (_, Some(_), _) => "finishing",
            (_, _, Some(_)) => "stopping",
            _ if self.workers == 0 && self.hosts.workers.is_empty() => "waiting",
            _ => "training",
        };
        let processes: Vec<_> = std::iter::once(Monitor::coordinator())
            .chain(supervisor.processes().iter().map(|view| {
                let ready = match (view.role, view.worker) {
                    (Role::Gateway, _) => self.hosts.is_ready(),
                    (_, None) => scheduler.is_some(),
                    (_, Some(worker)) => self.heard.contains_key(&worker),
                };
                let tasks = view.worker.zip(scheduler);
                let shards = tasks.map(|(worker, scheduler)| {
                    scheduler.tasks(worker).map(ToString::to_string).collect()
                });
                self.monitor.process(view, ready, shards.unwrap_or_default())
            }))
            .collect();
        let planned_iterations = config.planned_iterations();
        let left = planned_iterations.saturating_sub(self.reported) * config.steps_per_iteration();
        let limit =
            config.run.time_limit().map(|limit| limit.saturating_sub(self.started.elapsed()));
        let eta = self.monitor.eta.estimate(left, limit);
        LiveStatus {
            run_dir: self.spec.run_dir.path().to_owned(),
            state: state.to_owned(),
            task: config.task.name.as_str().to_owned(),
            iterations: self.reported,
            planned_iterations,
            env_steps: self.reported * config.steps_per_iteration(),
            env_steps_per_s: self.monitor.env_steps_per_s,
            wall_s: self.started.elapsed().as_secs_f64(),
            eta_s: eta.map(|eta| eta.as_secs_f64().max(1.0)),
            workers: self.workers,
            min_workers: self.min_workers(),
            max_workers: self.channels.sizes().max_workers,
            resident_bytes: processes.iter().map(|process| process.resident_bytes).sum(),
            processes,
            hosts: self.hosts.look(scheduler, &self.audits.same),
            refused_hosts: self.audits.look(),
            shards_open: scheduler.map_or(0, Scheduler::open),
            shards_in_flight: scheduler.map_or(0, Scheduler::in_flight),
            orders_missed: self.monitor.orders_missed,
            orders_overdue: self.monitor.orders_overdue,
            worker_restarts: supervisor.restarts(),
            learner_restarts: self.learner_restarts,
            stages: self.monitor.stages,
            accounting: self.books.totals,
            shared_memory_bytes: self.spec.domain.size(),
            commits: self.monitor.commits,
            // Known to who sends.
            bucket: None,
            checkpoint: self.monitor.checkpoint.clone(),
            best: self.monitor.best.clone().map(|(name, score)| Best { name, score }),
            divergence: self.monitor.divergence.clone(),
            last: self.monitor.last.clone(),
        }
    }
}
