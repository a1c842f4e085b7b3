// One flight of a compiled loop.
import type { Program } from "../../../wasm/program";
import type { Value } from "../../../wasm/signal";

export interface Flight {
  readonly parameters: Record<string, Value>;
  readonly states: Record<string, Value>;
  /** Constant inputs. */
  readonly inputs: Record<string, Value>;
  readonly columns: Record<string, Float64Array>;
  readonly steps: number;
  readonly wanted: readonly string[];
}

export function fly(program: Program, ticks: number, asked: Flight): Record<string, Float64Array> {
  const known = new Set(program.table.parameters.map((one) => one.path));
  program.reset(); // a parameter that is not tunable is set before the first step only
  program.set(Object.fromEntries(Object.entries(asked.parameters).filter(([path]) => known.has(path))));
  program.reset();
  for (const [path, value] of Object.entries(asked.states)) program.state(path).set(value);
  for (const [path, value] of Object.entries(asked.inputs)) program.input(path).set(value);
  const columns: Record<string, Float64Array> = {};
  for (const [path, steps] of Object.entries(asked.columns)) {
    const column = (columns[path] = new Float64Array(asked.steps * ticks));
    steps.forEach((value, step) => column.fill(value, step * ticks, (step + 1) * ticks));
  }
  const outputs = new Map(program.table.outputs.map((one) => [one.path, one]));
  const wanted = asked.wanted.filter((path) => outputs.has(path));
  const found = program.run(asked.steps * ticks, wanted, columns);
  const signals: Record<string, Float64Array> = {};
  for (const path of wanted) {
    const { count, array } = outputs.get(path)!;
    for (let element = 0; element < count; element++) {
      const values = new Float64Array(asked.steps);
      for (let step = 0; step < asked.steps; step++) values[step] = found[path]![step * ticks * count + element]!;
      signals[array ? `${path}[${element}]` : path] = values;
    }
  }
  return signals;
}
