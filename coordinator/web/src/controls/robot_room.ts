// The room in which the robot moves: scene, time, controls and curves together.

import { Curves } from "../curves/curves";
import { h, ICONS, iconButton, notice } from "../page/dom";
import type { PolicyEntry, Source } from "../page/source";
import { onTheme, sceneLook } from "../page/theme";
import type { Goal } from "../scene/goals";
import { View } from "../scene/view";
import type { Simulation } from "../simulation/simulation";
import { Timeline } from "../simulation/timeline";
import type { Frame, PolicyFiles, Start } from "../simulation/types";
import { Arms, plain } from "./arms";
import { type Key, listen } from "./keyboard";
import { fromFragment, parse, type Recording, save, toFragment } from "./share";
import { Transport } from "./transport";
import { World } from "./world";

/** Which policy plays while new ones come. */
type Followed = "none" | "newest" | "best";

export class RobotRoom {
    readonly element = h("main", { class: "robot-room" });
    readonly timeline: Timeline;
    readonly view: View;
    policies: PolicyEntry[] = [];
    /** Name of the policy of slot 0, and of all slots of the episode. */
    current = "";
    private slots: string[] = [];
    private readonly loaded = new Map<string, PolicyFiles>();
    private readonly transport: Transport;
    private readonly arms: Arms;
    private readonly world: World;
    private readonly curves: Curves;
    private readonly title = h("select", { class: "policy", aria: { label: "Policy" } });
    private catchingUp = false;
    /** Episodes that are about to begin. */
    private opening = 0;
    private readonly followed = h("select", { aria: { label: "When new policies come" } });
    private readonly camera = h("select", { aria: { label: "The camera follows" } });
    private readonly episode = h("input", { type: "number", min: "0", max: "99999", value: "0", aria: { label: "Episode" } });
    private readonly force = h("div", { class: "force", hidden: true });
    private readonly status = h("div", { class: "scene-status" });
    private readonly modes: Record<"translate" | "rotate", HTMLButtonElement>;
    private shownFrame: Frame | undefined;
    private last = performance.now();
    private frames = { count: 0, since: performance.now(), rate: 0 };

    constructor(
        private readonly source: Source,
        simulation: Simulation,
    ) {
        this.timeline = new Timeline(simulation);
        const scene = h("div", { class: "scene" });
        this.transport = new Transport(this.timeline, () => void this.again());
        this.arms = new Arms({
            control: (arm, choice) => void this.control(arm, choice),
            select: (goal) => this.view.goals.select(this.view.goals.selected === goal ? undefined : goal),
        });
        this.world = new World({
            mass: (mass) => this.timeline.happen("mass", { base_mass: { mass } }),
            delay: (steps) => this.timeline.happen("delay", { delay: { steps } }),
        });
        this.curves = new Curves(this.timeline);
        this.modes = {
            translate: h("button", { type: "button", onclick: () => this.view.goals.setMode("translate"), title: "Move the goal (G)" }, "move"),
            rotate: h("button", { type: "button", onclick: () => this.view.goals.setMode("rotate"), title: "Turn the goal (R)" }, "turn"),
        };
        const handles = h("div", { class: "handles segmented", hidden: true, role: "group", aria: { label: "Handles" } }, this.modes.translate, this.modes.rotate);
        const stage = h("section", { class: "stage", aria: { label: "Scene" } }, scene, this.force, this.status, handles, this.transport.element);
        this.element.append(h("div", { class: "left" }, stage, this.curves.element), this.panel());

        this.view = new View(scene, this.timeline);
        this.view.push.onForce = (newtons) => {
            this.force.hidden = newtons === undefined;
            if (newtons !== undefined) this.force.textContent = `${newtons.toFixed(0)} N`;
        };
        this.view.goals.onChange = (goal, event) => this.timeline.happen(`goal ${goal}`, event);
        this.view.goals.onSelect = () => {
            const { selected, mode } = this.view.goals;
            handles.hidden = selected === undefined;
            this.modes.translate.disabled = selected === "base";
            for (const [name, button] of Object.entries(this.modes)) button.setAttribute("aria-pressed", String(name === mode));
            if (typeof selected === "number" && selected !== this.curves.arm && this.timeline.frames.length > 0) {
                this.curves.arm = selected;
                this.curves.begin();
            }
            this.shownFrame = undefined;
        };
        this.timeline.lasting = () => this.view.push.event();
        this.timeline.onFrames = () => this.curves.update();
        this.timeline.onCut = (step) => this.curves.invalidate(step);
        this.timeline.onError = (error) => notice(error.message, "error");
        const look = (): void => {
            this.view.stage.look(sceneLook());
            if (this.timeline.frames.length > 0) this.curves.begin();
        };
        this.view.stage.look(sceneLook());
        onTheme(look);
    }

