import { ProgramRefusal, Signal, write, type Value } from "./signal";
import { numbersAt, roomFor, type Entry, type Numbers, type ParameterEntry, type ProgramTable } from "./table";

/** Trap in the module, which can no longer run. */
export class ProgramFault extends Error {}

/**
 * A diagram that the library compiled to WebAssembly, running here: the same bits as on board.
 *
 *     const program = await Program.load(bytes, table);           // the .wasm, and the JSON beside it
 *     program.set({ "flight.cascade.attitude.k_theta": 5 });      // all or none; refused beyond the bounds
 *     program.reset();                                            // initial states of these parameters
 *     program.input("theta").set(0.17);                           // handles: look them up once, not in the loop
 *     program.step();                                             // one tick of program.dt seconds
 *     program.output("true_theta").value();
 *     const { true_theta } = program.run(1000, ["true_theta"]);   // many ticks at once, and what they gave
 *
 * The module and its table come from the library (`emit_program` and `compile_module`, or a route that calls them).
 * What it runs has no other import than its own memory: it cannot reach the page. Loops have constant bounds, so each
 * call ends. `dt`, `inputs`, `outputs`, `states` and `parameters` of `table` say what there is.
 */
export class Program {
  private readonly parameters: ReadonlyMap<string, ParameterEntry>;
  private readonly handles = new Map<string, Signal>();
  private readonly memory: ArrayBuffer;
  private fault: ProgramFault | undefined;
  private ticked = 0;

  private constructor(
    readonly table: ProgramTable,
    private readonly exports: Record<string, CallableFunction>,
    memory: WebAssembly.Memory,
  ) {
    this.memory = memory.buffer as ArrayBuffer; // it cannot grow, so views of it stay as they are
    this.parameters = new Map(table.parameters.map((one) => [one.path, one]));
    this.call("defaults", this.at("P"));
    this.call("prepare", this.at("P"));
    this.reset();
  }

  /**
   * Makes an instance with a memory of its own; of a module that was compiled before at once.
   * Raises ProgramRefusal for a table of another version, or a module that is not the table's.
   */
  static async load(module: BufferSource | WebAssembly.Module, table: ProgramTable): Promise<Program> {
    if (table.twodof !== 1)
      throw new ProgramRefusal(
        `the module's table has version ${table.twodof}, this page reads 1: load the page again`,
      );
    const compiled = module instanceof WebAssembly.Module ? module : await WebAssembly.compile(module);
    const { exports } = await WebAssembly.instantiate(compiled, {});
    const memory = exports["memory"];
    const missing = Object.values(table.functions).filter((name) => typeof exports[name] !== "function");
    if (!(memory instanceof WebAssembly.Memory) || missing.length)
      throw new ProgramRefusal(`the module has no ${missing.join(", ") || "memory"}: it is not that of ${table.name}`);
    return new Program(table, exports as Record<string, CallableFunction>, memory);
  }

  get dt(): number {
    return this.table.dt;
  }

  /** Set the initial states of the present parameters. */
  reset(): void {
    this.call("init", this.at("P"), this.at("S"));
    this.ticked = 0;
  }

  step(): void {
    this.call("tick");
    this.ticked += 1;
  }

