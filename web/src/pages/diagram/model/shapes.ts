// What ports and parameters a part has. A library block's follow from its arguments, which Python decides: the page asks
// the server once for each block and keeps the answer by the block's text.
import { MACHINE, STATE } from "./chart";
import { declaredName, findPart, type Block, type Diagram, type Part } from "./diagram";
import { isList, isObject, Num, readJson, writeJson, type Json, type JsonObject } from "./json_text";

export interface Port {
  readonly name: string;
  readonly kind: string;
  readonly width: number | null;
  readonly unit: string;
}

export interface Parameter extends Port {
  readonly value: unknown;
  readonly low: number | null;
  readonly high: number | null;
  readonly text: string;
}

export interface Shape {
  readonly inputs: readonly Port[];
  readonly outputs: readonly Port[];
  readonly params: readonly Parameter[];
  /** Equal for blocks that differ in values of parameters only. */
  readonly structure: string;
}

/** Shape of a block, or the server's refusal. */
export type Answer = Shape | { readonly what: string; readonly where: string; readonly remedy: string };

const NOTHING: Shape = { inputs: [], outputs: [], params: [], structure: "" };

export class Shapes {
  private readonly known = new Map<string, Answer>();
  private readonly byType = new Map<string, { readonly config: Json; readonly shape: Shape }[]>();
  private readonly keys = new WeakMap<Block, string>();
  private readonly own = new WeakMap<Block | Diagram, Shape>();

  key(block: Block): string {
    let key = this.keys.get(block);
    if (key === undefined) {
      key = writeJson(block.json);
      this.keys.set(block, key);
    }
    return key;
  }

  learn(key: string, answer: Answer): void {
    this.known.set(key, answer);
    if (!("inputs" in answer)) return;
    const read = readJson(key);
    if (!isObject(read) || typeof read["type"] !== "string") return;
    const alike = this.byType.get(read["type"]) ?? [];
    if (alike.some(({ shape }) => shape.structure === answer.structure)) return;
    this.byType.set(read["type"], [...alike, { config: read["config"] ?? {}, shape: answer }]);
  }

  /** Return the shape of the known block with the most arguments in common. */
  private nearest(block: Block): Shape {
    const config = block.json["config"];
    const own = isObject(config) ? Object.entries(config).map(([name, value]) => [name, writeJson(value)]) : [];
    let [best, most] = [NOTHING, -1];
    for (const { config: other, shape } of this.byType.get(block.type) ?? []) {
      if (!isObject(other)) continue;
      const common = own.filter(([name, text]) => name! in other && writeJson(other[name!]!) === text).length;
      if (common >= most) [best, most] = [shape, common]; // of two the one that was seen later
    }
    return best;
  }

  /** Return the library blocks without a known shape, sub-diagrams included. */
  unknown(diagram: Diagram, found = new Map<string, Block>()): Map<string, Block> {
    for (const { item } of diagram.parts) {
      if (item.is === "diagram") this.unknown(item, found);
      else if (fromLibrary(item) && !this.known.has(this.key(item))) found.set(this.key(item), item);
    }
    return found;
  }

  refusal(item: Block | Diagram): { what: string; where: string; remedy: string } | undefined {
    if (item.is === "diagram" || !fromLibrary(item)) return undefined;
    const answer = this.known.get(this.key(item));
    return answer !== undefined && "what" in answer ? answer : undefined;
  }

  /** Return the shape of a part; that of a similar block if it is unknown or refused. */
  of(item: Block | Diagram): Shape {
    if (item.is === "block" && fromLibrary(item)) {
      const answer = this.known.get(this.key(item));
      if (answer !== undefined && "inputs" in answer) return answer;
      // Not answered yet, or refused: its wires stay where they are.
      let presumed = this.own.get(item);
      if (presumed === undefined) this.own.set(item, (presumed = this.nearest(item)));
      return presumed;
    }
    let shape = this.own.get(item);
    if (shape === undefined) {
      shape = item.is === "diagram" ? this.ofDiagram(item) : ofCustom(item);
      this.own.set(item, shape);
    }
    return shape;
  }

  private ofDiagram(d: Diagram): Shape {
    return {
      inputs: d.inputs.map(portOf),
      outputs: d.outputs.map(([name, source]) => ({ ...this.carried(d, source), name })),
      params: d.params.map(parameterOf),
      structure: "",
    };
  }

