// What page and worker say to each other.

import type { Description, Event, Frame, PolicyFiles, Start } from "./types";

export type Request =
    | { kind: "open"; module: ArrayBuffer }
    /** Begins an episode in a fresh simulator with these policies, in order of slots. */
    | { kind: "begin"; policies: PolicyFiles[]; start: Start }
    /** One more policy, for the episode that plays. */
    | { kind: "policy"; files: PolicyFiles }
    /** Goes to the control step `from`, drops all later ones, lets events happen, and then takes `steps`. */
    | { kind: "advance"; from: number; events: Event[]; steps: number };

export type Answer =
    | { kind: "done" }
    | { kind: "begun"; description: Description; frame: Frame }
    | { kind: "loaded"; slot: number }
    /** The moment before the first step, as events have changed it, and that after each step. */
    | { kind: "frames"; frames: Frame[]; stepMs: number };

export type ToWorker = { id: number; request: Request };
export type FromWorker = { id: number; answer: Answer } | { id: number; error: string };