    /** Loads what there is and begins; `wanted` is a policy's name. */
    async start(wanted: string | undefined, recording: string | undefined): Promise<void> {
        await this.refresh();
        if (!(await this.shows(wanted, recording))) {
            const name = this.best();
            if (name === undefined) this.status.textContent = "There is no checkpoint yet. This page waits for the first one.";
            else await this.play(name);
        }
        requestAnimationFrame(() => this.tick());
    }

    /** Plays what the address asks for. False if that is nothing, or cannot be played, which is said. */
    async shows(wanted: string | undefined, recording: string | undefined): Promise<boolean> {
        try {
            if (recording !== undefined) return await this.replay(await fromFragment(recording));
            return wanted !== undefined && (await this.play(wanted));
        } catch (error) {
            notice(error instanceof Error ? error.message : String(error), "error");
            return false;
        }
    }

    /** Begins an episode with one policy. */
    async begin(name: string, start: Start = this.startOf()): Promise<boolean> {
        return this.open([name], start, (files) => this.timeline.begin(files, start));
    }

    /** Plays a policy from the beginning. */
    async play(name: string): Promise<boolean> {
        const begun = await this.begin(name);
        if (begun) this.timeline.play(true);
        return begun;
    }

    /** Plays a recording from its beginning; false if that cannot be, which is said. */
    async replay(recording: Recording): Promise<boolean> {
        const names = recording.policies.length > 0 ? recording.policies.map(({ name }) => name) : [this.current || (this.best() ?? "")];
        const [before] = this.timeline.frames;
        if (!(await this.open(names, recording.script.start, (files) => this.timeline.replay(files, recording.script)))) {
            // What broke off may be of another robot than what is drawn.
            if (this.timeline.frames[0] !== before && this.current !== "") await this.begin(this.current);
            return false;
        }
        for (const { policies } of [recording]) {
            for (const { name, digest } of policies) {
                const here = this.policies.find((policy) => policy.name === name);
                if (digest !== "" && here !== undefined && here.digest !== "" && here.digest !== digest) {
                    notice(`${plain(name)} is another policy than the one that was recorded`, "error");
                }
            }
        }
        this.timeline.seek(0);
        this.timeline.play(true);
        return true;
    }

    recording(): Recording {
        const policies = this.slots.map((name) => ({ name, digest: this.policies.find((policy) => policy.name === name)?.digest ?? "" }));
        return { policies, script: this.timeline.script() };
    }

    private async open(names: string[], start: Start, run: (files: PolicyFiles[]) => Promise<void>): Promise<boolean> {
        this.status.textContent = "";
        this.opening += 1;
        try {
            const files = await Promise.all(names.map((name) => this.files(name)));
            const playing = this.timeline.playing;
            await run(files);
            this.timeline.playing = playing;
            this.current = names[0] ?? "";
            this.slots = [...names];
            this.episode.value = String(start.episode ?? 0);
            const { description } = this.timeline;
            this.view.begin();
            this.offerCameras();
            this.arms.begin(description, this.policies, this.current);
            this.world.begin(description);
            this.curves.arm = Math.min(this.curves.arm, description.n_arms - 1);
            this.curves.begin();
            this.offer();
            return true;
        } catch (error) {
            notice(error instanceof Error ? error.message : String(error), "error");
            return false;
        } finally {
            this.opening -= 1;
        }
    }

    private async again(): Promise<void> {
        await this.begin(this.current);
    }

