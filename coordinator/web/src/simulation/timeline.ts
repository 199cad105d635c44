// An episode in time: what has been simulated, where in it the page stands, and what its user did.

import type { Simulation } from "./simulation";
import { type Control, type Description, type Event, type Frame, isEffect, type PolicyFiles, type Script, type Start } from "./types";

/** Steps after which an episode pauses, and most that are played again: an hour of the robot's time. */
export const LONGEST = 9000;
/** Control steps that are taken at most before the page looks again. */
const AT_ONCE = 4;

/** Something that lasts while a pointer is down: it is asked anew before each control step. */
export type Lasting = () => Event | undefined;

/** What moves each arm, and what is other than in training. */
export interface Settings {
    arms: Control[];
    mass: number;
    delay: number;
}

export class Timeline {
    description!: Description;
    frames: Frame[] = [];
    events: { step: number; event: Event }[] = [];
    start: Start = {};
    /** Where the page stands, in control steps; between two of them while it plays. */
    cursor = 0;
    playing = false;
    /** Seconds of the robot's time in one of ours. */
    speed = 4;
    /** Milliseconds that a control step took of late. */
    stepMs = 0;
    lasting: Lasting | undefined;
    onFrames: () => void = () => undefined;
    /** What was simulated from this control step on is another one now. */
    onCut: (step: number) => void = () => undefined;
    onError: (error: Error) => void = () => undefined;

    /** Slots whose policies are gone, and the slot of the policy that has their place. */
    private readonly retired = new Map<number, number>();
    private pending = new Map<string, Event>();
    private wanted = 0;
    private busy = false;
    /** Whether the simulator is being told of something. */
    private acting = false;
    /** Counts episodes, so that an answer for an earlier one is dropped. */
    private episode = 0;

    constructor(private readonly simulation: Simulation) {}

    /** The newest control step. */
    get head(): number {
        return this.frames.length - 1;
    }

    get period(): number {
        return this.description.control_period;
    }

    async begin(policies: PolicyFiles[], start: Start): Promise<void> {
        const episode = ++this.episode;
        // Steps of the episode before are none of the one that begins: the simulator would refuse them, and that would stop this one.
        this.busy = true;
        const { description, frame } = await this.simulation.begin(policies, start).catch((error: unknown) => {
            // The episode before goes on, without the answer that it waited for.
            if (episode === this.episode) this.busy = this.acting = false;
            throw error;
        });
        if (episode !== this.episode) return;
        this.description = description;
        this.start = start;
        this.frames = [frame];
        this.events = [];
        this.pending.clear();
        this.retired.clear();
        this.cursor = 0;
        this.wanted = 0;
        this.busy = this.acting = false;
        this.onCut(0);
        this.onFrames();
    }

    /** Loads one more policy for the episode that plays; returns its slot. */
    add(files: PolicyFiles): Promise<number> {
        return this.simulation.policy(files);
    }

    /** Lets go of the policy of a slot. Whoever takes hold of a moment at which it played goes on with that of `successor`. */
    retire(slot: number, successor: number): void {
        this.retired.set(slot, successor);
        void this.simulation.retire(slot, successor).catch((error: Error) => this.onError(error));
    }

    isRetired(slot: number): boolean {
        return this.retired.has(slot);
    }

    /** Plays a script from its beginning to its end; policies must be loaded as it was recorded. */
    async replay(policies: PolicyFiles[], script: Script): Promise<void> {
        const episode = this.episode + 1;
        await this.begin(policies, script.start);
        if (episode !== this.episode) return;
        this.busy = true;
        try {
            for (let step = 0; step <= script.steps; step++) {
                const events = script.events.filter((event) => event.step === step).map(({ event }) => event);
                const { frames } = await this.simulation.advance(step, events, step < script.steps ? 1 : 0);
                if (episode !== this.episode) return;
                this.keep(step, events, frames);
            }
        } finally {
            // Of an episode that has begun meanwhile it is not ours.
            if (episode === this.episode) this.busy = false;
        }
        this.onFrames();
    }

    /** What plays the same again. */
    script(): Script {
        return { start: this.start, steps: this.head, events: this.events };
    }

    /** What a person has set by the control step `step`, and has not been simulated otherwise since. */
    settings(step: number): Settings {
        const found: Settings = { arms: this.description.arms.map(() => ({ policy: 0 })), mass: this.description.base_mass, delay: 0 };
        for (const { step: at, event } of this.events) {
            if (at > step || event === "clear_effects") continue;
            if ("arm" in event) found.arms[event.arm.arm] = event.arm.control;
            else if ("base_mass" in event) found.mass = event.base_mass.mass;
            else if ("delay" in event) found.delay = event.delay.steps;
        }
        return found;
    }

    /** Whether something shall happen that no control step has seen yet. */
    get isPending(): boolean {
        return this.pending.size > 0 || this.acting;
    }

