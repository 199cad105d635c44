// The HTTP service of the run, with the token.

import { forgetToken, mayBeKnown, token } from "./token";

/** The service refuses; its own words. */
export class Refusal extends Error {
    constructor(
        readonly status: number,
        message: string,
    ) {
        super(message);
    }
}

export async function ask(path: string, init: RequestInit = {}): Promise<Response> {
    const headers = new Headers(init.headers);
    const shown = token();
    if (shown !== undefined) {
        if (!mayBeKnown(shown)) {
            forgetToken(shown);
            throw new Refusal(401, "the token is wrong");
        }
        headers.set("authorization", `Bearer ${shown}`);
    }
    const response = await fetch(path, { ...init, headers, credentials: "omit", cache: "no-cache" });
    if (response.ok) return response;
    if (response.status === 401 && shown !== undefined) forgetToken(shown);
    let message = `${response.status} ${response.statusText}`;
    try {
        message = ((await response.json()) as { error: string }).error;
    } catch {
        // Not of the service itself.
    }
    throw new Refusal(response.status, message);
}

export async function json<T>(path: string, init: RequestInit = {}): Promise<T> {
    return (await (await ask(path, init)).json()) as T;
}

export async function bytes(path: string): Promise<Uint8Array> {
    return new Uint8Array(await (await ask(path)).arrayBuffer());
}
