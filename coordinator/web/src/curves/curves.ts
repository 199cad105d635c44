// Errors, joint rates and torques over time, under one cursor.

import uPlot from "uplot";
import { h } from "../page/dom";
import { GPU } from "../page/gpu";
import { colour } from "../page/theme";
import { ofArm } from "../scene/colours";
import type { Timeline } from "../simulation/timeline";
import { aimsOf, type Description, type Frame } from "../simulation/types";

/** Curves are drawn anew at most so often (ms). */
const REST = GPU ? 80 : 250;

interface Kind {
    title: string;
    unit: string;
    /** Lines of a robot; `arm` is the one whose joints are shown. */
    lines(description: Description, arm: number): Line[];
}

interface Line {
    label: string;
    stroke: string;
    value(frame: Frame): number;
}

/** A line for each hand that has a goal. */
function ofHands(robot: Description, value: (frame: Frame, arm: number) => number): Line[] {
    const { hands } = aimsOf(robot);
    const lines = robot.arms.map((label, arm) => ({ label, stroke: ofArm(arm), value: (frame: Frame) => value(frame, arm) }));
    return lines.filter((_, arm) => hands.includes(arm));
}

const KINDS: Kind[] = [
    {
        title: "Position error",
        unit: "mm",
        lines: (robot) => ofHands(robot, (frame, arm) => 1000 * (frame.position_error[arm] ?? 0)),
    },
    {
        title: "Attitude error",
        unit: "mrad",
        lines: (robot) => [
            ...ofHands(robot, (frame, arm) => 1000 * (frame.orientation_error[arm] ?? 0)),
            ...(aimsOf(robot).base ? [{ label: "base", stroke: "#8b95a5", value: (frame: Frame) => 1000 * (frame.base_error[0] ?? 0) }] : []),
        ],
    },
    {
        title: "Joint rates",
        unit: "rad/s",
        lines: (robot, arm) => joints(robot, (frame, joint) => frame.state[13 + robot.n_joints + joint] ?? 0, arm),
    },
    {
        title: "Joint torques",
        unit: "N m",
        lines: (robot, arm) => joints(robot, (frame, joint) => frame.torques[joint] ?? 0, arm),
    },
];

/** A line for each joint of an arm, by the name of the link that it moves. */
function joints(robot: Description, value: (frame: Frame, joint: number) => number, arm: number): Line[] {
    const [first, end] = robot.joints[arm] ?? [0, 0];
    return robot.bodies.slice(1 + first, 1 + end).map(({ name }, index) => ({
        label: name.replaceAll("_", " "),
        stroke: ofArm(index),
        value: (frame) => value(frame, first + index),
    }));
}

export class Curves {
    readonly element = h("section", { class: "curves", aria: { label: "Curves" } });
    /** The arm whose joints are shown. */
    arm = 0;
    private plots: { plot: uPlot; lines: Line[]; data: number[][] }[] = [];
    private times: number[] = [];
    private readonly observer = new ResizeObserver(() => this.resize());
    private drawnAt = 0;

    constructor(private readonly timeline: Timeline) {
        this.observer.observe(this.element);
    }

    /** Makes the plots anew: another robot, arm or theme. */
    begin(): void {
        for (const { plot } of this.plots) plot.destroy();
        this.element.replaceChildren();
        this.times = [];
        this.plots = KINDS.flatMap((kind) => {
            const lines = kind.lines(this.timeline.description, this.arm);
            if (lines.length === 0) return [];
            const of = kind.title.startsWith("Joint") ? ` · ${this.timeline.description.arms[this.arm] ?? ""}` : "";
            const box = h("figure", { class: "curve" }, h("figcaption", {}, h("b", {}, kind.title), `${of.replace("_", " ")}  ${kind.unit}`));
            this.element.append(box);
            const data = [this.times, ...lines.map((): number[] => [])];
            return [{ plot: this.make(box, lines, data), lines, data }];
        });
        this.update(true);
    }

