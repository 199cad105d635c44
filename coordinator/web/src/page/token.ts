// The token that the service wants to see. It comes in the fragment of the address, which no browser sends anywhere, or its user types it.
// It is kept for this tab only.

const KEY = "token";

/** Takes the token out of the address, where others could read it over a shoulder or in the history. */
export function takeToken(): void {
    const parts = new URLSearchParams(location.hash.slice(1));
    const token = parts.get("token");
    if (token === null) return;
    sessionStorage.setItem(KEY, token);
    parts.delete("token");
    const rest = parts.toString();
    history.replaceState(null, "", location.pathname + location.search + (rest === "" ? "" : `#${rest}`));
}

export function token(): string | undefined {
    return sessionStorage.getItem(KEY) ?? undefined;
}

export function keepToken(text: string): void {
    sessionStorage.setItem(KEY, text.trim());
}

/** Forgets a token that the service does not know, unless there is another by now. */
export function forgetToken(shown: string): void {
    if (token() === shown) sessionStorage.removeItem(KEY);
}

/** Whether a service may know it: no other fits into a header. */
export function mayBeKnown(token: string): boolean {
    return /^[\x21-\x7e]+$/.test(token);
}
