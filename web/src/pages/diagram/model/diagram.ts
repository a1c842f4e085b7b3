// A diagram as the page edits it. Nothing here is ever changed in place: an edit makes a new diagram that shares what
// stayed, so that undo is keeping the old one, and what is drawn is compared by identity.
import { chartOf, opens } from "./chart";
import { isList, isObject, Num, readJson, writeJson, type Json, type JsonObject } from "./json_text";

/** "part.port" or "part", or an input's name; [source, "part.port"]. */
export type Connection = readonly [source: string, destination: string];
export type Output = readonly [name: string, source: string | null];
export type Point = readonly [x: number, y: number];
export const CONDITIONS = ["enable", "reset", "trigger"] as const;
export type Condition = (typeof CONDITIONS)[number];

export interface Block {
  readonly is: "block";
  readonly type: string;
  readonly json: JsonObject;
}

export interface Diagram {
  readonly is: "diagram";
  readonly name: string;
  readonly text: string;
  readonly inputs: readonly JsonObject[];
  readonly params: readonly JsonObject[];
  readonly parts: readonly Part[];
  readonly connections: readonly Connection[];
  readonly outputs: readonly Output[];
  /** Positions of moved inputs and outputs by name. */
  readonly inputPositions: Positions;
  readonly outputPositions: Positions;
  /** Of the chart of a state machine: its outputs and variables, and guard and action of each transition by port. */
  readonly chart?: {
    readonly ports: readonly JsonObject[];
    readonly variables: readonly JsonObject[];
    readonly ways: Readonly<Record<string, JsonObject>>;
  };
  /** Places by id of what has none in the file, as they were drawn before the last edit; not written. */
  readonly drawn?: ReadonlyMap<string, Point> | undefined;
}
export type Positions = Readonly<Record<string, readonly Num[]>>;

export interface Part {
  readonly name: string;
  readonly rate: readonly Num[] | null;
  /** Outer names of bound parameters by inner name. */
  readonly params: Readonly<Record<string, string>>;
  readonly conditions: Readonly<Partial<Record<Condition, string>>>;
  /** Properties that the page does not edit. */
  readonly rest: JsonObject;
  readonly position: readonly Num[] | null;
  readonly flipped: boolean;
  /** Place if the file gives none; it is not written. */
  readonly presumed?: Point;
  readonly item: Block | Diagram;
}

export const EMPTY: Diagram = {
  is: "diagram",
  name: "untitled",
  text: "",
  inputs: [],
  params: [],
  parts: [],
  connections: [],
  outputs: [],
  inputPositions: {},
  outputPositions: {},
};

// Ids of what stands on a sheet.
export const partId = (name: string): string => `p:${name}`;
export const inputId = (name: string): string => `i:${name}`;
export const outputId = (name: string): string => `o:${name}`;
export const wireId = (destination: string): string => `w:${destination}`;

export class DiagramFault extends Error {}

const SCHEMA = "twodof/diagram";
const VERSION = "1";
const REST = ["disabled", "edge", "enabling", "initial", "commented"] as const;

/** Read the text of a file. Raises JsonFault or DiagramFault. */
export function readDiagram(text: string): Diagram {
  const file = readJson(text);
  if (!isObject(file) || file["schema"] !== SCHEMA) throw new DiagramFault("this is not a diagram of twodof");
  const version = file["version"];
  if (!(version instanceof Num) || version.text !== VERSION) throw new DiagramFault("its version is unknown");
  return diagramFrom(file["diagram"]);
}

export function writeDiagram(diagram: Diagram): string {
  return writeJson({ schema: SCHEMA, version: new Num(VERSION), diagram: diagramTo(diagram) });
}

export function declaredName(declared: JsonObject): string {
  return string(declared["name"]);
}

export function placeOf(part: Part): Point | null {
  return pointOf(part.position) ?? part.presumed ?? null;
}

export function pointOf(position: readonly Num[] | null | undefined): Point | null {
  const [x, y] = position ?? [];
  return x === undefined || y === undefined ? null : [x.value, y.value];
}

/** Return all wires of a sheet, those to its outputs too: [source, destination]. */
export function wiresOf(d: Diagram): Connection[] {
  const outputs = d.outputs.flatMap(([name, source]) => (source === null ? [] : [[source, name] as const]));
  return [...d.connections, ...outputs];
}

/** Return the source of the wire to "part.port" or to an output. */
export function sourceOf(d: Diagram, destination: string): string | undefined {
  return wiresOf(d).find(([, to]) => to === destination)?.[0];
}

/** Return the names of inputs; the fields of a bus count as one. */
export function inputNames(d: Diagram): string[] {
  return [...new Set(d.inputs.map((one) => declaredName(one).split(".")[0] ?? ""))];
}

