// Flies the compiled loop off the page's thread.
import { Program } from "../../../wasm/program";
import type { ProgramTable } from "../../../wasm/table";
import { fly, type Flight } from "./fly";

export type Asked = { do: "load"; module: ArrayBuffer; table: ProgramTable; ticks: number } | ({ do: "run" } & Flight);
export interface Answer {
  readonly id: number;
  readonly error?: string;
  readonly signals?: Record<string, Float64Array>;
}

let program: Program | undefined;
let ticks = 4;

async function answered(asked: Asked): Promise<Record<string, Float64Array>> {
  if (asked.do === "load") {
    program = await Program.load(asked.module, asked.table);
    ticks = asked.ticks;
    return {};
  }
  if (program === undefined) throw new Error("nothing is loaded");
  return fly(program, ticks, asked);
}

self.onmessage = async ({ data }: MessageEvent<Asked & { id: number }>) => {
  try {
    const signals = await answered(data);
    const moved = Object.values(signals).map((values) => values.buffer);
    self.postMessage({ id: data.id, signals }, { transfer: moved });
  } catch (failure) {
    self.postMessage({ id: data.id, error: failure instanceof Error ? failure.message : String(failure) });
  }
};
