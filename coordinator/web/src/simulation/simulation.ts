// The page's side of the worker.

import type { Answer, FromWorker, Request, ToWorker } from "./messages";
import type { Block, Description, Event, Frame, PolicyFiles, Start } from "./types";

interface Waiting {
    resolve(answer: Answer): void;
    reject(error: Error): void;
}

/** The simulator in its thread. */
export class Simulation {
    private readonly waiting = new Map<number, Waiting>();
    private next = 0;

    private constructor(private readonly worker: Worker) {
        worker.addEventListener("message", ({ data }: MessageEvent<FromWorker>) => {
            const waiting = this.waiting.get(data.id);
            this.waiting.delete(data.id);
            if ("error" in data) waiting?.reject(new Error(data.error));
            else waiting?.resolve(data.answer);
        });
        worker.addEventListener("error", (event) => {
            for (const { reject } of this.waiting.values()) reject(new Error(event.message || "the simulator's thread failed"));
            this.waiting.clear();
        });
    }

    static async start(worker: Worker, module: ArrayBuffer): Promise<Simulation> {
        const simulation = new Simulation(worker);
        await simulation.ask({ kind: "open", module });
        return simulation;
    }

    async begin(policies: PolicyFiles[], start: Start): Promise<{ description: Description; frame: Frame }> {
        return this.expect("begun", await this.ask({ kind: "begin", policies, start }));
    }

    /** Loads one more policy; returns its slot. */
    async policy(files: PolicyFiles): Promise<number> {
        return this.expect("loaded", await this.ask({ kind: "policy", files })).slot;
    }

    /** Lets go of the policy of a slot; that of `successor` has its place. */
    async retire(slot: number, successor: number): Promise<void> {
        this.expect("done", await this.ask({ kind: "retire", slot, successor }));
    }

    async advance(from: number, events: Event[], steps: number): Promise<{ frames: Frame[]; stepMs: number }> {
        return this.expect("frames", await this.ask({ kind: "advance", from, events, steps }));
    }

    /** Makes a block again, of the run that the policy is of. */
    async block(files: PolicyFiles, iteration: number, shard: number): Promise<Block> {
        return this.expect("made", await this.ask({ kind: "block", files, iteration, shard })).block;
    }

    /** Ends the thread; what was asked and not answered stays so. */
    end(): void {
        this.worker.terminate();
    }

    private expect<K extends Answer["kind"]>(kind: K, answer: Answer): Extract<Answer, { kind: K }> {
        if (answer.kind !== kind) throw new Error(`the simulator answered ${answer.kind}, expected ${kind}`);
        return answer as Extract<Answer, { kind: K }>;
    }

    private ask(request: Request): Promise<Answer> {
        const id = this.next++;
        return new Promise((resolve, reject) => {
            this.waiting.set(id, { resolve, reject });
            this.worker.postMessage({ id, request } satisfies ToWorker);
        });
    }
}