  /**
   * `ticks` ticks; the outputs called `wanted` at each of them, one behind the other. Inputs stay as they are, but for
   * those of `columns`, which have a number (or an array's numbers) for each tick.
   */
  run(
    ticks: number,
    wanted: readonly string[] = [],
    columns: Readonly<Record<string, ArrayLike<number>>> = {},
  ): Record<string, Numbers> {
    const { rows, structs } = this.table;
    const inputs = Object.entries(columns).map(([path, column]) => ({ entry: this.entry("input", path), column }));
    const outputs = wanted.map((path) => ({ path, entry: this.entry("output", path) }));
    const found: Record<string, Numbers> = {};
    for (const { path, entry } of outputs) found[path] = roomFor(entry, ticks * entry.count);
    const bytes = new Uint8Array(this.memory);
    for (let start = 0; start < ticks; start += rows.count) {
      const count = Math.min(rows.count, ticks - start);
      const ofU = rows.U.address - structs.U.address;
      const ofY = rows.Y.address - structs.Y.address;
      if (inputs.length) {
        for (let k = 0; k < count; k += 1) {
          bytes.copyWithin(rows.U.address + k * rows.U.stride, structs.U.address, structs.U.address + structs.U.size);
          for (const { entry, column } of inputs) {
            const row = numbersAt(this.memory, entry, ofU + k * rows.U.stride);
            for (let c = 0; c < entry.count; c += 1) row[c] = column[(start + k) * entry.count + c] ?? NaN;
          }
        }
        this.call("run", this.at("P"), this.at("S"), rows.U.address, 1, rows.Y.address, 1, count);
        const last = rows.U.address + (count - 1) * rows.U.stride;
        bytes.copyWithin(structs.U.address, last, last + structs.U.size);
      } else {
        this.call("run", this.at("P"), this.at("S"), structs.U.address, 0, rows.Y.address, 1, count);
      }
      for (const { path, entry } of outputs)
        for (let k = 0; k < count; k += 1)
          found[path]!.set(numbersAt(this.memory, entry, ofY + k * rows.Y.stride), (start + k) * entry.count);
      const end = rows.Y.address + (count - 1) * rows.Y.stride;
      bytes.copyWithin(structs.Y.address, end, end + structs.Y.size);
      this.ticked += count;
    }
    return found;
  }

  /** Set parameters by path, all or none. Raises ProgramRefusal. */
  set(values: Readonly<Record<string, Value>>): void {
    const given = Object.entries(values).map(([path, value]) => [this.checked(path, value), value] as const);
    const { address, size } = this.table.structs.P;
    const bytes = new Uint8Array(this.memory, address, size);
    const before = bytes.slice();
    for (const [entry, value] of given) write(numbersAt(this.memory, entry), value);
    try {
      this.call("prepare", address);
    } catch (failure) {
      bytes.set(before);
      throw failure;
    }
  }

  get(path: string): number | number[] {
    return this.handle("parameter", path).value();
  }

  input(path: string): Signal {
    return this.handle("input", path);
  }

  output(path: string): Signal {
    return this.handle("output", path);
  }

  state(path: string): Signal {
    return this.handle("state", path);
  }

  private handle(what: "parameter" | "input" | "output" | "state", path: string): Signal {
    const key = `${what} ${path}`;
    let found = this.handles.get(key);
    if (found === undefined) {
      const entry = this.entry(what, path);
      found = new Signal(entry, numbersAt(this.memory, entry));
      this.handles.set(key, found);
    }
    return found;
  }

  private entry(what: "parameter" | "input" | "output" | "state", path: string): Entry {
    const entry = this.table[`${what}s`].find((one) => one.path === path);
    if (entry === undefined) throw new ProgramRefusal(`${this.table.name} has no ${what} ${path}`);
    return entry;
  }

  private checked(path: string, value: Value): Entry {
    const entry = this.parameters.get(path);
    if (entry === undefined) throw new ProgramRefusal(`${this.table.name} has no parameter ${path}`);
    if (!entry.tunable && this.ticked)
      throw new ProgramRefusal(`${path} cannot be changed while it runs: start anew, then set it`);
    const numbers = Array.isArray(value) ? (value as readonly number[]) : [Number(value)];
    if (Array.isArray(value) !== entry.array || numbers.length !== entry.count)
      throw new ProgramRefusal(`${path} takes ${entry.count} numbers, not ${numbers.length}`);
    for (const one of numbers) {
      const whole = entry.type.startsWith("float") || Number.isInteger(one);
      if (!whole) throw new ProgramRefusal(`${path} = ${one}: it takes a whole number`);
      if (!(one >= (entry.low ?? -Infinity) && one <= (entry.high ?? Infinity)))
        throw new ProgramRefusal(
          `${path} = ${one} ${entry.unit} is out of its bounds, ${entry.low ?? "-∞"} to ${entry.high ?? "∞"} ${entry.unit}`,
        );
    }
    return entry;
  }

  private at(struct: "P" | "S"): number {
    return this.table.structs[struct].address;
  }

  private call(what: keyof ProgramTable["functions"], ...rest: number[]): void {
    if (this.fault !== undefined) throw this.fault;
    try {
      this.exports[this.table.functions[what]]!(...rest);
    } catch (failure) {
      this.fault = new ProgramFault(
        `${this.table.name} was stopped in ${what}, tick ${this.ticked}: ${String(failure)}`,
      );
      throw this.fault;
    }
  }
}
