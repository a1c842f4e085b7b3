// Edits: each takes a diagram and gives the one after it. What they refuse is a sentence in an EditFault.
import type { Block, Connection, Diagram, Part, Point, Positions } from "./diagram";
import { declaredName } from "./diagram";
import { Num, real, type Json, type JsonObject } from "./json_text";
import { blockOf, chartOf, opens } from "./chart";
import type { Parameter, Port } from "./shapes";

export class EditFault extends Error {}

const NAME = /^[A-Za-z][A-Za-z0-9_]{0,62}$/;

/** Return the diagram's name for a file's name, which may have other characters. */
export function nameForFile(file: string): string {
  return file
    .replace(/\W+/g, "_")
    .replace(/^(?![A-Za-z])/, "d")
    .slice(0, 63);
}

/** Apply an edit to the sub-diagram at a path. */
export function edited(root: Diagram, path: readonly string[], edit: (d: Diagram) => Diagram): Diagram {
  const [name, ...rest] = path;
  if (name === undefined) return edit(root);
  let found = false;
  const parts = root.parts.map((part) => {
    if (part.name !== name || !opens(part)) return part;
    found = true;
    const before = part.item.is === "diagram" ? part.item : chartOf(part.item);
    const after = edited(before, rest, edit);
    return after === before ? part : { ...part, item: part.item.is === "diagram" ? after : blockOf(part.item, after) };
  });
  if (!found) throw new EditFault(`there is no sub-diagram ${name}`);
  return parts.every((part, i) => part === root.parts[i]) ? root : { ...root, parts };
}

export function taken(d: Diagram): Set<string> {
  const tops = [...d.inputs, ...d.params, ...(d.chart?.variables ?? [])].map(
    (one) => declaredName(one).split(".")[0] ?? "",
  );
  return new Set([...d.parts.map((part) => part.name), ...tops]);
}

/** Return `wanted`, with a number if it is used. */
export function freeName(d: Diagram, wanted: string, also: Iterable<string> = []): string {
  return namer(new Set([...taken(d), ...also]))(wanted);
}

/** Return a function that returns and adds to `used` the name wanted, with a number if it is used. */
export function namer(used: Set<string>): (wanted: string) => string {
  return (wanted) => {
    const stem = wanted.replace(/_?\d+$/, "").slice(0, 56);
    let name = wanted;
    for (let n = 2; used.has(name); n++) name = `${stem}_${n}`;
    used.add(name);
    return name;
  };
}

export function checkForm(name: string): void {
  if (!NAME.test(name)) throw new EditFault(`"${name}" is not a name: use a letter, then letters, digits or _`);
}

function checkName(d: Diagram, name: string, besides = ""): void {
  checkForm(name);
  if (name !== besides && taken(d).has(name)) throw new EditFault(`the name ${name} is taken`);
}

export function addPart(d: Diagram, part: Part): Diagram {
  checkName(d, part.name);
  return { ...d, parts: [...d.parts, part] };
}

export function changePart(d: Diagram, name: string, change: (part: Part) => Part): Diagram {
  return { ...d, parts: d.parts.map((part) => (part.name === name ? change(part) : part)) };
}

export function movePart(part: Part, to: Point): Part {
  return { ...part, position: written(to) };
}

export function flipParts(d: Diagram, names: ReadonlySet<string>): Diagram {
  return { ...d, parts: d.parts.map((one) => (names.has(one.name) ? { ...one, flipped: !one.flipped } : one)) };
}

export function written(to: Point): Num[] {
  return to.map((v) => real(Math.min(1e6, Math.max(-1e6, Math.round(v * 100) / 100))));
}

export function moveParts(d: Diagram, places: ReadonlyMap<string, Point>): Diagram {
  const parts = d.parts.map((part) => {
    const to = places.get(part.name);
    return to === undefined ? part : movePart(part, to);
  });
  return { ...d, parts };
}

