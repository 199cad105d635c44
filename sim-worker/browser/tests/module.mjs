// Plays a script in the module and writes every state: node module.mjs MODULE POLICIES SCRIPT. POLICIES are directories with commas between;
// to standard output go the states (f32, little endian), to standard error one line of JSON with what was measured.
import { readFileSync, writeSync } from "node:fs";

const [modulePath, directories, scriptPath] = process.argv.slice(2);
const measured = {};
let since = performance.now();
const lap = (name) => {
  const now = performance.now();
  measured[name] = now - since;
  since = now;
};
const module = new WebAssembly.Module(readFileSync(modulePath));
lap("compile_ms");
const x = new WebAssembly.Instance(module, {}).exports;
if (x.version() !== 3) throw new Error("another version of the module");

const text = () => new TextDecoder().decode(new Uint8Array(x.memory.buffer, x.text(), x.text_len()));
const ok = (answer) => {
  if (answer < 0) throw new Error(text());
  return answer;
};
const put = (...parts) => {
  const len = parts.reduce((sum, part) => sum + part.length, 0);
  let at = x.input(len);
  for (const part of parts) {
    new Uint8Array(x.memory.buffer).set(part, at);
    at += part.length;
  }
};
const json = (value) => put(new TextEncoder().encode(JSON.stringify(value)));

for (const directory of directories.split(",")) {
  const files = ["config.toml", "robot.toml", "policy.safetensors"].map((name) => readFileSync(`${directory}/${name}`));
  put(...files);
  ok(x.policy(-1, files[0].length, files[1].length));
}
ok(x.describe());
const { state } = JSON.parse(text()).arrays;
lap("load_ms");

const states = [];
const keep = () => states.push(new Float32Array(x.memory.buffer, state.at, state.len).slice());
const script = JSON.parse(readFileSync(scriptPath, "utf8"));
json(script.start ?? {});
ok(x.reset());
keep();
let steps = 0;
const processor = process.cpuUsage();
for (let step = 0; step < script.steps; step += 1) {
  for (const timed of script.events ?? []) {
    if (timed.step === step) {
      json(timed.event);
      ok(x.event());
    }
  }
  const start = performance.now();
  ok(x.step());
  steps += performance.now() - start;
  keep();
}
const { user, system } = process.cpuUsage(processor);
measured.step_ms = steps / script.steps;
measured.step_processor_ms = (user + system) / 1e3 / script.steps;
measured.memory_bytes = x.memory.buffer.byteLength;
process.stderr.write(`${JSON.stringify(measured)}\n`);
const bytes = Buffer.concat(states.map((row) => Buffer.from(row.buffer)));
for (let at = 0; at < bytes.length; ) at += writeSync(1, bytes, at);
