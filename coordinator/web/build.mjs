// Makes of the page's sources what the service reads: a folder with each file compressed, and the frame of the one file that holds all.
//
//     node build.mjs simulator.wasm FOLDER

import { existsSync, mkdirSync, readFileSync, renameSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const [module, folder] = process.argv.slice(2);
if (folder === undefined) throw new Error("usage: node build.mjs simulator.wasm FOLDER");
// It comes into place as a whole: a service may be reading it.
const fresh = `${folder}.tmp`;

const common = {
    absWorkingDir: here,
    bundle: true,
    minify: true,
    write: false,
    target: "es2022",
    format: "iife",
    legalComments: "inline",
    logLevel: "warning",
};
const [page, worker, boot, style] = await Promise.all([
    build({ ...common, entryPoints: ["src/main.ts"] }),
    build({ ...common, entryPoints: ["src/simulation/worker.ts"] }),
    build({ ...common, entryPoints: ["src/single.ts"] }),
    build({ ...common, entryPoints: ["src/style.css"] }),
]);
const text = (result) => result.outputFiles[0].text;

const files = {
    "index.html": readFileSync(join(here, "src/index.html")),
    "page.css": Buffer.from(text(style)),
    "page.js": Buffer.from(text(page)),
    "worker.js": Buffer.from(text(worker)),
    "simulator.wasm": readFileSync(module),
};
rmSync(fresh, { recursive: true, force: true });
mkdirSync(fresh, { recursive: true });
let sum = 0;
for (const [name, bytes] of Object.entries(files)) {
    const compressed = gzipSync(bytes, { level: 9 });
    sum += compressed.length;
    writeFileSync(join(fresh, `${name}.gz`), compressed);
    console.log(`${name.padEnd(16)} ${kb(bytes.length)}, compressed ${kb(compressed.length)}`);
}
const frame = readFileSync(join(here, "src/single.html"), "utf8");
// A function, so that `$` in the scripts means itself.
const filled = frame.replace("/* style */", () => text(style)).replace("/* boot */", () => text(boot));
writeFileSync(join(fresh, "single.html"), filled);
const old = `${folder}.old`;
rmSync(old, { recursive: true, force: true });
if (existsSync(folder)) renameSync(folder, old);
renameSync(fresh, folder);
rmSync(old, { recursive: true, force: true });
console.log(`${"in all".padEnd(16)} compressed ${kb(sum)}`);

function kb(bytes) {
    return `${(bytes / 1000).toFixed(1).padStart(8)} kB`;
}
