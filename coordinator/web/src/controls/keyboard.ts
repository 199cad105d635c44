// Keys, and the list of them.

import { h } from "../page/dom";

export interface Key {
    /** As `KeyboardEvent.key` has it. */
    keys: string[];
    /** As it is written in the list. */
    shown: string;
    what: string;
    run(key: string): void;
}

/** Keys act while `active` holds. */
export function listen(keys: Key[], active: () => boolean): { help(): void } {
    const rows = keys.map(({ shown, what }) => h("tr", {}, h("td", {}, h("kbd", {}, shown)), h("td", {}, what)));
    const dialog = h(
        "dialog",
        { class: "help", aria: { label: "Keys" } },
        h("h2", {}, "Keys and pointer"),
        h("table", {}, ...rows),
        h("p", {}, "Drag the background to turn the view, a body to push it (the arrow is the force), a goal's handles to move and turn it. The wheel or two fingers zoom."),
        h("form", { method: "dialog" }, h("button", { type: "submit" }, "Close")),
    );
    document.body.append(dialog);
    const help = (): void => (dialog.open ? dialog.close() : dialog.showModal());
    window.addEventListener("keydown", (event) => {
        if (!active()) return;
        if (event.ctrlKey || event.metaKey || event.altKey || dialog.open) return;
        const at = event.target as HTMLElement | null;
        // What has the focus keeps the keys that it knows.
        if (at?.closest("input:not([type=range]):not([type=checkbox]), textarea, select") !== null) return;
        if (event.key === " " && at?.closest("button, input[type=checkbox], summary") !== null) return;
        if (event.key.startsWith("Arrow") && at?.closest("input") !== null) return;
        if ((event.key === "Home" || event.key === "End") && at?.closest("input[type=range]") !== null) return;
        if (event.key === "?") {
            help();
            return;
        }
        const key = keys.find((key) => key.keys.includes(event.key));
        if (key === undefined) return;
        event.preventDefault();
        key.run(event.key);
    });
    return { help };
}
