// What moves each arm, and how far its hand is from its goal.

import { h, put } from "../page/dom";
import type { PolicyEntry } from "../page/source";
import { ofArm } from "../scene/colours";
import type { Goal } from "../scene/goals";
import type { Description, Frame } from "../simulation/types";

export interface ArmActions {
    /** A policy by name, or what needs none. */
    control(arm: number, choice: { policy: string } | "hold" | "limp"): void;
    select(goal: Goal): void;
}

export class Arms {
    readonly element = h("div", { class: "arms" });
    private rows: { row: HTMLElement; position: HTMLElement; orientation: HTMLElement; choice: HTMLSelectElement }[] = [];
    private base: { row: HTMLElement; error: HTMLElement } | undefined;

    constructor(private readonly actions: ArmActions) {}

    begin(description: Description, policies: PolicyEntry[], current: string): void {
        this.rows = description.arms.map((name, arm) => {
            const position = h("td", { class: "number" });
            const orientation = h("td", { class: "number" });
            const choice = h("select", { aria: { label: `What moves arm ${name}` } });
            choice.append(...options(policies, current));
            choice.onchange = () => {
                const value = choice.value;
                this.actions.control(arm, value === "hold" || value === "limp" ? value : { policy: value.slice(1) });
            };
            const dot = h("span", { class: "dot" });
            dot.style.background = ofArm(arm);
            const button = h("button", { type: "button", class: "row-name", title: `Select its goal (${arm + 1})`, onclick: () => this.actions.select(arm) }, dot, plain(name));
            const row = h("tr", {}, h("td", {}, button), position, orientation, h("td", { class: "choice" }, choice));
            return { row, position, orientation, choice };
        });
        const head = h("tr", {}, h("th", {}, "arm"), h("th", { class: "number" }, "mm"), h("th", { class: "number" }, "mrad"), h("th", {}, "moved by"));
        const error = h("td", { class: "number" });
        const dot = h("span", { class: "dot" });
        dot.style.background = "#8b95a5";
        const button = h("button", { type: "button", class: "row-name", title: "Select its goal (B)", onclick: () => this.actions.select("base") }, dot, "base");
        this.base = { row: h("tr", {}, h("td", {}, button), h("td", {}), error, h("td", {})), error };
        this.element.replaceChildren(h("table", {}, h("thead", {}, head), h("tbody", {}, ...this.rows.map(({ row }) => row), this.base.row)));
    }

    /** The policies to choose from have changed. */
    offer(policies: PolicyEntry[]): void {
        for (const { choice } of this.rows) {
            const chosen = choice.value;
            choice.replaceChildren(...options(policies, chosen.startsWith(":") ? chosen.slice(1) : ""));
            choice.value = chosen;
        }
    }

    set(arm: number, choice: { policy: string } | "hold" | "limp"): void {
        const row = this.rows[arm];
        if (row !== undefined) row.choice.value = typeof choice === "string" ? choice : `:${choice.policy}`;
    }

    chosen(arm: number): string {
        return this.rows[arm]?.choice.value ?? "";
    }

    show(frame: Frame, selected: Goal | undefined): void {
        this.rows.forEach(({ row, position, orientation }, arm) => {
            put(position, rounded(1000 * (frame.position_error[arm] ?? 0)));
            put(orientation, rounded(1000 * (frame.orientation_error[arm] ?? 0)));
            row.classList.toggle("selected", selected === arm);
        });
        if (this.base !== undefined) {
            put(this.base.error, rounded(1000 * (frame.base_error[0] ?? 0)));
            this.base.row.classList.toggle("selected", selected === "base");
        }
    }
}

function options(policies: PolicyEntry[], current: string): Node[] {
    const names = policies.map(({ name }) => name);
    if (current !== "" && !names.includes(current)) names.push(current);
    const policy = (name: string): HTMLOptionElement => h("option", { value: `:${name}`, selected: name === current }, plain(name));
    return [...names.map(policy), h("option", { value: "hold" }, "hold still"), h("option", { value: "limp" }, "limp")];
}

/** A name as people read it: `iteration-00000120` is iteration 120. */
export function plain(name: string): string {
    return name.replace(/^iteration-0*(\d+)$/, "iteration $1").replaceAll("_", " ");
}

function rounded(value: number): string {
    return value < 10 ? value.toFixed(1) : value.toFixed(0);
}
