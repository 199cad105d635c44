// The page: finds out where it stands and opens its rooms.

import { RobotRoom } from "./controls/robot_room";
import { askForToken } from "./controls/sign_in";
import { h, ICONS, iconButton, notice } from "./page/dom";
import { Refusal } from "./page/service";
import { EnclosedSource, ServiceSource, type Source } from "./page/source";
import { restoreTheme, toggleTheme } from "./page/theme";
import { takeToken } from "./page/token";
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
    const header = h(
        "header",
        {},
        h("h1", {}, "SpaceOctopus"),
        h("div", { class: "spring" }),
        iconButton(ICONS.help, "Keys and pointer (?)", help.help),
        iconButton(ICONS.light, "Light or dark", toggleTheme),
    );
    document.body.append(header, room.element);
    const wanted = new URLSearchParams(location.hash.slice(1));
    await room.start(wanted.get("policy") ?? undefined, wanted.get("play") ?? undefined);
    document.body.dataset["ready"] = String(Math.round(performance.now()));
    // Tests and curious people ask it what it shows.
    Object.assign(window, { spaceoctopus: room });
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
