// What the server tells of a log as series of plots: each kind of curve has its colour.

import type { LogView, PackedCurve } from "../../api/logs";
import { type Kind, type Series, SERIES } from "../../chart/kinds";
import { Curve } from "../../chart/draw/curve";
import { float32s, float64s, staircase } from "./unpack";

export interface Panel {
  /** The same for each window of a log. */
  key: string;
  label: string;
  unit: string;
  series: Series[];
}

const KIND: Record<string, Kind> = {
  true: "truth",
  estimated: "estimate",
  "set-point": "set-point",
  "moment M": "input",
  "thrust T": "simple",
};

/** Split "pitch θ [deg]" into name and unit. */
export function nameAndUnit(label: string): [string, string] {
  const match = /^(.*) \[([^\]]*)\]$/.exec(label);
  return match ? [match[1]!, match[2] === "–" ? "" : match[2]!] : [label, ""];
}

/** Return the plots of a view; the first `own` are the user's. Compared flights have the same colour in every plot. */
export function panels(view: Pick<LogView, "views">, flights: readonly string[] = [], own = 0): Panel[] {
  return view.views.map((one, k) => {
    const [label, unit] = nameAndUnit(one.label);
    const lines = one.curves.map((curve, place) => series(curve, place, flights));
    return { key: k < own ? `own-${k}` : label, label, unit, series: lines };
  });
}

function series(curve: PackedCurve, place: number, flights: readonly string[]): Series {
  const [time, value] = [float64s(curve.time), float32s(curve.value)];
  const line = curve.held ? staircase(time, value) : { x: time, y: value };
  const flight = flights.indexOf(curve.label);
  const kind = KIND[curve.label];
  const made: Series = { label: curve.label, ...line, kind: flight >= 0 ? "estimate" : (kind ?? "estimate") };
  if (flight >= 0) made.colour = SERIES[flight % SERIES.length]!;
  else if (kind === undefined) made.colour = SERIES[place % SERIES.length]!;
  return made;
}

/** Return whether samples were left out. */
export function isThinned(shown: readonly Panel[], points: number): boolean {
  return shown.some((panel) => panel.series.some((one) => one.x.length >= 0.8 * points));
}

/** Put the samples of a finer curve in place of those of `whole` between its ends. */
export function spliced(whole: Series, finer: Series): Series {
  const from = whole.x.filter((x) => x < (finer.x[0] ?? Infinity)).length;
  const rest = whole.x.filter((x) => x > (finer.x.at(-1) ?? -Infinity)).length;
  const joined = (all: Series["y"], part: Series["y"]): Float64Array =>
    Float64Array.of(...all.subarray(0, from), ...part, ...all.subarray(all.length - rest));
  return finer.x.length ? { ...whole, x: joined(whole.x, finer.x), y: joined(whole.y, finer.y) } : whole;
}

/** Return the rows of a plot in the table of cursors. */
export function cursorRows(panel: Panel): { label: string; unit: string; at: (x: number) => number }[] {
  return panel.series.map((one) => {
    const drawn = new Curve(one);
    return { label: `${panel.label}, ${one.label}`, unit: panel.unit, at: (x) => drawn.at(x) };
  });
}
