// A live run as the service tells it.

export interface Process {
    role: "coordinator" | "learner" | "worker" | "gateway";
    worker: number | null;
    pid: number | null;
    state: string;
    restarts: number;
    resident_bytes: number;
    cpu_s: number;
    shards: string[];
    env_steps: number;
}

/** Another machine that helps. */
export interface Host {
    host: number;
    name: string;
    workers: number[];
    blocks: number;
    /** Blocks that were made a second time here, and were the same. */
    compared: number;
    bytes: number;
    /** Pieces of blocks that were waited for and did not come. */
    missing: number;
}

export interface LiveStatus {
    run_dir: string;
    state: string;
    task: string;
    iterations: number;
    planned_iterations: number;
    env_steps: number;
    env_steps_per_s: number;
    wall_s: number;
    eta_s: number | null;
    workers: number;
    max_workers: number;
    min_workers: number;
    processes: Process[];
    hosts: Host[];
    refused_hosts: { name: string; reason: string }[];
    worker_restarts: number;
    learner_restarts: number;
    accounting: { produced: number; received: number; trained: number; duplicate: number; lost: number };
    resident_bytes: number;
    shared_memory_bytes: number;
    checkpoint: string | null;
    /** Programs of before say nothing of it. */
    bucket?: Bucket | null;
    divergence: { iteration: number; reason: string } | null;
}

/** What of a run is in the bucket that its checkpoints go to. */
export interface Bucket {
    address: string;
    waiting: string[];
    trouble: string | null;
}

export interface Metrics {
    iteration: number;
    policy_version: number;
    /** Digests of the blocks that were trained on, a shard each; programs of before recorded none. */
    blocks?: string[];
    env_steps: number;
    wall_s: number;
    env_steps_per_s: number;
    return_mean: number;
    policy_loss: number;
    value_loss: number;
    kl: number;
    actor_lr: number;
    critic_lr: number;
    action_std: number;
    errors: { position: number; orientation: number; base: number };
}

/** An evaluation on held-out goals; `iteration` counts those that the policy was trained on. */
export interface Evaluation {
    iteration: number;
    score: number;
    errors: { tail: { position: number; orientation: number; base: number } };
}

/** Something that has happened in a live run; without a worker it is about the learner. */
export interface Happening {
    number: number;
    at_s: number;
    what: "block" | "update" | "ready" | "died" | "left" | "note";
    worker?: number | null;
    iteration?: number;
    shard?: number;
    seconds?: number;
    cause?: string;
    text?: string;
}

export interface LogLine {
    who: string;
    text: string;
}

/** Seconds as people say them. */
export function duration(seconds: number): string {
    if (seconds < 90) return `${seconds.toFixed(0)} s`;
    if (seconds < 5400) return `${(seconds / 60).toFixed(0)} min`;
    return `${(seconds / 3600).toFixed(1)} h`;
}

export function bytes(count: number): string {
    return count < 1e9 ? `${(count / 1e6).toFixed(0)} MB` : `${(count / 1e9).toFixed(1)} GB`;
}

export function grouped(count: number): string {
    return Math.round(count).toLocaleString("en").replaceAll(",", " ");
}