  /** Return the port of a source, as far as it is known. */
  carried(d: Diagram, source: string | null): Port {
    const nothing: Port = { name: "", kind: "real", width: null, unit: "" };
    if (source === null) return nothing;
    const input = d.inputs.find((one) => declaredName(one) === source);
    if (input !== undefined) return portOf(input);
    const [name = "", ...path] = source.split(".");
    const part = findPart(d, name);
    if (part === undefined) return nothing;
    const outputs = this.of(part.item).outputs;
    const port = path.join(".");
    return outputs.find((one) => one.name === port) ?? (port === "" ? outputs[0] : undefined) ?? nothing;
  }
}

export function fromLibrary(block: Block): boolean {
  return !["custom", MACHINE, STATE].includes(block.type);
}

export function portText({ kind, width, unit }: Port): string {
  return `${kind}${width === null ? "" : ` × ${width}`}${unit && ` [${unit}]`}`;
}

const named = new WeakMap<readonly Port[], readonly string[]>();

/** Return the names of ports; the fields of a bus count as one. */
export function tops(ports: readonly Port[]): readonly string[] {
  let names = named.get(ports);
  if (names === undefined) named.set(ports, (names = [...new Set(ports.map((port) => port.name.split(".")[0] ?? ""))]));
  return names;
}

/** Split a source: "pid" is ["pid", "M"], an input "q" is [null, "q"]. */
export function sourceEnd(d: Diagram, shapes: Shapes, source: string): readonly [string | null, string] | undefined {
  if (d.inputs.some((one) => inBus(declaredName(one), source))) return [null, source];
  const [name = "", ...path] = source.split(".");
  const part = findPart(d, name);
  if (part === undefined) {
    const bus = d.inputs.some((one) => declaredName(one) === name);
    return bus ? [null, source] : undefined;
  }
  const names = tops(shapes.of(part.item).outputs);
  const port = path.join(".");
  if (port === "") return names[0] === undefined ? undefined : [name, names[0]];
  return names.includes(path[0] ?? "") || names.length !== 1 ? [name, port] : [name, `${names[0]}.${port}`];
}

function inBus(declared: string, source: string): boolean {
  return declared === source || declared.startsWith(`${source}.`);
}

/** Write a source: the part alone if it has one output. */
export function sourceText(part: Part, port: string, shapes: Shapes): string {
  const names = tops(shapes.of(part.item).outputs);
  return names.length === 1 && names[0] === port ? part.name : `${part.name}.${port}`;
}

function ofCustom(block: Block): Shape {
  const params = items(block.json["params"]).map(parameterOf);
  return {
    inputs: items(block.json["inputs"]).map(portOf),
    outputs: items(block.json["outputs"]).map(portOf),
    params,
    structure: writeJson({ ...block.json, params: items(block.json["params"]).map(withoutValue) }).replace(PLACE, ""),
  };
}

/** Place of a state, which changes no program. */
const PLACE = /"position": \[[^\]]*\](, )?/g;

export function withoutValue(declared: JsonObject): JsonObject {
  const { value: _, ...rest } = declared;
  return rest;
}

function items(json: Json | undefined): JsonObject[] {
  return isList(json) ? json.filter(isObject) : [];
}

export function portOf(declared: JsonObject): Port {
  const width = declared["width"];
  const shape = declared["shape"];
  const elements = isList(shape) ? shape.reduce((n: number, one) => n * plainNumber(one, 1), 1) : null;
  return {
    name: declaredName(declared),
    kind: typeof declared["kind"] === "string" ? declared["kind"] : isObject(declared["enum"]) ? "int32" : "real",
    width: width instanceof Num ? width.value : elements,
    unit: typeof declared["unit"] === "string" ? declared["unit"] : "",
  };
}

export function parameterOf(declared: JsonObject): Parameter {
  return {
    ...portOf(declared),
    value: plain(declared["value"] ?? null),
    low: bound(declared["low"]),
    high: bound(declared["high"]),
    text: typeof declared["text"] === "string" ? declared["text"] : "",
  };
}

/** Return whether a diagram can declare a parameter like that of a block: a number, or a list. */
export function canBeParameter({ value, width }: Parameter): boolean {
  const all = width === null ? [value] : value;
  return Array.isArray(all) && all.every((one) => typeof one === "number" || typeof one === "boolean");
}

function bound(json: Json | undefined): number | null {
  return json instanceof Num ? json.value : null;
}

function plainNumber(json: Json, otherwise: number): number {
  return json instanceof Num ? json.value : otherwise;
}

export function plain(json: Json): unknown {
  if (json instanceof Num) return json.value;
  if (isList(json)) return json.map(plain);
  if (isObject(json)) {
    if (Object.keys(json).length === 1 && typeof json["float"] === "string")
      return Number(json["float"].replace("inf", "Infinity"));
    return Object.fromEntries(Object.entries(json).map(([key, value]) => [key, plain(value)]));
  }
  return json;
}