/** Move nodes by id. */
export function moveThings(d: Diagram, places: ReadonlyMap<string, Point>): Diagram {
  const of = (mark: string) =>
    [...places].filter(([id]) => id.startsWith(mark)).map(([id, to]) => [id.slice(2), to] as const);
  const moved = (before: Positions, mark: string): Positions => {
    const some = of(mark).map(([name, to]) => [name, written(to)] as const);
    return some.length === 0 ? before : { ...before, ...Object.fromEntries(some) };
  };
  return {
    ...moveParts(d, new Map(of("p:"))),
    inputPositions: moved(d.inputPositions, "i:"),
    outputPositions: moved(d.outputPositions, "o:"),
  };
}

/** Forget the places of inputs and outputs. */
export function freeBorder(d: Diagram): Diagram {
  return { ...d, inputPositions: {}, outputPositions: {}, drawn: new Map() };
}

/** Write the presumed places once any node has a place of its own. */
export function settled(d: Diagram): Diagram {
  const positions = [d.inputPositions, d.outputPositions].some((one) => Object.keys(one).length > 0);
  if (!positions && d.parts.every((part) => part.position === null)) return d;
  if (!d.parts.some((part) => part.position === null && part.presumed !== undefined)) return d;
  const keep = (part: Part): Part =>
    part.position === null && part.presumed !== undefined ? movePart(part, part.presumed) : part;
  return { ...d, parts: d.parts.map(keep) };
}

/** Return the part with `change`; the same part if nothing changes. */
function updated(part: Part, change: Partial<Part>): Part {
  const keys = Object.keys(change) as (keyof Part)[];
  return keys.every((key) => part[key] === change[key]) ? part : { ...part, ...change };
}

/** Keep the entries for which `keep` is true; the same record if none goes. */
function filtered<V>(record: Readonly<Record<string, V>>, keep: (key: string, value: V) => boolean): typeof record {
  const kept = Object.entries(record).filter(([key, value]) => keep(key, value));
  return kept.length === Object.keys(record).length ? record : Object.fromEntries(kept);
}

/** Rename a key; the same record if it is not there. */
function rekeyed<V>(record: Readonly<Record<string, V>>, from: string, to: string): typeof record {
  if (!Object.hasOwn(record, from)) return record;
  return Object.fromEntries(Object.entries(record).map(([key, value]) => [key === from ? to : key, value]));
}

/** Change the values; the same record if none changes. */
function mapped(record: Readonly<Record<string, string>>, change: (value: string) => string): typeof record {
  if (Object.values(record).every((value) => change(value) === value)) return record;
  return Object.fromEntries(Object.entries(record).map(([key, value]) => [key, change(value)]));
}

/** Remove parts with their wires and conditions. */
export function removeParts(d: Diagram, names: ReadonlySet<string>): Diagram {
  const parts = d.parts.filter((part) => !names.has(part.name));
  const connections = d.connections.filter(([, to]) => !names.has(to.split(".")[0] ?? ""));
  return withoutSources({ ...d, parts, connections }, (source) => {
    return names.has(source.split(".")[0] ?? "") && !isInput(d, source);
  });
}

/** Remove the wires and conditions that come from `gone` sources. */
function withoutSources(d: Diagram, gone: (source: string) => boolean): Diagram {
  return {
    ...d,
    parts: d.parts.map((part) => updated(part, { conditions: filtered(part.conditions, (_, s) => !gone(s)) })),
    connections: d.connections.filter(([source]) => !gone(source)),
    outputs: d.outputs.map(([name, source]) => [name, source !== null && gone(source) ? null : source] as const),
  };
}

function isInput(d: Diagram, source: string): boolean {
  return d.inputs.some((one) => declaredName(one).split(".")[0] === source.split(".")[0]);
}

/** Wire a source to "part.port" or to an output; replaces the wire there. */
export function connect(d: Diagram, source: string, destination: string): Diagram {
  if (d.outputs.some(([name]) => name === destination)) {
    return { ...d, outputs: d.outputs.map(([name, from]) => [name, name === destination ? source : from] as const) };
  }
  const overlaps = (to: string): boolean =>
    to === destination || to.startsWith(`${destination}.`) || destination.startsWith(`${to}.`);
  const connections = d.connections.filter(([, to]) => !overlaps(to));
  return { ...d, connections: [...connections, [source, destination] as Connection] };
}

export function disconnect(d: Diagram, destinations: ReadonlySet<string>): Diagram {
  return {
    ...d,
    connections: d.connections.filter(([, to]) => !destinations.has(to)),
    outputs: d.outputs.map(([name, source]) => [name, destinations.has(name) ? null : source] as const),
  };
}

