// Two checkpoints side by side: how far they were trained, how good they are, and in what they differ.

import { plain } from "../controls/arms";
import { h } from "../page/dom";
import { json } from "../page/service";
import type { CheckpointEntry } from "../page/source";
import { grouped } from "./status";

/** As the service tells it. */
interface Difference {
    same: boolean;
    config: { key: string; a: string | null; b: string | null }[];
    same_robot: boolean;
    equal_tensors: number;
    tensors: { tensor: string; a: string | null; b: string | null; max_abs: number | null; norm: number | null }[];
}

export class Comparison {
    readonly element = h("div", { class: "comparison", hidden: true });
    /** Names of the one or two that were chosen, the earlier choice first. */
    chosen: string[] = [];
    private entries: CheckpointEntry[] = [];

    /** What there is to choose from; what is gone is chosen no longer. */
    offer(checkpoints: CheckpointEntry[]): void {
        this.entries = checkpoints;
        const there = this.chosen.filter((name) => checkpoints.some((entry) => entry.name === name));
        if (there.length === this.chosen.length) return;
        this.chosen = there;
        this.element.hidden = true;
    }

    /** Chooses one, or lets it go; with two they are compared. Of three the first is let go. */
    async choose(name: string): Promise<void> {
        this.chosen = this.chosen.includes(name) ? this.chosen.filter((other) => other !== name) : [...this.chosen, name].slice(-2);
        const [a, b] = this.chosen;
        this.element.hidden = a === undefined;
        if (a === undefined) return;
        if (b === undefined) {
            this.element.replaceChildren(h("p", { class: "faint" }, `${plain(a)} beside … choose a second one.`));
            return;
        }
        const [first, second] = [a, b].map((name) => encodeURIComponent(name));
        const difference = await json<Difference>(`v1/checkpoints/${first}/differences/${second}`);
        if (this.chosen[0] === a && this.chosen[1] === b) this.show(a, b, difference);
    }

    private show(a: string, b: string, { same, config, same_robot, equal_tensors, tensors }: Difference): void {
        const [left, right] = [a, b].map((name) => this.entries.find((entry) => entry.name === name));
        const row = (name: string, of: (entry: CheckpointEntry) => string): HTMLElement =>
            h("tr", {}, h("td", {}, name), ...[left, right].map((entry) => h("td", { class: "number" }, entry === undefined ? "" : of(entry))));
        const score = (entry: CheckpointEntry): string => entry.labels.score?.value.toFixed(2) ?? "–";
        const count = equal_tensors + tensors.length;
        const words = same
            ? "The same policy, configuration and robot."
            : `${tensors.length} of ${count} tensors of the policies differ. ${same_robot ? "The robot is the same." : "The robots differ."} ${config.length === 0 ? "The configuration is the same." : ""}`;
        const numbers = (value: number | null): string => (value === null ? "–" : value.toPrecision(2));
        const table = (head: string[], rows: HTMLElement[]): HTMLElement =>
            h("table", {}, h("thead", {}, h("tr", {}, ...head.map((text, index) => h("th", index === 0 ? {} : { class: "number" }, text)))), h("tbody", {}, ...rows));
        this.element.replaceChildren(
            table(
                ["", plain(a), plain(b)],
                [
                    row("Iterations", (entry) => grouped(entry.iteration)),
                    row("Env-steps", (entry) => grouped(entry.env_steps)),
                    row("Score", score),
                    ...config.map(({ key, a, b }) => h("tr", {}, h("td", {}, key), h("td", { class: "number" }, a ?? "–"), h("td", { class: "number" }, b ?? "–"))),
                ],
            ),
            h("p", {}, words),
        );
        if (tensors.length === 0) return;
        const rows = tensors.map(({ tensor, norm, max_abs }) =>
            h("tr", { data: { tensor } }, h("td", {}, tensor.replace("policy.safetensors/", "")), h("td", { class: "number" }, numbers(norm)), h("td", { class: "number" }, numbers(max_abs))),
        );
        this.element.append(h("details", {}, h("summary", {}, "How far each tensor has moved"), table(["tensor", "norm", "largest"], rows)));
    }
}
