// The stream of all that happens: server-sent events, read by hand, because the browser's own reader cannot show the token.

import { ask, Refusal } from "./service";

/** How long to wait before the next attempt (ms), and how long at most. */
const WAIT = 500;
const LONGEST = 8000;
/** How long a service that lives says nothing at most (ms): it shows every 10 s that it does. */
const SILENT = 30_000;

export interface Hearing {
    /** Where to go on: asked for anew with each attempt. */
    path(): string;
    /** Something has happened. */
    event(name: string, data: unknown): void;
    /** The service is heard, or is not. */
    heard(on: boolean): void;
    /** The service refuses, and will not change its mind by itself. Whether to ask anew, once somebody has done something about it. */
    refused(refusal: Refusal): Promise<boolean>;
}

/** Listens while the page is looked at, again and again: browsers open few streams to one service at a time. */
export class EventStream {
    private wait = WAIT;
    private running: AbortController | undefined;

    constructor(private readonly hearing: Hearing) {}

    start(): void {
        document.addEventListener("visibilitychange", () => this.attend());
        this.attend();
    }

    private attend(): void {
        if (document.hidden) {
            this.running?.abort();
            this.running = undefined;
        } else if (this.running === undefined) {
            this.running = new AbortController();
            void this.listen(this.running);
        }
    }

    private async listen(control: AbortController): Promise<void> {
        while (!control.signal.aborted) {
            try {
                await this.once(control.signal);
            } catch (error) {
                if (error instanceof Refusal && error.status < 500) {
                    if (await this.hearing.refused(error)) continue;
                    return;
                }
            }
            if (control.signal.aborted) return;
            this.hearing.heard(false);
            await new Promise((done) => setTimeout(done, this.wait));
            this.wait = Math.min(2 * this.wait, LONGEST);
        }
    }

    private async once(signal: AbortSignal): Promise<void> {
        const response = await ask(this.hearing.path(), { signal });
        this.wait = WAIT;
        this.hearing.heard(true);
        const reader = response.body?.pipeThrough(new TextDecoderStream()).getReader();
        if (reader === undefined) return;
        let text = "";
        for (;;) {
            // What is cancelled has come to its end.
            const silent = setTimeout(() => void reader.cancel().catch(() => undefined), SILENT);
            const { done, value } = await reader.read().finally(() => clearTimeout(silent));
            if (done) return;
            text += value;
            for (let end = text.indexOf("\n\n"); end >= 0; end = text.indexOf("\n\n")) {
                this.take(text.slice(0, end));
                text = text.slice(end + 2);
            }
        }
    }

    private take(block: string): void {
        let [name, data] = ["message", ""];
        for (const line of block.split("\n")) {
            if (line.startsWith("event: ")) name = line.slice(7);
            else if (line.startsWith("data: ")) data += line.slice(6);
        }
        // Without data it only shows that it lives.
        if (data !== "") this.hearing.event(name, JSON.parse(data));
    }
}
