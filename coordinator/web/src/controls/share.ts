// What a person did, as a link or a file that plays the same again.

import type { Script } from "../simulation/types";

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
    const found = atob(text.replaceAll("-", "+").replaceAll("_", "/"));
    const bytes = Uint8Array.from(found, (c) => c.charCodeAt(0));
    return parse(new TextDecoder().decode(await through(bytes, new DecompressionStream("deflate-raw"))));
}

export function parse(text: string): Recording {
    const value = JSON.parse(text) as Partial<Recording> & Partial<Script>;
    const script = value.script ?? value;
    if (!Array.isArray(script.events) || typeof script.steps !== "number") throw new Error("this is no recording of an episode");
    return { policies: value.policies ?? [], script: { start: script.start ?? {}, steps: script.steps, events: script.events } };
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
