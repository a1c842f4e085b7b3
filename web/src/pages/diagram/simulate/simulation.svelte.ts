// The simulation: whenever the diagram or the scenario changes, the loop is flown in this browser. Values of parameters
// are set in the program that is there; another structure is compiled by the server first.
import * as api from "../../../api/diagrams";
import { messageOf } from "../../../api/client";
import { editor } from "../editor.svelte";
import { findings } from "../findings.svelte";
import type { Diagram } from "../model/diagram";
import { parameterValues, structureOf } from "../model/structure";
import type { ControlLoop } from "../../../loops";
import { beginWith, flown, modeOf, PERIOD, type Scenario } from "./scenario";
import { scopes } from "./scopes.svelte";
import type { Answer, Asked } from "./worker";

const WAIT_MS = 40;

export interface Flown {
  readonly loop: ControlLoop;
  readonly time: Float64Array;
  readonly signals: Readonly<Record<string, Float64Array>>;
  readonly prefix: string;
  readonly given: Readonly<Record<string, string>>;
}

class Simulation {
  scenario = $state.raw<Scenario>(beginWith("attitude_control"));
  result = $state.raw<Flown | undefined>(undefined);
  template = $state("attitude_control");
  problem = $state("");
  busy = $state<"" | "compiling" | "flying">("");
  /** Time from the change to the result [ms]. */
  took = $state({ all: 0, compiled: false });
  flights = $state(0);
  private worker: Worker | undefined;
  private loop: api.PortableLoop | undefined;
  private structure = "";
  /** Time of the first change since the last flight, or 0. */
  private began = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private asked = 0;
  private abort: AbortController | undefined;
  private readonly waiting = new Map<number, (answer: Answer) => void>();

  changed(): void {
    this.began ||= performance.now();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.fly(), WAIT_MS);
  }

  stop(): void {
    clearTimeout(this.timer);
    this.abort?.abort();
    this.worker?.terminate();
    this.worker = undefined;
    this.structure = "";
  }

  private async fly(): Promise<void> {
    const turn = ++this.asked;
    const root = editor.root;
    const began = this.began;
    if (editor.shapes.unknown(root).size > 0) return; // asked for: what is known then calls again
    const structure = `${this.scenario.rig} ${structureOf(root, editor.shapes)}`;
    const compiled = structure !== this.structure;
    if (compiled && !this.mayCompile(root)) return;
    try {
      if (compiled) await this.compile(structure);
      if (turn !== this.asked || this.loop === undefined) return;
      await this.run(turn, began, compiled);
    } catch (failure) {
      if (turn !== this.asked) return;
      this.began = 0;
      this.problem = messageOf(failure);
      this.busy = "";
    }
  }

  private mayCompile(root: Diagram): boolean {
    const missing = editor.catalogue?.not_simulated ?? "";
    if (missing !== "") return this.refuse(missing);
    const { checked, of, failure } = findings;
    if (failure !== "") return true; // the compiler will say what is wrong
    if (of !== root || checked === undefined) return false;
    if (checked.fine && checked.template?.fits) return true;
    return this.refuse(
      checked.fine
        ? "it does not have the ports of a controller of the drone, see Problems"
        : "it does not compile yet, see Problems",
    );
  }

  private refuse(why: string): false {
    this.began = 0;
    this.busy = "";
    this.problem = why;
    return false;
  }

  private async compile(structure: string): Promise<void> {
    this.abort?.abort();
    const abort = (this.abort = new AbortController());
    [this.busy, this.problem] = ["compiling", ""];
    const loop = await api.compileLoop(editor.text, this.scenario.rig, abort.signal);
    if (abort.signal.aborted) throw new DOMException("another one is compiled", "AbortError");
    const module = Uint8Array.from(atob(loop.module), (c) => c.charCodeAt(0)).buffer;
    const answer = await this.ask({ do: "load", id: 0, module, table: loop.interface, ticks: loop.ticks });
    if (answer.error !== undefined) throw new Error(answer.error);
    [this.loop, this.structure] = [loop, structure];
    if (this.template !== loop.template) {
      this.template = loop.template;
      this.scenario = { ...beginWith(loop.template), rig: this.scenario.rig };
    }
  }

  private async run(turn: number, began: number, compiled: boolean): Promise<void> {
    const loop = this.loop!;
    this.busy = "flying";
    const plan = flown(this.scenario, loop.template, loop.setpoints);
    const own = parameterValues(editor.root, editor.shapes, loop.prefix);
    const shown = scopes.all.map((one) =>
      one.of === "input" ? (loop.given[one.path] ?? one.path) : loop.prefix + one.path,
    );
    const outputs = loop.interface.outputs.map((one) => one.path);
    const elements = outputs.filter((path) => shown.some((one) => path === one || path.startsWith(`${one}.`)));
    const answer = await this.ask({
      do: "run",
      id: 0,
      parameters: { ...loop.parameters, ...plan.parameters, ...own },
      states: loop.states,
      inputs: plan.inputs,
      columns: plan.columns,
      steps: plan.steps,
      wanted: [...new Set([`${plan.loop.loop}0`, `true_${plan.loop.loop}`, "M", "T", ...elements])],
    });
    if (turn !== this.asked) return;
    this.busy = "";
    this.began = 0;
    if (answer.error !== undefined || answer.signals === undefined) {
      this.problem = answer.error ?? "nothing came back";
      return;
    }
    const time = Float64Array.from({ length: plan.steps }, (_, k) => k * PERIOD);
    const { prefix, given } = loop;
    this.problem = "";
    this.result = { loop: plan.loop, time, signals: answer.signals, prefix, given };
    this.flights++;
    this.took = { all: performance.now() - began, compiled };
  }

  private ask(asked: Asked): Promise<Answer> {
    this.worker ??= this.start();
    const id = Math.random();
    return new Promise((resolve) => {
      this.waiting.set(id, resolve);
      this.worker!.postMessage({ ...asked, id });
    });
  }

  private start(): Worker {
    const worker = new Worker(new URL("./worker.ts", import.meta.url), { type: "module" });
    worker.onmessage = ({ data }: MessageEvent<Answer>) => {
      this.waiting.get(data.id)?.(data);
      this.waiting.delete(data.id);
    };
    worker.onerror = (fault) => {
      for (const [id, resolve] of this.waiting)
        resolve({ id, error: fault.message || "the simulation's worker failed" });
      this.waiting.clear();
    };
    return worker;
  }

  choose(change: Partial<Scenario>): void {
    this.scenario = { ...this.scenario, ...change };
    if (change.mode !== undefined) {
      const { size, rings } = modeOf(this.template, change.mode);
      this.scenario = { ...this.scenario, size, rings };
    }
  }
}

export const simulation = new Simulation();
