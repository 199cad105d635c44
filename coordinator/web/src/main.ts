// The page: finds out where it stands and opens its rooms.

import { RobotRoom } from "./controls/robot_room";
import { askForToken } from "./controls/sign_in";
import { h, ICONS, iconButton, notice } from "./page/dom";
import { json, Refusal } from "./page/service";
import { EnclosedSource, policyOf, ServiceSource, type Source } from "./page/source";
import { restoreTheme, toggleTheme } from "./page/theme";
import { takeToken } from "./page/token";
import { Blocks } from "./run/blocks";
import { Feed } from "./run/feed";
import { RunRoom } from "./run/run_room";
import { RunsRoom } from "./runs/runs_room";
import { Simulation } from "./simulation/simulation";
import { type Aims, aimsOf } from "./simulation/types";

restoreTheme();

/** What the service says of itself. */
interface Health {
    read_only: boolean;
    serves: "run" | "store" | "runs";
}

async function main(): Promise<void> {
    const enclosed = EnclosedSource.isHere();
    const source: Source = enclosed ? new EnclosedSource() : new ServiceSource();
    if (!enclosed) {
        takeToken();
        await admitted();
        const health = await json<Health>("health");
        if (health.serves === "runs") {
            document.body.append(header(), (await RunsRoom.open(refused)).element);
            document.body.dataset["ready"] = String(Math.round(performance.now()));
            return;
        }
        await robot(source, health);
        return;
    }
    await robot(source, undefined);
}

/** The robot, and beside it the run, if there is a service. */
async function robot(source: Source, health: Health | undefined): Promise<void> {
    const [module, worker] = await Promise.all([source.module(), source.worker()]);
    const simulation = await Simulation.start(worker, module);
    const room = new RobotRoom(source, simulation);
    const { help } = room.listen();
    const tabs = h("nav", { class: "segmented", hidden: true });
    document.body.append(header(tabs, iconButton(ICONS.help, "Keys and pointer (?)", help)), room.element);
    const feed = health === undefined ? undefined : new Feed(refused);
    let run: RunRoom | undefined;
    if (feed !== undefined && health?.serves === "run") run = rooms(tabs, room, feed, new Blocks(feed, source, module), health.read_only);
    const { policy, play } = wanted();
    await room.start(policy, play ?? EnclosedSource.episode());
    // A link that is pasted where the page is open already changes the fragment alone.
    addEventListener("hashchange", () => {
        if (health !== undefined) takeToken();
        const { policy, play } = wanted();
        void room.shows(policy, play);
    });
    feed?.on(["checkpoints"], () => void room.offered((feed.checkpoints ?? []).map(policyOf)));
    feed?.start();
    document.body.dataset["ready"] = String(Math.round(performance.now()));
    // Tests and curious people ask it what it shows.
    Object.assign(window, { spaceoctopus: room, feed, run });
}

/** What the fragment of the address asks for. */
function wanted(): { policy: string | undefined; play: string | undefined; run: boolean } {
    const parts = new URLSearchParams(location.hash.slice(1));
    return { policy: parts.get("policy") ?? undefined, play: parts.get("play") ?? undefined, run: parts.has("run") };
}

function header(...more: HTMLElement[]): HTMLElement {
    const [tabs, help] = more;
    // One of several runs leads back to all of them.
    const all = /\/runs\/[^/]+\/$/.test(location.pathname) ? h("a", { href: "../../", class: "back" }, "All runs") : undefined;
    return h("header", {}, h("h1", {}, "SpaceOctopus"), tabs, all, h("div", { class: "spring" }), help, iconButton(ICONS.light, "Light or dark", toggleTheme));
}

/** The room of the run beside that of the robot. */
function rooms(tabs: HTMLElement, robot: RobotRoom, feed: Feed, blocks: Blocks, readOnly: boolean): RunRoom {
    const show = (which: "robot" | "run"): void => {
        robot.element.hidden = which !== "robot";
        run.show(which === "run");
        for (const [name, button] of Object.entries(buttons)) button.setAttribute("aria-pressed", String(name === which));
    };
    const play = (name: string): void => {
        show("robot");
        void robot.play(name);
    };
    const aims = (task: string | undefined): Aims => {
        const { description } = robot.timeline;
        const of = task === undefined ? undefined : description?.aims[task];
        return of ?? (description ? aimsOf(description) : { hands: [0, 1, 2, 3], base: true });
    };
    const run = new RunRoom(feed, blocks, play, aims, readOnly);
    const buttons = {
        robot: h("button", { type: "button", onclick: () => show("robot") }, "Robot"),
        run: h("button", { type: "button", onclick: () => show("run") }, "Run"),
    };
    tabs.append(buttons.robot, buttons.run);
    tabs.hidden = false;
    document.body.append(run.element);
    show(wanted().run ? "run" : "robot");
    addEventListener("hashchange", () => {
        const { policy, play, run } = wanted();
        if (run) show("run");
        else if ((policy ?? play) !== undefined) show("robot");
    });
    return run;
}

/** Asks for the token until the service takes it. */
async function admitted(): Promise<void> {
    for (;;) {
        try {
            await json("v1/checkpoints");
            return;
        } catch (error) {
            if (!(error instanceof Refusal) || error.status !== 401) throw error;
            await refused(error);
        }
    }
}

/** Asks for the token if the service wants another one, and is true then; says anything else. */
async function refused(refusal: Refusal): Promise<boolean> {
    if (refusal.status !== 401) {
        notice(refusal.message, "error");
        return false;
    }
    await askForToken(refusal.message.includes("wrong") ? "The service does not know this token." : "This service asks for a token.");
    return true;
}

main().catch((error: unknown) => notice(error instanceof Error ? error.message : String(error), "error"));
