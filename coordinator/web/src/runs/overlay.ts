// Curves of several runs over each other: a line for each family, a band over its seeds.

import uPlot from "uplot";
import { h } from "../page/dom";
import { colour } from "../page/theme";
import type { Metrics } from "../run/status";
import { ofArm } from "../scene/colours";
import type { Family } from "./alike";

interface Panel {
    title: string;
    unit: string;
    log: boolean;
    value(line: Metrics): number;
}

const PANELS: Panel[] = [
    { title: "Return", unit: "mean of agents", log: false, value: (m) => m.return_mean },
    { title: "Position error", unit: "mm, training", log: true, value: (m) => 1000 * m.errors.position },
    { title: "Orientation error", unit: "mrad, training", log: true, value: (m) => 1000 * m.errors.orientation },
    { title: "Attitude error of the base", unit: "mrad, training", log: true, value: (m) => 1000 * m.errors.base },
];
/** Places along the curve of a family; more than a screen shows. */
const PLACES = 400;
/** Places of all families together, where there are many. */
const MOST_PLACES = 8000;

export class Overlay {
    readonly element = h("section", { class: "growth", aria: { label: "Curves of the chosen runs" } });
    private plots: uPlot[] = [];

    constructor() {
        new ResizeObserver(() => this.plots.forEach((plot) => plot.setSize(this.size()))).observe(this.element);
    }

    show(families: Family[], lines: Map<string, Metrics[]>): void {
        for (const plot of this.plots) plot.destroy();
        this.element.replaceChildren();
        const places = placesOf(families, lines);
        this.plots = PANELS.map((panel) => this.panel(panel, families, lines, places));
    }

    private panel(panel: Panel, families: Family[], lines: Map<string, Metrics[]>, places: number[]): uPlot {
        const box = h("figure", { class: "curve card" }, h("figcaption", {}, h("b", {}, panel.title), `  ${panel.unit}`));
        this.element.append(box);
        const data: (number | null)[][] = [places];
        const series: uPlot.Series[] = [{}];
        const bands: uPlot.Band[] = [];
        families.forEach((family, index) => {
            const curves = family.runs.map(({ name }) => sampled(lines.get(name) ?? [], places, panel));
            const stroke = ofArm(index);
            const over = (of: (values: number[]) => number): (number | null)[] =>
                places.map((_, at) => {
                    const values = curves.map((curve) => curve[at]).filter((value) => value !== null && value !== undefined);
                    // Where not all seeds are there yet, their mean would jump.
                    return values.length === curves.length && values.length > 0 ? of(values) : null;
                });
            if (curves.length > 1) {
                const at = data.length;
                data.push(over((v) => Math.max(...v)), over((v) => Math.min(...v)));
                series.push({ stroke: "transparent", points: { show: false } }, { stroke: "transparent", points: { show: false } });
                bands.push({ series: [at, at + 1], fill: `${stroke}33` });
            }
            data.push(over((v) => v.reduce((sum, value) => sum + value, 0) / v.length));
            series.push({ label: family.legend, stroke, width: 1.8, points: { show: false } });
        });
        const axis = { stroke: colour("faint"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("grid"), width: 1, size: 4 }, font: "11px system-ui, sans-serif" };
        return new uPlot(
            {
                ...this.size(),
                padding: [8, 14, 0, 0],
                legend: { show: false },
                cursor: { sync: { key: "env-steps" }, drag: { x: false, y: false }, points: { size: 6 } },
                scales: { x: { time: false }, ...(panel.log ? { y: { distr: 3 } } : {}) },
                axes: [
                    { ...axis, size: 24, gap: 2, space: 80, values: (_, splits) => splits.map((n) => (n >= 1e6 ? `${+(n / 1e6).toPrecision(3)}M` : n >= 1e3 ? `${+(n / 1e3).toPrecision(3)}k` : String(n))) },
                    { ...axis, size: 52, gap: 4, space: 30 },
                ],
                series,
                bands,
            },
            data as uPlot.AlignedData,
            box,
        );
    }

    private size(): { width: number; height: number } {
        const columns = Math.max(1, getComputedStyle(this.element).gridTemplateColumns.split(" ").length);
        return { width: Math.max(160, Math.floor((this.element.clientWidth - 16 * (columns - 1)) / columns) - 36), height: 220 };
    }
}

/** Places of all families: each has as many along its own curve, so that a short one beside a long one is drawn, too. */
function placesOf(families: Family[], lines: Map<string, Metrics[]>): number[] {
    const count = Math.min(PLACES, Math.ceil(MOST_PLACES / families.length));
    const of = ({ runs }: Family): number[] => {
        const most = Math.max(0, ...runs.map(({ name }) => lines.get(name)?.at(-1)?.env_steps ?? 0));
        return most === 0 ? [] : Array.from({ length: count }, (_, i) => ((i + 1) * most) / count);
    };
    return [...new Set(families.flatMap(of))].sort((a, b) => a - b);
}

/** The last value up to each place; nothing before the first and after the last. */
function sampled(lines: Metrics[], places: number[], panel: Panel): (number | null)[] {
    let at = -1;
    const end = lines.at(-1)?.env_steps ?? 0;
    return places.map((place) => {
        while (at + 1 < lines.length && (lines[at + 1]?.env_steps ?? Infinity) <= place) at += 1;
        const line = lines[at];
        if (line === undefined || place > end * (1 + 1 / PLACES)) return null;
        const value = panel.value(line);
        return Number.isFinite(value) && (!panel.log || value > 0) ? value : null;
    });
}
