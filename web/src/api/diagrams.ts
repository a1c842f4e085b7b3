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
  kinds: Record<string, string>;
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

export async function shapes(blocks: readonly string[]): Promise<Answer[]> {
  // As texts put together: a number must arrive as it is written.
  return (await postText("diagrams/shapes", `{"blocks": [${blocks.join(", ")}]}`)) as Answer[];
}

export async function canonical(text: string): Promise<string> {
  return (await send<{ text: string }>("POST", "diagrams/read", { text })).text;
}

export async function check(text: string): Promise<Check> {
  return await send<Check>("POST", "diagrams/check", { text });
}

export async function code(text: string, precision: string): Promise<Code> {
  return await send<Code>("POST", "diagrams/code", { text, precision });
}

export async function starter(name: string): Promise<string> {
  return (await get<{ text: string }>(`diagrams/starters/${encodeURIComponent(name)}`)).text;
}

export async function keptDiagrams(): Promise<KeptDiagram[]> {
  return await get<KeptDiagram[]>("diagrams/files");
}

export async function keptText(name: string): Promise<string> {
  return (await get<{ text: string }>(`diagrams/files/${encodeURIComponent(name)}`)).text;
}

export async function keep(name: string, text: string): Promise<string> {
  return (await send<{ text: string }>("PUT", `diagrams/files/${encodeURIComponent(name)}`, { text })).text;
}

export async function forget(name: string): Promise<string> {
  return (await send<{ text: string }>("DELETE", `diagrams/files/${encodeURIComponent(name)}`)).text;
}

async function postText(path: string, text: string): Promise<unknown> {
  const body = new Blob([text], { type: "application/json" });
  return await (await request("POST", path, body)).json();
}

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

export async function compileLoop(text: string, rig: string, signal: AbortSignal): Promise<PortableLoop> {
  return (await (await request("POST", "diagrams/compile", { text, rig }, 40, signal)).json()) as PortableLoop;
}

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

/** Flash a rehearsed diagram. The drone builds it in up to two minutes. */
export const startFlash = (text: string, drone: number, rehearsal: string, force: boolean) =>
  send<Job<{ drone: number; template: string }>>("POST", "diagrams/flash", { text, drone, rehearsal, force });
