import { readJson, type JsonObject } from "../pages/diagram/model/json_text";
import type { Answer } from "../pages/diagram/model/shapes";
import type { Value } from "../wasm/signal";
import type { ProgramTable } from "../wasm/table";
import { get, request, send } from "./client";
import type { Job } from "./jobs";

export interface CatalogueEntry {
  type: string;
  name: string;
  group: string;
  text: string;
  choices: Record<string, string[]>;
  shape: Answer;
  /** Default arguments in Python's order; numbers as Python writes them. */
  config: JsonObject;
}

export interface Catalogue {
  /** Why diagrams cannot be simulated here; "" if they can. */
  not_simulated: string;
  blocks: CatalogueEntry[];
  starters: Record<string, { name: string; text: string }>;
}

/** Problem or remark; `where` is the path of a block, or "diagram.input". */
export interface Finding {
  what: string;
  where: string;
  remedy: string;
  loop?: string[];
}

export interface Check {
  fine: boolean;
  problems: Finding[];
  remarks: Finding[];
  sizes: Record<string, unknown> | null;
  template: { name: string; fits: boolean; faults: string[] } | null;
}

export interface KeptDiagram {
  name: string;
  changed: number;
}

export interface Code {
  lines: [text: string, block: string, part: string][];
  left_out: string[];
}

/** Return the library of blocks; default arguments keep 1.0 and 1 apart. */
export async function catalogue(): Promise<Catalogue> {
  const text = await (await request("GET", "diagrams/catalogue")).text();
  const found = JSON.parse(text) as Catalogue;
  const exact = readJson(text) as { blocks: { config: JsonObject }[] } & JsonObject;
  found.blocks.forEach((entry, i) => (entry.config = exact.blocks[i]?.config ?? {}));
  return found;
}

/** Ask for the ports of blocks; their texts are put together, as a number must arrive as it is written. */
export const shapes = (blocks: readonly string[]) =>
  send<Answer[]>(
    "POST",
    "diagrams/shapes",
    new Blob([`{"blocks": [${blocks.join(", ")}]}`], { type: "application/json" }),
  );

const at = (name: string) => `diagrams/files/${encodeURIComponent(name)}`;
const textOf = async (answer: Promise<{ text: string }>) => (await answer).text;

export const canonical = (text: string) => textOf(send("POST", "diagrams/read", { text }));
export const check = (text: string) => send<Check>("POST", "diagrams/check", { text });
export const code = (text: string, precision: string) => send<Code>("POST", "diagrams/code", { text, precision });
export const starter = (name: string) => textOf(get(`diagrams/starters/${encodeURIComponent(name)}`));
export const keptDiagrams = () => get<KeptDiagram[]>("diagrams/files");
export const keptText = (name: string) => textOf(get(at(name)));
export const keep = (name: string, text: string) => textOf(send("PUT", at(name), { text }));
export const forget = (name: string) => textOf(send("DELETE", at(name)));

/** Closed loop of the diagram and the virtual rig as WebAssembly, and its initial state. */
export interface PortableLoop {
  /** Base 64. */
  module: string;
  interface: ProgramTable;
  template: string;
  /** Path of the diagram in the loop. */
  prefix: string;
  parameters: Record<string, Value>;
  states: Record<string, Value>;
  signals: string[];
  /** Outputs of the module that the diagram's inputs read. */
  given: Record<string, string>;
  setpoints: string[];
  /** Ticks per step of the controller. */
  ticks: number;
}

export const compileLoop = (text: string, rig: string, signal: AbortSignal) =>
  send<PortableLoop>("POST", "diagrams/compile", { text, rig }, 40, signal);

/** Margins of one loop, SI; null if unlimited. The gain margin is a factor above 1. */
export interface LoopMargins {
  stable: boolean;
  crossover: number | null;
  gain_margin: number | null;
  phase_margin: number | null;
  delay_margin: number | null;
}

export interface AnalysedLoop extends LoopMargins {
  about: string;
  motion_text: string;
  ms: number | null;
  bode: { omega: number[]; gain: number[]; phase: number[] };
}

export interface Margins {
  rig: string;
  loops: Record<string, AnalysedLoop>;
}

export interface Change {
  what: string;
  kind: "added" | "removed" | "changed";
  path: string;
  before: string;
  after: string;
}

export interface Rehearsal {
  name: string;
  template: string;
  against: string;
  costs: { parameter_bytes: number; state_bytes: number };
  trial: {
    margins: Record<string, LoopMargins>;
    margins_unknown: string | null;
    fault: string | null;
  };
  remarks: string[];
  changes: Change[];
}

export interface Px4Module {
  module: string;
  /** Base 64. */
  zip: string;
  files: string[];
  parameters: Record<string, string>;
  not_exported: Record<string, string>;
  reads: string[];
  writes: string[];
  stops: string[];
}

export const startMargins = (text: string, rig: string) =>
  send<Job<Margins>>("POST", "diagrams/margins", { text, rig });
export const startPx4 = (text: string) => send<Job<Px4Module>>("POST", "diagrams/px4", { text });
export const startRehearsal = (text: string, drone: number) =>
  send<Job<Rehearsal>>("POST", "diagrams/rehearsal", { text, drone });

/** System of a Simulink model; `text` is its diagram, "" if something is refused. */
export interface SimulinkSystem {
  name: string;
  release: string;
  /** Paths with their numbers of blocks. */
  systems: [path: string, blocks: number][];
  svg: string;
  report: { path: string; kind: string; status: string; why: string }[];
  /** Lines of the report by status. */
  counts: Record<string, number>;
  notes: string[];
  /** Period [s]. */
  dt: number;
  text: string;
}

/** Read a system of a model, the first of `files`; the others are its libraries and workspace. */
export function simulink(files: readonly File[], system: string, end: AbortSignal): Promise<SimulinkSystem> {
  const query = new URLSearchParams({ system });
  for (const { name, size } of files) [query.append("name", name), query.append("size", String(size))];
  return send("POST", `diagrams/simulink?${query}`, new Blob([...files]), 60, end);
}

export const startFlash = (text: string, drone: number, rehearsal: string, force: boolean) =>
  send<Job<{ drone: number; template: string }>>("POST", "diagrams/flash", { text, drone, rehearsal, force });
