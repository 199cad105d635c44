// Play, pause, step, speed, back in time.

import { h, ICONS, iconButton } from "../page/dom";
import type { Timeline } from "../simulation/timeline";

const SPEEDS = [0.5, 1, 2, 4, 8, 16];

export class Transport {
    readonly element: HTMLElement;
    private readonly play: HTMLButtonElement;
    private readonly slider: HTMLInputElement;
    private readonly time: HTMLOutputElement;
    private readonly speed: HTMLSelectElement;
    private shown = "";

    constructor(
        private readonly timeline: Timeline,
        again: () => void,
    ) {
        this.play = h("button", { class: "play", type: "button", onclick: () => this.toggle() });
        this.slider = h("input", {
            type: "range",
            class: "time",
            min: "0",
            step: "1",
            oninput: () => timeline.seek(Number(this.slider.value)),
            aria: { label: "Control step" },
        });
        this.time = h("output", { class: "clock" });
        this.speed = h(
            "select",
            {
                title: "Seconds of the robot in one of yours (+ and −)",
                onchange: () => (timeline.speed = Number(this.speed.value)),
                aria: { label: "Speed" },
            },
            ...SPEEDS.map((speed) => h("option", { value: String(speed), selected: speed === timeline.speed }, `${speed}×`)),
        );
        this.element = h(
            "div",
            { class: "transport", role: "toolbar", aria: { label: "Time" } },
            iconButton(ICONS.first, "Start again (Home)", again),
            iconButton(ICONS.back, "A control step back (←)", () => timeline.back()),
            this.play,
            iconButton(ICONS.next, "A control step on (→)", () => timeline.step()),
            this.slider,
            this.time,
            this.speed,
        );
    }

    toggle(): void {
        this.timeline.play(!this.timeline.playing);
    }

    faster(by: number): void {
        const at = SPEEDS.indexOf(this.timeline.speed) + by;
        const speed = SPEEDS[Math.max(0, Math.min(at, SPEEDS.length - 1))] ?? 1;
        this.timeline.speed = speed;
        this.speed.value = String(speed);
    }

    tick(): void {
        const { timeline } = this;
        const state = timeline.playing ? "pause" : "play";
        if (this.play.dataset["state"] !== state) {
            this.play.dataset["state"] = state;
            this.play.replaceChildren(iconButton(ICONS[state], "", () => undefined).firstChild as Node);
            this.play.title = timeline.playing ? "Pause (space)" : "Play (space)";
            this.play.setAttribute("aria-label", timeline.playing ? "Pause" : "Play");
        }
        const step = Math.floor(timeline.cursor + 1e-6);
        const text = `${step} ${timeline.head}`;
        if (text === this.shown) return;
        this.shown = text;
        // The slider grows with what was simulated, but is not full from the first step on.
        this.slider.max = String(Math.max(timeline.head, 50));
        this.slider.value = String(step);
        this.time.textContent = `${(step * timeline.period).toFixed(1)} s`;
        this.time.title = `control step ${step} of ${timeline.head}`;
        this.time.dataset["step"] = String(step);
    }
}
