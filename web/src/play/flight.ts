import { History } from "../chart/history";
import { Program } from "../wasm/program";
import type { Signal } from "../wasm/signal";
import type { PlayData } from "./data";

export interface Start {
  rig: string;
  seed: number;
  noise: boolean;
  rings: boolean;
}

export interface Command {
  /** Index into signals.MODES. */
  mode: number;
  theta: number;
  q: number;
  x: number;
  v: number;
  thrust: number;
  arm: boolean;
  link: boolean;
}

export interface Safety {
  state: string;
  action: string;
  reasons: string[];
}

/** Outputs of the closed loop by column of telemetry. */
const OUTPUTS: Readonly<Record<string, string>> = {
  ...Object.fromEntries(
    ["theta", "q", "x", "v"].flatMap((name) => [
      [`estimate.${name}`, name],
      [`setpoint.${name}`, `${name}0`],
      [`truth.${name}`, `true_${name}`],
    ]),
  ),
  ...{ "command.M": "M", "command.T": "T", "battery.voltage": "voltage" },
};

/** Most control steps per call, so that a page that slept does not catch up. */
const MOST_STEPS = 500;

export class Flight {
  readonly history = new History([...Object.keys(OUTPUTS), "state.mode"], 1 << 17);
  steps = 0;
  private readonly outputs: Signal[];
  private readonly inputs: Record<string, Signal>;
  private pushed = { force: 0, until: 0 };
  /** Start on the charts, where flights follow one another [s]. */
  private began = 0;

  private constructor(
    private readonly program: Program,
    readonly data: PlayData,
  ) {
    this.outputs = Object.values(OUTPUTS).map((path) => program.output(path));
    this.inputs = Object.fromEntries(data.table.inputs.map(({ path }) => [path, program.input(path)]));
  }

  static async load(module: BufferSource, data: PlayData): Promise<Flight> {
    return new Flight(await Program.load(module, data.table), data);
  }

  get period(): number {
    return this.program.dt * this.data.ticks;
  }

  get time(): number {
    return this.began + this.steps * this.period;
  }

  start(start: Start): void {
    const { program, data } = this;
    const at = data.starts.hover;
    program.set({
      ...data.rigs[start.rig]!,
      ...at.parameters,
      "rig.noise": start.noise ? 1 : 0,
      "rig.seed": start.seed,
      "rig.rings": start.rings ? 1 : 0,
      "rig.ring_place": 0,
      "rig.rail_force": 0,
    });
    program.reset();
    for (const [path, value] of Object.entries(at.states)) program.state(path).set(value);
    this.began = this.time + (this.steps ? 0.5 : 0);
    if (this.steps) this.gap();
    this.steps = 0;
    this.pushed = { force: 0, until: 0 };
    this.inputs["rings"]!.set(start.rings);
  }

  /** Fly control steps; each appends a row. */
  advance(steps: number, command: Command): void {
    const count = Math.min(steps, MOST_STEPS);
    if (count <= 0) return;
    this.give(command);
    const time = new Float64Array(count);
    const armed = this.program.output("armed");
    const columns = [...this.outputs, undefined].map(() => new Float32Array(count));
    for (let k = 0; k < count; k += 1) {
      if (this.pushed.force && this.steps >= this.pushed.until) this.push(0, 0);
      this.program.step();
      this.outputs.forEach((output, c) => (columns[c]![k] = output.number()));
      columns[this.outputs.length]![k] = armed.number() ? command.mode : 0;
      for (let tick = 1; tick < this.data.ticks; tick += 1) this.program.step();
      time[k] = this.time;
      this.steps += 1;
    }
    this.history.append({ time, columns });
  }

  /** Set parameters by path, all or none. Raises ProgramRefusal. */
  set(values: Readonly<Record<string, number>>): void {
    this.program.set(values);
  }

  get(path: string): number {
    return Number(this.program.get(path));
  }

  push(force: number, seconds: number): void {
    this.pushed = { force, until: this.steps + Math.round(seconds / this.period) };
    this.program.set({ "rig.rail_force": force });
  }

  /** Add `rate` [rad/s] to the pitch rate. */
  strike(rate: number): void {
    const q = this.program.state("rig.dynamics.q");
    q.set(q.number() + rate);
  }

  charge(share: number): void {
    this.program.state("rig.battery.charge").set(share);
  }

  safety(): Safety {
    const at = (name: string): number => this.program.output(name).number();
    const state = this.data.states[at("state")] ?? "";
    // While it flies, what only speaks against arming is of no interest.
    const mask = at("action") ? at("reason") : state === "refused" ? at("causes") : 0;
    return {
      state,
      action: this.data.actions[at("action")] ?? "",
      reasons: this.data.causes.filter((_, bit) => (mask >>> bit) & 1).map((cause) => cause.text),
    };
  }

  private give(command: Command): void {
    const { inputs } = this;
    const flying = command.arm;
    inputs["mode"]!.set(command.mode);
    inputs["theta0"]!.set(command.theta);
    inputs["q0"]!.set(command.q);
    inputs["x0"]!.set(command.x);
    inputs["v0"]!.set(command.v);
    inputs["thrust"]!.set(flying ? command.thrust : 0);
    inputs["arm"]!.set(flying);
    inputs["imu_new"]!.set(true);
    inputs["setpoint_new"]!.set(command.link);
    inputs["link_new"]!.set(command.link);
  }

  /** Append an empty row, so that no line joins two flights. */
  private gap(): void {
    this.history.append({ time: [this.began - 0.25], columns: this.history.names.map(() => [NaN]) });
  }
}
