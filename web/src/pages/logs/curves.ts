// What the server tells of a log as series of plots: each kind of curve has its colour.

import type { LogView, PackedCurve } from "../../api/logs";
import { type Kind, type Series, SERIES } from "../../chart/kinds";
import { float32s, float64s, staircase } from "./unpack";

export interface Panel {
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

/** Return the plots of a view. Compared flights have the same colour in every plot. */
export function panels(view: Pick<LogView, "views">, flights: readonly string[] = []): Panel[] {
  return view.views.map((one) => {
    const [label, unit] = nameAndUnit(one.label);
    return { label, unit, series: one.curves.map((curve, place) => series(curve, place, flights)) };
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
