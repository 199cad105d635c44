// All runs of a directory: a list, and the curves of the chosen ones over each other.

import { h, notice } from "../page/dom";
import { ask, json } from "../page/service";
import { onTheme } from "../page/theme";
import { grouped, type Metrics } from "../run/status";
import { ofArm } from "../scene/colours";
import { families, type Run } from "./alike";
import { Overlay } from "./overlay";

/** How often to look for more (ms). */
const LOOK = 3000;
/** Chosen at the beginning. */
const FIRST = 6;

export class RunsRoom {
    readonly element = h("main", { class: "runs-room" });
    private readonly list = h("section", { class: "card runs" });
    private readonly legend = h("ul", { class: "legend card" });
    private readonly overlay = new Overlay();
    private runs: Run[] = [];
    private readonly chosen = new Set<string>();
    private readonly lines = new Map<string, Metrics[]>();
    private readonly places = new Map<string, number>();
    /** What went wrong with a run, so that it is said once. */
    private readonly troubles = new Map<string, string>();
    private shown = "";

    static async open(): Promise<RunsRoom> {
        const room = new RunsRoom();
        await room.look();
        return room;
    }

    private constructor() {
        this.element.append(this.list, h("div", { class: "side" }, this.legend, this.overlay.element));
        onTheme(() => this.draw());
        // It has a width only when it stands in the page.
        requestAnimationFrame(() => this.draw());
    }

    private async look(): Promise<void> {
        try {
            if (!document.hidden) await this.refresh();
        } catch (error) {
            notice(error instanceof Error ? error.message : String(error), "error");
        }
        setTimeout(() => void this.look(), LOOK);
    }

    private async refresh(): Promise<void> {
        const first = this.runs.length === 0;
        this.runs = (await json<{ runs: Run[] }>("v1/runs")).runs;
        if (first) for (const { name } of this.runs.filter(({ last }) => last !== null).slice(-FIRST)) this.chosen.add(name);
        const grown = await Promise.all(this.runs.filter(({ name }) => this.chosen.has(name)).map(({ name }) => this.followed(name)));
        const text = JSON.stringify(this.runs);
        if (text !== this.shown) this.rows();
        if (text !== this.shown || grown.includes(true)) this.draw();
        this.shown = text;
    }

    /** Fetches what is new of a run. One that fails holds up no other. */
    private async followed(name: string): Promise<boolean> {
        try {
            const changed = await this.follow(name);
            this.troubles.delete(name);
            return changed;
        } catch (error) {
            const words = error instanceof Error ? error.message : String(error);
            if (this.troubles.get(name) !== words) notice(`${name}: ${words}`, "error");
            this.troubles.set(name, words);
            return false;
        }
    }

    private async follow(name: string): Promise<boolean> {
        let changed = false;
        for (;;) {
            const from = this.places.get(name) ?? 0;
            const response = await ask(`runs/${encodeURIComponent(name)}/v1/metrics?from=${from}`);
            const begun = Number(response.headers.get("octopus-from") ?? 0);
            const next = Number(response.headers.get("octopus-next") ?? 0);
            const text = await response.text();
            // Who asked at the same time was answered first.
            if ((this.places.get(name) ?? 0) !== from) return changed;
            // Cut off after a recovery: from the beginning.
            const lines = begun < from || from === 0 ? [] : (this.lines.get(name) ?? []);
            this.places.set(name, next);
            if (text === "") return changed;
            for (const line of text.trimEnd().split("\n")) lines.push(JSON.parse(line) as Metrics);
            this.lines.set(name, lines);
            changed = true;
        }
    }

    private rows(): void {
        const row = (run: Run): HTMLElement => {
            const box = h("input", { type: "checkbox", checked: this.chosen.has(run.name), aria: { label: `Draw ${run.name}` } });
            box.onchange = () => {
                if (box.checked) this.chosen.add(run.name);
                else this.chosen.delete(run.name);
                void (box.checked ? this.followed(run.name) : Promise.resolve(false)).then(() => this.draw());
            };
            const done = run.last === null ? 0 : run.last.iteration + 1;
            return h(
                "tr",
                { data: { name: run.name } },
                h("td", {}, h("label", { class: "check" }, box, h("span", { class: "name" }, run.name))),
                h("td", { class: "number" }, `${grouped(done)} / ${grouped(run.planned_iterations)}`),
                h("td", { class: "number" }, run.last === null ? "" : run.last.return_mean.toFixed(2)),
                h("td", {}, run.live ? h("span", { class: "tag live" }, "trains") : undefined),
                h("td", { class: "actions" }, h("a", { href: `runs/${encodeURIComponent(run.name)}/` }, "Open")),
            );
        };
        const head = h("tr", {}, h("th", {}, "run"), h("th", { class: "number" }, "iterations"), h("th", { class: "number" }, "return"), h("th", {}), h("th", {}));
        const none = h("p", { class: "faint" }, "No runs here yet.");
        this.list.replaceChildren(h("h2", {}, "Runs"), this.runs.length === 0 ? none : h("table", {}, h("thead", {}, head), h("tbody", {}, ...this.runs.map(row))));
    }

    private draw(): void {
        const all = families(this.runs.filter(({ name }) => this.chosen.has(name)));
        this.legend.hidden = all.length === 0;
        this.legend.replaceChildren(
            ...all.map(({ legend, runs }, index) => {
                const dot = h("span", { class: "dot" });
                dot.style.background = ofArm(index);
                const seeds = runs.length > 1 ? ` · ${runs.length} seeds, band over them` : "";
                return h("li", { title: runs.map(({ name }) => name).join(", ") }, dot, h("span", {}, legend, h("span", { class: "faint" }, seeds)));
            }),
        );
        this.overlay.show(all, this.lines);
    }
}
