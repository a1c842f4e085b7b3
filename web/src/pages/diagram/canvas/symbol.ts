// What stands on a block, and how large it is.
import { STATE } from "../model/chart";
import { commented } from "../model/comment";
import type { Block, Diagram, Part } from "../model/diagram";
import { isObject, Num, type Json, type JsonObject } from "../model/json_text";
import { fromLibrary, tops, type Shape } from "../model/shapes";

const PITCH = 20; // between two ports
const GRID = 10;

export function configOf(item: Block | Diagram): JsonObject {
  const config = item.is === "block" ? item.json["config"] : undefined;
  return isObject(config) ? config : {};
}

const FIXED: Readonly<Record<string, string>> = {
  sum: "Σ",
  divide: "÷",
  abs: "|u|",
  sign: "sgn",
  unit_delay: "z⁻¹",
  integrator: "1/s",
  discrete_integrator: "T Σ",
  discrete_derivative: "Δ/T",
  transfer_function: "B(s)/A(s)",
  discrete_transfer_function: "B(z)/A(z)",
  state_space: "A B C D",
  discrete_state_space: "A B C D",
  switch: "a | b",
  pid: "PID",
  minimum: "min",
  maximum: "max",
  saturation: "limit",
  dead_zone: "dead zone",
  mux: "mux",
  demux: "demux",
  matrix_gain: "K u",
  hypot: "√(a²+b²)",
  power: "aᵇ",
  bias: "u + b",
};

const SHOWN: Readonly<Record<string, string>> = {
  ...{ gain: "k", constant: "value", trigonometry: "function", elementary: "function", rounding: "function" },
  ...{ logic: "operation", bitwise: "operation", compare: "operation" },
};

export function symbol(part: Part): string {
  const { item } = part;
  const held = commented(part)?.held;
  if (held) return symbol(held);
  if (item.is === "diagram") return item.name;
  if (!fromLibrary(item)) {
    return typeof item.json["name"] === "string" ? item.json["name"] : item.type;
  }
  const config = configOf(item);
  const of = (key: string): string => part.params[key] ?? shown(config[key]);
  const argument = SHOWN[item.type];
  if (argument !== undefined) return of(argument);
  if (item.type === "product") return of("operations") === "*/" ? "×÷" : "×";
  if (item.type === "compare_to_constant") return `${of("operation")} ${of("constant")}`;
  if (item.type === "delay") return `z⁻${superscript(of("samples"))}`;
  return FIXED[item.type] ?? item.type.replace(/^models\./, "").replace(/_/g, " ");
}

export function shown(value: Json | undefined): string {
  if (value === undefined || value === null) return "";
  if (value instanceof Num) return String(Number(value.value.toPrecision(4)));
  if (typeof value === "object") return "[…]";
  return String(value);
}

function superscript(text: string): string {
  return [...text].map((c) => "⁰¹²³⁴⁵⁶⁷⁸⁹"["0123456789".indexOf(c)] ?? c).join("");
}

export function portSign({ item }: Part, index: number): string {
  if (item.is === "block" && item.type === STATE) return "›";
  if (item.is === "diagram" || (item.type !== "sum" && item.type !== "product")) return "";
  const signs = configOf(item)[item.type === "sum" ? "signs" : "operations"];
  if (typeof signs !== "string") return "";
  if (item.type === "sum") return (signs[index] ?? "").replace("-", "−");
  return signs[index] === "/" ? "÷" : "×";
}

export interface Size {
  readonly width: number;
  readonly height: number;
}

const sizes = new WeakMap<Part, { readonly shape: Shape; readonly size: Size }>();

export function partSize(part: Part, shape: Shape): Size {
  const known = sizes.get(part);
  if (known?.shape === shape) return known.size;
  const size = measured(part, shape);
  sizes.set(part, { shape, size });
  return size;
}

function measured(part: Part, shape: Shape): Size {
  const held = commented(part)?.held;
  if (held) return measured(held, shape);
  const inputs = tops(shape.inputs);
  const outputs = tops(shape.outputs);
  const named = (names: readonly string[]): number => (names.length > 1 ? Math.max(...names.map((n) => n.length)) : 0);
  const signed = portSign(part, 0) !== "";
  const sides = (signed ? 1 : 5.4 * named(inputs)) + 5.4 * named(outputs);
  const own = part.item.is === "diagram" || !fromLibrary(part.item);
  const wanted = symbol(part).length * 7 + (own ? 2 : 1) * sides + 22;
  const width = Math.min(own ? 200 : 100, Math.max(50, GRID * Math.ceil(wanted / GRID)));
  const height = Math.max(40, PITCH * Math.max(inputs.length, outputs.length) + PITCH);
  return { width, height };
}

export function portPlace(index: number, count: number, height: number): number {
  const first = GRID * Math.round((height - PITCH * (count - 1)) / 2 / GRID);
  return first + PITCH * index;
}
