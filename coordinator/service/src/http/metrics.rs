//! `/metrics`: numbers of the run, the store and the service for Prometheus.

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use store::checkpoint::{CheckpointStore, Entry};

use super::context::Shared;
use super::exposition::{self, Exposition};
use super::problem::{ErrorBody, Problem};
use super::requests::{BOUNDS, Requests};
use crate::live::{LiveStatus, ProcessStatus, Role};

/// Numbers of the run, the store and the service, in Prometheus' text format.
#[utoipa::path(get, path = "/metrics", tag = "service", responses(
    (status = 200, description = "A page of metrics", body = String, content_type = "text/plain"),
    (status = 500, description = "The store cannot be read", body = ErrorBody),
))]
pub(super) async fn metrics(State(context): State<Shared>) -> Result<impl IntoResponse, Problem> {
    // Not `entries`, which logs what is damaged: once would do, and this is asked every few seconds.
    let entries = context.with_store(CheckpointStore::survey).await?.entries;
    let mut page = Exposition::default();
    let version = env!("CARGO_PKG_VERSION");
    page.by(("octopus_build_info", "gauge", "The program."), "version", [(version, 1.0)]);
    store(&mut page, &entries);
    if let Some(live) = &context.live {
        run(&mut page, &live.status());
    }
    service(&mut page, &context.requests);
    Ok(([(CONTENT_TYPE, exposition::CONTENT_TYPE)], page.into_text()))
}

fn store(page: &mut Exposition, entries: &[Entry]) {
    let pinned = entries.iter().filter(|entry| entry.labels.pinned).count();
    let bytes: u64 = entries.iter().map(|entry| entry.bytes).sum();
    page.single("octopus_checkpoints", "gauge", "Checkpoints in the store.", entries.len() as f64);
    page.single("octopus_checkpoints_pinned", "gauge", "Pinned ones of them.", pinned as f64);
    page.single("octopus_checkpoint_bytes", "gauge", "Length of their files.", bytes as f64);
}

fn run(page: &mut Exposition, status: &LiveStatus) {
    let gauge = "gauge";
    let counter = "counter";
    page.by(
        ("octopus_run_state", gauge, "1 for the state that the run is in."),
        "state",
        [(status.state.as_str(), 1.0)],
    );
    let task = [("task", status.task.as_str())];
    page.family("octopus_iterations_total", counter, "Iterations trained on.");
    page.sample("octopus_iterations_total", &task, status.iterations as f64);
    page.family("octopus_env_steps_total", counter, "Env-steps trained on.");
    page.sample("octopus_env_steps_total", &task, status.env_steps as f64);
    for (name, help, value) in [
        ("octopus_planned_iterations", "Iterations planned.", status.planned_iterations as f64),
        ("octopus_env_steps_per_second", "Env-steps a second, of late.", status.env_steps_per_s),
        ("octopus_session_seconds", "Time since this session of the run began.", status.wall_s),
        ("octopus_workers", "Workers wanted.", status.workers as f64),
        ("octopus_workers_limit", "Most workers that the run can have.", status.max_workers as f64),
        ("octopus_shards_open", "Shards not ordered yet.", status.shards_open as f64),
        (
            "octopus_shards_in_flight",
            "Shards ordered and not yet at the learner.",
            status.shards_in_flight as f64,
        ),
        (
            "octopus_resident_bytes",
            "Resident memory of all processes, shared memory counted in each.",
            status.resident_bytes as f64,
        ),
        (
            "octopus_shared_memory_bytes",
            "The run's files in shared memory.",
            status.shared_memory_bytes as f64,
        ),
    ] {
        page.single(name, gauge, help, value);
    }
    if let Some(eta) = status.eta_s {
        page.single("octopus_eta_seconds", gauge, "Time until the budget is used up.", eta);
    }
    if let Some(best) = &status.best {
        page.single("octopus_best_score", gauge, "Score of the best checkpoint.", best.score);
    }
    page.single(
        "octopus_commits_total",
        counter,
        "Checkpoints committed in this session.",
        status.commits as f64,
    );
    page.by(
        ("octopus_restarts_total", counter, "Processes replaced in this session."),
        "role",
        [("worker", status.worker_restarts as f64), ("learner", status.learner_restarts as f64)],
    );
    let stages = &status.stages;
    page.by(
        ("octopus_stage_seconds_total", counter, "Time by stage in this session."),
        "stage",
        [
            ("rollout", stages.rollout_s),
            ("wait", stages.wait_s),
            ("update", stages.update_s),
            ("publish", stages.publish_s),
            ("digest", stages.digest_s),
            ("copy", stages.copy_s),
            ("commit", stages.commit_s),
        ],
    );
    let totals = &status.accounting;
    page.by(
        ("octopus_accounted_env_steps_total", counter, "Env-steps by fate in this session."),
        "fate",
        [
            ("produced", totals.produced as f64),
            ("received", totals.received as f64),
            ("trained", totals.trained as f64),
            ("duplicate", totals.duplicate as f64),
            ("lost", totals.lost as f64),
        ],
    );
    processes(page, &status.processes);
}

