import { screenUnit } from "../design/units";

export { DEGREES } from "../design/units";

/** Kinds of curves; each has one colour on every page. */
export type Kind = "measured" | "estimate" | "set-point" | "input" | "truth" | "simple" | "grey-box";

/** Colours of curves of one kind, such as compared flights: tokens of design/tokens.css. */
export const SERIES = [1, 2, 3, 4, 5, 6, 7, 8].map((n) => `series-${n}`);

/** Column on a strip chart, with the unit of the screen and the factor from SI. */
export interface Channel extends Omit<Stroke, "dash"> {
  column: string;
  unit: string;
  factor?: number;
}

/** How a curve is drawn and called. */
export interface Stroke {
  label: string;
  kind: Kind;
  colour?: string;
  dash?: readonly number[];
}

/** Channels of one strip chart. */
export interface Panel {
  label: string;
  channels: readonly Channel[];
  /** The y axis is never narrower than this, in the unit of the screen. */
  least: number;
}

/** Curve of a static plot, rising in x. */
export interface Series extends Stroke {
  /** One of many, drawn thin, without a place in the legend. */
  faint?: boolean;
  x: Float64Array;
  y: Float32Array | Float64Array;
  band?: { low: Float32Array | Float64Array; high: Float32Array | Float64Array };
}

/** Convert SI values to the unit of the screen; null becomes NaN. */
export function scaled(values: ArrayLike<number | null>, unit = ""): Float64Array {
  const { factor } = screenUnit(unit);
  return Float64Array.from(values, (value) => (value === null ? NaN : value * factor));
}

/** Return the curve of `y` [`unit`], SI, with a band in the same unit. */
export function curve(
  label: string,
  kind: Kind,
  x: ArrayLike<number>,
  y: ArrayLike<number | null>,
  unit = "",
  { band, ...more }: { band?: { low: number[]; high: number[] }; colour?: string; dash?: readonly number[] } = {},
): Series {
  const made: Series = { label, x: Float64Array.from(x), y: scaled(y, unit), kind, ...more };
  return band === undefined ? made : { ...made, band: { low: scaled(band.low, unit), high: scaled(band.high, unit) } };
}

export const DASHES: Partial<Record<Kind, readonly number[]>> = { "set-point": [6, 4], truth: [2, 3] };