    private startOf(): Start {
        return { seed: 0, purpose: "evaluation", episode: Math.max(0, Number(this.episode.value) || 0) };
    }

    /** Gives an arm to a policy, which is loaded if it is not yet. */
    private async control(arm: number, choice: { policy: string } | "hold" | "limp"): Promise<void> {
        try {
            const control = typeof choice === "string" ? choice : { policy: await this.slot(choice.policy) };
            this.timeline.happen(`arm ${arm}`, { arm: { arm, control } });
            this.arms.set(arm, choice);
        } catch (error) {
            notice(error instanceof Error ? error.message : String(error), "error");
        }
    }

    /**
     * Gives every arm that is moved by a policy to another one, while it plays; where nothing has begun, begins with it. False if it cannot be loaded, which
     * is said.
     */
    private async change(name: string): Promise<boolean> {
        if (this.current === "") return this.play(name);
        try {
            await this.slot(name);
        } catch (error) {
            notice(error instanceof Error ? error.message : String(error), "error");
            return false;
        }
        for (let arm = 0; arm < this.timeline.description.n_arms; arm++) {
            if (this.arms.chosen(arm).startsWith(":")) await this.control(arm, { policy: name });
        }
        this.current = name;
        return true;
    }

    private async slot(name: string): Promise<number> {
        const there = this.seat(name);
        if (there >= 0) return there;
        const slot = await this.timeline.add(await this.files(name));
        this.slots[slot] = name;
        return slot;
    }

    /** The slot of a policy that is there, or −1. */
    private seat(name: string): number {
        return this.slots.findIndex((other, slot) => other === name && !this.timeline.isRetired(slot));
    }

    /**
     * Lets go of policies that play nowhere and that nobody can choose any more: a page that stays open beside a training would keep all that it has
     * followed, about 5 MB each.
     */
    private retire(): void {
        // What is on its way may be about a policy that does not play yet. The next list comes.
        if (this.opening > 0 || this.timeline.isPending) return;
        const { head, cursor } = this.timeline;
        const moments = [head, Math.floor(cursor + 1e-6)].flatMap((step) => this.timeline.settings(step).arms);
        const playing = moments.flatMap((control) => (typeof control === "string" ? [] : [this.slots[control.policy]]));
        const kept = new Set([this.current, ...playing, ...this.policies.map(({ name }) => name)]);
        const successor = this.seat(this.current);
        if (successor < 0) return;
        this.slots.forEach((name, slot) => {
            if (!kept.has(name) && !this.timeline.isRetired(slot)) this.timeline.retire(slot, successor);
        });
        for (const name of this.loaded.keys()) if (!kept.has(name)) this.loaded.delete(name);
    }

    private async files(name: string): Promise<PolicyFiles> {
        const there = this.loaded.get(name);
        if (there !== undefined) return there;
        const files = await this.source.load(name);
        this.loaded.set(name, files);
        return files;
    }

    /** What is shown without a wish: the best one, or else the newest; of a file the one that it was made of. */
    private best(): string | undefined {
        const best = this.policies.find(({ tags }) => tags.includes("best"));
        return (best ?? this.policies.at(this.source.live ? -1 : 0))?.name;
    }

    private async refresh(): Promise<void> {
        this.policies = await this.source.policies();
        this.offer();
    }

    /** The service has other policies than before. */
    async offered(policies: PolicyEntry[]): Promise<void> {
        this.policies = policies;
        this.offer();
        const best = this.best();
        if (this.current === "") {
            if (best !== undefined) await this.play(best);
            return;
        }
        this.retire();
        await this.catchUp();
    }

    /** Goes over to the newest or best policy, if that is wanted. Of two that come at once the later one is played in the end. */
    private async catchUp(): Promise<void> {
        if (this.catchingUp) return;
        this.catchingUp = true;
        try {
            for (let wanted = this.wanted(); wanted !== undefined && wanted !== this.current; wanted = this.wanted()) {
                // Tried again when the service says the next time what it has.
                if (!(await this.change(wanted))) return;
                this.offer();
                notice(`Now plays ${plain(wanted)}`);
            }
        } finally {
            this.catchingUp = false;
        }
    }

