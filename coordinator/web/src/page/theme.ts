// Light and dark: as the system has it, or as the user chose.

import type { Look } from "../scene/stage";

const KEY = "theme";

export function restoreTheme(): void {
    const chosen = stored();
    if (chosen !== undefined) document.documentElement.dataset["theme"] = chosen;
}

export function isDark(): boolean {
    const chosen = document.documentElement.dataset["theme"];
    return chosen === undefined ? matchMedia("(prefers-color-scheme: dark)").matches : chosen === "dark";
}

export function toggleTheme(): void {
    const next = isDark() ? "light" : "dark";
    document.documentElement.dataset["theme"] = next;
    try {
        localStorage.setItem(KEY, next);
    } catch {
        // A page from a file may have no storage.
    }
}

/** Calls back when the theme has changed, by whomever. */
export function onTheme(changed: () => void): void {
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
    new MutationObserver(changed).observe(document.documentElement, { attributeFilter: ["data-theme"] });
}

/** A colour of the style sheet. */
export function colour(name: string): string {
    return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

export function sceneLook(): Look {
    return { ground: colour("scene"), line: colour("scene-line"), ink: colour("ink") };
}

function stored(): "light" | "dark" | undefined {
    try {
        const value = localStorage.getItem(KEY);
        return value === "light" || value === "dark" ? value : undefined;
    } catch {
        return undefined;
    }
}
