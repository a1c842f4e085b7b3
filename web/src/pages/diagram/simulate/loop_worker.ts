// A compiled loop in a worker of its own.
import * as api from "../../../api/diagrams";
import type { ControlLoop } from "../../../loops";
import type { Value } from "../../../wasm/signal";
import { flown, PERIOD, type Scenario } from "./scenario";
import type { Answer, Asked } from "./worker";

export interface Flown {
  readonly loop: ControlLoop;
  readonly time: Float64Array;
  readonly signals: Readonly<Record<string, Float64Array>>;
  readonly prefix: string;
  readonly given: Readonly<Record<string, string>>;
}

export class LoopWorker {
  loop: api.PortableLoop | undefined;
  private worker: Worker | undefined;
  private readonly waiting = new Map<number, (answer: Answer) => void>();

  /** Compile a diagram in its loop. Raises ApiError, or AbortError if another one is compiled instead. */
  async load(text: string, rig: string, signal = new AbortController().signal): Promise<api.PortableLoop> {
    const loop = await api.compileLoop(text, rig, signal);
    if (signal.aborted) throw new DOMException("another one is compiled", "AbortError");
    const module = Uint8Array.from(atob(loop.module), (c) => c.charCodeAt(0)).buffer;
    await this.ask({ do: "load", module, table: loop.interface, ticks: loop.ticks });
    return (this.loop = loop);
  }

  /** Fly a scenario with values of parameters; `shown` are the paths of further signals. */
  async fly(scenario: Scenario, own: Record<string, Value> = {}, shown: readonly string[] = []): Promise<Flown> {
    const { prefix, given, ...loop } = this.loop!;
    const plan = flown(scenario, loop.template, loop.setpoints);
    const outputs = loop.interface.outputs.map((one) => one.path);
    const elements = outputs.filter((path) => shown.some((one) => path === one || path.startsWith(`${one}.`)));
    const { signals = {} } = await this.ask({
      do: "run",
      parameters: { ...loop.parameters, ...plan.parameters, ...own },
      states: loop.states,
      inputs: plan.inputs,
      columns: plan.columns,
      steps: plan.steps,
      wanted: [...new Set([`${plan.loop.loop}0`, `true_${plan.loop.loop}`, "M", "T", ...elements])],
    });
    const time = Float64Array.from({ length: plan.steps }, (_, k) => k * PERIOD);
    return { loop: plan.loop, time, signals, prefix, given };
  }

  stop(): void {
    this.worker?.terminate();
    this.worker = undefined;
  }

  /** Raises Error if the worker refuses. */
  private async ask(asked: Asked): Promise<Answer> {
    this.worker ??= this.start();
    const id = Math.random();
    const answer = await new Promise<Answer>((resolve) => {
      this.waiting.set(id, resolve);
      this.worker!.postMessage({ ...asked, id });
    });
    if (answer.error !== undefined) throw new Error(answer.error);
    return answer;
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
}
