// The room of the run: how it is doing, and what it can be asked to do.

import { plain } from "../controls/arms";
import { type Slider, slider } from "../controls/world";
import { h, notice } from "../page/dom";
import { json } from "../page/service";
import { onTheme } from "../page/theme";
import type { Aims } from "../simulation/types";
import type { Blocks } from "./blocks";
import { Checkpoints } from "./checkpoints";
import type { Feed } from "./feed";
import { Growth } from "./growth";
import { Logs } from "./logs";
import { bytes, duration, grouped, type Bucket, type Host, type Process } from "./status";
import { TimeLine } from "./time_line";

export class RunRoom {
    readonly element = h("main", { class: "run-room", hidden: true });
    private readonly growth: Growth;
    private readonly checkpoints: Checkpoints;
    private readonly timeLine: TimeLine;
    private readonly logs = new Logs();
    private readonly lost = h("div", { class: "lost", role: "status", hidden: true });
    private readonly tiles = h("section", { class: "tiles card" });
    private readonly workers = h("section", { class: "card" });
    private readonly processes = h("div");
    private slider: Slider | undefined;
    private wanted = 0;
    /** As many as were heard of; what was before is no news. */
    private deaths: number | undefined;

    constructor(
        private readonly feed: Feed,
        private readonly blocks: Blocks,
        private readonly play: (name: string) => void,
        /** What a task has goals for; of the robot that is shown, where no run says its own. */
        private readonly aims: (task: string | undefined) => Aims,
        private readonly readOnly: boolean,
    ) {
        this.growth = new Growth((iteration) => this.playNearest(iteration));
        this.checkpoints = new Checkpoints(play, readOnly);
        this.timeLine = new TimeLine(feed, (iteration, shard) => void blocks.make(iteration, shard));
        this.workers.append(h("h2", {}, "Processes"), this.processes);
        const left = h("div", { class: "side" }, this.timeLine.element, this.growth.element);
        this.element.append(this.lost, this.tiles, left, h("div", { class: "side" }, this.workers, this.checkpoints.element, blocks.element, this.logs.element));
        feed.on(["status", "trains", "metrics", "heard"], () => this.showStatus());
        feed.on(["metrics", "evaluations"], () => this.draw());
        feed.on(["checkpoints", "heard"], () => this.checkpoints.show(feed.checkpoints ?? [], feed.status !== undefined));
        feed.on(["checkpoints", "metrics"], () => this.showBlocks());
        feed.on(["logs"], () => this.logs.show(feed.logs));
        onTheme(() => this.growth.restyle(feed));
    }

    show(on: boolean): void {
        this.element.hidden = !on;
        this.timeLine.show(on);
        if (!on) return;
        this.draw();
        this.blocks.show();
        this.logs.show(this.feed.logs);
    }

    private showBlocks(): void {
        if (!this.element.hidden) this.blocks.show();
    }

    private draw(): void {
        if (!this.element.hidden) this.growth.show(this.feed, this.aims(this.feed.status?.task || undefined));
    }

    /** The policy after an iteration, or the nearest that is kept. */
    private playNearest(iteration: number): void {
        const kept = (this.feed.checkpoints ?? []).filter(({ kind }) => kind === "training");
        const far = (entry: { iteration: number }): number => Math.abs(entry.iteration - iteration);
        const [nearest] = kept.toSorted((a, b) => far(a) - far(b));
        if (nearest === undefined) {
            notice("No policy is kept yet");
            return;
        }
        this.play(nearest.name);
        notice(nearest.iteration === iteration ? `${plain(nearest.name)} plays` : `Iteration ${iteration} is not kept; ${plain(nearest.name)} is the nearest and plays`);
    }

