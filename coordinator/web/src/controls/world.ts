// What is other than in training: mass of the base, delay of commands.

import { h } from "../page/dom";
import type { Settings } from "../simulation/timeline";
import type { Description } from "../simulation/types";

export interface Slider {
    element: HTMLElement;
    set(value: number): void;
}

/** A slider with its name and its value in words. */
export function slider(
    name: string,
    [min, max, step]: [number, number, number],
    value: number,
    words: (value: number) => string,
    changed: (value: number) => void,
): Slider {
    const output = h("output", {}, words(value));
    const input = h("input", { type: "range", min: String(min), max: String(max), step: String(step), value: String(value) });
    input.oninput = () => (output.textContent = words(Number(input.value)));
    input.onchange = () => changed(Number(input.value));
    const element = h("label", { class: "slider" }, h("span", {}, name), output, input);
    return {
        element,
        set(value) {
            // Who holds it has not said it yet.
            if (input.matches(":active")) return;
            input.value = String(value);
            output.textContent = words(value);
        },
    };
}

export class World {
    readonly element = h("div", { class: "world" });
    private mass: Slider | undefined;
    private delay: Slider | undefined;

    constructor(private readonly change: { mass(kilograms: number): void; delay(steps: number): void }) {}

    begin({ base_mass, control_period }: Description): void {
        // Its own mass is a place of the slider, whatever it is: 35 steps up from the least.
        const step = base_mass / 40;
        const kilograms = (mass: number): string => `${mass.toFixed(step < 1 ? 1 : 0)} kg`;
        const milliseconds = (steps: number): string => (steps === 0 ? "none" : `${(1000 * steps * control_period).toFixed(0)} ms`);
        // What the browser has rounded on the way there would be another robot.
        const exact = (mass: number): number => (Math.abs(mass - base_mass) < step / 2 ? base_mass : mass);
        this.mass = slider("Mass of the base", [base_mass / 8, 2.5 * base_mass, step], base_mass, kilograms, (mass) => this.change.mass(exact(mass)));
        this.delay = slider("Delay of commands", [0, 5, 1], 0, milliseconds, (steps) => this.change.delay(steps));
        this.element.replaceChildren(this.mass.element, this.delay.element);
    }

    show({ mass, delay }: Settings): void {
        this.mass?.set(mass);
        this.delay?.set(delay);
    }
}
