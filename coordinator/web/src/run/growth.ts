// Curves that grow while a run trains.

import uPlot from "uplot";
import { h } from "../page/dom";
import { GPU } from "../page/gpu";
import { colour } from "../page/theme";
import { ARMS } from "../scene/colours";
import type { Aims } from "../simulation/types";
import type { Feed } from "./feed";
import type { Evaluation, Metrics } from "./status";

/** Curves are drawn anew at most so often (ms): a training on the same machine wants its processor. */
const REST = GPU ? 500 : 2000;

interface Drawn {
    title: string;
    unit: string;
    /** Whether a logarithmic axis suits it. */
    log?: boolean;
}

/** A curve over the iterations: of the training, or of evaluations on held-out goals. */
type Kind = Drawn & ({ value(metrics: Metrics): number } | { held(evaluation: Evaluation): number });

function kinds({ hands, base }: Aims): Kind[] {
    const ofBase: Kind[] = [
        { title: "Attitude error of the base", unit: "mrad, training", value: (m) => 1000 * m.errors.base, log: true },
        { title: "Attitude error of the base", unit: "mrad, held-out goals", held: (e) => 1000 * e.errors.tail.base, log: true },
    ];
    const ofHands: Kind[] = [
        { title: "Position error", unit: "mm, training", value: (m) => 1000 * m.errors.position, log: true },
        { title: "Orientation error", unit: "mrad, training", value: (m) => 1000 * m.errors.orientation, log: true },
        { title: "Position error", unit: "mm, held-out goals", held: (e) => 1000 * e.errors.tail.position, log: true },
        { title: "Orientation error", unit: "mrad, held-out goals", held: (e) => 1000 * e.errors.tail.orientation, log: true },
    ];
    const errors = [...(hands.length > 0 ? ofHands : []), ...(base ? ofBase : [])];
    return [
        { title: "Return", unit: "mean of agents", value: (m) => m.return_mean },
        ...errors,
        { title: "Score", unit: "held-out goals; 1 is as good as the paper", held: (e) => e.score, log: true },
        { title: "Policy loss", unit: "", value: (m) => m.policy_loss },
        { title: "Value loss", unit: "", value: (m) => m.value_loss, log: true },
        { title: "Divergence", unit: "KL from the policy that played, nat", value: (m) => m.kl, log: true },
        { title: "Learning rate", unit: "of the actors", value: (m) => m.actor_lr },
        { title: "Noise", unit: "standard deviation of actions", value: (m) => m.action_std },
        { title: "Speed", unit: "env-steps/s", value: (m) => m.env_steps_per_s },
    ];
}

export class Growth {
    readonly element = h("section", { class: "growth", aria: { label: "Learning curves" } });
    private plots: { plot: uPlot; kind: Kind; box: HTMLElement }[] = [];
    private aims: Aims | undefined;
    private drawnAt = 0;
    private drawnLines = 0;
    private waiting = false;

    constructor(private readonly pick: (iteration: number) => void) {
        new ResizeObserver(() => this.resize()).observe(this.element);
    }

    begin(aims: Aims): void {
        this.aims = aims;
        for (const { plot } of this.plots) plot.destroy();
        this.element.replaceChildren();
        this.plots = kinds(aims).map((kind, index) => {
            const box = h("figure", { class: "curve card" }, h("figcaption", {}, h("b", {}, kind.title), `  ${kind.unit}`));
            this.element.append(box);
            return { kind, box, plot: this.make(box, kind, ARMS[index % ARMS.length] ?? "#000") };
        });
    }

    /** Draws what there is: at once if it is much that is new, else as soon as it is time. */
    show(feed: Feed, aims: Aims): void {
        const same = aims.hands.length === this.aims?.hands.length && aims.base === this.aims.base;
        if (!same || this.plots.length === 0) this.begin(aims);
        const { length } = feed.metrics.lines;
        const rest = REST - (performance.now() - this.drawnAt);
        if (rest <= 0 || length > 2 * this.drawnLines || length < this.drawnLines) {
            this.draw(feed);
        } else if (!this.waiting) {
            this.waiting = true;
            setTimeout(() => this.draw(feed), rest);
        }
    }

    private draw({ metrics, evaluations }: Feed): void {
        this.waiting = false;
        this.drawnAt = performance.now();
        this.drawnLines = metrics.lines.length;
        const iterations = metrics.lines.map(({ iteration }) => iteration);
        const held = evaluations.lines.map(({ iteration }) => iteration);
        for (const { plot, kind, box } of this.plots) {
            const log = kind.log === true;
            if ("held" in kind) {
                box.hidden = held.length === 0;
                plot.setData([held, evaluations.lines.map((line) => finite(kind.held(line), log))]);
            } else {
                plot.setData([iterations, metrics.lines.map((line) => finite(kind.value(line), log))]);
            }
        }
    }

    /** Colours have changed. */
    restyle(feed: Feed): void {
        if (this.aims !== undefined) this.begin(this.aims);
        this.draw(feed);
    }

    private make(box: HTMLElement, kind: Kind, stroke: string): uPlot {
        const [ink, grid] = [colour("faint"), colour("grid")];
        const axis = { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1, size: 4 }, font: "11px system-ui, sans-serif" };
        const plot: uPlot = new uPlot(
            {
                ...this.size(),
                padding: [8, 14, 0, 0],
                legend: { show: false },
                cursor: { sync: { key: "iteration" }, drag: { x: false, y: false }, points: { size: 6 } },
                scales: { x: { time: false }, ...(kind.log === true ? { y: { distr: 3 } } : {}) },
                axes: [
                    { ...axis, size: 24, gap: 2, space: 60 },
                    { ...axis, size: 52, gap: 4, space: 30 },
                ],
                series: [{}, { label: kind.title, stroke, width: 1.7, points: { show: "held" in kind, size: 4, fill: stroke } }],
            },
            [[], []],
            box,
        );
        plot.over.title = "Click: the policy of that iteration plays, or the nearest that is kept";
        plot.over.addEventListener("click", () => {
            const at = plot.cursor.idx;
            const iteration = at === null || at === undefined ? undefined : plot.data[0][at];
            if (iteration !== undefined) this.pick(iteration);
        });
        return plot;
    }

    private size(): { width: number; height: number } {
        const columns = Math.max(1, getComputedStyle(this.element).gridTemplateColumns.split(" ").length);
        return { width: Math.max(160, Math.floor((this.element.clientWidth - 16 * (columns - 1)) / columns) - 32), height: 170 };
    }

    private resize(): void {
        for (const { plot } of this.plots) plot.setSize(this.size());
    }
}

/** What cannot be drawn is a gap. */
function finite(value: number, log: boolean): number | null {
    return Number.isFinite(value) && (!log || value > 0) ? value : null;
}
