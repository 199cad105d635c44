// The simulator's module: exports of WebAssembly as functions with types, failures as errors.

import { ARRAYS, type Block, type Description, type Event, type Frame, type PolicyFiles, type Start } from "./types";

interface Exports {
    memory: WebAssembly.Memory;
    version(): number;
    input(len: number): number;
    policy(slot: number, configLen: number, robotLen: number): number;
    retire(slot: number, successor: number): number;
    reset(): number;
    event(): number;
    step(): number;
    describe(): number;
    text(): number;
    text_len(): number;
    block(): number;
    snapshot(): number;
    restore(n: number): number;
    forget(n: number): void;
}

const VERSION = 3;

/** One simulation of one environment. */
export class Simulator {
    private readonly x: Exports;
    private description: Description | undefined;

    private constructor(x: Exports) {
        this.x = x;
    }

    static async start(module: WebAssembly.Module): Promise<Simulator> {
        const instance = await WebAssembly.instantiate(module, {});
        const x = instance.exports as unknown as Exports;
        if (x.version() !== VERSION) throw new Error(`the simulator is of version ${x.version()}, expected ${VERSION}`);
        return new Simulator(x);
    }

    /** Loads one more policy. Returns its slot. */
    policy({ config, robot, tensors }: PolicyFiles): number {
        this.put(config, robot, tensors);
        const slot = this.x.policy(-1, config.length, robot.length);
        if (slot < 0) throw this.failure();
        if (slot === 0) {
            this.check(this.x.describe());
            this.description = JSON.parse(this.text()) as Description;
        }
        return slot;
    }

    /** Lets go of the policy of a slot, also in moments that are kept; that of `successor` has its place. */
    retire(slot: number, successor: number): void {
        this.check(this.x.retire(slot, successor));
    }

    /** The robot, once there is a policy. */
    describe(): Description {
        if (this.description === undefined) throw new Error("no policy is loaded");
        return this.description;
    }

    reset(start: Start): void {
        this.json(start);
        this.check(this.x.reset());
    }

    event(event: Event): void {
        this.json(event);
        this.check(this.x.event());
    }

    step(): void {
        this.check(this.x.step());
    }

    /** Makes a block again, of the run that the first policy is of. */
    block(iteration: number, shard: number): Block {
        this.json({ iteration, shard });
        this.check(this.x.block());
        return JSON.parse(this.text()) as Block;
    }

    snapshot(): number {
        const n = this.x.snapshot();
        if (n < 0) throw this.failure();
        return n;
    }

    restore(n: number): void {
        this.check(this.x.restore(n));
    }

    forget(n: number): void {
        this.x.forget(n);
    }

    /** Copies all numbers of this moment. */
    frame(): Frame {
        const { arrays } = this.describe();
        const rows = new Float32Array(this.x.memory.buffer, arrays.counters.at, 1)[0] ?? 0;
        const entries = ARRAYS.map((name) => {
            const { at, len } = arrays[name];
            const used = name === "contacts" ? Math.min(8 * rows, len) : len;
            return [name, new Float32Array(this.x.memory.buffer, at, used).slice()];
        });
        return Object.fromEntries(entries) as Frame;
    }

    /** Writes what the next call takes. */
    private put(...parts: Uint8Array[]): void {
        const len = parts.reduce((sum, part) => sum + part.length, 0);
        // First, because memory may grow and then is another one.
        const at = this.x.input(len);
        const room = new Uint8Array(this.x.memory.buffer, at, len);
        let end = 0;
        for (const part of parts) {
            room.set(part, end);
            end += part.length;
        }
    }

    private json(value: unknown): void {
        this.put(new TextEncoder().encode(JSON.stringify(value)));
    }

    private check(status: number): void {
        if (status < 0) throw this.failure();
    }

    private failure(): Error {
        return new Error(this.text());
    }

    private text(): string {
        return new TextDecoder().decode(new Uint8Array(this.x.memory.buffer, this.x.text(), this.x.text_len()));
    }
}