    /** Moves time on by `seconds` of ours. */
    tick(seconds: number): void {
        if (this.frames.length === 0) return;
        if (this.playing) {
            // Who pushes in the past makes another future.
            if (this.lasting?.() !== undefined && this.cursor < this.head - 1) this.cutAt(Math.ceil(this.cursor));
            const target = this.cursor + (seconds * this.speed) / this.period;
            this.cursor = Math.min(target, this.head);
            this.wanted = Math.min(Math.ceil(target + 0.5), LONGEST);
            if (this.head >= LONGEST && this.cursor >= this.head) this.playing = false;
        }
        this.work();
    }

    /** Lets something happen where the page stands; a later one of the same key takes the place of an earlier one. */
    happen(key: string, event: Event): void {
        if (this.cursor < this.head - 1 || (!this.playing && this.cursor < this.head)) this.cutAt(Math.ceil(this.cursor));
        this.pending.set(key, event);
        this.work();
    }

    play(on: boolean): void {
        this.playing = on;
        if (!on) {
            this.wanted = 0;
            this.cursor = Math.min(Math.round(this.cursor), this.head);
        }
        this.onFrames();
    }

    /** One control step forward. */
    step(): void {
        this.play(false);
        const next = Math.floor(this.cursor) + 1;
        if (this.lasting?.() !== undefined && next <= this.head) this.cutAt(next - 1);
        if (next <= this.head) {
            this.cursor = next;
            this.onFrames();
        } else if (next <= LONGEST) {
            this.wanted = next;
            this.work();
        }
    }

    back(): void {
        this.seek(Math.ceil(this.cursor) - 1);
    }

    seek(step: number): void {
        this.play(false);
        this.cursor = Math.max(0, Math.min(step, this.head));
        this.onFrames();
    }

    /** Forgets what was simulated after a control step, so that it is simulated anew. */
    cutAt(step: number): void {
        this.frames.length = step + 1;
        this.events = this.events.filter((it) => it.step < step || (it.step === step && !isEffect(it.event)));
        this.cursor = Math.min(this.cursor, step);
    }

    private work(): void {
        const ahead = Math.min(this.wanted - this.head, AT_ONCE);
        if (this.busy || (ahead <= 0 && this.pending.size === 0)) return;
        const events = [...this.successions(), ...this.pending.values()];
        this.pending.clear();
        let steps = Math.max(ahead, 0);
        const lasting = steps > 0 ? this.lasting?.() : undefined;
        if (lasting !== undefined) {
            events.push(lasting);
            steps = 1;
        }
        const from = this.head;
        const episode = this.episode;
        this.busy = true;
        this.acting = events.length > 0;
        void this.simulation.advance(from, events, steps).then(
            ({ frames, stepMs }) => {
                if (episode !== this.episode) return;
                this.busy = this.acting = false;
                // What was cut off meanwhile is not wanted any more.
                if (from > this.head) return;
                if (stepMs > 0) this.stepMs = this.stepMs === 0 ? stepMs : 0.9 * this.stepMs + 0.1 * stepMs;
                this.keep(from, events, frames);
                if (!this.playing) this.cursor = Math.max(this.cursor, Math.min(this.wanted, this.head));
                this.onFrames();
            },
            (error: Error) => {
                if (episode !== this.episode) return;
                this.busy = this.acting = false;
                this.play(false);
                this.onError(error);
            },
        );
    }

    /** Arms that a policy moved which is gone are given to its successor in so many words, so that the script says who plays. */
    private successions(): Event[] {
        if (this.retired.size === 0) return [];
        return this.settings(this.head).arms.flatMap((control, arm) => {
            if (typeof control === "string" || !this.retired.has(control.policy)) return [];
            let { policy } = control;
            for (let next = this.retired.get(policy); next !== undefined; next = this.retired.get(policy)) policy = next;
            return [{ arm: { arm, control: { policy } } }];
        });
    }

    private keep(from: number, events: Event[], frames: Frame[]): void {
        this.onCut(from);
        this.frames.length = from;
        this.frames.push(...frames);
        for (const event of events) this.record(from, event);
    }

    /**
     * Of several masses, delays or goals for the base before the same step the last one counts; the script needs no other. Goals of hands and who moves an arm
     * it needs all: goal postures remember where a goal was, and a goal that moves a little is followed.
     */
    private record(step: number, event: Event): void {
        const key = keyOf(event);
        if (key !== undefined) this.events = this.events.filter((other) => other.step !== step || keyOf(other.event) !== key);
        this.events.push({ step, event });
    }
}

/** What an event sets, if a later event that sets the same makes it void. */
function keyOf(event: Event): string | undefined {
    if (event === "clear_effects" || "effect" in event || "hand_goal" in event || "arm" in event) return undefined;
    return Object.keys(event)[0];
}
