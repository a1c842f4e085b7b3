/** What a curve is: each has one colour, on every page. */
export const KINDS = ["measured", "estimate", "set-point", "input", "truth", "simple", "grey-box"] as const;
export type Kind = (typeof KINDS)[number];

/** Curves of the same kind, such as flights laid over each other, take these in turn: tokens of design/tokens.css. */
export const SERIES = [1, 2, 3, 4, 5, 6, 7, 8].map((n) => `series-${n}`);

/** A column on a strip chart: its name in the subscription, label, unit on the screen, and the factor from SI to it. */
export interface Channel {
  column: string;
  label: string;
  kind: Kind;
  unit: string;
  factor?: number;
  /** Token of its colour where the kind's is taken, such as "series-2". */
  colour?: string;
}

/** A curve of a static plot: y over x, rising in x, with a band around it if there is one. */
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

/** What tells set-points from responses where colours do not. */
export const DASHES: Partial<Record<Kind, readonly number[]>> = { "set-point": [6, 4], truth: [2, 3] };