    /** The policy that is followed, if one is. */
    private wanted(): string | undefined {
        const followed = this.followed.value as Followed;
        return followed === "newest" ? this.policies.at(-1)?.name : followed === "best" ? this.best() : undefined;
    }

    private offer(): void {
        const names = this.policies.map(({ name, tags }) => ({ name, text: plain(name) + (tags.length > 0 ? ` · ${tags.join(", ")}` : "") }));
        this.title.replaceChildren(...names.map(({ name, text }) => h("option", { value: name }, text)));
        // None where none plays, so that each can be chosen.
        this.title.value = this.current;
        if (this.timeline.frames.length > 0) this.arms.offer(this.policies);
    }

    private panel(): HTMLElement {
        this.title.onchange = () => void this.change(this.title.value).then(() => this.offer());
        this.episode.onchange = () => void this.again();
        const trails = h("input", { type: "checkbox", checked: true, onchange: () => (this.view.trailsShown = trails.checked) });
        this.camera.onchange = () => this.follow();
        const file = h("input", { type: "file", accept: "application/json,.json", hidden: true });
        file.onchange = () => {
            const [chosen] = file.files ?? [];
            file.value = "";
            if (chosen !== undefined) void chosen.text().then((text) => this.replay(parse(text))).catch((error: Error) => notice(error.message, "error"));
        };
        const choices: [Followed, string][] = [["none", "stay with this one"], ["newest", "follow the newest"], ["best", "follow the best"]];
        this.followed.append(...choices.map(([value, text]) => h("option", { value }, text)));
        this.followed.onchange = () => void this.catchUp();
        const newest = this.source.live ? h("label", { class: "field follow" }, h("span", {}, "New ones"), this.followed) : undefined;
        return h(
            "aside",
            { class: "panel" },
            h("section", {}, h("h2", {}, "Policy"), this.title, newest),
            h("section", {}, h("h2", {}, "Arms"), this.arms.element),
            h(
                "section",
                {},
                h("h2", {}, "Episode"),
                h(
                    "div",
                    { class: "line" },
                    h("label", { class: "episode" }, h("span", {}, "Goals of episode"), this.episode),
                    h("button", { type: "button", onclick: () => this.nextEpisode(), title: "Other goals (N)" }, "New goals"),
                ),
                this.world.element,
            ),
            h("section", {}, h("h2", {}, "View"), h("div", { class: "line" }, h("label", { class: "field" }, h("span", {}, "Camera"), this.camera), h("label", { class: "check" }, trails, "trails"))),
            h(
                "section",
                {},
                h("h2", {}, "Play it again elsewhere"),
                h(
                    "div",
                    { class: "line" },
                    h("button", { type: "button", class: "with-icon", onclick: () => void this.copyLink() }, iconButton(ICONS.link, "", () => undefined).firstChild as Node, "Copy link"),
                    h("button", { type: "button", class: "with-icon", onclick: () => save("episode.json", JSON.stringify(this.recording(), null, 1)) }, iconButton(ICONS.save, "", () => undefined).firstChild as Node, "Save"),
                    h("button", { type: "button", class: "with-icon", onclick: () => file.click() }, iconButton(ICONS.open, "", () => undefined).firstChild as Node, "Open"),
                    file,
                ),
            ),
        );
    }

    /** What the camera can follow of the robot that is here; a hand that this one does not have is followed no more. */
    private offerCameras(): void {
        const before = this.camera.value;
        const hands = Array.from({ length: this.timeline.description.n_arms }, (_, arm): [string, string] => [String(arm), `follows hand ${arm + 1}`]);
        const choices: [string, string][] = [["nothing", "stays"], ["base", "follows the base"], ...hands];
        this.camera.replaceChildren(...choices.map(([value, text]) => h("option", { value, selected: value === before }, text)));
        this.follow();
    }

    private follow(): void {
        const { value } = this.camera;
        this.view.follow(value === "base" ? value : value === "nothing" || value === "" ? "nothing" : Number(value));
    }

    /** The fragment of a link that plays this again. */
    fragment(): Promise<string> {
        return toFragment(this.recording());
    }