const byName = new WeakMap<readonly Part[], ReadonlyMap<string, Part>>();

export function findPart(diagram: Diagram, name: string): Part | undefined {
  let parts = byName.get(diagram.parts);
  if (parts === undefined) {
    parts = new Map([...diagram.parts].reverse().map((part) => [part.name, part])); // the first of two counts
    byName.set(diagram.parts, parts);
  }
  return parts.get(name);
}

export function diagramAt(root: Diagram, path: readonly string[]): Diagram | undefined {
  let here: Diagram = root;
  for (const name of path) {
    const part = findPart(here, name);
    if (part === undefined || !opens(part)) return undefined;
    here = part.item.is === "diagram" ? part.item : chartOf(part.item);
  }
  return here;
}

export function diagramFrom(json: Json | undefined): Diagram {
  const data = object(json, "the diagram");
  return {
    is: "diagram",
    name: string(data["name"]),
    text: data["text"] === undefined ? "" : string(data["text"]),
    inputs: list(data["inputs"]).map((one) => object(one, "an input")),
    params: list(data["params"]).map((one) => object(one, "a parameter")),
    parts: list(data["parts"]).map(partFrom),
    connections: list(data["connections"]).map((pair) => {
      const [source, destination] = list(pair);
      return [string(source), string(destination)] as const;
    }),
    outputs: list(data["outputs"]).map((pair) => {
      const [name, source] = list(pair);
      return [string(name), source === null || source === undefined ? null : string(source)] as const;
    }),
    inputPositions: positionsFrom(data["input_positions"]),
    outputPositions: positionsFrom(data["output_positions"]),
  };
}

function positionsFrom(json: Json | undefined): Positions {
  const found = Object.entries(object(json ?? {}, "the positions"));
  return Object.fromEntries(found.map(([name, at]) => [name, list(at).map(number)]));
}

export function partFrom(json: Json): Part {
  const form = object(json, "a part");
  const block = form["block"];
  const conditions: Partial<Record<Condition, string>> = {};
  for (const key of CONDITIONS) if (typeof form[key] === "string") conditions[key] = form[key];
  const rest: Record<string, Json> = {};
  for (const key of REST) if (form[key] !== undefined) rest[key] = form[key];
  const params: Record<string, string> = Object.create(null) as Record<string, string>;
  for (const [inner, outer] of Object.entries(object(form["params"] ?? {}, "params"))) params[inner] = string(outer);
  return {
    name: string(form["name"]),
    rate: form["rate"] === undefined ? null : list(form["rate"]).map(number),
    params,
    conditions,
    rest,
    position: form["position"] === undefined || form["position"] === null ? null : list(form["position"]).map(number),
    flipped: form["flipped"] === true,
    item: block === undefined ? diagramFrom(form["diagram"]) : blockFrom(block),
  };
}

function blockFrom(json: Json): Block {
  const form = object(json, "a block");
  return { is: "block", type: string(form["type"]), json: form };
}

export function diagramTo(d: Diagram): JsonObject {
  return {
    name: d.name,
    text: d.text,
    inputs: d.inputs,
    params: d.params,
    parts: d.parts.map(partTo),
    connections: d.connections,
    outputs: d.outputs,
    ...(Object.keys(d.inputPositions).length === 0 ? {} : { input_positions: d.inputPositions }),
    ...(Object.keys(d.outputPositions).length === 0 ? {} : { output_positions: d.outputPositions }),
  };
}

/** A part's keys in the order of Python's writer. */
export function partTo(part: Part): JsonObject {
  const form: Record<string, Json> = { name: part.name };
  if (part.rate !== null) form["rate"] = part.rate;
  if (Object.keys(part.params).length > 0) form["params"] = part.params;
  for (const key of CONDITIONS) if (part.conditions[key]) form[key] = part.conditions[key];
  for (const key of REST) if (part.rest[key] !== undefined) form[key] = part.rest[key];
  if (part.position !== null) form["position"] = part.position;
  if (part.flipped) form["flipped"] = true;
  if (part.item.is === "diagram") form["diagram"] = diagramTo(part.item);
  else form["block"] = part.item.json;
  return form;
}

function object(json: Json | undefined, what: string): JsonObject {
  if (!isObject(json)) throw new DiagramFault(`${what} is not an object`);
  return json;
}

function list(json: Json | undefined): readonly Json[] {
  if (json === undefined) return [];
  if (!isList(json)) throw new DiagramFault("a list is missing");
  return json;
}

function string(json: Json | undefined): string {
  if (typeof json !== "string") throw new DiagramFault("a name is missing");
  return json;
}

function number(json: Json): Num {
  if (!(json instanceof Num)) throw new DiagramFault("a number is missing");
  return json;
}