    /** Takes what has been simulated since. */
    update(now = false): void {
        const { frames, period } = this.timeline;
        // Whatever may have been cut off and simulated anew is read anew.
        const keep = Math.min(this.times.length, this.valid, frames.length);
        const changed = keep !== this.times.length || keep !== frames.length;
        this.times.length = keep;
        for (const { data } of this.plots) for (const line of data.slice(1)) line.length = Math.min(line.length, keep);
        for (let step = keep; step < frames.length; step++) {
            const frame = frames[step] as Frame;
            this.times.push(step * period);
            for (const { lines, data } of this.plots) lines.forEach((line, index) => data[index + 1]?.push(line.value(frame)));
        }
        this.valid = frames.length;
        const time = performance.now();
        if (!now && (!changed || time - this.drawnAt < REST)) {
            this.late ||= changed;
            return;
        }
        this.late = false;
        this.drawnAt = time;
        for (const { plot, data } of this.plots) {
            const end = Math.max((frames.length - 1) * period, 20);
            plot.batch(() => {
                plot.setData(data as uPlot.AlignedData, false);
                plot.setScale("x", { min: 0, max: end });
            });
        }
    }

    /** Steps up to which what was read still holds. */
    invalidate(step: number): void {
        this.valid = Math.min(this.valid, step);
    }

    /** Draws the line of now, and what has come too soon after the last time. */
    tick(): void {
        if (this.late && performance.now() - this.drawnAt >= REST) this.update(true);
        for (const { plot } of this.plots) this.mark(plot);
    }

    private valid = 0;
    private late = false;

    private make(box: HTMLElement, lines: Line[], data: number[][]): uPlot {
        const [ink, grid] = [colour("faint"), colour("grid")];
        const axis = { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1, size: 4 }, font: "11px system-ui, sans-serif" };
        const plot = new uPlot(
            {
                ...this.size(),
                padding: [6, 18, 0, 0],
                legend: { show: false },
                cursor: {
                    sync: { key: "time" },
                    drag: { x: false, y: false },
                    points: { size: 5 },
                    bind: {
                        mousedown: (u) => (event) => {
                            const seek = (): void => this.timeline.seek(Math.round(u.posToVal(u.cursor.left ?? 0, "x") / this.timeline.period));
                            if (event.button === 0) seek();
                            return null;
                        },
                    },
                },
                scales: { x: { time: false }, y: { range: (_, min, max) => range(min, max) } },
                axes: [
                    { ...axis, size: 22, gap: 2, values: (_, ticks) => ticks.map((tick) => `${tick} s`), space: 60 },
                    { ...axis, size: 44, gap: 4, space: 26 },
                ],
                series: [{}, ...lines.map(({ label, stroke }) => ({ label, stroke, width: 1.6, points: { show: false } }))],
            },
            data as uPlot.AlignedData,
            box,
        );
        const line = h("div", { class: "now" });
        plot.over.append(line);
        return plot;
    }

    private mark(plot: uPlot): void {
        const line = plot.over.querySelector<HTMLElement>(".now");
        const x = plot.valToPos(this.timeline.cursor * this.timeline.period, "x");
        if (line !== null) line.style.transform = `translateX(${Number.isFinite(x) ? x.toFixed(1) : 0}px)`;
    }

    private size(): { width: number; height: number } {
        const style = getComputedStyle(this.element);
        const columns = Math.max(1, style.gridTemplateColumns.split(" ").length);
        const gap = 20;
        const inner = this.element.clientWidth - 2 * Number.parseFloat(style.paddingLeft || "0");
        return { width: Math.max(140, Math.floor((inner - gap * (columns - 1)) / columns)), height: 128 };
    }

    private resize(): void {
        for (const { plot } of this.plots) plot.setSize(this.size());
    }
}

/** From zero where nothing is below it. */
function range(min: number | null, max: number | null): [number, number] {
    if (min === null || max === null) return [0, 1];
    const low = Math.min(min, 0);
    const pad = 0.05 * Math.max(max - low, 1e-6);
    return [low < 0 ? low - pad : 0, max + pad];
}