export function renamePart(d: Diagram, from: string, to: string): Diagram {
  if (from === to) return d;
  checkName(d, to, from);
  return renamed({ ...d, parts: d.parts.map((p) => (p.name === from ? { ...p, name: to } : p)) }, from, to, true);
}

export function renameInput(d: Diagram, from: string, to: string): Diagram {
  if (from === to) return d;
  checkName(d, to, from);
  const inputs = d.inputs.map((one) => (declaredName(one) === from ? { ...one, name: to } : one));
  return renamed({ ...d, inputs, inputPositions: rekeyed(d.inputPositions, from, to) }, from, to, false);
}

/** Rename sources and, for a part, destinations. */
function renamed(d: Diagram, from: string, to: string, part: boolean): Diagram {
  const follow = (end: string): string =>
    end === from ? to : end.startsWith(`${from}.`) ? to + end.slice(from.length) : end;
  return {
    ...d,
    parts: d.parts.map((one) => updated(one, { conditions: mapped(one.conditions, follow) })),
    connections: d.connections.map((pair) => {
      const next = [follow(pair[0]), part ? follow(pair[1]) : pair[1]] as const;
      return next[0] === pair[0] && next[1] === pair[1] ? pair : next;
    }),
    outputs: d.outputs.map(([name, source]) => [name, source === null ? null : follow(source)] as const),
  };
}

export function addInput(d: Diagram, declared: JsonObject): Diagram {
  checkName(d, declaredName(declared));
  return { ...d, inputs: [...d.inputs, declared] };
}

export function removeInput(d: Diagram, name: string): Diagram {
  const inputs = d.inputs.filter((one) => declaredName(one) !== name);
  const inputPositions = filtered(d.inputPositions, (one) => one !== name);
  return withoutSources({ ...d, inputs, inputPositions }, (source) => {
    return source === name || source.startsWith(`${name}.`);
  });
}

function checkOutput(d: Diagram, name: string): void {
  checkForm(name);
  if (d.outputs.some(([one]) => one === name)) throw new EditFault(`the name ${name} is taken`);
}

export function addOutput(d: Diagram, name: string, source: string | null = null): Diagram {
  checkOutput(d, name);
  return { ...d, outputs: [...d.outputs, [name, source] as const] };
}

export function removeOutput(d: Diagram, name: string): Diagram {
  const outputs = d.outputs.filter(([one]) => one !== name);
  return { ...d, outputs, outputPositions: filtered(d.outputPositions, (one) => one !== name) };
}

export function renameOutput(d: Diagram, from: string, to: string): Diagram {
  if (from === to) return d;
  checkOutput(d, to);
  const outputs = d.outputs.map(([name, source]) => [name === from ? to : name, source] as const);
  return { ...d, outputs, outputPositions: rekeyed(d.outputPositions, from, to) };
}

/** What a diagram or a chart declares with a type; the outputs of a chart are its ports. */
export type Section = "inputs" | "params" | "ports" | "variables";

function withVariables(d: Diagram, change: (all: readonly JsonObject[]) => readonly JsonObject[]): Diagram {
  return d.chart ? { ...d, chart: { ...d.chart, variables: change(d.chart.variables) } } : d;
}

export function addVariable(d: Diagram, name: string): Diagram {
  checkName(d, name);
  return withVariables(d, (all) => [...all, { name, initial: real(0) }]);
}

export function removeVariable(d: Diagram, name: string): Diagram {
  return withVariables(d, (all) => all.filter((one) => declaredName(one) !== name));
}

export function renameVariable(d: Diagram, from: string, to: string): Diagram {
  if (from !== to) checkName(d, to, from);
  return withVariables(d, (all) => all.map((one) => (declaredName(one) === from ? { ...one, name: to } : one)));
}

/** Set a property of an input, parameter or the like; undefined removes it. */
export function declare(d: Diagram, section: Section, name: string, key: string, value: Json | undefined): Diagram {
  const change = (one: JsonObject): JsonObject => {
    const { [key]: _, ...rest } = one;
    if (value === undefined) return rest;
    return key in one ? { ...one, [key]: value } : ordered({ ...one, [key]: value });
  };
  const changed = (all: readonly JsonObject[]): JsonObject[] =>
    all.map((one) => (declaredName(one) === name ? change(one) : one));
  if (section === "inputs" || section === "params") return { ...d, [section]: changed(d[section]) };
  return d.chart ? { ...d, chart: { ...d.chart, [section]: changed(d.chart[section]) } } : d;
}

