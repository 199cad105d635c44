// What the page knows of a run, kept up to date by the stream of its service.

import { EventStream } from "../page/events";
import type { Refusal } from "../page/service";
import type { CheckpointEntry } from "../page/source";
import type { Evaluation, Happening, LiveStatus, LogLine, Metrics } from "./status";

/** What can change. */
export type Topic = "status" | "happened" | "metrics" | "evaluations" | "logs" | "trains" | "checkpoints" | "heard";

/** Most that is kept to be shown. */
const HAPPENINGS = 6000;
const LOG_LINES = 400;

interface Piece<Line> {
    from: number;
    next: number;
    lines: Line[];
}

/** Lines that were recorded: each iteration once, and again from the beginning if the file is another one. */
export class Lines<Line extends { iteration: number }> {
    lines: Line[] = [];
    next = 0;

    take({ from, next, lines }: Piece<Line>): void {
        // Cut off after a recovery: what comes takes the place of what was.
        if (from === 0) this.lines = [];
        this.next = next;
        for (const line of lines) {
            while ((this.lines.at(-1)?.iteration ?? -1) >= line.iteration) this.lines.pop();
            this.lines.push(line);
        }
    }
}

export class Feed {
    status: LiveStatus | undefined;
    readonly metrics = new Lines<Metrics>();
    readonly evaluations = new Lines<Evaluation>();
    happened: Happening[] = [];
    /** The run's time now (s), and when the page heard that. */
    now = { run: 0, page: 0 };
    logs: LogLine[] = [];
    checkpoints: CheckpointEntry[] | undefined;
    /** Whether the run goes on, which a service says that does not stand beside it, too. */
    trains: boolean | undefined;
    heard = true;
    /** What the service has refused with, if it is not heard because of that. */
    refusal: Refusal | undefined;
    private readonly listeners: { topic: Topic; run(): void }[] = [];
    private readonly stream: EventStream;

    constructor(refused: (refusal: Refusal) => Promise<boolean>) {
        this.stream = new EventStream({
            path: () => `v1/events?metrics=${this.metrics.next}&evaluations=${this.evaluations.next}`,
            event: (name, data) => this.take(name, data),
            heard: (on) => this.hear(on),
            refused: (refusal) => {
                this.hear(false, refusal);
                return refused(refusal);
            },
        });
    }

    start(): void {
        this.stream.start();
    }

    on(topics: Topic[], run: () => void): void {
        for (const topic of topics) this.listeners.push({ topic, run });
    }

    private tell(topic: Topic): void {
        for (const listener of this.listeners) if (listener.topic === topic) listener.run();
    }

    private hear(on: boolean, refusal?: Refusal): void {
        if (on) {
            // The service tells the end of these anew, and of a resumed run they are others.
            this.happened = [];
            this.logs = [];
        } else {
            this.status = undefined;
            this.trains = undefined;
        }
        if (this.heard === on && this.refusal === refusal) return;
        this.heard = on;
        this.refusal = refusal;
        this.tell("heard");
    }

    private take(name: string, data: unknown): void {
        switch (name) {
            case "status":
                this.status = data as LiveStatus;
                break;
            case "happened": {
                const { now_s, list } = data as { now_s: number; list: Happening[] };
                this.now = { run: now_s, page: performance.now() };
                this.happened.push(...list);
                if (this.happened.length > HAPPENINGS) this.happened.splice(0, this.happened.length - HAPPENINGS);
                this.logs.push(...list.filter((it) => it.what === "note").map(({ text }) => ({ who: "run", text: text ?? "" })));
                if (list.some((it) => it.what === "note")) this.tell("logs");
                break;
            }
            case "metrics":
                this.metrics.take(data as Piece<Metrics>);
                break;
            case "evaluations":
                this.evaluations.take(data as Piece<Evaluation>);
                break;
            case "logs":
                this.logs.push(...(data as LogLine[]));
                break;
            case "trains":
                this.trains = data as boolean;
                break;
            case "checkpoints":
                this.checkpoints = (data as { checkpoints: CheckpointEntry[] }).checkpoints;
                break;
            default:
                return;
        }
        if (this.logs.length > LOG_LINES) this.logs.splice(0, this.logs.length - LOG_LINES);
        this.tell(name as Topic);
    }
}
