// Where policies and the simulator come from: the service, or the file that holds everything.

import type { PolicyFiles } from "../simulation/types";
import { bytes, json } from "./service";

/** A policy to choose from. */
export interface PolicyEntry {
    name: string;
    /** Iterations trained on. */
    iteration: number;
    digest: string;
    tags: string[];
}

export interface Source {
    /** Whether there is a service to ask for more. */
    readonly live: boolean;
    policies(): Promise<PolicyEntry[]>;
    load(name: string): Promise<PolicyFiles>;
    module(): Promise<ArrayBuffer>;
    worker(): Promise<Worker>;
}

export interface CheckpointEntry {
    name: string;
    kind: "training" | "policy" | "composed";
    iteration: number;
    env_steps: number;
    digest: string;
    created_unix_s: number;
    bytes: number;
    labels: { pinned: boolean; tags: string[]; score?: { value: number } | null };
}

export function policyOf({ name, iteration, digest, labels }: CheckpointEntry): PolicyEntry {
    return { name, iteration, digest, tags: labels.tags };
}

export class ServiceSource implements Source {
    readonly live = true;

    async policies(): Promise<PolicyEntry[]> {
        const { checkpoints } = await json<{ checkpoints: CheckpointEntry[] }>("v1/checkpoints");
        return checkpoints.map(policyOf);
    }

    async load(name: string): Promise<PolicyFiles> {
        const file = (file: string): Promise<Uint8Array> => bytes(`v1/checkpoints/${encodeURIComponent(name)}/files/${file}`);
        const [config, robot, tensors] = await Promise.all([file("config.toml"), file("robot.toml"), file("policy.safetensors")]);
        return { config, robot, tensors };
    }

    async module(): Promise<ArrayBuffer> {
        return (await fetch("page/simulator.wasm")).arrayBuffer();
    }

    async worker(): Promise<Worker> {
        return new Worker("page/worker.js");
    }
}

/** Everything stands in the page, as text. */
export class EnclosedSource implements Source {
    readonly live = false;

    static isHere(): boolean {
        return document.querySelector("script[data-policy]") !== null;
    }

    /** The episode that the file was made for, as the fragment of an address holds it. */
    static episode(): string | undefined {
        return document.querySelector<HTMLScriptElement>("script[data-play]")?.dataset["play"];
    }

    async policies(): Promise<PolicyEntry[]> {
        const scripts = document.querySelectorAll<HTMLScriptElement>('script[data-policy$="/policy.safetensors"]');
        return [...scripts].map((script) => {
            const name = (script.dataset["policy"] ?? "").split("/")[0] ?? "";
            return { name, iteration: 0, digest: "", tags: [] };
        });
    }

    async load(name: string): Promise<PolicyFiles> {
        const file = (file: string): Uint8Array => decode(`script[data-policy="${name}/${file}"]`);
        return { config: file("config.toml"), robot: file("robot.toml"), tensors: file("policy.safetensors") };
    }

    async module(): Promise<ArrayBuffer> {
        return (await unpack("simulator.wasm")).arrayBuffer();
    }

    async worker(): Promise<Worker> {
        const program = new Blob([await (await unpack("worker.js")).text()], { type: "text/javascript" });
        return new Worker(URL.createObjectURL(program));
    }
}

function decode(selector: string): Uint8Array<ArrayBuffer> {
    const text = document.querySelector(selector)?.textContent;
    if (text === undefined || text === null) throw new Error(`this file has no ${selector}`);
    const found = atob(text);
    const out = new Uint8Array(found.length);
    for (let i = 0; i < found.length; i++) out[i] = found.charCodeAt(i);
    return out;
}

async function unpack(name: string): Promise<Response> {
    const packed = new Blob([decode(`script[data-asset="${name}"]`)]);
    return new Response(packed.stream().pipeThrough(new DecompressionStream("gzip")));
}
