/** Kinds of curves; each has one colour on every page. */
export type Kind = "measured" | "estimate" | "set-point" | "input" | "truth" | "simple" | "grey-box";

/** Colours of curves of one kind, such as compared flights: tokens of design/tokens.css. */
export const SERIES = [1, 2, 3, 4, 5, 6, 7, 8].map((n) => `series-${n}`);

/** Column on a strip chart, with the unit of the screen and the factor from SI. */
export interface Channel {
  column: string;
  label: string;
  kind: Kind;
  unit: string;
  factor?: number;
  colour?: string;
}

/** Curve of a static plot, rising in x. */
export interface Series {
  label: string;
  x: Float64Array;
  y: Float32Array | Float64Array;
  kind: Kind;
  band?: { low: Float32Array | Float64Array; high: Float32Array | Float64Array };
  colour?: string;
  dash?: readonly number[];
}

export { DEGREES } from "../design/units";

export const DASHES: Partial<Record<Kind, readonly number[]>> = { "set-point": [6, 4], truth: [2, 3] };
