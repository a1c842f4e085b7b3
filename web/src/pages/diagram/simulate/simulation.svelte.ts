// The simulation: whenever the diagram or the scenario changes, the loop is flown in this browser. Values of parameters
// are set in the program that is there; another structure is compiled by the server first.
import * as api from "../../../api/diagrams";
import { messageOf } from "../../../api/client";
import { editor } from "../editor.svelte";
import { findings } from "../findings.svelte";
import type { Diagram } from "../model/diagram";
import { parameterValues, structureOf } from "../model/structure";
import { tried } from "../../../state/toasts.svelte";
import { beginWith, modeOf, type Scenario } from "./scenario";
import { scopes } from "./scopes.svelte";
import { LoopWorker, type Flown } from "./loop_worker";

const WAIT_MS = 40;

export const stockText = (template: string) => api.starter(`stock-${template.replace("_control", "")}`);

class Simulation {
  scenario = $state.raw<Scenario>(beginWith("attitude_control"));
  result = $state.raw<Flown | undefined>(undefined);
  template = $state("attitude_control");
  problem = $state("");
  busy = $state<"" | "compiling" | "flying">("");
  /** Time from the change to the result [ms]. */
  took = $state({ all: 0, compiled: false });
  flights = $state(0);
  /** Whether the stock controller flies beside the diagram. */
  beside = $state(false);
  /** What the plots show. */
  plot = $state<"step" | "Bode plot">("step");
  stock = $state.raw<Flown | undefined>(undefined);
  private readonly mine = new LoopWorker();
  private readonly other = new LoopWorker();
  private structure = "";
  /** Time of the first change since the last flight, or 0. */
  private began = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private asked = 0;
  private abort: AbortController | undefined;
  /** Scenario of the stock controller's flight, and the loop that its worker holds. */
  private stockOf = "";
  private stockLoop = "";

  changed(): void {
    this.began ||= performance.now();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.fly(), WAIT_MS);
  }

  stop(): void {
    clearTimeout(this.timer);
    this.abort?.abort();
    this.mine.stop();
    this.other.stop();
    this.structure = this.stockOf = this.stockLoop = "";
  }

  private async fly(): Promise<void> {
    const turn = ++this.asked;
    const root = editor.root;
    const began = this.began;
    if (editor.shapes.unknown(root).size > 0) return; // asked for: what is known then calls again
    const structure = `${this.scenario.rig} ${structureOf(root, editor.shapes)}`;
    const compiled = structure !== this.structure;
    // A block that is refused keeps its last structure.
    if ((compiled || findings.of === root) && !this.mayCompile(root)) return;
    try {
      if (compiled) await this.compile(structure);
      if (turn !== this.asked) return;
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
        ? "it does not fit a controller of the drone, see Problems"
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
    const loop = await this.mine.load(editor.text, this.scenario.rig, abort.signal);
    this.structure = structure;
    if (this.template !== loop.template) {
      this.template = loop.template;
      this.scenario = { ...beginWith(loop.template), rig: this.scenario.rig };
    }
  }

  private async run(turn: number, began: number, compiled: boolean): Promise<void> {
    const loop = this.mine.loop!;
    this.busy = "flying";
    const own = parameterValues(editor.root, editor.shapes, loop.prefix);
    const shown = scopes.all.map((one) =>
      one.of === "input" ? (loop.given[one.path] ?? one.path) : loop.prefix + one.path,
    );
    const result = await this.mine.fly(this.scenario, own, shown);
    if (turn !== this.asked) return;
    [this.busy, this.began, this.problem, this.result] = ["", 0, "", result];
    this.flights++;
    this.took = { all: performance.now() - began, compiled };
    await tried(() => this.flyStock());
  }

  async compare(on: boolean): Promise<void> {
    this.beside = on;
    await tried(() => this.flyStock());
  }

  /** Fly the template's stock controller through the same scenario. */
  private async flyStock(): Promise<void> {
    const { template, scenario } = this;
    const of = this.beside ? JSON.stringify([template, scenario]) : "";
    if (of === this.stockOf) return;
    [this.stockOf, this.stock] = [of, undefined];
    if (of === "") return;
    try {
      const loop = `${template} ${scenario.rig}`;
      if (this.stockLoop !== loop) await this.other.load(await stockText(template), scenario.rig);
      this.stockLoop = loop;
      const flown = await this.other.fly(scenario);
      if (this.stockOf === of) this.stock = flown;
    } catch (failure) {
      [this.stockOf, this.beside] = ["", false];
      throw failure;
    }
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
