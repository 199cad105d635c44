// The beginning of the one file: unpacks the page's program from the file itself and starts it.

async function unpack(name: string): Promise<string> {
    const text = document.querySelector(`script[data-asset="${name}"]`)?.textContent ?? "";
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
}

void unpack("page.js").then((program) => {
    const script = document.createElement("script");
    script.textContent = program;
    document.body.append(script);
});