    private showStatus(): void {
        const { status: live, heard, refusal, trains, metrics } = this.feed;
        this.lost.hidden = heard;
        this.lost.textContent = refusal === undefined ? "The service does not answer. This page tries again." : `The service refuses: ${refusal.message}`;
        const last = metrics.lines.at(-1);
        const tile = (name: string, value: string): HTMLElement => h("div", { class: "tile" }, h("span", {}, name), h("b", {}, value));
        this.workers.hidden = live === undefined;
        if (live === undefined) {
            const state = !heard ? "not heard" : trains === undefined ? "–" : trains ? "trains" : "at rest";
            this.tiles.replaceChildren(tile("State", state), tile("Iterations", grouped((last?.iteration ?? -1) + 1)), tile("Env-steps", grouped(last?.env_steps ?? 0)));
            this.deaths = undefined;
            return;
        }
        this.checkpoints.show(this.feed.checkpoints ?? [], true);
        this.tiles.replaceChildren(
            tile("State", live.divergence === null ? live.state : "diverged"),
            tile("Iteration", `${grouped(live.iterations)} of ${grouped(live.planned_iterations)}`),
            tile("Env-steps", grouped(live.env_steps)),
            tile("Env-steps/s", grouped(live.env_steps_per_s)),
            tile("Time left", live.eta_s === null ? "–" : duration(live.eta_s)),
            tile("Memory", bytes(live.resident_bytes)),
            tile("Lost env-steps", grouped(live.accounting.lost)),
        );
        if (this.slider === undefined && live.max_workers > 1 && !this.readOnly) {
            this.slider = slider("Workers", [live.min_workers, live.max_workers, 1], live.workers, String, (count) => void this.scale(count));
            this.workers.append(this.slider.element);
        }
        if (live.workers !== this.wanted) {
            this.wanted = live.workers;
            this.slider?.set(live.workers);
        }
        const deaths = live.worker_restarts + live.learner_restarts;
        if (this.deaths !== undefined && deaths > this.deaths) notice("A process has died and was replaced; what is learned does not change");
        this.deaths = deaths;
        const refused = live.refused_hosts.map(({ name, reason }) => h("p", { class: "refused" }, `${name} was thrown out: it ${reason}`));
        this.processes.replaceChildren(table(live.processes), ...hosts(live.hosts), ...refused, ...bucket(live.bucket));
    }

    private async scale(workers: number): Promise<void> {
        try {
            await json("v1/workers", { method: "PUT", headers: { "content-type": "application/json" }, body: JSON.stringify({ workers }) });
        } catch (error) {
            this.slider?.set(this.wanted);
            notice(error instanceof Error ? error.message : String(error), "error");
        }
    }
}

function bucket(there?: Bucket | null): HTMLElement[] {
    if (there === null || there === undefined) return [];
    const [newest] = there.waiting;
    const others = there.waiting.length > 1 ? ` and ${there.waiting.length - 1} more` : "";
    const state = newest === undefined ? "has all checkpoints" : `${plain(newest)}${others} not sent yet`;
    const why = there.trouble === null ? "" : `: ${there.trouble}`;
    return [h("p", there.trouble === null ? {} : { class: "refused" }, `${there.address} ${state}${why}`)];
}

function table(processes: Process[]): HTMLElement {
    const cell = (text: string, number = false): HTMLElement => h("td", number ? { class: "number" } : {}, text);
    const rows = processes.map((process) =>
        h(
            "tr",
            { data: { role: process.role, pid: String(process.pid ?? "") } },
            cell(process.worker === null ? process.role : `worker ${process.worker}`),
            cell(process.state),
            cell(process.restarts === 0 ? "" : `replaced ${process.restarts}×`),
            cell(bytes(process.resident_bytes), true),
        ),
    );
    return h("table", {}, ...rows);
}

/** Other machines, if there are any. */
function hosts(all: Host[]): HTMLElement[] {
    if (all.length === 0) return [];
    const head = h("tr", {}, ...["Machine", "Workers", "Blocks", "Compared", "Came", "Missing pieces"].map((name) => h("th", {}, name)));
    const rows = all.map((host) => {
        const numbers = [grouped(host.workers.length), grouped(host.blocks), grouped(host.compared), bytes(host.bytes), grouped(host.missing)];
        return h("tr", { data: { host: String(host.host) } }, h("td", {}, `${host.host} ${host.name}`), ...numbers.map((text) => h("td", { class: "number" }, text)));
    });
    return [h("h3", {}, "Other machines"), h("table", { class: "hosts" }, head, ...rows)];
}
