// Run by tests/web/test_page_code.py, which names a file with the closed loop as WebAssembly, what to fly, and what the native
// build gave; numbers are float64 in base64.
import { describe, expect, it } from "vitest";
import { Program } from "../src/wasm/program";
import type { ProgramTable } from "../src/wasm/table";

interface Flight {
  table: ProgramTable;
  module: string;
  parameters: Record<string, number>;
  states: Record<string, number | boolean | number[]>;
  ticks: number;
  inputs: Record<string, string>;
  native: Record<string, string>;
}

const file = import.meta.env["VITE_TWODOF_FLIGHT"] as string | undefined;
const read = async (path: string): Promise<Flight> =>
  ((await import(/* @vite-ignore */ path)) as { default: Flight }).default;
const flight = file === undefined ? undefined : await read(file);

const bytesOf = (base64: string): Uint8Array<ArrayBuffer> =>
  Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
const floatsOf = (base64: string): Float64Array => new Float64Array(bytesOf(base64).buffer);

async function started(given: Flight): Promise<Program> {
  const program = await Program.load(bytesOf(given.module), given.table);
  program.set(given.parameters);
  program.reset();
  for (const [path, value] of Object.entries(given.states)) program.state(path).set(value);
  return program;
}

/** The bits of numbers, and one NaN for all. */
function bits(values: ArrayLike<number>): string[] {
  const view = new DataView(new ArrayBuffer(8));
  return Array.from(values, (value) => {
    view.setFloat64(0, Number.isNaN(value) ? NaN : value);
    return view.getBigUint64(0).toString(16);
  });
}

describe.skipIf(flight === undefined)("the closed loop in the browser's engine", () => {
  it("gives the bits of the native build, step by step and in one run", async () => {
    const given = flight!;
    const names = given.table.outputs.map((one) => one.path);
    const columns = Object.fromEntries(Object.entries(given.inputs).map(([name, values]) => [name, floatsOf(values)]));
    const whole = (await started(given)).run(given.ticks, names, columns);
    const program = await started(given);
    const outputs = names.map((name) => program.output(name));
    const inputs = Object.entries(columns).map(([name, values]) => ({ signal: program.input(name), values }));
    const stepped = names.map(() => new Float64Array(given.ticks));
    for (let k = 0; k < given.ticks; k += 1) {
      for (const { signal, values } of inputs) signal.set(values[k]!);
      program.step();
      outputs.forEach((output, n) => (stepped[n]![k] = output.number()));
    }
    names.forEach((name, n) => {
      const native = bits(floatsOf(given.native[name]!));
      expect(bits(whole[name]!), name).toEqual(native);
      expect(bits(stepped[n]!), name).toEqual(native);
    });
  });

  it("refuses what is out of bounds, unknown or of another size, and changes nothing", async () => {
    const program = await started(flight!);
    const path = "flight.cascade.attitude.kp";
    const before = program.get(path);
    for (const values of [{ [path]: 1e9 }, { [path]: NaN }, { [path]: 5, nothing: 1 }, { [path]: [1, 2] }]) {
      expect(() => program.set(values)).toThrow(/bounds|no parameter|takes 1 numbers/);
      expect(program.get(path)).toBe(before);
    }
    expect(() => program.input("nothing")).toThrow("no input");
    program.set({ [path]: 5 });
    expect(program.get(path)).toBe(5);
  });

  it("refuses a table of another version, and a module that is not the table's", async () => {
    const given = flight!;
    await expect(Program.load(new Uint8Array(), { ...given.table, twodof: 2 })).rejects.toThrow("version 2");
    const empty = new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0]);
    await expect(Program.load(empty, given.table)).rejects.toThrow("it is not that of closed_loop");
  });
});
