// What a run records, followed while it grows: whole lines, each once, and again from the beginning after a recovery.

import { ask } from "../page/service";

export class Follower<Line extends { iteration: number }> {
    lines: Line[] = [];
    private next = 0;

    constructor(private readonly path: string) {}

    /** Fetches what is new; says whether anything is. */
    async look(): Promise<boolean> {
        let changed = false;
        for (;;) {
            const response = await ask(`${this.path}?from=${this.next}`);
            const next = Number(response.headers.get("octopus-next") ?? 0);
            const text = await response.text();
            if (next < this.next) this.lines = [];
            this.next = next;
            if (text === "") return changed;
            for (const line of text.trimEnd().split("\n")) this.take(JSON.parse(line) as Line);
            changed = true;
        }
    }

    /** An iteration that is trained a second time takes the place of the first. */
    private take(line: Line): void {
        while ((this.lines.at(-1)?.iteration ?? -1) >= line.iteration) this.lines.pop();
        this.lines.push(line);
    }
}
