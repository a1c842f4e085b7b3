// What of a diagram its compiled program depends on, and the values of parameters that can be set in the program instead.
import type { Value } from "../../../wasm/signal";
import { diagramTo, declaredName, partTo, type Diagram, type Part } from "./diagram";
import type { JsonObject } from "./json_text";
import { parameterOf, withoutValue, type Shapes } from "./shapes";
import { writeJson } from "./json_text";

/** Equal for diagrams of one program, which differ in values of parameters, places and texts only. */
export function structureOf(d: Diagram, shapes: Shapes): string {
  return writeJson(withoutValues(d, shapes));
}

function withoutValues(d: Diagram, shapes: Shapes): JsonObject {
  return {
    ...diagramTo({ ...d, parts: [] }),
    text: "",
    params: d.params.map((one) => (settable(one) ? withoutValue(one) : one)),
    parts: d.parts.map((part) => skeleton(part, shapes)),
  };
}

function skeleton(part: Part, shapes: Shapes): JsonObject {
  const { item } = part;
  const form = partTo({ ...part, position: null, flipped: false, item: { is: "block", type: "", json: {} } });
  if (item.is === "diagram") return { ...form, block: withoutValues(item, shapes) };
  const structure = shapes.of(item).structure;
  // Of a block whose shape is not known yet all counts.
  return { ...form, block: structure === "" ? item.json : { type: item.type, structure } };
}

function settable(declared: JsonObject): boolean {
  return valueOf(parameterOf(declared).value) !== undefined && declared["shape"] === undefined;
}

/** Return the values of unbound parameters by path. */
export function parameterValues(d: Diagram, shapes: Shapes, prefix = ""): Record<string, Value> {
  const found: Record<string, Value> = {};
  for (const declared of d.params) {
    const value = settable(declared) ? valueOf(parameterOf(declared).value) : undefined;
    if (value !== undefined) found[prefix + declaredName(declared)] = value;
  }
  for (const part of d.parts) {
    const inner =
      part.item.is === "diagram"
        ? parameterValues(part.item, shapes, `${prefix}${part.name}.`)
        : blockValues(part, shapes, `${prefix}${part.name}.`);
    for (const [path, value] of Object.entries(inner)) {
      if (part.params[path.slice(prefix.length + part.name.length + 1)] === undefined) found[path] = value;
    }
  }
  return found;
}

function blockValues(part: Part, shapes: Shapes, prefix: string): Record<string, Value> {
  if (part.item.is === "diagram" || part.item.type === "state_machine") return {};
  const rows = shapes.of(part.item).params.map((one) => [prefix + one.name, valueOf(one.value)] as const);
  return Object.fromEntries(rows.filter((row): row is [string, Value] => row[1] !== undefined));
}

function valueOf(value: unknown): Value | undefined {
  const one = numberOf(value);
  if (one !== undefined) return one;
  if (!Array.isArray(value)) return undefined;
  const many = value.map(numberOf);
  return many.every((v): v is number => v !== undefined) ? many : undefined;
}

function numberOf(value: unknown): number | undefined {
  if (typeof value === "number") return value;
  if (typeof value === "boolean") return Number(value);
  const special = (value as { float?: unknown } | null)?.float;
  return typeof special === "string" ? Number(special.replace("inf", "Infinity")) : undefined;
}
