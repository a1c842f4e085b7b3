// A host for modules in V8, by their interface alone: node host.mjs MODULE.wasm INTERFACE.json < runs.json > outputs.
// Each run sets parameters and steps with inputs, base64 of `steps` values each; all outputs come back in base64.
import { readFileSync } from "node:fs";

const ARRAYS = {
  float64: Float64Array, float32: Float32Array, int32: Int32Array, uint32: Uint32Array, bool: Uint8Array,
  int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array,
};

async function load(bytes, about) {
  const { instance } = await WebAssembly.instantiate(bytes, {});
  const { exports } = instance;
  const memory = exports.memory.buffer;
  const call = (name, ...rest) => exports[about.functions[name]](...rest);
  const [P, S, U, Y] = ["P", "S", "U", "Y"].map((kind) => about.structs[kind].address);
  const view = (entry, by = 0) => new ARRAYS[entry.type](memory, entry.address + by, entry.count);
  const named = (kind, path) => about[kind].find((entry) => entry.path === path);

  call("defaults", P);
  call("prepare", P);
  call("init", P, S);
  return {
    set(values) {
      for (const [path, value] of Object.entries(values)) view(named("parameters", path)).fill(value);
      call("prepare", P);
    },
    run(steps, columns) {
      const found = Object.fromEntries(about.outputs.map((o) => [o.path, new ARRAYS[o.type](steps * o.count)]));
      for (let start = 0; start < steps; start += about.rows.count) {
        const n = Math.min(about.rows.count, steps - start);
        for (const input of about.inputs) {
          const offset = about.rows.U.address - U;
          for (let k = 0; k < n; k++) {
            const from = (start + k) * input.count;
            const row = columns[input.path].subarray(from, from + input.count);
            view(input, offset + k * about.rows.U.stride).set(row);
          }
        }
        call("run", P, S, about.rows.U.address, 1, about.rows.Y.address, 1, n);
        for (const output of about.outputs) {
          const offset = about.rows.Y.address - Y;
          for (let k = 0; k < n; k++) {
            found[output.path].set(view(output, offset + k * about.rows.Y.stride), (start + k) * output.count);
          }
        }
      }
      return found;
    },
  };
}

const [, , module, interface_] = process.argv;
const about = JSON.parse(readFileSync(interface_, "utf-8"));
const program = await load(readFileSync(module), about);
const results = [];
for (const { parameters, steps, inputs } of JSON.parse(readFileSync(0, "utf-8"))) {
  program.set(parameters);
  const columns = Object.fromEntries(about.inputs.map(({ path, type }) => {
    const bytes = Uint8Array.from(Buffer.from(inputs[path], "base64"));
    return [path, new ARRAYS[type](bytes.buffer)];
  }));
  const outputs = program.run(steps, columns);
  const shown = Object.entries(outputs).map(([path, values]) => [path, Buffer.from(values.buffer).toString("base64")]);
  results.push(Object.fromEntries(shown));
}
process.stdout.write(JSON.stringify(results));