    private nextEpisode(): void {
        this.episode.value = String((Number(this.episode.value) || 0) + 1);
        void this.again();
    }

    private async copyLink(): Promise<void> {
        const link = `${location.href.split("#")[0] ?? ""}#${await this.fragment()}`;
        try {
            await navigator.clipboard.writeText(link);
            notice("The link is in the clipboard");
        } catch {
            history.replaceState(null, "", link);
            notice("The link is in the address bar");
        }
    }

    keys(): Key[] {
        const { timeline, view } = this;
        return [
            { keys: [" "], shown: "space", what: "play or pause", run: () => this.transport.toggle() },
            { keys: ["ArrowRight", "."], shown: "→", what: "a control step on", run: () => timeline.step() },
            { keys: ["ArrowLeft", ","], shown: "←", what: "a control step back", run: () => timeline.back() },
            { keys: ["Home"], shown: "Home", what: "start again", run: () => void this.again() },
            { keys: ["+", "="], shown: "+", what: "faster", run: () => this.transport.faster(1) },
            { keys: ["-"], shown: "−", what: "slower", run: () => this.transport.faster(-1) },
            { keys: ["n"], shown: "N", what: "other goals", run: () => this.nextEpisode() },
            { keys: ["1", "2", "3", "4", "5", "6", "7", "8"], shown: "1 … 4", what: "select a hand's goal", run: (key) => this.selectArm(Number(key) - 1) },
            { keys: ["b"], shown: "B", what: "select the base's goal", run: () => view.goals.select("base") },
            { keys: ["g"], shown: "G", what: "move the goal", run: () => view.goals.setMode("translate") },
            { keys: ["r"], shown: "R", what: "turn the goal", run: () => view.goals.setMode("rotate") },
            { keys: ["Escape"], shown: "Esc", what: "let go of the goal", run: () => view.goals.select(undefined) },
            { keys: ["v"], shown: "V", what: "the view at the beginning", run: () => view.stage.home() },
            { keys: ["?"], shown: "?", what: "this list", run: () => undefined },
        ];
    }

    private selectArm(arm: number): void {
        const goal: Goal = arm;
        if (arm < (this.timeline.description?.n_arms ?? 0)) this.view.goals.select(goal);
    }

    private tick(): void {
        // Pictures that nobody sees cost as much as others.
        if (this.element.hidden) setTimeout(() => this.tick(), 100);
        else requestAnimationFrame(() => this.tick());
        const now = performance.now();
        const seconds = Math.min((now - this.last) / 1000, 0.25);
        this.last = now;
        if (this.timeline.frames.length === 0 || this.element.hidden) return;
        this.timeline.tick(seconds);
        this.view.draw(seconds);
        this.transport.tick();
        this.curves.tick();
        const frame = this.timeline.frames[Math.floor(this.timeline.cursor + 1e-6)];
        if (frame !== undefined && frame !== this.shownFrame) {
            this.shownFrame = frame;
            this.arms.show(frame, this.view.goals.selected);
            if (!this.timeline.isPending) this.showSettings();
        }
        this.measure(now);
    }

    /** Controls say what holds where the page stands. */
    private showSettings(): void {
        const settings = this.timeline.settings(Math.floor(this.timeline.cursor + 1e-6));
        this.world.show(settings);
        settings.arms.forEach((control, arm) => {
            this.arms.set(arm, typeof control === "string" ? control : { policy: this.slots[control.policy] ?? "" });
        });
    }

    /** For whoever measures the page. */
    private measure(now: number): void {
        this.frames.count += 1;
        if (now - this.frames.since < 1000) return;
        this.frames.rate = (1000 * this.frames.count) / (now - this.frames.since);
        this.frames = { count: 0, since: now, rate: this.frames.rate };
        this.element.dataset["framesPerSecond"] = this.frames.rate.toFixed(1);
        this.element.dataset["stepMs"] = this.timeline.stepMs.toFixed(2);
    }

    /** Keys act while this room is shown. */
    listen(): { help(): void } {
        return listen(this.keys(), () => !this.element.hidden);
    }
}
