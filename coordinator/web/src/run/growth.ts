// Curves that grow while a run trains.

import uPlot from "uplot";
import { h } from "../page/dom";
import { colour } from "../page/theme";
import { ARMS } from "../scene/colours";
import type { Metrics } from "./status";

interface Kind {
    title: string;
    unit: string;
    lines: { label: string; value(metrics: Metrics): number }[];
    /** Whether a logarithmic axis suits it. */
    log?: boolean;
}

function kinds(task: string): Kind[] {
    const errors: Kind[] =
        task === "reorientation"
            ? [{ title: "Attitude error of the base", unit: "mrad", lines: [{ label: "base", value: (m) => 1000 * m.errors.base }], log: true }]
            : [
                  { title: "Position error", unit: "mm", lines: [{ label: "hands", value: (m) => 1000 * m.errors.position }], log: true },
                  { title: "Orientation error", unit: "mrad", lines: [{ label: "hands", value: (m) => 1000 * m.errors.orientation }], log: true },
              ];
    return [
        { title: "Return", unit: "mean of agents", lines: [{ label: "return", value: (m) => m.return_mean }] },
        ...errors,
        { title: "Policy loss", unit: "", lines: [{ label: "policy", value: (m) => m.policy_loss }] },
        { title: "Value loss", unit: "", lines: [{ label: "value", value: (m) => m.value_loss }], log: true },
        { title: "Speed", unit: "env-steps/s", lines: [{ label: "speed", value: (m) => m.env_steps_per_s }] },
    ];
}

export class Growth {
    readonly element = h("section", { class: "growth", aria: { label: "Learning curves" } });
    private plots: { plot: uPlot; kind: Kind }[] = [];
    private task = "";

    constructor() {
        new ResizeObserver(() => this.resize()).observe(this.element);
    }

    begin(task: string): void {
        this.task = task;
        for (const { plot } of this.plots) plot.destroy();
        this.element.replaceChildren();
        this.plots = kinds(task).map((kind, index) => {
            const box = h("figure", { class: "curve card" }, h("figcaption", {}, h("b", {}, kind.title), `  ${kind.unit}`));
            this.element.append(box);
            return { kind, plot: this.make(box, kind, ARMS[index % ARMS.length] ?? "#000") };
        });
    }

    show(lines: Metrics[], task: string): void {
        if (task !== this.task || this.plots.length === 0) this.begin(task);
        const iterations = lines.map(({ iteration }) => iteration);
        for (const { plot, kind } of this.plots) {
            const data = kind.lines.map(({ value }) => lines.map((line) => finite(value(line), kind.log === true)));
            plot.setData([iterations, ...data]);
        }
    }

    /** Colours have changed. */
    restyle(lines: Metrics[]): void {
        const { task } = this;
        this.begin(task);
        this.show(lines, task);
    }

    private make(box: HTMLElement, kind: Kind, stroke: string): uPlot {
        const [ink, grid] = [colour("faint"), colour("grid")];
        const axis = { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1, size: 4 }, font: "11px system-ui, sans-serif" };
        return new uPlot(
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
                series: [{}, ...kind.lines.map(({ label }) => ({ label, stroke, width: 1.7, points: { show: false } }))],
            },
            [[], ...kind.lines.map(() => [])],
            box,
        );
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
