// Who made what, who waited, who died: a strip for the learner and for each worker, over the last minute.

import { h } from "../page/dom";
import { GPU } from "../page/gpu";
import { colour } from "../page/theme";
import { CONTACT, ofArm } from "../scene/colours";
import type { Feed } from "./feed";
import type { Happening } from "./status";

/** Seconds that a strip is long. */
const SPANS = [5, 20, 60];
/** It is drawn anew so often (ms). */
const REST = GPU ? 100 : 500;
const ROW = 22;
const NAMES = 74;
const AXIS = 18;

export class TimeLine {
    readonly element: HTMLElement;
    private readonly canvas = h("canvas", { role: "img", aria: { label: "Who made what of late" } });
    private readonly told = h("p", { class: "told faint", role: "status" });
    private readonly span = h("select", { aria: { label: "Length of the time line" } }, ...SPANS.map((s) => h("option", { value: String(s), selected: s === 20 }, `${s} s`)));
    private shown = false;
    private boxes: { x: number; width: number; row: number; it: Happening }[] = [];

    /** `pick` is called with the block that was clicked. */
    constructor(
        private readonly feed: Feed,
        private readonly pick: (iteration: number, shard: number) => void,
    ) {
        this.element = h("section", { class: "card time-line", hidden: true }, h("div", { class: "line" }, h("h2", {}, "Who makes what"), this.span), this.canvas, this.told);
        this.canvas.addEventListener("pointermove", (event) => this.point(event));
        this.canvas.addEventListener("click", (event) => {
            const it = this.under(event);
            if (it?.what === "block" && it.iteration !== undefined && it.shard !== undefined) this.pick(it.iteration, it.shard);
        });
        this.canvas.addEventListener("pointerleave", () => (this.told.textContent = ""));
    }

    show(on: boolean): void {
        const begin = on && !this.shown;
        this.shown = on;
        if (begin) requestAnimationFrame(() => this.tick());
    }

    private tick(): void {
        if (!this.shown) return;
        if (this.feed.heard) this.draw();
        setTimeout(() => requestAnimationFrame(() => this.tick()), REST);
    }

    /** Rows by what has been heard: the learner, then workers; who is gone for longer than the strip has none. */
    private rows(since: number): (number | null)[] {
        const seen = new Set<number | null>([null]);
        for (const { worker } of this.feed.status?.processes ?? []) if (worker !== null) seen.add(worker);
        for (const it of this.feed.happened) if (it.at_s >= since && it.what !== "note") seen.add(it.worker ?? null);
        return [...seen].sort((a, b) => (a ?? -1) - (b ?? -1));
    }

    private draw(): void {
        const { feed, canvas } = this;
        this.element.hidden = feed.happened.length === 0;
        const width = canvas.parentElement?.clientWidth === undefined ? 0 : canvas.clientWidth;
        if (this.element.hidden || width === 0) return;
        const span = Number(this.span.value);
        // The newest things come with a delay of up to half a second.
        const now = feed.now.run + (performance.now() - feed.now.page) / 1000 - 0.6;
        const since = now - span;
        const rows = this.rows(since);
        const height = rows.length * ROW + AXIS;
        const ratio = devicePixelRatio;
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
        canvas.style.height = `${height}px`;
        const g = canvas.getContext("2d");
        if (g === null) return;
        g.scale(ratio, ratio);
        g.font = "12px system-ui, sans-serif";
        g.textBaseline = "middle";
        const x = (s: number): number => NAMES + ((s - since) / span) * (width - NAMES);
        const [faint, grid, ink] = [colour("faint"), colour("grid"), colour("ink")];
        rows.forEach((worker, row) => {
            g.fillStyle = faint;
            g.fillText(worker === null ? "learner" : `worker ${worker}`, 0, (row + 0.5) * ROW);
            g.fillStyle = grid;
            g.fillRect(NAMES, row * ROW + 3, width - NAMES, ROW - 6);
        });
        this.boxes = [];
        g.save();
        g.beginPath();
        g.rect(NAMES, 0, width - NAMES, height);
        g.clip();
        const marks: (() => void)[] = [];
        for (const it of feed.happened) {
            if (it.at_s < since || it.what === "note") continue;
            const row = rows.indexOf(it.worker ?? null);
            const end = x(it.at_s);
            if (it.what === "block" || it.what === "update") {
                const begin = x(it.at_s - (it.seconds ?? 0));
                g.fillStyle = it.what === "update" ? ofArm(1) : ofArm((it.iteration ?? 0) % 2 === 0 ? 0 : 5);
                g.fillRect(begin, row * ROW + 3, Math.max(end - begin - 0.5, 0.75), ROW - 6);
                this.boxes.push({ x: begin, width: Math.max(end - begin, 3), row, it });
            } else {
                marks.push(() => mark(g, it.what, end, row * ROW, ink));
                this.boxes.push({ x: end - 5, width: 10, row, it });
            }
        }
        for (const draw of marks) draw();
        g.restore();
        g.fillStyle = faint;
        g.textAlign = "left";
        g.fillText(`${span} s ago`, NAMES, height - 7);
        g.textAlign = "right";
        g.fillText("now", width, height - 7);
        g.textAlign = "left";
    }

    private point(event: PointerEvent): void {
        const it = this.under(event);
        this.told.textContent = it === undefined ? "" : words(it);
        this.canvas.classList.toggle("picks", it?.what === "block");
    }

    private under(event: MouseEvent): Happening | undefined {
        const place = this.canvas.getBoundingClientRect();
        const [x, row] = [event.clientX - place.left, Math.floor((event.clientY - place.top) / ROW)];
        // Pointers are as exact as a pixel, and a pixel may be many blocks: one that can be made again is meant, or else
        // the one that begins last.
        const hit = this.boxes.filter((box) => box.row === row && x >= box.x - 1 && x <= box.x + box.width);
        const kept = new Set((this.feed.checkpoints ?? []).map(({ iteration }) => iteration));
        const known = ({ it }: { it: Happening }): number => Number(it.what === "block" && it.iteration !== undefined && kept.has(it.iteration));
        return hit.sort((a, b) => known(a) - known(b) || a.x - b.x).at(-1)?.it;
    }
}

function words(it: Happening): string {
    const who = it.worker === null || it.worker === undefined ? "the learner" : `worker ${it.worker}`;
    const ms = `${(1000 * (it.seconds ?? 0)).toFixed(0)} ms`;
    switch (it.what) {
        case "block":
            return `${who} made shard ${it.shard} of iteration ${it.iteration} in ${ms}; a click makes it here again`;
        case "update":
            return `${who} trained on iteration ${it.iteration} in ${ms}`;
        case "died":
            return `${who} died (${it.cause})`;
        default:
            return `${who} ${it.what === "ready" ? "is ready" : "has left"}`;
    }
}

/** A cross for a death, a line for who comes, a short one for who goes. */
function mark(g: CanvasRenderingContext2D, what: Happening["what"], x: number, y: number, ink: string): void {
    g.lineWidth = 2;
    g.strokeStyle = what === "died" ? CONTACT : ink;
    g.beginPath();
    if (what === "died") {
        g.moveTo(x - 5, y + ROW / 2 - 5);
        g.lineTo(x + 5, y + ROW / 2 + 5);
        g.moveTo(x + 5, y + ROW / 2 - 5);
        g.lineTo(x - 5, y + ROW / 2 + 5);
    } else {
        g.moveTo(x, y + (what === "ready" ? 2 : 7));
        g.lineTo(x, y + ROW - (what === "ready" ? 2 : 7));
    }
    g.stroke();
}
