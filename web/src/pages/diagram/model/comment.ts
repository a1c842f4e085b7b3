// Commented blocks: a sub-diagram with the ports of a block stands in its place and holds it; nothing reads the block.
import type { Block, Connection, Diagram, Output, Part } from "./diagram";
import { declaredName, EMPTY, findPart } from "./diagram";
import { declared, EditFault, newPart } from "./edits";
import { Num, real, type Json, type JsonObject } from "./json_text";
import { tops, type Port, type Shapes } from "./shapes";

/** Descriptions of such a sub-diagram. */
export const COMMENTS = {
  out: "Commented out: the outputs are 0.",
  through: "Commented through: the outputs are the inputs.",
} as const;
export type Comment = keyof typeof COMMENTS;

/** Return how a part is commented and the block that it holds; undefined for a part in use. */
export function commented({ item, rest }: Part): { how: Comment; held: Part } | undefined {
  if (item.is !== "diagram") return undefined;
  const by = (["out", "through"] as const).find((how) => item.text === COMMENTS[how]); // in files without `commented`
  const how = (rest["commented"] as Comment | undefined) || by;
  const held = item.parts[0];
  return how === undefined || held === undefined ? undefined : { how, held };
}

/** Comment parts, or use them again if all of them are commented so. */
export function commentToggled(d: Diagram, names: ReadonlySet<string>, how: Comment, shapes: Shapes): Diagram {
  const chosen = [...names].flatMap((name) => findPart(d, name) ?? []);
  const back = chosen.every((part) => commented(part)?.how === how);
  const change = (part: Part): Part => (back ? inUse(part) : wrapped(d, inUse(part), how, shapes));
  return { ...d, parts: d.parts.map((part) => (names.has(part.name) ? change(part) : part)) };
}

function inUse(part: Part): Part {
  const held = commented(part)?.held;
  if (held === undefined) return part;
  const { commented: _, ...rest } = part.rest;
  const bound = Object.entries(held.params).flatMap(([name, inner]) => {
    const outer = part.params[inner];
    return outer === undefined ? [] : [[name, outer] as const];
  });
  return { ...part, rest, item: held.item, params: Object.fromEntries(bound) };
}

function wrapped(d: Diagram, part: Part, how: Comment, shapes: Shapes): Part {
  const { inputs, outputs } = shapes.of(part.item);
  const params = new Set(Object.values(part.params));
  const clash = tops(inputs).find((port) => params.has(port));
  if (clash !== undefined) throw new EditFault(`${clash} names a parameter and an input of ${part.name}: rename one`);
  const connections: Connection[] = [];
  const outer: Output[] = [];
  let sub: Diagram = {
    ...EMPTY,
    name: part.name,
    text: COMMENTS[how],
    inputs: inputs.map((port) => declared(port.name, port)),
    params: d.params.filter((one) => params.has(declaredName(one))),
  };
  const put = (name: string, item: Block | Diagram, bound: Part["params"] = {}): string => {
    const made = newPart(sub, name, item, [160, 20 + 100 * sub.parts.length]);
    sub = { ...sub, parts: [...sub.parts, { ...made, params: bound }] };
    return made.name;
  };
  const block = put("block", part.item, part.params);
  for (const port of inputs) connections.push([port.name, `${block}.${port.name}`]);
  const left = [...inputs];
  for (const port of outputs) {
    if (port.name.includes(".")) throw new EditFault(`${part.name} gives a bus, which cannot be commented: delete it`);
    let source: string;
    if (how === "out") source = put("zero", library("constant", port, { value: zero(port) }));
    else {
      const at = left.findIndex((one) => one.kind === port.kind && one.width === port.width);
      const [input] = at < 0 ? [] : left.splice(at, 1);
      if (input === undefined) {
        throw new EditFault(`${part.name} has no input like its output ${port.name}: comment it out (Ctrl+Shift+X)`);
      }
      source = input.name;
      if (port.kind === "real" && input.unit !== port.unit) {
        const units = { k: real(1), gain_unit: "", input_unit: input.unit };
        source = put("pass", library("gain", port, units));
        connections.push([input.name, `${source}.u`]);
      }
    }
    outer.push([port.name, source]);
  }
  const item: Diagram = { ...sub, connections, outputs: outer };
  const rest = { ...part.rest, commented: how };
  return { ...part, rest, item, params: Object.fromEntries([...params].map((name) => [name, name])) };
}

function zero({ kind, width }: Port): Json {
  const one = kind === "bool" ? false : kind === "real" || kind.startsWith("float") ? real(0) : new Num("0");
  return width === null ? one : Array<Json>(width).fill(one);
}

function library(type: "constant" | "gain", { kind, width, unit }: Port, more: JsonObject): Block {
  const size = { width: width === null ? null : new Num(String(width)), unit };
  return { is: "block", type, json: { type, config: { ...more, ...(type === "constant" && { kind }), ...size } } };
}
