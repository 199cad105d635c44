// Elements made in one line.

type Child = Node | string | undefined;
type Props<K extends keyof HTMLElementTagNameMap> = Partial<Omit<HTMLElementTagNameMap[K], "style" | "dataset">> & {
    class?: string;
    data?: Record<string, string>;
    aria?: Record<string, string>;
};

export function h<K extends keyof HTMLElementTagNameMap>(tag: K, props: Props<K> = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
    const { class: classes, data, aria, ...rest } = props as Props<K> & Record<string, unknown>;
    const element = document.createElement(tag);
    if (classes !== undefined) element.className = classes;
    Object.assign(element, rest);
    Object.assign(element.dataset, data);
    for (const [name, value] of Object.entries(aria ?? {})) element.setAttribute(`aria-${name}`, value);
    element.append(...children.filter((child) => child !== undefined));
    return element;
}

/** Writes a text where another one stands: what has not changed can stay marked. */
export function put(element: HTMLElement, text: string): void {
    if (element.textContent !== text) element.textContent = text;
}

const SVG = "http://www.w3.org/2000/svg";

/** A picture of lines on a 16 by 16 grid. */
export function icon(path: string): SVGSVGElement {
    const svg = document.createElementNS(SVG, "svg");
    svg.setAttribute("viewBox", "0 0 16 16");
    svg.setAttribute("class", "icon");
    svg.setAttribute("aria-hidden", "true");
    const line = document.createElementNS(SVG, "path");
    line.setAttribute("d", path);
    svg.append(line);
    return svg;
}

export const ICONS = {
    play: "M5 3.2v9.6l8-4.8z",
    pause: "M5.5 3.5v9M10.5 3.5v9",
    next: "M4.5 3.5v9l6-4.5zM12.2 3.5v9",
    back: "M11.5 3.5v9l-6-4.5zM3.8 3.5v9",
    first: "M12.5 3.5v9L7 8zM7 3.5v9L1.5 8z",
    link: "M6.6 9.4l2.8-2.8M7.6 4.6l1.6-1.6a2.7 2.7 0 013.8 3.8l-1.6 1.6M8.4 11.4l-1.6 1.6a2.7 2.7 0 01-3.8-3.8l1.6-1.6",
    save: "M8 2.5v7.2M4.8 6.8L8 10l3.2-3.2M3 13.2h10",
    open: "M8 10V2.8M4.8 5.7L8 2.5l3.2 3.2M3 13.2h10",
    light: "M8 5.2a2.8 2.8 0 100 5.6 2.8 2.8 0 000-5.6M8 1.2v1.6M8 13.2v1.6M1.2 8h1.6M13.2 8h1.6M3.2 3.2l1.1 1.1M11.7 11.7l1.1 1.1M3.2 12.8l1.1-1.1M11.7 4.3l1.1-1.1",
    help: "M5.8 6a2.2 2.2 0 114 1.2c-.5.7-1.8 1-1.8 2.2M8 11.8v.2",
    pin: "M8 9.6v4M5 2.5h6l-.8 4.2 1.8 2.4H4l1.8-2.4z",
    promote: "M4 14V2.8h7.6L9.8 5.6l1.8 2.8H4",
    compare: "M2.6 5.2h9.8M9.6 2.4l2.8 2.8-2.8 2.8M13.4 10.8H3.6M6.4 8l-2.8 2.8 2.8 2.8",
    tag: "M2.5 2.5h5l6 6-5 5-6-6zM5.2 5.2v.1",
} as const;

/** A button with a picture and a name for those who do not see it. */
export function iconButton(path: string, name: string, onclick: () => void): HTMLButtonElement {
    return h("button", { class: "icon-button", type: "button", title: name, onclick, aria: { label: name.replace(/ \(.*/, "") } }, icon(path));
}

/** Says something for a while. */
export function notice(text: string, kind: "info" | "error" = "info"): void {
    document.querySelector(".notice")?.remove();
    const element = h("div", { class: `notice ${kind}`, role: kind === "error" ? "alert" : "status" }, text);
    document.body.append(element);
    setTimeout(() => element.remove(), kind === "error" ? 9000 : 3500);
}
