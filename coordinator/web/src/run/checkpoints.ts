// The checkpoints of a run: look, play, commit, compare, promote, pin, tag, download.

import { plain } from "../controls/arms";
import { h, ICONS, icon, notice } from "../page/dom";
import { ask, json } from "../page/service";
import type { CheckpointEntry } from "../page/source";
import { Comparison } from "./comparison";
import { bytes } from "./status";

/** The tag of the one that others shall use: `RUN:promoted`. */
const PROMOTED = "promoted";

export class Checkpoints {
    readonly element = h("section", { class: "card" });
    private shown = "";
    private checkpoints: CheckpointEntry[] = [];
    private readonly comparison = new Comparison();
    private readonly list = h("div", { class: "checkpoints" });
    private readonly commit = h("button", { type: "button", onclick: () => void this.commitNow() }, "Commit now");

    constructor(
        private readonly play: (name: string) => void,
        private readonly readOnly: boolean,
    ) {
        this.element.append(h("div", { class: "line" }, h("h2", {}, "Checkpoints"), this.commit), this.list, this.comparison.element);
    }

    show(checkpoints: CheckpointEntry[], live: boolean): void {
        this.commit.hidden = !live || this.readOnly;
        this.comparison.offer(checkpoints);
        const text = JSON.stringify([checkpoints, this.comparison.chosen]);
        if (text === this.shown) return;
        this.shown = text;
        this.checkpoints = checkpoints;
        const rows = checkpoints.toReversed().map((entry) => this.row(entry));
        this.list.replaceChildren(rows.length === 0 ? h("p", { class: "faint" }, "None yet.") : h("table", {}, ...rows));
    }

    private row(entry: CheckpointEntry): HTMLElement {
        const { name, labels } = entry;
        const path = `v1/checkpoints/${encodeURIComponent(name)}`;
        const pin = h(
            "button",
            {
                type: "button",
                class: "icon-button",
                title: labels.pinned ? "Let it go" : "Keep it for ever",
                onclick: () => void this.act(() => ask(`${path}/pin`, { method: labels.pinned ? "DELETE" : "PUT" })),
                aria: { label: `Pin ${plain(name)}`, pressed: String(labels.pinned) },
            },
            icon(ICONS.pin),
        );
        const isPromoted = labels.tags.includes(PROMOTED);
        const promote = h(
            "button",
            {
                type: "button",
                class: "icon-button",
                title: isPromoted ? "Promote it no longer" : "Promote it: it becomes `promoted`, in the place of the one before",
                onclick: () => void this.act(() => ask(`${path}/tags/${PROMOTED}`, { method: isPromoted ? "DELETE" : "PUT" })),
                aria: { label: `Promote ${plain(name)}`, pressed: String(isPromoted) },
            },
            icon(ICONS.promote),
        );
        const compare = h(
            "button",
            {
                type: "button",
                class: "icon-button",
                title: "Compare it with another one",
                onclick: () => this.compare(name),
                aria: { label: `Compare ${plain(name)}`, pressed: String(this.comparison.chosen.includes(name)) },
            },
            icon(ICONS.compare),
        );
        const tag = h(
            "button",
            { type: "button", class: "icon-button", title: "Give it a tag", onclick: () => this.tag(path), aria: { label: `Tag ${plain(name)}` } },
            icon(ICONS.tag),
        );
        const save = h(
            "button",
            {
                type: "button",
                class: "icon-button",
                title: `Download as a tar archive (${bytes(entry.bytes)})`,
                onclick: () => void this.act(() => this.download(name, path)),
                aria: { label: `Download ${plain(name)}` },
            },
            icon(ICONS.save),
        );
        const play = h("button", { type: "button", class: "row-name", title: "Play it", onclick: () => this.play(name) }, plain(name));
        const score = labels.score?.value.toFixed(2) ?? "";
        return h(
            "tr",
            { data: { name } },
            h("td", {}, play, ...labels.tags.map((text) => h("span", { class: "tag" }, text))),
            h("td", { class: "number", title: "Score: 1 is as good as the paper" }, score),
            h("td", { class: "actions" }, compare, ...(this.readOnly ? [] : [promote, pin, tag]), save),
        );
    }

    private compare(name: string): void {
        void this.act(() => this.comparison.choose(name));
        for (const button of this.list.querySelectorAll<HTMLButtonElement>("button[aria-label^=Compare]")) {
            const of = button.closest("tr")?.dataset["name"] ?? "";
            button.setAttribute("aria-pressed", String(this.comparison.chosen.includes(of)));
        }
        this.shown = JSON.stringify([this.checkpoints, this.comparison.chosen]);
    }

    private tag(path: string): void {
        const name = prompt("Tag:");
        if (name !== null && name !== "") void this.act(() => ask(`${path}/tags/${encodeURIComponent(name)}`, { method: "PUT" }));
    }

    private async commitNow(): Promise<void> {
        this.commit.disabled = true;
        await this.act(async () => {
            const { checkpoint } = await json<{ checkpoint: string | null }>("v1/checkpoints", { method: "POST" });
            notice(checkpoint === null ? "It will be committed after this iteration" : `${plain(checkpoint)} is committed`);
        });
        this.commit.disabled = false;
    }

    private async download(name: string, path: string): Promise<void> {
        const blob = await (await ask(`${path}/archive`)).blob();
        const link = h("a", { href: URL.createObjectURL(blob), download: `${name}.tar` });
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    }

    private async act(what: () => Promise<unknown>): Promise<void> {
        try {
            await what();
        } catch (error) {
            notice(error instanceof Error ? error.message : String(error), "error");
        }
    }
}
