// Flies the compiled loop off the page's thread.
import { Program } from "../../../wasm/program";
import type { ProgramTable } from "../../../wasm/table";
import { fly, type Flight } from "./fly";

export interface Load {
  readonly do: "load";
  readonly id: number;
  readonly module: ArrayBuffer;
  readonly table: ProgramTable;
  readonly ticks: number;
}
export interface Run extends Flight {
  readonly do: "run";
  readonly id: number;
}
export type Asked = Load | Run;
export interface Answer {
  readonly id: number;
  readonly error?: string;
  readonly signals?: Record<string, Float64Array>;
}

let program: Program | undefined;
let ticks = 4;

async function load(asked: Load): Promise<Answer> {
  program = await Program.load(asked.module, asked.table);
  ticks = asked.ticks;
  return { id: asked.id };
}

function run(asked: Run): Answer {
  if (program === undefined) throw new Error("nothing is loaded");
  return { id: asked.id, signals: fly(program, ticks, asked) };
}

self.onmessage = async ({ data }: MessageEvent<Asked>) => {
  try {
    const answer = data.do === "load" ? await load(data) : run(data);
    const moved = Object.values(answer.signals ?? {}).map((values) => values.buffer);
    self.postMessage(answer, { transfer: moved });
  } catch (failure) {
    self.postMessage({ id: data.id, error: failure instanceof Error ? failure.message : String(failure) });
  }
};
