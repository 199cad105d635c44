// Asks for the token, where the address did not bring one or a wrong one.

import { h } from "../page/dom";
import { keepToken } from "../page/token";

let asked: Promise<void> | undefined;

/** Resolves when the user has given a token. Who asks meanwhile waits for the same. */
export function askForToken(why: string): Promise<void> {
    asked ??= ask(why).finally(() => (asked = undefined));
    return asked;
}

function ask(why: string): Promise<void> {
    return new Promise((resolve) => {
        const input = h("input", { type: "password", autocomplete: "off", required: true, placeholder: "token", aria: { label: "Token" } });
        const form = h(
            "form",
            { class: "sign-in" },
            h("h1", {}, "SpaceOctopus"),
            h("p", {}, why),
            h("p", { class: "faint" }, "`octopus view RUN` prints an address that brings the token. It also stands in the file http.token of the run's directory."),
            input,
            h("button", { type: "submit" }, "Continue"),
        );
        form.onsubmit = (event) => {
            event.preventDefault();
            keepToken(input.value);
            form.remove();
            resolve();
        };
        document.body.append(form);
        input.focus();
    });
}