export function declared(name: string, port: Port): JsonObject {
  return {
    name,
    ...(port.kind !== "real" && { kind: port.kind }),
    ...(port.width !== null && { width: new Num(String(port.width)) }),
    ...(port.unit !== "" && { unit: port.unit }),
  };
}

const ORDER = ["name", "value", "kind", "width", "unit", "low", "high", "text", "tunable", "shape", "enum"];

function ordered(one: JsonObject): JsonObject {
  const place = (key: string): number => (ORDER.includes(key) ? ORDER.indexOf(key) : ORDER.length);
  return Object.fromEntries(Object.entries(one).sort(([a], [b]) => place(a) - place(b)));
}

export function configure(part: Part, key: string, value: Json): Part {
  if (part.item.is !== "block") return part;
  const config = (part.item.json["config"] ?? {}) as JsonObject;
  return { ...part, item: { ...part.item, json: { ...part.item.json, config: { ...config, [key]: value } } } };
}

export function setDeclared(part: Part, name: string, value: Json): Part {
  if (part.item.is !== "block") return part;
  const params = (part.item.json["params"] ?? []) as readonly JsonObject[];
  const changed = params.map((one) => (declaredName(one) === name ? { ...one, value } : one));
  return { ...part, item: { ...part.item, json: { ...part.item.json, params: changed } } };
}

/** Run the part at ticks with tick % divider == offset. */
export function setRate(part: Part, divider: number, offset: number): Part {
  const base = divider === 1 && offset === 0;
  return { ...part, rate: base ? null : [new Num(String(divider)), new Num(String(offset))] };
}

/** Bind a parameter of a part to one of the diagram; "" unbinds it. */
export function bind(part: Part, inner: string, outer: string): Part {
  const params = filtered(part.params, (name) => name !== inner);
  return { ...part, params: outer === "" ? params : { ...params, [inner]: outer } };
}

export function newPart(d: Diagram, wanted: string, item: Block | Diagram, position: Point): Part {
  const name = freeName(d, wanted);
  return movePart(
    { name, rate: null, params: {}, conditions: {}, rest: {}, position: null, flipped: false, item },
    position,
  );
}

export function addParam(d: Diagram, declared: JsonObject): Diagram {
  checkName(d, declaredName(declared));
  return { ...d, params: [...d.params, declared] };
}

/** Declare a parameter of the diagram like one of a part, and bind that to it. */
export function withParameter(d: Diagram, part: Part, parameter: Parameter): Diagram {
  const { kind, low, high, text } = parameter;
  const one = (value: unknown): Json =>
    typeof value === "boolean" ? value : kind === "real" ? real(Number(value)) : new Num(String(value));
  const name = freeName(d, `${part.name}_${parameter.name.replaceAll(".", "_")}`.slice(0, 56));
  const made = ordered({
    ...declared(name, parameter),
    value: Array.isArray(parameter.value) ? parameter.value.map(one) : one(parameter.value),
    ...(low !== null && { low: real(low) }),
    ...(high !== null && { high: real(high) }),
    ...(text !== "" && { text }),
  });
  return changePart(addParam(d, made), part.name, (p) => bind(p, parameter.name, name));
}

export function removeParam(d: Diagram, name: string): Diagram {
  const parts = d.parts.map((part) => updated(part, { params: filtered(part.params, (_, outer) => outer !== name) }));
  return { ...d, parts, params: d.params.filter((one) => declaredName(one) !== name) };
}

export function renameParam(d: Diagram, from: string, to: string): Diagram {
  if (from === to) return d;
  checkName(d, to, from);
  const follow = (outer: string): string => (outer === from ? to : outer);
  const parts = d.parts.map((part) => updated(part, { params: mapped(part.params, follow) }));
  return { ...d, parts, params: d.params.map((one) => (declaredName(one) === from ? { ...one, name: to } : one)) };
}
