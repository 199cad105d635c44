// What page and worker say to each other.

import type { Block, Description, Event, Frame, PolicyFiles, Start } from "./types";

export type Request =
    | { kind: "open"; module: ArrayBuffer }
    /** Begins an episode in a fresh simulator with these policies, in order of slots. */
    | { kind: "begin"; policies: PolicyFiles[]; start: Start }
    /** One more policy, for the episode that plays. */
    | { kind: "policy"; files: PolicyFiles }
    /** Lets go of the policy of a slot; that of `successor` has its place. */
    | { kind: "retire"; slot: number; successor: number }
    /** A block of the run that the policy is of, made again; whatever plays goes on. */
    | { kind: "block"; files: PolicyFiles; iteration: number; shard: number }
    /** Goes to the control step `from`, drops all later ones, lets events happen, and then takes `steps`. */
    | { kind: "advance"; from: number; events: Event[]; steps: number };

export type Answer =
    | { kind: "done" }
    | { kind: "begun"; description: Description; frame: Frame }
    | { kind: "loaded"; slot: number }
    | { kind: "made"; block: Block }
    /** The moment before the first step, as events have changed it, and that after each step. */
    | { kind: "frames"; frames: Frame[]; stepMs: number };

export type ToWorker = { id: number; request: Request };
export type FromWorker = { id: number; answer: Answer } | { id: number; error: string };
