// The page: finds out where it stands and opens its rooms.

import { RobotRoom } from "./controls/robot_room";
import { askForToken } from "./controls/sign_in";
import { h, ICONS, iconButton, notice } from "./page/dom";
import { json, Refusal } from "./page/service";
import { EnclosedSource, ServiceSource, type Source } from "./page/source";
import { restoreTheme, toggleTheme } from "./page/theme";
import { takeToken } from "./page/token";
import { RunRoom } from "./run/run_room";
import { Simulation } from "./simulation/simulation";

restoreTheme();

async function main(): Promise<void> {
    const enclosed = EnclosedSource.isHere();
    const source: Source = enclosed ? new EnclosedSource() : new ServiceSource();
    if (!enclosed) takeToken();
    const [module, worker] = await Promise.all([source.module(), source.worker()]);
    const simulation = await Simulation.start(worker, module);
    if (!enclosed) await admitted(source);

    const room = new RobotRoom(source, simulation);
    const help = room.listen();
    const tabs = h("nav", { class: "segmented", hidden: true });
    const header = h(
        "header",
        {},
        h("h1", {}, "SpaceOctopus"),
        tabs,
        h("div", { class: "spring" }),
        iconButton(ICONS.help, "Keys and pointer (?)", help.help),
        iconButton(ICONS.light, "Light or dark", toggleTheme),
    );
    document.body.append(header, room.element);
    if (!enclosed && (await RunRoom.isHere())) {
        const { read_only } = await json<{ read_only: boolean }>("health");
        rooms(tabs, room, read_only);
    }
    const wanted = new URLSearchParams(location.hash.slice(1));
    await room.start(wanted.get("policy") ?? undefined, wanted.get("play") ?? undefined);
    document.body.dataset["ready"] = String(Math.round(performance.now()));
    // Tests and curious people ask it what it shows.
    Object.assign(window, { spaceoctopus: room });
}

/** The room of the run beside that of the robot. */
function rooms(tabs: HTMLElement, robot: RobotRoom, readOnly: boolean): void {
    const show = (which: "robot" | "run"): void => {
        robot.element.hidden = which !== "robot";
        run.show(which === "run");
        for (const [name, button] of Object.entries(buttons)) button.setAttribute("aria-pressed", String(name === which));
    };
    const run = new RunRoom((name) => {
        show("robot");
        void robot.play(name);
    }, readOnly);
    const buttons = {
        robot: h("button", { type: "button", onclick: () => show("robot") }, "Robot"),
        run: h("button", { type: "button", onclick: () => show("run") }, "Run"),
    };
    tabs.append(buttons.robot, buttons.run);
    tabs.hidden = false;
    document.body.append(run.element);
    show("robot");
    run.start();
}

/** Asks for the token until the service takes it. */
async function admitted(source: Source): Promise<void> {
    for (let why = "This service asks for a token."; ; ) {
        try {
            await source.policies();
            return;
        } catch (error) {
            if (!(error instanceof Refusal) || error.status !== 401) throw error;
            if (error.message.includes("wrong")) why = "The service does not know this token.";
        }
        await askForToken(why);
    }
}

main().catch((error: unknown) => notice(error instanceof Error ? error.message : String(error), "error"));
