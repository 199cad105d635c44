// A block of the run, made again in the page from its address, beside what the learner recorded of it.

import { plain } from "../controls/arms";
import { h } from "../page/dom";
import type { Source } from "../page/source";
import { Simulation } from "../simulation/simulation";
import type { Block } from "../simulation/types";
import type { Feed } from "./feed";
import { grouped, type Metrics } from "./status";

export class Blocks {
    private readonly iteration = h("select", { aria: { label: "Iteration of the block" } });
    private readonly shard = h("input", { type: "number", min: "0", value: "0", aria: { label: "Shard of the block" } });
    private readonly button = h("button", { type: "button", onclick: () => void this.make(Number(this.iteration.value), Number(this.shard.value)) }, "Make it again");
    private readonly told = h("p", { class: "made", role: "status" });
    readonly element = h(
        "section",
        { class: "card blocks", hidden: true },
        h("h2", {}, "A block again"),
        h("div", { class: "line" }, h("label", { class: "field" }, h("span", {}, "Iteration"), this.iteration), h("label", { class: "field" }, h("span", {}, "Shard"), this.shard), this.button),
        this.told,
    );
    private shown = "";

    constructor(
        private readonly feed: Feed,
        private readonly source: Source,
        private readonly module: ArrayBuffer,
    ) {}

    /** Offers the iterations whose policy is kept. */
    show(): void {
        const kept = this.kept();
        const text = kept.map(({ iteration }) => iteration).join(" ");
        this.element.hidden = kept.length === 0;
        if (text === this.shown) return;
        this.shown = text;
        const before = this.iteration.value;
        this.iteration.replaceChildren(...kept.toReversed().map(({ iteration }) => h("option", { value: String(iteration) }, String(iteration))));
        if (kept.some(({ iteration }) => String(iteration) === before)) this.iteration.value = before;
        this.shard.max = String(Math.max(0, (kept[0]?.blocks?.length ?? 1) - 1));
    }

    /** Makes one again, as it was clicked somewhere. */
    async make(iteration: number, shard: number): Promise<void> {
        const line = this.feed.metrics.lines.find((line) => line.iteration === iteration);
        const checkpoint = line === undefined ? undefined : this.checkpoint(line);
        const name = `Block of iteration ${iteration}, shard ${shard}`;
        this.element.hidden = false;
        if (line === undefined) {
            this.say(`${name}: the learner has not trained on it yet.`, "unknown");
            return;
        }
        if (checkpoint === undefined) {
            const kept = this.kept().map(({ iteration }) => iteration);
            const others = kept.length === 0 ? "no policy is kept yet" : `kept are those of iterations ${kept.slice(-6).join(", ")}`;
            this.say(`${name}: the policy that acted in it, version ${line.policy_version}, was not kept; ${others}.`, "unknown");
            return;
        }
        this.iteration.value = String(iteration);
        this.shard.value = String(shard);
        this.button.disabled = true;
        this.say(`${name}: ${plain(checkpoint)} plays it …`, "busy");
        try {
            const since = performance.now();
            const block = await this.made(checkpoint, iteration, shard);
            this.judge(name, block, line.blocks?.[shard], (performance.now() - since) / 1000);
        } catch (error) {
            this.say(`${name}: ${error instanceof Error ? error.message : String(error)}.`, "unknown");
        }
        this.button.disabled = false;
    }

    /** In a thread of its own, so that the robot moves on. */
    private async made(checkpoint: string, iteration: number, shard: number): Promise<Block> {
        const [files, worker] = await Promise.all([this.source.load(checkpoint), this.source.worker()]);
        const simulation = await Simulation.start(worker, this.module);
        try {
            return await simulation.block(files, iteration, shard);
        } finally {
            simulation.end();
        }
    }

    private judge(name: string, { seed, digest, env_steps, returns }: Block, recorded: string | undefined, seconds: number): void {
        const mean = returns.reduce((sum, value) => sum + value, 0) / Math.max(1, returns.length);
        const what = `${name}, seed ${seed}: ${grouped(env_steps)} env-steps in ${seconds.toFixed(1)} s, return ${mean.toFixed(2)}`;
        if (recorded === undefined) this.say(`${what}. This run has recorded no digest of it; here it is ${digest}.`, "unknown", digest);
        else if (recorded === digest) this.say(`${what}. Its digest ${digest} is what the learner recorded.`, "same", digest);
        else this.say(`${what}. Its digest is ${digest}, but the learner recorded ${recorded}: it trained on another block.`, "another", digest);
    }

    private say(text: string, verdict: "busy" | "same" | "another" | "unknown", digest = ""): void {
        this.told.textContent = text;
        Object.assign(this.told.dataset, { verdict, digest });
    }

    /** The checkpoint whose policy acted in an iteration. */
    private checkpoint({ policy_version }: Metrics): string | undefined {
        const own = (this.feed.checkpoints ?? []).find(({ kind, iteration, name }) => kind === "training" && iteration === policy_version && /^iteration-\d+$/.test(name));
        return own?.name;
    }

    /** Recorded iterations that can be made again. */
    private kept(): Metrics[] {
        const versions = new Set((this.feed.checkpoints ?? []).filter(({ kind }) => kind === "training").map(({ iteration }) => iteration));
        return this.feed.metrics.lines.filter(({ policy_version }) => versions.has(policy_version));
    }
}
