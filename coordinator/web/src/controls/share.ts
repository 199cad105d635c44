// What a person did, as a link or a file that plays the same again.

import { LONGEST } from "../simulation/timeline";
import type { Event, Script } from "../simulation/types";

/** What may happen, but for `clear_effects`, which holds nothing. */
const EVENTS = new Set(["hand_goal", "base_goal", "arm", "effect", "base_mass", "delay", "sensors"]);

/** An episode and the policies of its slots, in order. */
export interface Recording {
    policies: { name: string; digest: string }[];
    script: Script;
}

/** The fragment of a link. */
export async function toFragment(recording: Recording): Promise<string> {
    const bytes = new TextEncoder().encode(JSON.stringify(recording));
    const packed = await through(bytes, new CompressionStream("deflate-raw"));
    const text = btoa(Array.from(packed, (byte) => String.fromCharCode(byte)).join(""));
    return `play=${text.replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "")}`;
}

export async function fromFragment(text: string): Promise<Recording> {
    let unpacked: string;
    try {
        const found = atob(text.replaceAll("-", "+").replaceAll("_", "/"));
        const bytes = Uint8Array.from(found, (c) => c.charCodeAt(0));
        unpacked = new TextDecoder().decode(await through(bytes, new DecompressionStream("deflate-raw")));
    } catch {
        throw new Error("this link is damaged");
    }
    return parse(unpacked);
}

/** Reads a recording, of which everything may be wrong. What an event holds is for the simulator to judge, which knows the robot. */
export function parse(text: string): Recording {
    const value = fields(json(text));
    const script = fields(value["script"] ?? value);
    const [start, steps, events] = [fields(script["start"] ?? {}), count(script["steps"]), list(script["events"] ?? [])];
    if (steps > LONGEST) throw new Error(`the recording has ${steps} control steps; this page plays ${LONGEST} at most, an hour of the robot's time`);
    // Another number than the file's would have been read.
    if (typeof start["seed"] === "number" && !Number.isSafeInteger(start["seed"])) throw new Error('the recording\'s seed is no number that a browser holds; write it as a text, as in "seed": "18446744073709551615"');
    return { policies: list(value["policies"] ?? []).map(tookPart), script: { start, steps, events: events.map(happened) } };
}

function json(text: string): unknown {
    try {
        return JSON.parse(text);
    } catch {
        throw none();
    }
}

function tookPart(value: unknown): Recording["policies"][number] {
    const { name, digest = "" } = fields(value);
    if (typeof name !== "string" || typeof digest !== "string") throw none();
    return { name, digest };
}

function happened(value: unknown): Script["events"][number] {
    const { step, event } = fields(value);
    if (event === "clear_effects") return { step: count(step), event };
    const [kind, ...more] = Object.keys(fields(event));
    if (kind === undefined || !EVENTS.has(kind) || more.length > 0) throw none();
    fields(fields(event)[kind]);
    return { step: count(step), event: event as Event };
}

function fields(value: unknown): Record<string, unknown> {
    if (typeof value !== "object" || value === null || Array.isArray(value)) throw none();
    return value as Record<string, unknown>;
}

function list(value: unknown): unknown[] {
    if (!Array.isArray(value)) throw none();
    return value;
}

function count(value: unknown): number {
    if (!Number.isSafeInteger(value) || (value as number) < 0) throw none();
    return value as number;
}

function none(): Error {
    return new Error("this is no recording of an episode");
}

/** Lets the browser save a file. */
export function save(name: string, text: string): void {
    const url = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    const link = document.createElement("a");
    link.href = url;
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(url), 1000);
}

async function through(bytes: Uint8Array<ArrayBuffer>, stream: CompressionStream | DecompressionStream): Promise<Uint8Array> {
    const out = new Blob([bytes]).stream().pipeThrough(stream as ReadableWritablePair<Uint8Array<ArrayBuffer>, Uint8Array<ArrayBuffer>>);
    return new Uint8Array(await new Response(out).arrayBuffer());
}
