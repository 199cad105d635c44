// The worker thread of the page: owns the simulator and does what it is asked, one after the other.

import type { Answer, FromWorker, Request, ToWorker } from "./messages";
import { Simulator } from "./module";
import { isEffect } from "./types";

let module: WebAssembly.Module | undefined;
let simulator: Simulator | undefined;
/** The control step at which the simulator stands. Its snapshots have the same numbers. */
let now = 0;
let queue: Promise<void> = Promise.resolve();

function opened(): Simulator {
    if (simulator === undefined) throw new Error("no episode has begun");
    return simulator;
}

async function handle(request: Request): Promise<Answer> {
    switch (request.kind) {
        case "open":
            module = await WebAssembly.compile(request.module);
            return { kind: "done" };
        case "begin": {
            if (module === undefined) throw new Error("the simulator is not loaded");
            const it = await Simulator.start(module);
            for (const files of request.policies) it.policy(files);
            it.reset(request.start);
            it.snapshot();
            simulator = it;
            now = 0;
            return { kind: "begun", description: it.describe(), frame: it.frame() };
        }
        case "policy":
            return { kind: "loaded", slot: opened().policy(request.files) };
        case "retire":
            opened().retire(request.slot, request.successor);
            return { kind: "done" };
        case "block": {
            if (module === undefined) throw new Error("the simulator is not loaded");
            const it = await Simulator.start(module);
            it.policy(request.files);
            return { kind: "made", block: it.block(request.iteration, request.shard) };
        }
        case "advance": {
            const it = opened();
            if (request.from !== now) {
                it.restore(request.from);
                now = request.from;
                it.forget(now + 1);
            }
            const settings = request.events.filter((event) => !isEffect(event));
            if (settings.length > 0) {
                for (const event of settings) it.event(event);
                // The moment as it has been set takes the place of the one before.
                it.forget(now);
                it.snapshot();
            }
            // Whoever comes back to this moment begins another future, without what was pushed in this one.
            for (const event of request.events.filter(isEffect)) it.event(event);
            const frames = [it.frame()];
            const begin = performance.now();
            for (let i = 0; i < request.steps; i++) {
                it.step();
                it.snapshot();
                now += 1;
                frames.push(it.frame());
            }
            const stepMs = request.steps === 0 ? 0 : (performance.now() - begin) / request.steps;
            return { kind: "frames", frames, stepMs };
        }
    }
}

self.addEventListener("message", ({ data: { id, request } }: MessageEvent<ToWorker>) => {
    queue = queue.then(async () => {
        let said: FromWorker;
        try {
            said = { id, answer: await handle(request) };
        } catch (error) {
            said = { id, error: error instanceof Error ? error.message : String(error) };
        }
        self.postMessage(said);
    });
});