/// A number of a process: name, type and help of its family, and where it stands.
type ProcessMetric = (&'static str, &'static str, &'static str, fn(&ProcessStatus) -> f64);

const PROCESS_METRICS: [ProcessMetric; 6] = [
    ("octopus_process_up", "gauge", "1 if the process lives.", |process| {
        f64::from(u8::from(process.pid.is_some()))
    }),
    (
        "octopus_process_resident_bytes",
        "gauge",
        "Resident memory, shared memory included.",
        |process| process.resident_bytes as f64,
    ),
    (
        "octopus_process_cpu_seconds_total",
        "counter",
        "Processor time since the process began.",
        |process| process.cpu_s,
    ),
    (
        "octopus_process_restarts_total",
        "counter",
        "How often its predecessors were replaced.",
        |process| f64::from(process.restarts),
    ),
    ("octopus_process_env_steps_total", "counter", "Env-steps sent.", |process| {
        process.env_steps as f64
    }),
    (
        "octopus_process_rollout_seconds_total",
        "counter",
        "Time spent rolling these out.",
        |process| process.rollout_s,
    ),
];

fn processes(page: &mut Exposition, processes: &[ProcessStatus]) {
    for (name, kind, help, value) in PROCESS_METRICS {
        page.family(name, kind, help);
        for process in processes {
            let role = match process.role {
                Role::Coordinator => "coordinator",
                Role::Learner => "learner",
                Role::Worker => "worker",
                Role::Gateway => "gateway",
            };
            let worker = process.worker.map_or_else(String::new, |worker| worker.to_string());
            page.sample(name, &[("role", role), ("worker", &worker)], value(process));
        }
    }
}

fn service(page: &mut Exposition, requests: &Requests) {
    let counts = requests.counts();
    let open = requests.connections() as f64;
    page.single("octopus_http_connections", "gauge", "Open connections.", open);
    let name = "octopus_http_requests_total";
    page.family(name, "counter", "Requests answered.");
    for ((method, route, status), count) in &counts.requests {
        let status = status.to_string();
        let labels = [("method", *method), ("route", route), ("status", &status)];
        page.sample(name, &labels, *count as f64);
    }
    let name = "octopus_http_request_duration_seconds";
    page.family(name, "histogram", "Time from a request's head to the head of its answer.");
    for (route, histogram) in &counts.latencies {
        let mut up_to = 0;
        let bounds = BOUNDS.iter().map(f64::to_string).chain(["+Inf".to_owned()]);
        for (bound, count) in bounds.zip(histogram.classes) {
            up_to += count;
            let labels = [("route", route.as_str()), ("le", &bound)];
            page.sample(&format!("{name}_bucket"), &labels, up_to as f64);
        }
        page.sample(&format!("{name}_sum"), &[("route", route)], histogram.sum);
        page.sample(&format!("{name}_count"), &[("route", route)], up_to as f64);
    }
}
