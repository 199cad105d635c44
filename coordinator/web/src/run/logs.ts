// The last lines of the logs, and what the owner of the run was told.

import { h } from "../page/dom";
import type { LogLine } from "./status";

export class Logs {
    private readonly list = h("ol", { class: "log", tabIndex: 0, aria: { label: "Log lines" } });
    readonly element = h("section", { class: "card", hidden: true }, h("h2", {}, "Log"), this.list);

    show(lines: LogLine[]): void {
        this.element.hidden = lines.length === 0;
        // Who has scrolled back reads.
        const atEnd = this.list.scrollHeight - this.list.scrollTop - this.list.clientHeight < 30;
        this.list.replaceChildren(...lines.map(({ who, text }) => h("li", {}, h("span", { class: "faint" }, who.replace("-", " ")), text)));
        if (atEnd) this.list.scrollTop = this.list.scrollHeight;
    }
}
