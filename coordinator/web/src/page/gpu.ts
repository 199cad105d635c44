// Whether the machine has a GPU for the page. Where the processor draws everything, the page leaves out what costs
// it pictures: smooth edges, blurred grounds, and curves that are drawn anew many times a second.

/** What browsers draw with where there is no GPU: Chromium's, Mesa's, Windows'. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** A browser that does not say so is taken to have a GPU. */
function found(): boolean {
    const probe = document.createElement("canvas").getContext("webgl2");
    const names = probe?.getExtension("WEBGL_debug_renderer_info");
    const name: unknown = names && probe?.getParameter(names.UNMASKED_RENDERER_WEBGL);
    probe?.getExtension("WEBGL_lose_context")?.loseContext();
    return typeof name !== "string" || !SOFTWARE.test(name);
}

export const GPU = found();
document.documentElement.dataset["gpu"] = GPU ? "yes" : "no";
