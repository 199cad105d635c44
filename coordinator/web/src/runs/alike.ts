// Which runs learn the same but for their seeds, and in what the others differ.

export interface Run {
    name: string;
    live: boolean;
    planned_iterations: number;
    last: { iteration: number; env_steps: number; return_mean: number } | null;
    config: Record<string, unknown>;
}

export interface Family {
    /** The keys in which it differs from the other families. */
    legend: string;
    runs: Run[];
}

/** What changes nothing that is learned, as `Run::HARMLESS` has it, and the seed. */
const HOUSEKEEPING = [
    "run.seed",
    "run.audit",
    "run.best_after",
    "run.checkpoint_every",
    "run.checkpoint_every_s",
    "run.checkpoints",
    "run.checkpoints_kept",
    "run.evaluate_every",
    "run.evaluation_episodes",
    "run.evaluation_steps",
    "run.keep_every",
    "run.milestone_every_s",
    "run.order_deadline_s",
    "run.pin",
    "run.time_limit_s",
    "run.workers",
];

/** Runs that differ in their seeds alone belong together. */
export function families(runs: Run[]): Family[] {
    const flat = new Map(runs.map((run) => [run, flatten(run.config)]));
    const groups = new Map<string, Run[]>();
    for (const run of runs) {
        const key = JSON.stringify([...(flat.get(run) ?? [])].filter(([name]) => !HOUSEKEEPING.includes(name)).sort());
        groups.set(key, [...(groups.get(key) ?? []), run]);
    }
    const all = [...groups.values()];
    const keys = new Set([...flat.values()].flatMap((values) => [...values.keys()]));
    const differing = [...keys].filter((key) => {
        const values = new Set(all.map(([run]) => (run === undefined ? "" : flat.get(run)?.get(key))));
        return !HOUSEKEEPING.includes(key) && values.size > 1;
    });
    return all.map((group) => {
        const [first] = group;
        const values = first === undefined ? undefined : flat.get(first);
        const said = differing.map((key) => `${short(key)} ${values?.get(key) ?? "none"}`);
        const names = group.map(({ name }) => name).join(", ");
        return { legend: said.length > 0 ? said.slice(0, 4).join(", ") + (said.length > 4 ? " …" : "") : names, runs: group };
    });
}

function short(key: string): string {
    return key.split(".").slice(-2).join(".");
}

function flatten(value: unknown, path = ""): Map<string, string> {
    if (value === null || typeof value !== "object" || Array.isArray(value)) return new Map([[path, typeof value === "string" ? value : JSON.stringify(value)]]);
    return new Map(Object.entries(value).flatMap(([key, inner]) => [...flatten(inner, path === "" ? key : `${path}.${key}`)]));
}
