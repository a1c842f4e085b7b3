// What a person fills in for each kind of excitation. The server's library knows what it means, and what cannot be.
import type { Excitation, Loop } from "../../../api/drones";
import { controlLoop } from "../../../loops";

/** Field of the form; the unit "amplitude" is that of the loop. */
export type Field =
  | (Named & { type: "number"; unit: string; value: number; low: number; high: number; whole?: boolean })
  | (Named & { type: "numbers"; unit: string; values: readonly number[] })
  | (Named & { type: "choice"; choices: readonly string[]; value: string });
interface Named {
  name: string;
  label: string;
}

export interface Kind {
  kind: string;
  label: string;
  text: string;
  fields: readonly Field[];
}

const DEG = Math.PI / 180;
/** Initial amplitudes, well within the stops. */
const AMPLITUDES: Record<Loop, number> = { theta: 5 * DEG, q: 30 * DEG, M: 0.03, v: 0.15, x: 0.1 };
const LARGEST: Record<Loop, number> = { theta: 50 * DEG, q: 10, M: 1, v: 2, x: 0.4 };

type NumberEntry = Extract<Field, { type: "number" }>;
function number(name: string, label: string, unit: string, value: number, low: number, high: number): NumberEntry {
  return { name, label, type: "number", unit, value, low, high };
}
const seconds = (name: string, label: string, value: number, low = 0): Field =>
  number(name, label, "s", value, low, 3600);
const hertz = (name: string, label: string, value: number): Field => number(name, label, "Hz", value, 0, 125);
const whole = (name: string, label: string, value: number, low: number, high: number): Field => {
  return { ...number(name, label, "", value, low, high), whole: true };
};
const numbers = (name: string, label: string, unit: string, values: readonly number[]): Field => {
  return { name, label, type: "numbers", unit, values };
};

const kind = (kind: string, label: string, text: string, ...fields: Field[]): Kind => ({ kind, label, text, fields });

const HOLD = 0.001;

/** Return the kinds with initial values for a loop. */
export function kinds(loop: Loop): readonly Kind[] {
  const most = LARGEST[loop];
  const amplitude = (name = "amplitude", label = "Amplitude"): Field =>
    number(name, label, "amplitude", AMPLITUDES[loop], -most, most);
  const slow = loop === "x" || loop === "v";
  const scale = slow ? 4 : 1;
  const levels = [1, 0, -1, 0].map((sign) => sign * AMPLITUDES[loop]);
  const harmonics = slow ? [1, 2, 3, 5, 7] : [2, 3, 5, 7, 11, 13, 19, 29];
  const laws = { choices: ["linear", "logarithmic"], value: "logarithmic" };
  return [
    kind(
      "impulse",
      "Impulse",
      "A short pulse, then the free response.",
      amplitude(),
      seconds("width", "Width", 0.2 * scale, HOLD),
    ),
    kind(
      "doublet",
      "Doublet",
      "The amplitude for half a period, then its opposite.",
      amplitude(),
      seconds("period", "Period", 0.6 * scale, 2 * HOLD),
    ),
    kind(
      "3-2-1-1",
      "3-2-1-1",
      "Plus, minus, plus, minus for 3, 2, 1 and 1 times a step: a broader band than a doublet's.",
      amplitude(),
      seconds("step", "Step", 0.2 * scale, HOLD),
    ),
    kind(
      "steps",
      "Steps",
      "Levels, one after the other.",
      numbers("levels", "Levels", "amplitude", levels),
      seconds("hold", "Each held for", slow ? 4 : 2, HOLD),
    ),
    kind(
      "sweep",
      "Sweep",
      "A sine whose frequency rises.",
      amplitude(),
      hertz("start_hz", "From frequency", slow ? 0.1 : 0.2),
      hertz("end_hz", "To frequency", slow ? 1 : 4),
      seconds("length", "Length", 20, HOLD),
      { name: "law", label: "Frequency rises", type: "choice", ...laws },
    ),
    kind(
      "prbs",
      "PRBS",
      "A binary sequence that looks random, of 2^order − 1 bits.",
      amplitude(),
      seconds("clock", "Each bit lasts", slow ? 0.4 : 0.06, HOLD),
      whole("order", "Order", slow ? 5 : 7, 2, 16),
      whole("seed", "Seed", 1, 1, 65535),
    ),
    kind(
      "multisine",
      "Multisine",
      "A sum of sines with phases that keep its peak low (Schroeder).",
      amplitude("peak", "Peak"),
      seconds("period", "Period", 10, HOLD),
      numbers("harmonics", "Harmonics of 1/period", "", harmonics),
    ),
  ];
}

/** Return the kind of a name, or the first. */
export function kindOf(loop: Loop, name: string): Kind {
  const all = kinds(loop);
  return all.find((one) => one.kind === name) ?? all[0]!;
}

export const COMMON: readonly Field[] = [
  seconds("lead", "Rest before", 0.5),
  whole("repeat", "Repetitions", 1, 1, 100),
  seconds("pause", "Pause between", 0),
  seconds("settle", "Rest after", 2),
];

export type Values = Record<string, number | readonly number[] | string>;

export function initial(kind: Kind): Values {
  return Object.fromEntries(
    [...kind.fields, ...COMMON].map((field) => [field.name, field.type === "numbers" ? field.values : field.value]),
  );
}

/** Return the library's JSON; of a multisine the peak, from which the server computes amplitudes and phases. */
export function excitationOf(kind: Kind, loop: Loop, values: Values): Excitation {
  const given = [...kind.fields, ...COMMON].map((field) => [field.name, values[field.name]]);
  return { kind: kind.kind, version: 1, unit: controlLoop(loop).unit, ...Object.fromEntries(given) } as Excitation;
}

export function unitOf(field: Field, loop: Loop): string {
  if (field.type === "choice") return "";
  return field.unit === "amplitude" ? controlLoop(loop).unit : field.unit;
}
