import type { Value } from "../wasm/signal";
import type { ProgramTable } from "../wasm/table";

/** Data of `twodof.sim.portable_loop.play_program`. */
export interface PlayData {
  table: ProgramTable;
  ticks: number;
  modes: string[];
  states: string[];
  actions: string[];
  causes: { name: string; text: string }[];
  rigs: Record<string, Record<string, number>>;
  starts: Record<"rest" | "hover", { parameters: Record<string, number>; states: Record<string, Value> }>;
  texts: Record<string, string>;
}

/** Read the module and its data from the page itself. */
export function embedded(): { module: Uint8Array<ArrayBuffer>; data: PlayData } {
  const text = (id: string): string => {
    const found = document.getElementById(id)?.textContent?.trim();
    if (!found) throw new Error(`the page has no ${id}: build it by make play`);
    return found;
  };
  const module = Uint8Array.from(atob(text("play-module")), (letter) => letter.charCodeAt(0));
  return { module, data: JSON.parse(text("play-data")) as PlayData };
}
