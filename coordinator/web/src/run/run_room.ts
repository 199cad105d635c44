// The room of the run: how it is doing, and what it can be asked to do.

import { slider } from "../controls/world";
import { h, notice } from "../page/dom";
import { json, Refusal } from "../page/service";
import { onTheme } from "../page/theme";
import { Checkpoints } from "./checkpoints";
import { Follower } from "./follow";
import { Growth } from "./growth";
import { bytes, duration, grouped, type LiveStatus, type Metrics, type Process } from "./status";

/** How often to look (ms), and how often at most while nobody answers. */
const LOOK = 1000;
const LOOK_LOST = 8000;

export class RunRoom {
    readonly element = h("main", { class: "run-room", hidden: true });
    private readonly metrics = new Follower<Metrics>("v1/metrics");
    private readonly growth = new Growth();
    private readonly checkpoints: Checkpoints;
    private readonly lost = h("div", { class: "lost", role: "status", hidden: true }, "The service does not answer. This page tries again.");
    private readonly tiles = h("section", { class: "tiles card" });
    private readonly workers = h("section", { class: "card" });
    private readonly processes = h("div");
    private slider: { element: HTMLElement; set(value: number): void } | undefined;
    private wait = LOOK;
    private live: LiveStatus | undefined;
    private wanted = 0;
    private isBesideARun = true;
    private deaths = 0;

    constructor(
        play: (name: string) => void,
        private readonly readOnly: boolean,
    ) {
        this.checkpoints = new Checkpoints(play, readOnly);
        this.workers.append(h("h2", {}, "Processes"), this.processes);
        this.element.append(this.lost, this.tiles, this.growth.element, h("div", { class: "side" }, this.workers, this.checkpoints.element));
        onTheme(() => this.growth.restyle(this.metrics.lines));
    }

    /** Whether the service stands beside something that records. */
    static async isHere(): Promise<boolean> {
        try {
            await new Follower("v1/metrics").look();
            return true;
        } catch (error) {
            if (error instanceof Refusal && error.status === 404) return false;
            throw error;
        }
    }

    start(): void {
        void this.look();
    }

    show(on: boolean): void {
        this.element.hidden = !on;
        if (on) this.growth.show(this.metrics.lines, this.task());
    }

    private async look(): Promise<void> {
        try {
            if (!document.hidden) await this.ask();
            this.lost.hidden = true;
            this.wait = LOOK;
        } catch (error) {
            if (error instanceof Refusal) notice(error.message, "error");
            else this.lost.hidden = false;
            this.wait = Math.min(2 * this.wait, LOOK_LOST);
        }
        setTimeout(() => void this.look(), this.wait);
    }

    private async ask(): Promise<void> {
        try {
            if (this.isBesideARun) this.live = await json<LiveStatus>("v1/status");
        } catch (error) {
            if (!(error instanceof Refusal) || error.status !== 404) throw error;
            // A service that stands beside no run never will.
            this.isBesideARun = false;
        }
        const grown = await this.metrics.look();
        await this.checkpoints.look(this.live !== undefined);
        this.showStatus();
        if (grown && !this.element.hidden) this.growth.show(this.metrics.lines, this.task());
    }

    private task(): string {
        return this.live?.task ?? "trajectory";
    }

    private showStatus(): void {
        const { live } = this;
        const last = this.metrics.lines.at(-1);
        const tile = (name: string, value: string): HTMLElement => h("div", { class: "tile" }, h("span", {}, name), h("b", {}, value));
        if (live === undefined) {
            this.tiles.replaceChildren(tile("State", "at rest"), tile("Iterations", grouped((last?.iteration ?? -1) + 1)), tile("Env-steps", grouped(last?.env_steps ?? 0)));
            this.workers.hidden = true;
            return;
        }
        this.workers.hidden = false;
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
            this.slider = slider("Workers", [1, live.max_workers, 1], live.workers, String, (count) => void this.scale(count));
            this.workers.append(this.slider.element);
        }
        if (live.workers !== this.wanted) {
            this.wanted = live.workers;
            this.slider?.set(live.workers);
        }
        const deaths = live.worker_restarts + live.learner_restarts;
        if (deaths > this.deaths) notice("A process has died and was replaced; what is learned does not change");
        this.deaths = deaths;
        this.processes.replaceChildren(table(live.processes));
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
