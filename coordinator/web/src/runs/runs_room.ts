// All runs of a directory: a list, and the curves of the chosen ones over each other.

import { h, notice, put } from "../page/dom";
import { Refusal, ask, json } from "../page/service";
import { onTheme } from "../page/theme";
import { grouped, type Metrics } from "../run/status";
import { ofArm } from "../scene/colours";
import { families, type Family, type Run } from "./alike";
import { Overlay } from "./overlay";

/** How often to look for more (ms). */
const LOOK = 3000;
/** Chosen at the beginning. */
const FIRST = 6;

/** A row of the list. */
interface Row {
    element: HTMLElement;
    show(run: Run): void;
}

export class RunsRoom {
    readonly element = h("main", { class: "runs-room" });
    private readonly body = h("tbody");
    private readonly rows = new Map<string, Row>();
    private readonly table: HTMLElement;
    private readonly none = h("p", { class: "faint", hidden: true }, "No runs here yet.");
    private readonly legend = h("ul", { class: "legend card" });
    private readonly overlay = new Overlay();
    private runs: Run[] = [];
    private readonly chosen = new Set<string>();
    private readonly lines = new Map<string, Metrics[]>();
    private readonly places = new Map<string, number>();
    /** What went wrong with a run, so that it is said once. */
    private readonly troubles = new Map<string, string>();
    /** The runs that the list shows. */
    private shown = "";
    /** What the legend says. */
    private said = "";

    /** `refused` says what the service has refused with, and is true where it is worth asking again. */
    static async open(refused: (refusal: Refusal) => Promise<boolean>): Promise<RunsRoom> {
        const room = new RunsRoom(refused);
        await room.look();
        return room;
    }

    private constructor(private readonly refused: (refusal: Refusal) => Promise<boolean>) {
        const head = h("tr", {}, h("th", {}, "run"), h("th", { class: "number" }, "iterations"), h("th", { class: "number" }, "return"), h("th", {}), h("th", {}));
        this.table = h("table", { hidden: true }, h("thead", {}, head), this.body);
        const list = h("section", { class: "card runs" }, h("h2", {}, "Runs"), this.none, this.table);
        this.element.append(list, h("div", { class: "side" }, this.legend, this.overlay.element));
        onTheme(() => this.draw());
        // It has a width only when it stands in the page.
        requestAnimationFrame(() => this.draw());
    }

    private async look(): Promise<void> {
        try {
            if (!document.hidden) await this.refresh();
        } catch (error) {
            if (error instanceof Refusal) await this.refused(error);
            else notice(error instanceof Error ? error.message : String(error), "error");
        }
        setTimeout(() => void this.look(), LOOK);
    }

    private async refresh(): Promise<void> {
        const first = this.runs.length === 0;
        this.runs = (await json<{ runs: Run[] }>("v1/runs")).runs;
        if (first) for (const { name } of this.runs.filter(({ last }) => last !== null).slice(-FIRST)) this.chosen.add(name);
        const grown = await Promise.all(this.runs.filter(({ name }) => this.chosen.has(name)).map(({ name }) => this.followed(name)));
        const text = JSON.stringify(this.runs);
        if (text !== this.shown) this.list();
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

    /** Brings the list up to date. What stays in it stays in its place: an element that is made anew or moved loses the keyboard and what is marked in it. */
    private list(): void {
        const names = new Set(this.runs.map(({ name }) => name));
        for (const [name, { element }] of this.rows) {
            if (names.has(name)) continue;
            element.remove();
            this.rows.delete(name);
        }
        let next = this.body.firstElementChild;
        for (const run of this.runs) {
            const row = this.rows.get(run.name) ?? this.row(run.name);
            row.show(run);
            if (row.element === next) next = next.nextElementSibling;
            else this.body.insertBefore(row.element, next);
        }
        this.none.hidden = this.runs.length > 0;
        this.table.hidden = this.runs.length === 0;
    }

    private row(name: string): Row {
        const box = h("input", { type: "checkbox", checked: this.chosen.has(name), aria: { label: `Draw ${name}` } });
        box.onchange = () => {
            if (box.checked) this.chosen.add(name);
            else this.chosen.delete(name);
            void (box.checked ? this.followed(name) : Promise.resolve(false)).then(() => this.draw());
        };
        const iterations = h("td", { class: "number" });
        const mean = h("td", { class: "number" });
        const live = h("span", { class: "tag live" }, "trains");
        const element = h(
            "tr",
            { data: { name } },
            h("td", {}, h("label", { class: "check" }, box, h("span", { class: "name" }, name))),
            iterations,
            mean,
            h("td", {}, live),
            h("td", { class: "actions" }, h("a", { href: `runs/${encodeURIComponent(name)}/` }, "Open")),
        );
        const show = (run: Run): void => {
            const done = run.last === null ? 0 : run.last.iteration + 1;
            put(iterations, `${grouped(done)} / ${grouped(run.planned_iterations)}`);
            put(mean, run.last === null ? "" : run.last.return_mean.toFixed(2));
            live.hidden = !run.live;
        };
        const row = { element, show };
        this.rows.set(name, row);
        return row;
    }

    private draw(): void {
        const all = families(this.runs.filter(({ name }) => this.chosen.has(name)));
        const said = JSON.stringify(all.map(({ legend, runs }) => [legend, runs.map(({ name }) => name)]));
        this.legend.hidden = all.length === 0;
        if (said !== this.said) this.explain(all);
        this.said = said;
        this.overlay.show(all, this.lines);
    }

    private explain(all: Family[]): void {
        this.legend.replaceChildren(
            ...all.map(({ legend, runs }, index) => {
                const dot = h("span", { class: "dot" });
                dot.style.background = ofArm(index);
                const seeds = runs.length > 1 ? ` · ${runs.length} seeds, band over them` : "";
                return h("li", { title: runs.map(({ name }) => name).join(", ") }, dot, h("span", {}, legend, h("span", { class: "faint" }, seeds)));
            }),
        );
    }
}
